"""Plots of filters in one scene, laid over each other; each function returns a PNG."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from experiments.reports.corridor_table import FilterRun
from experiments.reports.plots.style import (
    FILTERED,
    INK,
    UNFILTERED,
    UNSAFE,
    as_png,
    label_time,
    legend_above,
    new_axes,
)
from robots.messages import Array

Style = dict[str, Any]

DASHES: dict[str, Any] = {"ssa": (0, (4, 4)), "none": (0, (1, 1))}
"""Lines that are not solid, by filter: SSA may lie on p-SSA."""


@dataclass(frozen=True, slots=True)
class Phase:
    """A stretch of time that plots shade: ``start`` to ``end`` [s], in ``words``."""

    start: float
    end: float
    words: str


@as_png
def hand_plot(runs: Sequence[FilterRun], phases: Sequence[Phase], hand: int, margin: float) -> Figure:
    """Index phi of body ``hand`` and its nearest obstacle over time [mm], for a distance ``margin`` [m] to be kept."""

    def phi(run: FilterRun) -> Array:
        return 1e3 * (margin - run.series["h_obstacle"][:, hand].min(axis=1))

    figure, axis = _overlay(runs, phases, phi, "phi [mm]")
    contact, top = 1e3 * margin, axis.get_ylim()[1]
    # where all is well is not worth most of the picture
    axis.set_ylim(-contact, max(top, 1.2 * contact))
    axis.axhspan(contact, axis.get_ylim()[1], color=UNSAFE, alpha=0.09, lw=0)
    axis.axhline(0.0, color=INK, lw=0.8, ls=":")
    axis.annotate("contact", (0.0, contact), (3, 3), textcoords="offset points", fontsize=8, color=UNSAFE)
    axis.annotate("d_min", (0.0, 0.0), (3, 3), textcoords="offset points", fontsize=8, color=INK)
    return figure


@as_png
def joint_plot(runs: Sequence[FilterRun], phases: Sequence[Phase], joint: int) -> Figure:
    """Position of one joint over time [rad]."""
    return _overlay(runs, phases, lambda run: run.series["q"][:, joint], "position [rad]")[0]


@as_png
def violation_plot(runs: Sequence[FilterRun], phases: Sequence[Phase]) -> Figure:
    """Total violation over time [m/s]."""
    return _overlay(runs, phases, lambda run: run.series["violation"], "total violation [m/s]")[0]


def _overlay(
    runs: Sequence[FilterRun], phases: Sequence[Phase], values: Callable[[FilterRun], Array], label: str
) -> tuple[Figure, Axes]:
    """One axes with ``values`` of all runs, the scene's phases shaded."""
    figure, (axis,) = new_axes(1, 1, 3.4)
    styled = list(_styles(runs))
    for run, style in styled:
        axis.plot(run.series["time"], values(run), lw=1.3, **style)
    end = float(max(run.series["time"][-1] for run in runs))
    for k, phase in enumerate(phases):
        if phase.start < end:
            axis.axvspan(phase.start, min(phase.end, end), color=INK, alpha=0.05 + 0.04 * k, lw=0)
            place = (phase.start, 1.0 - 0.07 * k)
            words: Style = {"textcoords": "offset points", "fontsize": 8, "color": INK, "va": "top"}
            axis.annotate(phase.words, place, (4, -3), xycoords=axis.get_xaxis_transform(), **words)
    axis.set_xlim(0.0, end)
    axis.set_ylabel(label)
    label_time([axis])
    legend_above(figure, [Line2D([], [], lw=2.2, label=run.title, **style) for run, style in styled], 6)
    return figure, axis


def _styles(runs: Sequence[FilterRun]) -> Iterator[tuple[FilterRun, Style]]:
    """Red where the nominal velocity may pass unfiltered, another colour for each other filter."""
    free = iter(FILTERED)
    for run in runs:
        unfiltered = run.name == "none" or run.summary["infeasible_action"] == "unsafe_pass_nominal"
        colour = UNFILTERED if unfiltered else next(free)
        yield run, {"color": colour, "ls": DASHES.get(run.name, "-"), "zorder": 3 if run.name in DASHES else 2}
