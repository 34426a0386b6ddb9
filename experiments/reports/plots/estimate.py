"""Plots of a state estimate beside the truth; each returns a PNG, or ``None`` without data."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from experiments.metrics.estimate import base_rotations, velocity_errors
from experiments.recording.recording import Recording
from experiments.reports.plots.style import INK, as_png, coloured, label_time, legend_of_runs, new_axes

FEET = ("left", "right")


@as_png
def estimate_plot(results: Sequence[Recording]) -> Figure | None:
    """Errors of the base: velocity per axis of the world [mm/s], tilt [mrad], height [mm]."""
    shown = [r for r in results if "q_estimated" in r.series]
    if not shown:
        return None
    figure, axes = new_axes(5, 1, 7.5, sharex=True)
    for result, colour in coloured(shown):
        series = result.series
        time, velocity = series["time"], velocity_errors(series)
        for axis, values in zip(axes, velocity.T, strict=False):
            axis.plot(time, 1e3 * values, color=colour, lw=0.8)
        up, guess = (base_rotations(series[name])[:, 2] for name in ("q", "q_estimated"))
        tilt = np.arccos(np.clip(np.vecdot(up, guess), -1.0, 1.0))
        axes[3].plot(time, 1e3 * tilt, color=colour, lw=0.8)
        axes[4].plot(time, 1e3 * (series["q_estimated"][:, 2] - series["q"][:, 2]), color=colour, lw=0.8)
    for axis, words in zip(axes, ("x [mm/s]", "y [mm/s]", "z [mm/s]", "tilt [mrad]", "height [mm]"), strict=True):
        axis.set_ylabel(words)
    label_time(axes[-1:])
    legend_of_runs(figure, shown)
    return figure


@as_png
def contact_plot(results: Sequence[Recording]) -> Figure | None:
    """Force along each sole's normal, estimated and true [N], and the probability that the foot stands."""
    shown = [r for r in results if "contact_estimated" in r.series]
    if not shown:
        return None
    figure, axes = new_axes(4, 1, 7.0, sharex=True)
    for result, colour in coloured(shown):
        series = result.series
        for foot in range(2):
            axes[2 * foot].plot(series["time"], series["foot_force_estimated"][:, foot], color=colour, lw=0.8)
            axes[2 * foot + 1].plot(series["time"], series["contact_estimated"][:, foot], color=colour, lw=0.8)
    first = shown[0].series
    for foot, name in enumerate(FEET):
        axes[2 * foot].plot(first["time"], first["foot_wrench"][:, foot, 2], "--", color=INK, lw=0.8, label="true")
        axes[2 * foot].set_ylabel(f"{name} [N]")
        axes[2 * foot + 1].set_ylabel(f"{name}, stands")
        axes[2 * foot + 1].set_ylim(-0.05, 1.05)
    axes[0].legend(loc="best")
    label_time(axes[-1:])
    legend_of_runs(figure, shown)
    return figure
