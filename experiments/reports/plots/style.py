"""What all plots share: the style sheet, the colours of runs, figures of one width, legends, and the way to a PNG."""

import functools
import io
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, ParamSpec, overload

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from experiments.recording.recording import Recording, filter_title, run_title

P = ParamSpec("P")

STYLE_SHEET = Path(__file__).with_name("safewbc.mplstyle")
"""Sizes, colours and lines of every plot."""

WIDTH = 9.6
"""Width of every figure [inch]."""

_SHEET = mpl.rc_params_from_file(STYLE_SHEET)
INK: str = _SHEET["axes.labelcolor"]
FILTERED: tuple[str, ...] = tuple(_SHEET["axes.prop_cycle"].by_key()["color"])
UNSAFE, UNFILTERED = "#c62828", "#d1495b"


@overload
def as_png(draw: Callable[P, Figure]) -> Callable[P, bytes]: ...
@overload
def as_png(draw: Callable[P, Figure | None]) -> Callable[P, bytes | None]: ...
def as_png(draw: Callable[P, Figure | None]) -> Callable[P, bytes | None]:
    """Decorator of a function that draws a figure: it draws in the common style and returns the PNG.

    Artists take their style when they are made, so all of the drawing happens within the style sheet. ``None``, for
    data without a plot, stays ``None``.
    """

    @functools.wraps(draw)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> bytes | None:
        with mpl.rc_context(fname=STYLE_SHEET):
            figure = draw(*args, **kwargs)
            return None if figure is None else _png(figure)

    return drawn


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def with_ticks(results: Sequence[Recording]) -> list[Recording]:
    """The runs that got to a first tick."""
    return [r for r in results if len(r.series["time"])]


def coloured(results: Sequence[Recording]) -> Iterator[tuple[Recording, str]]:
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


def new_figure(height: float) -> Figure:
    """An empty figure of the common width and ``height`` [inch]."""
    return Figure(figsize=(WIDTH, height))


def new_axes(rows: int, columns: int, height: float, sharex: bool = False) -> tuple[Figure, list[Axes]]:
    """A figure of the common width and ``height`` [inch], and its axes row by row."""
    figure = new_figure(height)
    axes: NDArray[Any] = figure.subplots(rows, columns, sharex=sharex, squeeze=False)
    return figure, list(axes.flat)


def label_time(axes: Sequence[Axes]) -> None:
    """Time labels."""
    for axis in axes:
        axis.set_xlabel("time [s]")


def legend_of_runs(figure: Figure, results: Sequence[Recording]) -> None:
    """One legend of the runs over the figure."""
    legend_above(figure, [Line2D([], [], color=c, lw=2.2, label=run_title(r)) for r, c in coloured(results)], 4)


def shared_legend(figure: Figure, axis: Axes, columns: int) -> None:
    """One legend over the figure, of the lines of one of its axes."""
    legend_above(figure, axis.get_legend_handles_labels()[0], columns)


def legend_above(figure: Figure, handles: Sequence[Artist], columns: int) -> None:
    """A legend over the figure, without a frame."""
    figure.legend(handles=handles, loc="outside upper center", ncols=columns, frameon=False, fontsize=9)


def legend_below(figure: Figure, handles: Sequence[Artist]) -> None:
    """A legend of one line under the figure, without a frame."""
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)
