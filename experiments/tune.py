"""Chooses alpha and epsilon of the safety filter from the disturbance that the robot's own runs show."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from controllers.config import FilterTuning, controller_config
from controllers.tuning_file import Tuning, read_tuning, write_tuning
from experiments.console import make_console, results_folder
from experiments.options import OutputOptions
from experiments.registry import experiment_of
from experiments.results import GUARANTEED
from experiments.study_options import TuneOptions
from experiments.study_pool import in_parallel
from experiments.tuning_measure import Measured, measure
from experiments.tuning_scenarios import TuningRun, tuning_runs
from experiments.warmup import warm_up
from robots.checks import require_between, require_positive
from robots.description import RobotDescription
from robots.errors import ConfigError, DescriptionError
from robots.loader import load_robot

LEAST, MOST = 0.05, 20.0
"""Range of epsilon: below, the room kept at rest is more than arms have; above, the ISSf term is as good as none."""

GROWTH = 2.0
"""Largest factor by which epsilon grows from one round to the next: what was measured was measured near the old one."""

CAUTION = 0.9
"""Where a margin was missed, epsilon sinks at least by this factor."""

OVERSHOOT = 0.25
"""Largest alpha times the motors' time constant and delay.

A velocity followed with time constant T makes the condition :math:`T \\ddot h + \\dot h + \\alpha h = 0`: h does not
overshoot 0 for :math:`\\alpha T \\le 1/4`."""


@dataclass(frozen=True, slots=True)
class Choice:
    """Parameters of one family.

    Attributes:
        alpha: [1/s].
        epsilon: ISSf parameter.
        settled: whether a round of runs with it has kept the margin, or nothing more is to be tried.
        note: what the last round said of it, in words.
        least: smallest barrier of that round [m or rad]; NaN before one.
        push: largest push of that round [m/s or rad/s].
        squared: median squared gradient of the rows that bound.
        where: run of the smallest barrier.
    """

    alpha: float
    epsilon: float
    settled: bool = False
    note: str = "not met"
    least: float = math.nan
    push: float = math.nan
    squared: float = math.nan
    where: str = ""

    @property
    def room(self) -> float:
        """Barrier kept at rest, of the median row that bound [m or rad]; NaN where none did."""
        return self.squared / (self.alpha * self.epsilon)


@dataclass(frozen=True, slots=True)
class Seen:
    """What one run left for the choice: how it ended, and what it measured."""

    run: TuningRun
    ended: str
    measured: tuple[Measured, ...]


@dataclass(frozen=True, slots=True)
class TuningTask:
    """One run as a task."""

    run: TuningRun
    file: Path
    margins: dict[str, float]

    def __call__(self) -> Seen:
        """Run and measure."""
        options = self.run.with_parameters(self.file)
        result = experiment_of(options).run(options)
        summary = result.summary
        ended = "fell" if summary["fell"] else ("was stopped" if summary["stop_cause"] else "")
        return Seen(self.run, ended, tuple(measure(result, self.run.families, self.margins)))


def tune(options: TuneOptions) -> int:
    """Tune, print what was found, write the file; returns 0 where every family that was met keeps its margin, else 1.

    Raises:
        SafeWbcError: an option is not allowed; nothing has run then.
    """
    robot = check_tune(options)
    console = make_console()
    with results_folder(OutputOptions(out=options.out), "tune") as folder:
        warm_up(console, robot)
        before = start_choices(robot, options)
        chosen = Tuner(robot, options, folder, console).run(before)
        tuning = Tuning(
            {family: {"alpha": c.alpha, "epsilon": c.epsilon} for family, c in chosen.items()},
            provenance(robot, options, chosen),
        )
        write_tuning(folder / "tuning.toml", tuning)
    console.print(choice_table(robot, before, chosen))
    console.print(f"parameters: {folder / 'tuning.toml'}")
    return 0 if all(c.settled or math.isnan(c.least) for c in chosen.values()) else 1


def check_tune(options: TuneOptions) -> RobotDescription:
    """Check every option before anything runs; returns the robot.

    Raises:
        SafeWbcError: one is not allowed, or none of the scenarios fits the robot's description.
    """
    for name in ("masses", "joint_friction"):
        low, high = getattr(options, name)
        require_between(name, low, 0.0, high)
    require_between("payload", options.payload, 0.0, 5.0)
    require_between("delay", options.delay, 0.0, 0.02)
    require_positive("margin", options.margin)
    require_positive("margin_angle", options.margin_angle)
    for alpha in options.alphas:
        require_positive("alphas", alpha)
    require_between("rounds", options.rounds, 1, 20)
    require_between("jobs", options.jobs, 1, 64)
    if unknown := sorted(set(options.only) - set(GUARANTEED)):
        raise ConfigError("only", unknown, "among " + ", ".join(GUARANTEED))
    robot = load_robot(options.robot)
    if not slopes(robot, options):
        highest = OVERSHOOT / lag(robot, options.delay)
        raise ConfigError(
            "alphas", options.alphas, f"with one of at most {highest:.3g} 1/s, which the motors can follow"
        )
    start_choices(robot, options)
    possible_runs(robot, options)
    return robot


def lag(robot: RobotDescription, delay: float) -> float:
    """Time in which the robot takes on a velocity it is told: that of eq. (15) of Lee et al., and the delay [s]."""
    config = controller_config(robot)
    return 1.0 / (config.dynwbc.kd + config.dynwbc.kp * config.dt) + delay


def slopes(robot: RobotDescription, options: TuneOptions) -> list[float]:
    """The alphas that the motors can follow, rising."""
    return sorted(a for a in set(options.alphas) if a * lag(robot, options.delay) <= OVERSHOOT)


def families_of(options: TuneOptions) -> tuple[str, ...]:
    """The families to tune."""
    return options.only or GUARANTEED


def start_choices(robot: RobotDescription, options: TuneOptions) -> dict[str, Choice]:
    """The parameters to start from, of every family."""
    safety: FilterTuning = controller_config(robot).safety
    if options.start is not None:
        safety = read_tuning(options.start, robot.name).applied(safety)
    return {f: Choice(getattr(safety, f).alpha, getattr(safety, f).epsilon) for f in GUARANTEED}


def possible_runs(robot: RobotDescription, options: TuneOptions) -> list[TuningRun]:
    """The runs that the robot's description has what it needs for.

    Raises:
        SafeWbcError: none of them.
    """
    possible, refusal = [], None
    for run in tuning_runs(robot, options):
        try:
            experiment_of(run.options).check(run.options)
        except DescriptionError as error:
            refusal = error
        else:
            possible.append(run)
    if not possible and refusal is not None:
        raise refusal
    return possible


class Tuner:
    """Rounds of runs, each with the parameters that the last one proposed.

    Args:
        robot: the description.
        options: checked.
        folder: the parameters of each round are kept there.
        console: for the progress.
    """

    def __init__(self, robot: RobotDescription, options: TuneOptions, folder: Path, console: Console) -> None:
        self._robot, self._options, self._folder, self._console = robot, options, folder, console
        self._runs = possible_runs(robot, options)
        self._margins = {f: options.margin_angle if f == "joint_limit" else options.margin for f in GUARANTEED}
        self._rounds = 0

    def run(self, before: dict[str, Choice]) -> dict[str, Choice]:
        """The parameters of every family."""
        tuned = families_of(self._options)
        chosen = {f: c if f in tuned else replace(c, settled=True, note="left as it was") for f, c in before.items()}
        chosen = self._first(chosen, before)
        for _ in range(self._options.rounds - 1):
            if all(c.settled for c in chosen.values()):
                break
            seen = self._round(chosen)
            chosen = {f: self._judge(f, c, before[f], seen) for f, c in chosen.items()}
        return chosen

    def _first(self, chosen: dict[str, Choice], before: dict[str, Choice]) -> dict[str, Choice]:
        """A round for every slope: of each family that one which keeps the least room at rest."""
        tried: list[dict[str, Choice]] = []
        for alpha in slopes(self._robot, self._options):
            # at rest the room of before
            start = {
                f: c if c.settled else replace(c, alpha=alpha, epsilon=min(MOST, c.epsilon * c.alpha / alpha))
                for f, c in chosen.items()
            }
            seen = self._round(start)
            tried.append({f: self._propose(f, c, before[f], seen) for f, c in start.items()})
        return {f: c if c.settled else self._best(before[f], [t[f] for t in tried]) for f, c in chosen.items()}

    def _best(self, before: Choice, tried: Sequence[Choice]) -> Choice:
        met = [c for c in tried if not math.isnan(c.squared) and not c.settled]
        if met:
            return min(met, key=lambda c: (c.room, c.alpha))
        # no row came to its limit, or every slope made a robot fall: nothing is known that could be better
        notes = [c.note for c in tried if c.settled]
        return replace(before, settled=True, note=notes[0] if notes else before.note)

    def _propose(self, family: str, choice: Choice, before: Choice, seen: Iterable[Seen]) -> Choice:
        """What the runs with these parameters allow; settled where they must not be taken."""
        judged = self._judge(family, choice, before, seen)
        if math.isnan(judged.squared) or judged.note.startswith("kept"):
            return judged
        allowed = self._allowed(family, seen)
        return replace(
            judged, settled=False, epsilon=float(np.clip(allowed, LEAST, min(MOST, GROWTH * choice.epsilon)))
        )

    def _allowed(self, family: str, seen: Iterable[Seen]) -> float:
        return min((m.epsilon for s in seen for m in s.measured if m.family == family), default=math.inf)

    def _judge(self, family: str, choice: Choice, before: Choice, seen: Iterable[Seen]) -> Choice:
        """The choice after a round of runs with it."""
        if choice.settled:
            return choice
        own = [s for s in seen if family in s.run.families]
        if fallen := [s for s in own if s.ended]:
            tried = f"alpha {choice.alpha:.3g}, epsilon {choice.epsilon:.3g}"
            note = f"kept: {fallen[0].run.name} {fallen[0].ended} with {tried}"
            return replace(before, settled=True, note=note)
        bound = [(m, s.run.name) for s in own for m in s.measured if m.family == family and m.binding]
        if not bound:
            return replace(choice, note="not met")
        worst, where = min(bound, key=lambda pair: pair[0].least)
        known = replace(
            choice,
            least=worst.least,
            where=where,
            push=max(m.push for m, _ in bound),
            squared=float(np.median([m.squared for m, _ in bound])),
        )
        if worst.least >= self._margins[family]:
            return replace(known, settled=True, note="keeps its margin")
        lower = min(self._allowed(family, own), CAUTION * choice.epsilon)
        return replace(known, epsilon=max(LEAST, lower), note="margin missed")

    def _round(self, chosen: dict[str, Choice]) -> list[Seen]:
        """All runs that measure a family which is not settled."""
        self._rounds += 1
        file = self._folder / f"round-{self._rounds}.toml"
        tables = {f: {"alpha": c.alpha, "epsilon": c.epsilon} for f, c in chosen.items()}
        write_tuning(file, Tuning(tables, {"robot": self._robot.name}))
        open_families = {f for f, c in chosen.items() if not c.settled}
        tasks = [TuningTask(r, file, self._margins) for r in self._runs if open_families & set(r.families)]
        self._console.print(f"round {self._rounds}: " + "; ".join(f"{f} {tables[f]}" for f in sorted(open_families)))
        return list(in_parallel(tasks, self._options.jobs, self._console))


def provenance(robot: RobotDescription, options: TuneOptions, chosen: dict[str, Choice]) -> dict[str, Any]:
    """What the parameters were tuned for, in TOML's types."""
    names = sorted({run.name for run in possible_runs(robot, options)})
    told: dict[str, Any] = {
        "robot": robot.name,
        "masses": list(options.masses),
        "joint_friction": list(options.joint_friction),
        "payload_kg": options.payload,
        "delay_s": options.delay,
        "margin_m": options.margin,
        "margin_rad": options.margin_angle,
        "alphas": slopes(robot, options),
        "seeds": [0],
        "runs": names,
    }
    for family, choice in chosen.items():
        told[f"{family}_note"] = choice.note
        if math.isfinite(choice.least):
            told[f"{family}_least"] = round(choice.least, 6)
    return told


def choice_table(robot: RobotDescription, before: dict[str, Choice], chosen: dict[str, Choice]) -> Table:
    """Parameters before and after, and what they were found from."""
    table = Table(title=robot.title, title_justify="left")
    for heading in (
        "family",
        "before: alpha, epsilon",
        "alpha",
        "epsilon",
        "push",
        "room at rest",
        "least h",
        "in",
        "",
    ):
        table.add_column(heading, justify="left" if heading in {"family", "in", ""} else "right")
    for family, c in chosen.items():
        old = before[family]
        unit, factor = ("rad", 1.0) if family == "joint_limit" else ("mm", 1e3)
        figures = [_number(c.push, 1.0, f"{'rad' if unit == 'rad' else 'm'}/s")]
        figures += [_number(x, factor, unit) for x in (c.room, c.least)]
        table.add_row(
            family,
            f"{old.alpha:.3g}, {old.epsilon:.3g}",
            f"{c.alpha:.3g}",
            f"{c.epsilon:.3g}",
            *figures,
            c.where,
            c.note,
        )
    return table


def _number(value: float, factor: float, unit: str) -> str:
    return f"{factor * value:.3g} {unit}" if math.isfinite(value) else "-"
