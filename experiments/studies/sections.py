"""Studies that print tables for the documentation: sections of cases, each with the columns to show."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from experiments.metrics.metric import Metric
from experiments.reports.metric_tables import rows_table
from experiments.reports.table import show
from experiments.studies.case import Case, Row, Study
from experiments.studies.command import run_study, tell_failures
from experiments.studies.progress import study_console
from experiments.studies.runs import WarmUp
from experiments.studies.work import WorkOptions

Entries = Mapping[str, Any]
"""Metrics and labels of a row."""


@dataclass(frozen=True, slots=True)
class Section:
    """One table.

    Attributes:
        title: above it; empty for none.
        cases: one a line.
        columns: to show.
        note: a sentence below it, from the entries of the rows that did not fail.
        lines: the lines to show, from those entries; as they are if not given.
    """

    title: str
    cases: Sequence[Case]
    columns: tuple[Metric, ...]
    note: Callable[[Sequence[Entries]], str] | None = None
    lines: Callable[[Sequence[Entries]], Sequence[Entries]] | None = None


def print_sections(
    sections: Sequence[Section], title: str, robot: str, work: WorkOptions, folder: Path, command: str
) -> int:
    """Carry out what the sections need, and print the table of each as soon as its rows are there.

    Args:
        sections: in the order to print them.
        title: of the study.
        robot: whose controller every process warms up with.
        work: where the cases are evaluated.
        folder: of the study.
        command: line that makes the study.

    Returns:
        The exit code: 0, or 1 where cases failed.

    Raises:
        SafeWbcError: an option of the work is not allowed.
    """
    cases = [case for section in sections for case in section.cases]
    rows = run_study(Study(title, cases, WarmUp(robot), command), work, folder)
    done: list[Row] = []
    for section in sections:
        of_section = [next(rows) for _ in section.cases]
        done += of_section
        _print(section, of_section)
    # to its end: the results file is written then
    done += rows
    return tell_failures(done, folder)


def _print(section: Section, rows: Sequence[Row]) -> None:
    sound = [row.entries() for row in rows if row.error is None]
    lines = [row.entries() for row in rows] if section.lines is None else section.lines(sound)
    note = "" if section.note is None else section.note(sound)
    show(rows_table(lines, section.columns, section.title, note))
    seconds = sum(entries.get("cpu_s", 0.0) for entries in sound)
    study_console().print(f"{section.title or 'table'}: {len(rows)} cases, {seconds:.0f} s of processor time")
