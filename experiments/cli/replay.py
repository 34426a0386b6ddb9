"""A saved run made again from its scenario, and compared with what was saved."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.cli.replay_deployment import replay_deployment
from experiments.metrics.balance import versions
from experiments.recording.plain import plain
from experiments.recording.recording import Recording, load_recording
from experiments.running.deployment_replay import log_in
from experiments.running.ending import INTERRUPTED, InterruptionAt
from experiments.running.recorder import Progress
from experiments.running.run import run
from experiments.running.terminal import make_console, progress
from experiments.running.warmup import warm_up
from experiments.scenarios.options import ReplayOptions, refuse_without
from experiments.scenarios.registry import SCENARIO_FOLDER, read_scenario
from experiments.scenarios.scenario import Runnable
from robots.errors import ConfigError

TIMES = ("tick_ms", "stages", "filter_ms", "estimate_ms")
"""Recorded arrays that hold how long computing took: the only ones that may differ."""

VARYING = ("tick_ms_", "filter_ms_", "versions")
"""Beginnings of the entries of a summary that may differ for the same reason, or tell what else does."""

ROBOT = "robot_digest"
"""Entry of a configuration that tells a changed description."""


def replay(options: ReplayOptions) -> int:
    """Run a saved run again, or compute a deployment's commands, and print what differs; 0 where nothing does, else 1.

    Raises:
        SafeWbcError: the folder holds no run of this project, or one of its options is not allowed here.
    """
    if (log := log_in(options.folder)) is not None:
        return replay_deployment(log, options)
    refuse_without(options, False, ("report", "mcap"), "the log of a deployment")
    console = make_console()
    saved = load_recording(options.folder)
    if "scenario" not in saved.config:
        raise ConfigError("config.json", sorted(saved.config), "of a run of this project, with the entry 'scenario'")
    scenario = read_scenario(saved.config["scenario"], saved.config.get(SCENARIO_FOLDER))
    warm_up(console, saved.robot)
    with progress(console, [f"{scenario.name}, {saved.robot.title}"], float(saved.summary["duration_s"])) as advance:
        again = _run_again(saved, scenario, advance[0])
    differences = differences_of(saved, again)
    if not differences:
        console.print(_identical(saved))
        return 0
    for line in [*differences, *_reasons(saved, again)]:
        console.print(line)
    console.print(f"not identical: {len(differences)} of {_compared(saved, again)} differ")
    return 1


def _run_again(saved: Recording, scenario: Runnable, advance: Callable[[float], None]) -> Recording:
    """The same run, as far as the saved one got before a person stopped it."""
    interrupted = saved.summary.get("stop_cause") == INTERRUPTED
    ends = (InterruptionAt(saved.summary["duration_s"]),) if interrupted else ()
    return run(scenario, (Progress(advance), *ends))


def differences_of(saved: Recording, again: Recording) -> list[str]:
    """A line for everything recorded that is not the same: arrays, or metrics where no arrays were saved."""
    if saved.series:
        return array_differences(saved.series, again.series)
    before, now = _without_times(saved.summary), _without_times(again.summary)
    return [f"{n}: {before.get(n)} saved, {now.get(n)} now" for n in {**before, **now} if before.get(n) != now.get(n)]


def _without_times(summary: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in plain(summary).items() if not name.startswith(VARYING)}


def _identical(saved: Recording) -> str:
    if saved.series:
        return f"identical: {len(set(saved.series) - set(TIMES))} arrays, bit by bit"
    return f"identical: {len(_without_times(saved.summary))} entries of the summary (no arrays were saved)"


def _compared(saved: Recording, again: Recording) -> str:
    if saved.series:
        return f"{len((set(saved.series) | set(again.series)) - set(TIMES))} arrays"
    return f"{len(_without_times(saved.summary))} entries of the summary"


def array_differences(saved: Mapping[str, NDArray[Any]], again: Mapping[str, NDArray[Any]]) -> list[str]:
    """A line for every array but ``TIMES`` that is not the same bit by bit, by name."""
    lines = []
    for name in sorted((set(saved) | set(again)) - set(TIMES)):
        if name not in saved or name not in again:
            lines.append(f"{name}: only in the {'saved' if name in saved else 'new'} run")
        elif (line := _difference(saved[name], again[name])) is not None:
            lines.append(f"{name}: {line}")
    return lines


def _difference(a: NDArray[Any], b: NDArray[Any]) -> str | None:
    """How two arrays differ; ``None`` where they do not. NaN of the same bits is the same."""
    if a.shape != b.shape or a.dtype != b.dtype:
        return f"{a.dtype} {a.shape} saved, {b.dtype} {b.shape} now"
    if a.tobytes() == b.tobytes():
        return None
    rows = np.array([x.tobytes() != y.tobytes() for x, y in zip(np.atleast_1d(a), np.atleast_1d(b), strict=True)])
    gap = np.abs(a.astype(float) - b.astype(float))
    largest = f"{np.nanmax(gap):.3g}" if np.isfinite(gap).any() else "not a number"
    return f"first differs in row {int(np.argmax(rows))} of {len(rows)}, at most by {largest}"


def _reasons(saved: Recording, again: Recording) -> list[str]:
    """What else is not as it was: the robot's description, settings, and versions of packages."""
    before, now = _flat(plain(saved.config)), _flat(plain(again.config))
    reasons = []
    if before.pop(ROBOT, None) != now.pop(ROBOT, None):
        reasons.append(f"reason: the robot's description has changed since the run: {saved.config['robot']}")
    changes = _changes(before, now) + _changes(_flat(saved.summary.get("versions") or {}), _flat(plain(versions())))
    return reasons + [f"changed since: {line}" for line in changes]


def _changes(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    names = sorted(set(before) | set(now))
    return [f"{n}: {before.get(n)} -> {now.get(n)}" for n in names if before.get(n) != now.get(n)]


def _flat(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    out: dict[str, Any] = {}
    for key, value in table.items():
        out |= _flat(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {prefix + key: value}
    return out
