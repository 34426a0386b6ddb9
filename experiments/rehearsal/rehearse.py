"""``safewbc rehearse``: tasks and faults against a twin, a row each, resumed where it was interrupted."""

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from controllers.deployment.stages import Stage
from experiments.rehearsal.cores import AROUND, longest_pause
from experiments.rehearsal.fault_cases import BEFORE_CASES, FAULT_CASES, PROCESS_CASES, Expected, FaultCase
from experiments.rehearsal.in_process import Rehearsal
from experiments.rehearsal.judge import fault_figures, last_stage, task_figures
from experiments.rehearsal.performance import Performance
from experiments.rehearsal.processes import Pair, Place
from experiments.rehearsal.show import show_rows
from experiments.rehearsal.tasks import RehearsedTask, TwinVariant, task_called, variants
from experiments.running.deployment_tasks import build
from experiments.running.terminal import make_console
from experiments.scenarios.hardware_options import RehearseOptions
from experiments.scenarios.stand import Stand
from experiments.scenarios.walk import Walk
from robots.checks import require_between
from robots.errors import ConfigError, SafeWbcError
from robots.loader import load_robot
from sims.twin.twin import TwinConfig

ROWS = "rows.jsonl"
"""File of the results, a line each."""

TASK_NAMES = ("stand", "hands", "taichi", "walk", "turns", "fast")

DURING = {
    "stand": RehearsedTask("standing", Stand(duration=7.0), ("stand", "--duration", "7")),
    "walk": RehearsedTask("walking", Walk(duration=14.0), ("walk", "--duration", "14")),
}
"""Tasks that faults come into."""

AFTER = {"stand": 1.0, "walk": 5.0}
"""When they do, after the task's begin [s]."""

TO_THE_TASK = 90.0
"""How long a deployment may take from its start to its task [s]."""

AGAIN = 5
"""How often a rehearsal that is not as expected is played again at most, if the machine paused when it failed."""

TO_THE_END = 30.0
"""How long it may take from the task's end to its own [s]."""


@dataclass(frozen=True)
class Piece:
    """One rehearsal: ``key`` names it for good, ``play`` gives its row."""

    key: str
    play: Callable[[], dict[str, Any]]


def rehearse(options: RehearseOptions) -> int:
    """Rehearse, print the tables; 0 where all came as expected, 1 otherwise.

    Raises:
        SafeWbcError: an option is not allowed, or cyclonedds is not installed.
    """
    check(options)
    folder = options.out or Path("runs") / f"rehearsal-{time.strftime('%Y%m%d-%H%M%S')}"
    folder.mkdir(parents=True, exist_ok=True)
    rows = _rows(folder / ROWS)
    console = make_console()
    missing = [piece for piece in pieces(options, folder) if piece.key not in rows]
    for number, (key, row) in enumerate(_played(missing, options.jobs), 1):
        rows[key] = row
        with (folder / ROWS).open("a", encoding="utf-8") as file:
            file.write(json.dumps({"key": key} | row) + "\n")
        console.print(f"{number} of {len(missing)}: {key}: {'as expected' if is_good(row) else 'NOT as expected'}")
    wanted = [rows[piece.key] for piece in pieces(options, folder)]
    show_rows(console, wanted)
    console.print(f"results: {folder / ROWS}")
    return 0 if all(map(is_good, wanted)) else 1


def is_good(row: Mapping[str, Any]) -> bool:
    """Whether a task was done upright and with every true barrier above zero, or a fault answered as expected."""
    return bool(row["as_expected"] if "fault" in row else row["upright"] and row["safe"])


def check(options: RehearseOptions) -> None:
    """Refuse what cannot be done.

    Raises:
        SafeWbcError: an option is not allowed, or cyclonedds is not installed.
    """
    if not options.what:
        raise ConfigError("what", options.what, "one or more of tasks, faults, before, kills, short")
    require_between("seeds", options.seeds, 1, 1000)
    require_between("jobs", options.jobs, 1, 64)
    require_between("domain", options.domain, 1, 230)
    if options.in_process and {"before", "kills", "short"} & set(options.what):
        raise ConfigError("in_process", True, "left out with before, kills and short, which are about processes")
    if options.in_process and options.lockstep:
        raise ConfigError("lockstep", True, "left out with --in-process, where nobody has to wait for anybody")
    if options.jobs > 1 and not (options.in_process or options.lockstep):
        raise ConfigError(
            "jobs", options.jobs, "1 without --in-process or --lockstep: processes in real time need the machine"
        )
    if options.lockstep and options.domain + options.jobs > 231:
        raise ConfigError("domain", options.domain, f"at most {231 - options.jobs}, to have one for each of the jobs")
    if not options.in_process and find_spec("cyclonedds") is None:
        raise SafeWbcError("cyclonedds is not installed: pip install 'safewbc[g1]'")


def _rows(path: Path) -> dict[str, dict[str, Any]]:
    if not path.exists():
        return {}
    lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line.endswith("}")]
    return {line.pop("key"): line for line in lines}


def _played(missing: Sequence[Piece], jobs: int) -> Iterator[tuple[str, dict[str, Any]]]:
    if jobs == 1:
        for piece in missing:
            yield piece.key, play_fairly(piece)
        return
    played = Parallel(n_jobs=jobs, return_as="generator_unordered")(delayed(_play)(p) for p in missing)
    yield from played


def play_fairly(piece: Piece) -> dict[str, Any]:
    """Play it, and again where the machine paused when it failed; the row says how often."""
    row, again = piece.play(), 0
    while not is_good(row) and row.get("longest_pause_s", 0.0) > 0.0 and again < AGAIN:
        row, again = piece.play(), again + 1
    return row | {"again": again}


def _play(piece: Piece) -> tuple[str, dict[str, Any]]:
    return piece.key, piece.play()


def pieces(options: RehearseOptions, folder: Path) -> list[Piece]:
    """All rehearsals that the options ask for, in order."""
    found: list[Piece] = []
    places = _places(options)
    how = "in process" if options.in_process else next(places).how

    def task(name: str, twin: TwinVariant, into: Path) -> Callable[[], dict[str, Any]]:
        if options.in_process:
            return partial(play_task_in_process, task_called(name), twin, into)
        return partial(play_task, next(places), task_called(name), twin, into)

    def fault(during: str, case: FaultCase, into: Path) -> Callable[[], dict[str, Any]]:
        if options.in_process:
            return partial(play_fault_in_process, during, case, into)
        return partial(play_fault, next(places), during, case, into)

    for what in options.what:
        for name in TASK_NAMES if what == "tasks" else [w for w in (what,) if w in TASK_NAMES]:
            for twin in variants(options.seeds):
                key = f"{how}, {name}, seed {twin.seed}"
                found.append(Piece(key, task(name, twin, folder / key.replace(", ", "-"))))
        if what == "faults":
            cases = FAULT_CASES if options.in_process else FAULT_CASES + PROCESS_CASES
            for during in options.during:
                for case in _chosen(cases, options.fault):
                    key = f"{how}, {during}, {case.name}"
                    found.append(Piece(key, fault(during, case, folder / _file_name(key))))
        if what == "before":
            for case in _chosen(BEFORE_CASES, options.fault):
                key = f"{how}, before, {case.name}"
                found.append(Piece(key, partial(play_before, next(places), case, folder / _file_name(key))))
        if what == "kills":
            found += _kills(options.seeds, places, folder, how)
        if what == "short":
            case = next(case for case in FAULT_CASES if case.name == "remote: L2 + B")
            found.append(Piece(f"{how}, short", fault("stand", case, folder / "short")))
    return found


def _chosen(cases: Sequence[FaultCase], parts: Sequence[str]) -> list[FaultCase]:
    chosen = [case for case in cases if not parts or any(part in case.name for part in parts)]
    if not chosen:
        raise ConfigError("fault", ", ".join(parts), "part of a name: " + "; ".join(case.name for case in cases))
    return chosen


def _file_name(key: str) -> str:
    return "".join(letter if letter.isalnum() else "-" for letter in key)


def _places(options: RehearseOptions) -> Iterator[Place]:
    """Where processes meet, rehearsal by rehearsal: those side by side have a domain each."""
    domains = 231 - options.domain if options.jobs > 1 else 1
    for number in count():
        yield Place(options.domain + number % domains, options.lockstep)


def _kills(seeds: int, places: Iterator[Place], folder: Path, how: str) -> list[Piece]:
    """At an instant drawn from each seed the controller is killed, and at another one stopped."""
    found = []
    for seed in range(seeds):
        rng = np.random.default_rng([seed, 77])
        for case in PROCESS_CASES[:2]:
            during = "walk" if rng.random() < 0.7 else "stand"
            after = float(rng.uniform(0.5, 9.0 if during == "walk" else 5.0))
            key = f"{how}, kills, {case.name}, seed {seed}"
            play = partial(play_fault, next(places), during, case, folder / _file_name(key), after=after)
            found.append(Piece(key, play))
    return found


def play_task(place: Place, task: RehearsedTask, twin: TwinVariant, folder: Path) -> dict[str, Any]:
    """A task by processes."""
    with Pair(folder, place, twin.words(), task.words) as pair:
        pair.begin()
        pair.run_to_the_end(TO_THE_TASK + task.scenario.duration + TO_THE_END)
        return _task_row(place.how, task, twin, pair.finish())


def play_task_in_process(task: RehearsedTask, twin: TwinVariant, folder: Path) -> dict[str, Any]:
    """The same in this process."""
    folder.mkdir(parents=True, exist_ok=True)
    rehearsal = Rehearsal(build(task.scenario).deployment, twin.config(), folder / "truth.npz")
    return _task_row("in process", task, twin, rehearsal.finish())


def _task_row(how: str, task: RehearsedTask, twin: TwinVariant, performance: Performance) -> dict[str, Any]:
    head = {"how": how, "task": task.title, "seed": twin.seed, "mass_scale": twin.mass_scale, "drift": twin.gyro_drift}
    return head | task_figures(load_robot("g1"), performance) | _pause(performance)


def _pause(performance: Performance) -> dict[str, float]:
    """The machine's longest pause around the moment at which it was decided what came of it [s]."""
    at = performance.decided_at
    return {"longest_pause_s": longest_pause(performance.pauses, at - AROUND, at + AROUND)}


def play_fault(place: Place, during: str, case: FaultCase, folder: Path, after: float | None = None) -> dict[str, Any]:
    """A fault, by processes, at ``after`` the task's begin; at the usual time if not given [s]."""
    task, wait = DURING[during], AFTER[during] if after is None else after
    with Pair(folder, place, case.twin, task.words) as pair:
        pair.begin()
        if pair.run_to(Stage.TASK, TO_THE_TASK):
            pair.wait(wait)
            for order in case.orders:
                pair.order(order)
            if case.expected in (Expected.GUARDIAN, Expected.DRIVES_DAMP, Expected.DRIVES_HOLD):
                pair.wait(3.0)
            elif case.expected is Expected.GOES_ON:
                # what comes after the task is the same without a fault
                pair.run_to(Stage.STOPPING, task.scenario.duration + TO_THE_END)
            else:
                pair.run_to_the_end(task.scenario.duration + TO_THE_END)
        performance = pair.finish()
        return _fault_row(place.how, task, case, performance, pair.raised_at)


def play_fault_in_process(during: str, case: FaultCase, folder: Path) -> dict[str, Any]:
    """The same in this process."""
    folder.mkdir(parents=True, exist_ok=True)
    task = DURING[during]
    rehearsal = Rehearsal(build(task.scenario).deployment, TwinConfig(), folder / "truth.npz")
    rehearsal.run_to(Stage.TASK)
    rehearsal.run_for(AFTER[during])
    for order in case.orders:
        rehearsal.order(order)
    rehearsal.run_to(Stage.DAMPED, task.scenario.duration + TO_THE_END)
    rehearsal.run_for(1.0)
    return _fault_row("in process", task, case, rehearsal.performance(), rehearsal.raised_at)


def _fault_row(
    how: str, task: RehearsedTask, case: FaultCase, performance: Performance, raised_at: float
) -> dict[str, Any]:
    head = {"how": how, "during": task.title, "fault": case.name, "expected": case.expected.value}
    if not performance.orders:
        missed = {"as_expected": False, "cause": performance.cause, "end": last_stage(performance)}
        return head | missed | _pause(performance)
    return head | fault_figures(case, performance, raised_at) | _pause(performance)


def play_before(place: Place, case: FaultCase, folder: Path) -> dict[str, Any]:
    """A fault that is there before the deployment begins: its motors must be told nothing."""
    with Pair(folder, place, (), DURING["stand"].words) as pair:
        pair.begin(case.orders)
        pair.run_to_the_end(TO_THE_TASK)
        performance = pair.finish()
    assert pair.deployment is not None
    refusal = pair.deployment.lines[-1] if pair.deployment.lines else ""
    # a foreign writer's commands are counted too
    nothing = "foreign" in case.name or performance.figures.get("commands_received") == 0
    met = performance.exit_code == 2 and case.cause in refusal and nothing
    return {
        "how": place.how,
        "during": "before the start",
        "fault": case.name,
        "expected": case.expected.value,
        "as_expected": met,
        "cause": refusal.removeprefix("safewbc: "),
        "end": last_stage(performance),
    }
