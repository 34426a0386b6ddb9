"""Filters on several plants: in how many episodes something is touched, and how deep."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure

from experiments.reports.plots.style import FILTERED, INK, as_png, new_axes, shared_legend


@dataclass(frozen=True, slots=True)
class Bars:
    """One filter: by plant, the fraction of episodes that touch, and the least h [m]."""

    filter: str
    touching: Mapping[str, float]
    least: Mapping[str, float]


@as_png
def plants_plot(filters: Sequence[Bars], plants: Sequence[str]) -> Figure:
    """Bars of every filter, for ``plants`` in their order: episodes that touch, and the least h."""
    figure, (hits, depths) = new_axes(2, 1, 6.0, sharex=True)
    width = 0.8 / len(plants)
    for i, plant in enumerate(plants):
        at = [j + (i - 0.5 * (len(plants) - 1)) * width for j in range(len(filters))]
        colour = FILTERED[i % len(FILTERED)]
        hits.bar(at, [1e2 * bars.touching.get(plant, 0.0) for bars in filters], width, color=colour, label=plant)
        depths.bar(at, [1e3 * bars.least.get(plant, 0.0) for bars in filters], width, color=colour)
    hits.set_ylabel("episodes that touch [%]")
    depths.set_ylabel("least h [mm]")
    depths.axhline(0.0, color=INK, lw=0.8)
    depths.set_xticks(range(len(filters)), [bars.filter for bars in filters], rotation=30, ha="right")
    shared_legend(figure, hits, len(plants))
    return figure
