"""Plots of balance and walking: on the ground plan and over time; each returns a PNG, or ``None`` without data."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from experiments.metrics.locomotion import PAIR, achieved_velocity, touchdowns
from experiments.recording.gait_phases import Series, stances, swings, walks, without_sway
from experiments.recording.recording import Recording, run_title
from experiments.reports.plots.style import (
    INK,
    WIDTH,
    as_png,
    coloured,
    label_time,
    legend_below,
    legend_of_runs,
    new_axes,
    with_ticks,
)
from robots.messages import Array, Mask

SOLE, SOLE_EDGE = "#dfe5ec", "#9aa7b4"
ASKED = "#e08e1b"
FEET = ("left foot", "right foot")

LONGEST = 15.0
"""Of a longer walk only the middle is shown over time, ``EXCERPT`` of it [s]: it would be no more than a blur."""
EXCERPT = 10.0


@as_png
def plan_plot(results: Sequence[Recording]) -> Figure | None:
    """Ground plan [m]: where the soles stood, the CoM with its reference, and the measured ZMP; one picture a run.

    Lee et al., Fig. 5 (b). A run that fell is shown up to the fall.
    """
    shown = with_ticks(results)
    if not shown:
        return None
    columns = 1 if any(walks(r.series) for r in shown) else min(3, len(shown))
    rows = -(-len(shown) // columns)
    height = max(_panel_height(r, WIDTH / columns) for r in shown)
    figure, axes = new_axes(rows, columns, 0.5 + height * rows)
    for axis, (result, colour) in zip(axes, coloured(shown), strict=False):
        _draw_plan(axis, result, colour)
        axis.set_aspect("equal", adjustable="datalim")
        axis.set_xlabel("x [m]")
        axis.set_ylabel("y [m]")
        axis.set_title(run_title(result))
    for axis in axes[len(shown) :]:
        axis.set_visible(False)
    handles = [
        Patch(facecolor=SOLE, edgecolor=SOLE_EDGE, label="soles on the ground"),
        Line2D([], [], color=ASKED, ls="--", label="CoM asked for"),
        Line2D([], [], color=INK, label="CoM measured"),
        Line2D([], [], color="#8fa3b8", marker=".", ls="", label="ZMP, planned on both feet"),
    ]
    if any(swings(r.series) for r in shown):
        colour = next(iter(coloured(shown)))[1]
        handles.append(Line2D([], [], color=colour, marker=".", ls="", label="ZMP, planned on one foot"))
    legend_below(figure, handles)
    return figure


@as_png
def balance_plot(results: Sequence[Recording]) -> Figure | None:
    """CoM, DCM reference and ZMP over time, within what the soles on the ground span [m]; two rows a run.

    Where a run has no DCM reference that of the CoM takes its place. Coordinates of a walk are counted from the base's
    path without its swaying. ``None`` where no foot is lifted.
    """
    shown = [r for r in results if swings(r.series)]
    if not shown:
        return None
    figure, axes = new_axes(2 * len(shown), 1, 0.5 + 4.2 * len(shown))
    for k, (result, colour) in enumerate(coloured(shown)):
        for axis, i in zip(axes[2 * k : 2 * k + 2], (0, 1), strict=True):
            _draw_coordinate(axis, result, i, colour)
        axes[2 * k].set_title(_excerpt_title(result))
    handles = [
        Patch(facecolor=SOLE, label="soles on the ground"),
        Line2D([], [], color=next(iter(coloured(shown)))[1], label="ZMP"),
        Line2D([], [], color=INK, label="CoM"),
    ]
    asked = " or ".join(sorted({"DCM" if "dcm_ref" in r.series else "CoM" for r in shown}))
    handles.append(Line2D([], [], color=ASKED, ls="--", label=f"{asked} asked for"))
    legend_below(figure, handles)
    label_time(axes[-1:])
    return figure


@as_png
def feet_plot(results: Sequence[Recording]) -> Figure | None:
    """Vertical force [N] and height [mm] of each foot over time, with the height asked for.

    ``None`` where no foot is lifted.
    """
    shown = [r for r in results if swings(r.series)]
    if not shown:
        return None
    figure, axes = new_axes(2, 2, 5.2, sharex=True)
    for result, colour in coloured(shown):
        part = _excerpt(result.series)
        time = result.series["time"][part]
        for foot in (0, 1):
            floor = result.series["soles"][0, foot, 2]
            axes[foot].plot(time, result.series["foot_wrench"][part, foot, 2], color=colour)
            axes[2 + foot].plot(time, 1e3 * (result.series["soles"][part, foot, 2] - floor), color=colour)
            asked = 1e3 * (result.series["soles_ref"][part, foot, 2] - floor)
            axes[2 + foot].plot(time, asked, "--", color=INK, lw=0.9)
    for foot, name in enumerate(FEET):
        axes[foot].set_title(name)
        axes[foot].set_ylabel("vertical force [N]")
        axes[2 + foot].set_ylabel("height of the sole [mm]")
    label_time(axes[2:])
    legend_of_runs(figure, shown)
    return figure


@as_png
def velocity_plot(results: Sequence[Recording]) -> Figure | None:
    """Velocity of the body in its own heading over each pair of steps, and the command where one is recorded.

    ``None`` where no run has taken enough steps.
    """
    shown = [r for r in results if walks(r.series) and len(touchdowns(r.series)) > PAIR]
    if not shown:
        return None
    figure, axes = new_axes(3, 1, 5.6, sharex=True)
    for result, colour in coloured(shown):
        time, velocity = _velocities(result.series)
        for axis, values in zip(axes, velocity.T, strict=True):
            axis.plot(time, values, ".-", color=colour, ms=4)
        if "command" in result.series:
            for axis, values in zip(axes, result.series["command"].T, strict=True):
                axis.step(result.series["time"], values, "--", where="post", color=INK, lw=1.0)
    for axis, name in zip(axes, ("forward [m/s]", "left [m/s]", "turn [rad/s]"), strict=True):
        axis.set_ylabel(name)
        low, high = axis.get_ylim()
        # a small error is not to look like a motion
        axis.set_ylim(min(1.05 * low, -0.1), max(1.05 * high, 0.1))
    handles = [Line2D([], [], color=INK, marker=".", label="over two steps")]
    if any("command" in r.series for r in shown):
        handles.append(Line2D([], [], ls="--", color=INK, label="command"))
    legend_below(figure, handles)
    label_time(axes[-1:])
    legend_of_runs(figure, shown)
    return figure


def _velocities(series: Series) -> tuple[Array, Array]:
    """Middles of all pairs of steps (n,) [s], and the body's velocity over each (n, 3) [m/s, m/s, rad/s]."""
    landings = touchdowns(series)
    pairs = [(int(a), int(b)) for a, b in zip(landings, landings[PAIR:], strict=False)]
    middles = np.array([0.5 * (series["time"][a] + series["time"][b]) for a, b in pairs])
    return middles, np.array([achieved_velocity(series, a, b) for a, b in pairs])


def sole_span(series: Series) -> tuple[Array, Array]:
    """Least and largest coordinates of the corners of the soles that the plan has on the ground.

    Returns:
        Two arrays (T, 2) [m]; NaN while it has none there.
    """
    on_ground = np.asarray(series["in_contact"], dtype=bool)[:, :, None, None]
    low = np.where(on_ground, series["sole_corners"], np.inf).min(axis=(1, 2))
    high = np.where(on_ground, series["sole_corners"], -np.inf).max(axis=(1, 2))
    return np.where(np.isfinite(low), low, np.nan), np.where(np.isfinite(high), high, np.nan)


def _draw_plan(axis: Axes, result: Recording, colour: str) -> None:
    series, until = result.series, _until_fall(result)
    if not walks(series):
        axis.fill(*series["support_polygon"].T, facecolor="none", edgecolor=SOLE_EDGE, ls=":", lw=1.0, zorder=0)
    for stance in stances(series):
        if until[stance.first]:
            axis.fill(*stance.corners.T, facecolor=SOLE, edgecolor=SOLE_EDGE, lw=0.8, zorder=0.5)
    zmp = np.where(until[:, None], series["zmp"], np.nan)
    single = np.zeros(len(zmp), dtype=bool)
    for first, last in swings(series):
        single[first : last + 1] = True
    for chosen, shade in ((~single, "#8fa3b8"), (single, colour)):
        axis.plot(*zmp[chosen].T, ".", color=shade, ms=1.8, alpha=0.6, mec="none")
    axis.plot(*series["com"][until, :2].T, color=INK, lw=1.2)
    axis.plot(*series["com_ref"][until, :2].T, "--", color=ASKED, lw=1.2)


def _draw_coordinate(axis: Axes, result: Recording, i: int, colour: str) -> None:
    """One coordinate of what balances, over time: x (``i`` 0) or y (1)."""
    series, part = result.series, _excerpt(result.series)
    time = series["time"][part]
    origin = np.zeros(len(series["time"]))
    if walks(series):
        origin = without_sway(series["q"][:, :2], series["time"])[:, i]
    low, high = (bound[part, i] - origin[part] for bound in sole_span(series))
    axis.fill_between(time, low, high, color=SOLE, lw=0, step="post")
    axis.plot(time, series["zmp"][part, i] - origin[part], color=colour, lw=0.9)
    axis.plot(time, series["com"][part, i] - origin[part], color=INK)
    asked = series.get("dcm_ref", series["com_ref"])[part, i]
    axis.plot(time, asked - origin[part], "--", color=ASKED)
    # the ZMP of a stumbling robot goes anywhere
    axis.set_ylim(np.nanmin(low) - 0.06, np.nanmax(high) + 0.06)
    axis.set_ylabel(f"{'xy'[i]} [m]" if not walks(series) else f"{'xy'[i]} from the base's path [m]")


def _panel_height(result: Recording, width: float) -> float:
    """Height [inch] of a panel in which the run's ground plan fills ``width`` [inch], within bounds."""
    series, until = result.series, _until_fall(result)
    corners = [series["support_polygon"], *(s.corners for s in stances(series) if until[s.first])]
    points = np.concatenate([*corners, series["com"][until, :2]])
    size = np.ptp(points, axis=0)
    return float(np.clip(width * size[1] / size[0] + 0.6, 2.4, 5.0))


def _until_fall(result: Recording) -> Mask:
    """Ticks before the robot fell; all where it did not."""
    fell = result.summary.get("fell_at_s")
    time = result.series["time"]
    return np.ones(len(time), dtype=bool) if fell is None else np.asarray((time <= fell) | (time == time[0]))


def _excerpt(series: Series) -> slice:
    """Ticks that are shown over time."""
    time = series["time"]
    if not walks(series) or time[-1] <= LONGEST:
        return slice(None)
    start = 0.5 * (time[-1] - EXCERPT)
    first, last = np.searchsorted(time, [start, start + EXCERPT])
    return slice(int(first), int(last))


def _excerpt_title(result: Recording) -> str:
    part = _excerpt(result.series)
    return run_title(result) + ("" if part == slice(None) else f", the middle {EXCERPT:g} s")
