"""Tables of a study's rows: a line for every combination with mean and interval over seeds, and pivots."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from experiments.metrics.catalogue import declared
from experiments.metrics.metric import Metric
from experiments.reports.table import Cell, Column, Table
from experiments.reports.table import Row as Line
from experiments.studies.case import Row
from experiments.studies.parameters import SEED
from experiments.studies.statistics import (
    CONFIDENCE,
    STATISTICS,
    Group,
    groups,
    numbers,
    numeric_metrics,
    require_metrics,
    varied,
)
from robots.checks import require_one_of
from robots.errors import UnknownNameError

USUAL = (
    "fell",
    "min_h_self_collision_m",
    "min_h_obstacle_m",
    "hand_rmse_m",
    "velocity_error_x_mps",
    "filtered_fraction",
    "max_torque_fraction",
)
"""Metrics that are shown where none are asked for, as far as the runs have them."""


def chosen_metrics(rows: Sequence[Row], asked: Sequence[str], own: Sequence[Metric] = ()) -> tuple[Metric, ...]:
    """The metrics to show: those asked for, or the usual ones and the study's own that rows have, or the first few.

    Args:
        rows: of the study.
        asked: names.
        own: metrics that the project does not declare.

    Raises:
        UnknownNameError: no row has one that is asked for.
    """
    require_metrics(rows, asked)
    known = numeric_metrics(rows)
    usual = (*USUAL, *(metric.key for metric in own))
    names = tuple(asked) or tuple(name for name in usual if name in known) or known[:6]
    return tuple(metric_called(name, own) for name in names)


def metric_called(name: str, own: Sequence[Metric] = ()) -> Metric:
    """How a metric is shown; as it is where nothing is known of it."""
    found = declared(name) or next((metric for metric in own if metric.key == name), Metric(name, name))
    return found if found.words else replace(found, words=name)


def _over_seeds(rows: Sequence[Row], metric: Metric) -> Metric:
    """How the mean of a metric is shown: of a yes or no, in how many of the runs."""
    values = [row.metrics[metric.key] for row in rows if row.metrics.get(metric.key) is not None]
    is_switch = all(isinstance(value, bool) for value in values)
    return replace(metric, unit="%", factor=1e2) if is_switch else metric


def label_text(value: Any) -> str:
    """A parameter's value for a table."""
    if value is None:
        return "-"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def study_table(rows: Sequence[Row], metrics: Sequence[Metric], title: str = "") -> Table:
    """A line for every combination of parameters that differ: mean over seeds, and its interval.

    Where runs failed or were stopped before their end, a column says how many.
    """
    found, shown = groups(rows), [_over_seeds(rows, metric) for metric in metrics]
    names = [name for name in varied(rows) if name != SEED] or [name for name in rows[0].labels if name != SEED][:1]
    failed, stopped = any(group.failures for group in found), any(group.stops for group in found)
    columns = [*(Column(name, words=True) for name in names), Column("runs")]
    columns += [Column("failed")] if failed else []
    columns += [Column("stopped")] if stopped else []
    columns += [Column(figure.words, figure.unit) for figure in shown]
    lines = []
    for group in found:
        cells: list[Cell | str] = [*(label_text(group.labels.get(name)) for name in names), str(len(group.rows))]
        cells += [str(group.failures)] if failed else []
        cells += [Cell(str(group.stops), bad=group.stops > 0)] if stopped else []
        lines.append(Line((*cells, *(_mean_text(group, figure) for figure in shown))))
    caption = ""
    if any(len(group.rows) > 1 for group in found):
        caption = f"Mean over seeds, and in square brackets its {100 * CONFIDENCE:.0f} % bootstrap interval."
    return Table(tuple(columns), tuple(lines), title, caption)


def _mean_text(group: Group, figure: Metric) -> str:
    found = group.spread(figure.key)
    if found is None:
        return "-"
    mean, low, high = (figure.text(x) for x in (found.mean, found.low, found.high))
    return mean if low == high == mean else f"{mean} [{low}, {high}]"


def pivot(
    rows: Sequence[Row],
    down: str,
    across: str | None,
    metric: str,
    statistic: str = "mean",
    own: Sequence[Metric] = (),
) -> Table:
    """One metric by one or two parameters; a statistic over all rows that share their values.

    Args:
        rows: of a study.
        down: parameter whose values are the lines.
        across: parameter whose values are the columns; ``None`` for a single column.
        metric: name of a metric.
        statistic: one of ``STATISTICS``.
        own: metrics that the project does not declare.

    Raises:
        SafeWbcError: a name is not known.
    """
    labels = list(dict.fromkeys(name for row in rows for name in row.labels))
    for name in (down, across):
        if name is not None and name not in labels:
            raise UnknownNameError("parameter", name, labels)
    require_metrics(rows, [metric])
    require_one_of("statistic", statistic, tuple(STATISTICS))
    figure, of_values = metric_called(metric, own), STATISTICS[statistic]
    over = [None] if across is None else _values(rows, across)
    columns = [
        Column(statistic if across is None else f"{across} {label_text(v)}", _unit(figure, statistic)) for v in over
    ]
    lines = []
    for value in _values(rows, down):
        line = [row for row in rows if row.labels.get(down) == value]
        cells = [line if across is None else [r for r in line if r.labels.get(across) == v] for v in over]
        lines.append(Line((label_text(value), *(_cell(cell, figure, statistic, of_values) for cell in cells))))
    others = [name for name in varied(rows) if name not in (down, across)]
    caption = f"{statistic} over " + ", ".join(others) if others else ""
    stops = sum(row.stop_cause is not None for row in rows)
    caption += f"{'; ' if caption else ''}{stops} of {len(rows)} runs were stopped before their end" if stops else ""
    return Table((Column(down, words=True), *columns), tuple(lines), f"{figure.words} ({metric})", caption)


def _values(rows: Sequence[Row], name: str) -> list[Any]:
    return list({repr(row.labels.get(name)): row.labels.get(name) for row in rows}.values())


def _unit(figure: Metric, statistic: str) -> str:
    return "" if statistic == "count" else figure.unit


def _cell(rows: Sequence[Row], figure: Metric, statistic: str, of_values: Callable[[Sequence[float]], float]) -> str:
    values = numbers(rows, figure.key)
    if not values:
        return "-"
    found = of_values(values)
    return str(found) if statistic == "count" else figure.text(float(found))
