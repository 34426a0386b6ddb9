"""The look that all plots share: sizes, colours, axes, legends."""

import io
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import ScalarFormatter
from numpy.typing import NDArray

from experiments.recording.recording import RunResult, filter_title, run_title

DPI = 110
WIDTH = 9.6
INK, GRID, UNSAFE = "#3a4450", "#e3e7ec", "#c62828"
UNFILTERED = "#d1495b"
FILTERED = ("#2368b0", "#2f9e6e", "#e08e1b", "#7a56a8", "#12888f", "#a0522d", "#5c6b7a", "#b83b8a")


def with_ticks(results: Sequence[RunResult]) -> list[RunResult]:
    """The runs that got to a first tick."""
    return [r for r in results if len(r.series["time"])]


def coloured(results: Sequence[RunResult]) -> Iterator[tuple[RunResult, str]]:
    """Each run with its colour: red without a filter, another for each further run."""
    free = iter(FILTERED * (1 + len(results) // len(FILTERED)))
    unfiltered = False
    for result in results:
        if filter_title(result) == "no filter" and not unfiltered:
            unfiltered = True
            yield result, UNFILTERED
        else:
            yield result, next(free)


def shade_unsafe(axis: Axes) -> None:
    """Red below zero, and a range that shows what happens near zero."""
    low, high = axis.get_ylim()
    nearest = min((np.nanmin(line.get_ydata()) for line in axis.get_lines()), default=0.0)
    low = min(-5.0, low)
    # a little room above, so that a level line does not hide under the frame
    axis.set_ylim(low, max(5.0, min(1.06 * high, max(80.0, -3.0 * low, 2.0 * nearest))))
    axis.axhspan(low, 0.0, color=UNSAFE, alpha=0.09, lw=0)
    axis.axhline(0.0, color=UNSAFE, lw=1.1)


def new_figure(rows: int, columns: int, height: float, sharex: bool = False) -> tuple[Figure, list[Axes]]:
    """A figure of the common width and ``height`` [inch], and its axes row by row."""
    figure = Figure(figsize=(WIDTH, height), dpi=DPI, layout="constrained")
    axes: NDArray[Any] = figure.subplots(rows, columns, sharex=sharex, squeeze=False)
    style_axes(list(axes.flat))
    return figure, list(axes.flat)


def style_axes(axes: Sequence[Axes]) -> None:
    """Grid, colours and spines that all plots have."""
    for axis in axes:
        for formatter in (axis.xaxis.get_major_formatter(), axis.yaxis.get_major_formatter()):
            if isinstance(formatter, ScalarFormatter):
                formatter.set_useOffset(False)
        axis.grid(True, color=GRID, lw=0.8)
        axis.set_axisbelow(True)
        axis.tick_params(colors=INK, labelsize=8, length=0)
        axis.xaxis.label.set_color(INK)
        axis.yaxis.label.set_color(INK)
        for side, spine in axis.spines.items():
            spine.set_visible(side in {"left", "bottom"})
            spine.set_color("#b8c1cb")


def shared_legend(figure: Figure, axis: Axes, columns: int) -> None:
    """One legend over the figure, of the lines of one of its axes."""
    handles, labels = axis.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=columns, frameon=False, fontsize=9)


def finish(figure: Figure, time_axes: Sequence[Axes], results: Sequence[RunResult] = ()) -> bytes:
    """Time labels, one legend of runs over the figure where there are any, sizes of text; the PNG."""
    for axis in time_axes:
        axis.set_xlabel("time [s]")
    for axis in figure.axes:
        axis.title.set(fontsize=9, color=INK, fontweight="bold")
        axis.xaxis.label.set(fontsize=8.5, color=INK)
        axis.yaxis.label.set(fontsize=8.5, color=INK)
        for line in axis.get_lines():
            line.set_linewidth(min(line.get_linewidth(), 1.4))
        if (legend := axis.get_legend()) is not None:
            legend.get_frame().set(edgecolor=GRID, alpha=0.9)
            for text in legend.get_texts():
                text.set(fontsize=8, color=INK)
    if results:
        handles = [Line2D([], [], color=colour, lw=2.2, label=run_title(r)) for r, colour in coloured(results)]
        figure.legend(handles=handles, loc="outside upper center", ncols=4, frameon=False, fontsize=9)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()
