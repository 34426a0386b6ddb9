"""Tables of figures: a row for each run, or the runs side by side."""

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any

from experiments.metrics.catalogue import known_metrics
from experiments.metrics.metric import GROUPS, Metric
from experiments.recording.plain import plain
from experiments.recording.recording import Recording, run_title
from experiments.reports.table import Cell, Column, Row, Table


def rows_table(
    rows: Sequence[Mapping[str, Any]], figures: Sequence[Metric], title: str = "", caption: str = ""
) -> Table:
    """A row for each of ``rows``, a column for each of the ``figures``; columns whose values are words to the left."""
    columns = (Column(f.words, f.unit, _all_words([row.get(f.key) for row in rows])) for f in figures)
    cells = (tuple(_cell(f, row.get(f.key)) for f in figures) for row in rows)
    return Table(tuple(columns), tuple(Row(line) for line in cells), title, caption)


def _all_words(values: Sequence[Any]) -> bool:
    return all(isinstance(value, str) for value in values)


def runs_table(results: Sequence[Recording]) -> Table:
    """The summaries of runs side by side: a column for each run, a row for each metric that one of them has.

    Metrics of a group stand under its name.
    """
    rows: list[Row] = []
    for group, lines in groupby(known_metrics(results), key=lambda line: line[0].group):
        rows.append(Row((GROUPS[group],), bold=True, section=True))
        rows += [_line(metric, [plain(v) for v in values]) for metric, values in lines]
    return Table((Column("", words=True), *(Column(run_title(r)) for r in results)), tuple(rows))


def _line(figure: Metric, values: Sequence[Any]) -> Row:
    return Row((figure.words, *(_cell(figure, v) for v in values)), figure.unit)


def _cell(figure: Metric, value: Any) -> Cell:
    return Cell(figure.text(value), figure.is_bad(value))
