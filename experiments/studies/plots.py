"""Plots of a study: metrics over a parameter, one line for each value of another."""

import itertools
from collections.abc import Iterator, Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.metrics.metric import Metric
from experiments.reports.plots.style import FILTERED, UNSAFE, as_png, new_axes
from experiments.studies.case import Row
from experiments.studies.parameters import SEED
from experiments.studies.statistics import numbers, spread, varied
from experiments.studies.tables import label_text

PER_LINE = 2
"""Plots beside each other."""


def numeric_parameters(rows: Sequence[Row]) -> list[str]:
    """Parameters with at least two different numbers; the seed is none."""
    return [
        name for name, values in varied(rows).items() if name != SEED and sum(_is_number(value) for value in values) > 1
    ]


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def compared(rows: Sequence[Row], parameter: str) -> str | None:
    """The parameter whose values are told apart by colour: of words if there is one, of few values otherwise."""
    others = {name: values for name, values in varied(rows).items() if name not in (parameter, SEED)}
    of_words = [name for name, values in others.items() if any(isinstance(v, str | bool) for v in values)]
    few = [name for name, values in others.items() if len(values) <= len(FILTERED)]
    preferred = [name for name in ("filter", *of_words, *few) if name in few]
    return preferred[0] if preferred else None


@as_png
def plot_over(rows: Sequence[Row], parameter: str, metrics: Sequence[Metric]) -> Figure:
    """Each metric over a parameter: mean over all else, and its bootstrap interval."""
    by, count = compared(rows, parameter), -(-len(metrics) // PER_LINE)
    figure, axes = new_axes(count, min(PER_LINE, len(metrics)), 2.6 * count + 0.4)
    for axis, metric in zip(axes, metrics, strict=False):
        _draw_metric(axis, rows, parameter, by, metric)
    for axis in axes[len(metrics) :]:
        axis.set_visible(False)
    if by is not None:
        # containers, not only lines: their order is that of the values
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=6, title=by)
    return figure


def _draw_metric(axis: Axes, rows: Sequence[Row], parameter: str, by: str | None, shown: Metric) -> None:
    """One metric, a line for each value of ``by``."""
    for (label, line), colour in zip(_lines(rows, by), itertools.cycle(FILTERED), strict=False):
        _draw_line(axis, line, parameter, shown, label, colour)
    axis.set_title(shown.words)
    axis.set_xlabel(parameter)
    axis.set_ylabel(shown.unit)
    if shown.bad == "negative":
        axis.axhline(0.0, color=UNSAFE, lw=1.0)


def _lines(rows: Sequence[Row], by: str | None) -> Iterator[tuple[str, list[Row]]]:
    if by is None:
        yield "", list(rows)
        return
    for value in varied(rows)[by]:
        yield label_text(value), [row for row in rows if row.labels.get(by) == value]


def _draw_line(axis: Axes, rows: Sequence[Row], parameter: str, shown: Metric, label: str, colour: str) -> None:
    """Mean and interval at every value; where the parameter has no effect, a level line."""
    values = sorted({row.labels[parameter] for row in rows if _is_number(row.labels.get(parameter))})
    found = [(x, numbers([row for row in rows if row.labels.get(parameter) == x], shown.key)) for x in values]
    points = [(x, spread(y)) for x, y in found if y]
    if points:
        means = [shown.factor * s.mean for _, s in points]
        ends = (
            [shown.factor * (s.mean - s.low) for _, s in points],
            [shown.factor * (s.high - s.mean) for _, s in points],
        )
        axis.errorbar([x for x, _ in points], means, ends, fmt="o-", ms=3.5, capsize=2.5, color=colour, label=label)
    elif y := numbers(rows, shown.key):
        axis.axhline(shown.factor * spread(y).mean, color=colour, ls="--", label=label)
