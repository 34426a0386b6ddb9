"""A round of tuning: its runs as cases of one study, which grows by a round at a time."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from controllers.whole_body.tuning_file import Tuning, write_tuning
from experiments.recording.plain import plain
from experiments.recording.recording import GUARANTEED
from experiments.running.run import run
from experiments.studies.case import Case, Row, Study, content_key
from experiments.studies.command import run_study
from experiments.studies.progress import study_console
from experiments.studies.runs import WarmUp, run_key
from experiments.studies.store import CaseFailedError, RowStore
from experiments.studies.study_options import TuneOptions
from experiments.studies.tuning_measure import Measured, measure
from experiments.studies.tuning_scenarios import TuningRun
from robots.description import RobotDescription


@dataclass(frozen=True, slots=True)
class Seen:
    """What one run left for the choice.

    Attributes:
        run: that it is of.
        ended: how it ended before its time, in words; empty where it did not.
        measured: of each family.
    """

    run: TuningRun
    ended: str
    measured: tuple[Measured, ...]


def margins_of(options: TuneOptions) -> dict[str, float]:
    """The barrier to keep, by family [m or rad]."""
    return {f: options.margin_angle if f == "joint_limit" else options.margin for f in GUARANTEED}


@dataclass(frozen=True, slots=True)
class MeasuredRun:
    """Runs a scenario with parameters of the filter, and measures; what a case of the study evaluates.

    Attributes:
        run: to make.
        parameters: by family and name.
        margins: barrier to keep, by family [m or rad].
        robot: name of the robot that the parameters are of.
    """

    run: TuningRun
    parameters: Mapping[str, Mapping[str, float]]
    margins: Mapping[str, float]
    robot: str

    @property
    def key(self) -> str:
        """Stands for all that decides the row."""
        content = [run_key(self.run.options), self.run.families, self.parameters, self.margins]
        return content_key("tune", plain(content))

    def __call__(self, store: RowStore) -> dict[str, Any]:
        """The row. The parameters are left in the study's folder, in a file of their own, which the run takes."""
        file = store.folder / "parameters" / f"{content_key('tuning', plain(self.parameters))}.toml"
        file.parent.mkdir(exist_ok=True)
        with TemporaryDirectory(dir=file.parent) as beside:
            # the same parameters are written by several processes: each writes the same, and whole
            written = Path(beside) / file.name
            write_tuning(written, Tuning(self.parameters, {"robot": self.robot}))
            written.replace(file)
        result = run(self.run.with_parameters(file))
        return row_of(measure(result, self.run.families, dict(self.margins)), result.summary)


FIGURES = ("least", "epsilon", "push", "squared")
"""Attributes of :class:`Measured` that a row has by family; those that are not finite are left out."""


def row_of(measured: Sequence[Measured], summary: Mapping[str, Any]) -> dict[str, Any]:
    """A row, from what was measured and the summary of the run."""
    ended = "fell" if summary["fell"] else ("was stopped" if summary["stop_cause"] else "")
    row: dict[str, Any] = {"ended": ended, "stop_cause": summary["stop_cause"]}
    for m in measured:
        row[f"{m.family}_binding"] = m.binding
        figures = {name: getattr(m, name) for name in FIGURES}
        row |= {f"{m.family}_{name}": value for name, value in figures.items() if math.isfinite(value)}
    return row


def seen_in(run: TuningRun, entries: Mapping[str, Any]) -> Seen:
    """What the row of a run says; ``entries`` as :func:`row_of` makes them."""
    missing, found = {"least": math.nan, "epsilon": math.inf, "squared": math.nan}, []
    for family in run.families:
        if f"{family}_binding" in entries:
            names = ("binding", *FIGURES)
            kept = {name: entries[f"{family}_{name}"] for name in names if f"{family}_{name}" in entries}
            found.append(Measured(family, **missing | kept))
    return Seen(run, entries["ended"], tuple(found))


class TuningRounds:
    """Carries out rounds; what an earlier process did of them in the same folder is not done again."""

    def __init__(self, robot: RobotDescription, options: TuneOptions, folder: Path, command: str) -> None:
        """For checked options; ``folder`` of the study, and ``command`` that makes it."""
        self._robot, self._options, self._folder, self._command = robot, options, folder, command
        self._margins = margins_of(options)
        self._cases: list[Case] = []
        self._rounds = 0

    def __call__(
        self, runs: Sequence[TuningRun], parameters: Mapping[str, Mapping[str, float]], families: Sequence[str]
    ) -> list[Seen]:
        """What runs come to with parameters by family and name; ``families`` are those that they are made for.

        Raises:
            CaseFailedError: a run failed.
        """
        self._rounds += 1
        cases = [self._case(run, parameters) for run in runs]
        self._cases += cases
        told = "; ".join(f"{f} {dict(parameters[f])}" for f in families)
        study_console().print(f"round {self._rounds}: {told}", highlight=False)
        title = f"Tuning of {self._robot.title}, round {self._rounds}"
        study = Study(title, tuple(self._cases), WarmUp(self._options.robot), self._command)
        rows = list(run_study(study, self._options.work, self._folder))[-len(cases) :]
        return [self._seen(run, row) for run, row in zip(runs, rows, strict=True)]

    def _case(self, run: TuningRun, parameters: Mapping[str, Mapping[str, float]]) -> Case:
        made = MeasuredRun(run, parameters, self._margins, self._robot.name)
        return Case(made.key, {"round": self._rounds, "run": run.name}, made)

    def _seen(self, run: TuningRun, row: Row) -> Seen:
        if row.error is not None:
            cause = f"round {self._rounds}, run '{run.name}' failed: {row.error}; --retry-failed makes it again"
            raise CaseFailedError(cause)
        return seen_in(run, row.entries())
