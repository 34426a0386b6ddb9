"""A round of tuning: its runs as cases of one study, which grows by a round at a time."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from controllers.whole_body.tuning_file import Tuning, write_tuning
from experiments.recording.recording import GUARANTEED, Recording
from experiments.studies.case import Case, Study, content_key
from experiments.studies.command import run_study
from experiments.studies.progress import study_console
from experiments.studies.runs import WarmUp, run_case
from experiments.studies.store import sound
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
class TuningRow:
    """Makes the row of a run; figures that are not finite are left out of it.

    Attributes:
        families: to measure.
        margins: barrier to keep, by family [m or rad].
    """

    families: tuple[str, ...]
    margins: Mapping[str, float]

    def __call__(self, result: Recording) -> dict[str, Any]:
        """The row."""
        return row_of(measure(result, self.families, dict(self.margins)), result.summary)


def row_of(measured: Sequence[Measured], summary: Mapping[str, Any]) -> dict[str, Any]:
    """A row, from what was measured and the summary of the run."""
    ended = "fell" if summary["fell"] else ("was stopped" if summary["stop_cause"] else "")
    row: dict[str, Any] = {"ended": ended, "stop_cause": summary["stop_cause"]}
    for m in measured:
        figures = {"least": m.least, "epsilon": m.epsilon, "push": m.push, "squared": m.squared}
        row[m.family] = {n: v for n, v in figures.items() if math.isfinite(v)} | {"binding": m.binding}
    return row


def seen_in(run: TuningRun, entries: Mapping[str, Any]) -> Seen:
    """What the row of a run says; ``entries`` as :func:`row_of` makes them."""
    missing = {"least": math.nan, "epsilon": math.inf, "squared": math.nan}
    found = [Measured(family, **missing | entries[family]) for family in run.families if family in entries]
    return Seen(run, entries["ended"], tuple(found))


class TuningRounds:
    """Carries out rounds; what an earlier process did of them in the same folder is not done again."""

    def __init__(self, robot: RobotDescription, options: TuneOptions, folder: Path, command: str) -> None:
        """For checked options; ``folder`` of the study, and ``command`` that makes it."""
        self._robot, self._options, self._folder, self._command = robot, options, folder, command
        self._margins = margins_of(options)
        self._cases: list[Case] = []
        self._rounds = 0

    def __call__(self, runs: Sequence[TuningRun], parameters: Mapping[str, Mapping[str, float]]) -> list[Seen]:
        """What runs come to with parameters by family and name.

        Raises:
            CaseFailedError: a run failed.
        """
        self._rounds += 1
        file = self._folder / "rounds" / f"{self._rounds}.toml"
        file.parent.mkdir(parents=True, exist_ok=True)
        write_tuning(file, Tuning(parameters, {"robot": self._robot.name}))
        cases = [self._case(run, file) for run in runs]
        self._cases += cases
        told = sorted({family for run in runs for family in run.families})
        study_console().print(
            f"round {self._rounds}: " + "; ".join(f"{f} {dict(parameters[f])}" for f in told), highlight=False
        )
        title = f"Tuning of {self._robot.title}, round {self._rounds}"
        study = Study(title, tuple(self._cases), WarmUp(self._options.robot), self._command)
        rows = list(run_study(study, self._options.work, self._folder))[-len(cases) :]
        return [seen_in(run, sound(row)) for run, row in zip(runs, rows, strict=True)]

    def _case(self, run: TuningRun, file: Path) -> Case:
        measure_row = TuningRow(run.families, self._margins)
        case = run_case(
            run.with_parameters(file), {"round": self._rounds, "run": run.name}, None, series=False, measure=measure_row
        )
        # what is measured depends on the margins
        return replace(case, key=content_key("tune", [case.key, run.families, self._margins]))
