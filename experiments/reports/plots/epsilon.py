"""Collisions that filters leave, over the slope of their conditions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import matplotlib as mpl
from matplotlib.figure import Figure

from experiments.reports.plots.style import FILTERED, UNFILTERED, as_png, legend_above, new_axes

PER_LINE = 2
"""Panels beside each other."""


@dataclass(frozen=True, slots=True)
class Panel:
    """One set-up: points (alpha [1/s], fraction of collisions left) of every filter, by its name."""

    title: str
    lines: Mapping[str, Sequence[tuple[float, float]]]


@as_png
def collisions_plot(panels: Sequence[Panel]) -> Figure:
    """A panel for each set-up: collisions left over alpha, a line for each filter; ISSf-CBF by epsilon."""
    rows = -(-len(panels) // PER_LINE)
    figure, axes = new_axes(rows, min(PER_LINE, len(panels)), 2.6 * rows + 0.4, sharex=True)
    names = sorted(dict.fromkeys(name for panel in panels for name in panel.lines), key=_order)
    shades = [name for name in names if name.startswith("issf")]
    colours = mpl.colormaps["viridis"]
    drawn = {}
    for axis, panel in zip(axes, panels, strict=False):
        for name in names:
            if name not in panel.lines:
                continue
            shade = 0.9 * shades.index(name) / max(len(shades) - 1, 1) if name in shades else 0.0
            colour = {"cbf": UNFILTERED, "ecbf": FILTERED[0]}.get(name) or colours(shade)
            alphas, ratios = zip(*sorted(panel.lines[name]), strict=True)
            label = name.replace("issf ", "ISSf-CBF, epsilon ")
            (drawn[name],) = axis.plot(alphas, [1e2 * r for r in ratios], "o-", ms=3, color=colour, label=label)
        axis.set_title(panel.title)
        axis.set_ylabel("collisions left [%]")
        axis.set_ylim(-3.0, max(75.0, axis.get_ylim()[1]))
    for axis in axes[len(panels) :]:
        axis.set_visible(False)
    for axis in axes[max(0, len(panels) - PER_LINE) : len(panels)]:
        axis.set_xlabel("alpha [1/s]")
        axis.tick_params(labelbottom=True)
    legend_above(figure, [drawn[name] for name in names if name in drawn], 5)
    return figure


def _order(name: str) -> tuple[int, float]:
    kind, _, epsilon = name.partition(" ")
    return ("cbf", "ecbf", "issf").index(kind), float(epsilon or 0.0)
