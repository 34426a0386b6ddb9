"""Plots of finished runs, several runs laid over each other; each function returns a PNG, or ``None`` without data."""

import io
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import ScalarFormatter
from numpy.typing import NDArray

from experiments.results import (
    FILTER_STATUSES,
    GUARANTEED,
    RunResult,
    family_minima,
    filter_title,
    run_title,
    smallest_self_collision,
)
from robots.description import RobotDescription
from robots.messages import Array

DPI = 110
WIDTH = 9.6
INK, GRID, UNSAFE = "#3a4450", "#e3e7ec", "#c62828"
UNFILTERED = "#d1495b"
FILTERED = ("#2368b0", "#2f9e6e", "#e08e1b", "#7a56a8", "#12888f", "#a0522d", "#5c6b7a", "#b83b8a")
STATUS_COLOURS = ("#e3e7ec", "#7fb0e0", "#e9a13b", "#c62828", "#7b1fa2", "#6b7280")
CLOSEST_PAIRS = 3
HANDS = ("left_hand", "right_hand")
LINE_STYLES = ("-", "--", ":", "-.")


def barrier_plot(results: Sequence[RunResult]) -> bytes | None:
    """Self-collision barriers over time [mm]: of the pairs that get closest, then the smallest of all.

    Where the run has a hand task, the pairs are of hand and torso. The reference motion's is added where it is known.
    """
    shown = [r for r in results if r.series["h_self_collision"].size]
    if not shown:
        return None
    pairs = _closest_pairs(shown)
    figure, axes = _figure(2, 2, 6.0, sharex=True)
    for axis, k in zip(axes, pairs, strict=False):
        for result, colour in _coloured(shown):
            axis.plot(result.series["step_time"], 1e3 * result.series["h_self_collision"][:, k], color=colour)
        axis.set_title(_pair_title(shown[0].robot, k))
    for axis in axes[len(pairs) : -1]:
        axis.set_visible(False)
    for result, colour in _coloured(shown):
        axes[-1].plot(result.series["step_time"], 1e3 * smallest_self_collision(result), color=colour)
    reference = next((r for r in shown if "h_self_reference" in r.series), None)
    if reference is not None:
        h = 1e3 * reference.series["h_self_reference"]
        axes[-1].plot(reference.series["step_time"], h, ":", color=INK, lw=1.0, label="reference motion")
        axes[-1].legend(loc="upper right")
    axes[-1].set_title("smallest of all pairs")
    for axis in axes:
        _shade_unsafe(axis)
        axis.set_ylabel("distance [mm]")
    return _finish(figure, axes[-2:], shown)


def guarantee_plot(results: Sequence[RunResult]) -> bytes | None:
    """Smallest self-collision barrier, legs apart, with the bounds that the condition promises [mm]; |d| below.

    ``None`` where no run has a condition that promises one.
    """
    column = GUARANTEED.index("self_collision")
    shown = [r for r in results if "h_bound" in r.series and np.isfinite(r.series["h_bound"][:, column]).any()]
    if not shown:
        return None
    figure, axes = _figure(2, 1, 5.0, sharex=True)
    for result, colour in _coloured(shown):
        series = result.series
        time, h = series["step_time"], family_minima(series, len(result.robot.leg_pairs))[:, column]
        axes[0].plot(time, 1e3 * h, color=colour)
        axes[0].plot(time, 1e3 * series["h_row_bound"], ":", color=colour, lw=1.0)
        axes[0].plot(time, 1e3 * series["h_bound"][:, column], "--", color=colour, lw=1.0)
        axes[1].plot(time, series["disturbance"], color=colour)
    styles = {"solid": "smallest h", "dotted": "bound of the closest pair", "dashed": "bound from |d|"}
    lines = [Line2D([], [], ls=style, color=INK, lw=1.0, label=label) for style, label in styles.items()]
    axes[0].legend(handles=lines, loc="upper right", ncols=3)
    _shade_unsafe(axes[0])
    low, high = axes[0].get_ylim()
    axes[0].set_ylim(low, high + 0.2 * (high - low))  # the legend has the room above to itself
    axes[0].set_title("arms, torso and head")
    axes[0].set_ylabel("distance [mm]")
    axes[1].set_ylabel("|d| [m/s, rad/s]")
    axes[1].set_ylim(bottom=0.0)
    return _finish(figure, axes[-1:], shown)


def obstacle_plot(results: Sequence[RunResult]) -> bytes | None:
    """Smallest obstacle barrier over time [mm]; ``None`` where no run has an obstacle."""
    shown = [r for r in results if np.isfinite(r.series.get("h_obstacle", np.empty(0))).any()]
    if not shown:
        return None
    figure, axes = _figure(1, 1, 3.0)
    for result, colour in _coloured(shown):
        axes[0].plot(result.series["step_time"], 1e3 * result.series["h_obstacle"], color=colour)
    _shade_unsafe(axes[0])
    axes[0].set_ylabel("distance [mm]")
    return _finish(figure, axes, shown)


def limits_plot(results: Sequence[RunResult]) -> bytes | None:
    """Smallest joint-limit barrier [rad] and each workspace barrier [mm] over time."""
    shown = [r for r in results if len(r.series["step_time"])]
    if not shown:
        return None
    figure, axes = _figure(1, 2, 3.0, sharex=True)
    for result, colour in _coloured(shown):
        time = result.series["step_time"]
        axes[0].plot(time, result.series["h_joint_limit"], color=colour)
        for k, style in zip(range(result.series["h_workspace"].shape[1]), LINE_STYLES, strict=False):
            axes[1].plot(time, 1e3 * result.series["h_workspace"][:, k], style, color=colour)
    names = ", ".join(b.name.replace("_", " ") for b in shown[0].robot.workspace)
    axes[0].set_title("smallest of all joint limits")
    axes[1].set_title(f"workspace: {names}" if names else "workspace: no bounds")
    axes[0].set_ylabel("distance [rad]")
    axes[1].set_ylabel("distance [mm]")
    for axis in axes:
        axis.axhline(0.0, color=UNSAFE, lw=1.1)
    return _finish(figure, axes, shown)


def hand_plot(results: Sequence[RunResult]) -> bytes | None:
    """Hand positions against their references, per axis [m], and the length of the error [mm]."""
    shown = [r for r in results if all(f"{hand}_ref" in r.series for hand in HANDS)]
    if not shown:
        return None
    figure, axes = _figure(4, 2, 8.0, sharex=True)
    for column, hand in enumerate(HANDS):
        for row, name in enumerate("xyz"):
            axis = axes[2 * row + column]
            for result, colour in _coloured(shown):
                axis.plot(result.series["time"], result.series[hand][:, row], color=colour)
            reference = shown[0].series[f"{hand}_ref"][:, row]
            axis.plot(shown[0].series["time"], reference, "--", color=INK, lw=1.0, label="reference")
            axis.set_ylabel(f"{name} [m]")
        for result, colour in _coloured(shown):
            error = np.linalg.norm(result.series[hand] - result.series[f"{hand}_ref"], axis=1)
            axes[6 + column].plot(result.series["time"], 1e3 * error, color=colour)
        axes[6 + column].set_ylabel("error [mm]")
        axes[6 + column].set_ylim(bottom=0.0)
        axes[column].set_title(hand.replace("_", " "))
    axes[0].legend(loc="upper right")
    return _finish(figure, axes[-2:], shown)


def torque_plot(results: Sequence[RunResult]) -> bytes | None:
    """Torque as a share of the motor's limit: the largest of each limb over time, and each joint's largest."""
    shown = _with_ticks(results)
    if not shown:
        return None
    robot = shown[0].robot
    groups = joint_groups(robot)
    figure = Figure(figsize=(WIDTH, 6.4), dpi=DPI, layout="constrained")
    grid = figure.add_gridspec(2, len(groups), height_ratios=(1, 1.15))
    axes = [figure.add_subplot(grid[0, k]) for k in range(len(groups))]
    for axis, (name, joints) in zip(axes, groups.items(), strict=True):
        for result, colour in _coloured(shown):
            axis.plot(result.series["time"], _torque_share(result)[:, joints].max(axis=1), color=colour)
        _share_axis(axis, name)
        axis.set_xlabel("time [s]")
    bars = figure.add_subplot(grid[1, :])
    width = 0.8 / len(shown)
    for k, (result, colour) in enumerate(_coloured(shown)):
        place = np.arange(len(robot.joints)) + (k - 0.5 * (len(shown) - 1)) * width
        bars.bar(place, np.max(_torque_share(result), axis=0), width, color=colour, edgecolor="white", lw=0.3)
    bars.set_xlim(-0.7, len(robot.joints) - 0.3)
    names = [name.removesuffix("_joint").replace("_", " ") for name in robot.joint_names]
    bars.set_xticks(range(len(names)), names, rotation=60, ha="right", rotation_mode="anchor", fontsize=7)
    _share_axis(bars, "largest of the whole run, by joint")
    _style([*axes, bars])
    bars.grid(False, axis="x")
    return _finish(figure, [], shown)


def balance_plot(results: Sequence[RunResult]) -> bytes | None:
    """Ground plan [m]: measured zero-moment point and centre of mass in the support polygon, one picture a run."""
    shown = _with_ticks(results)
    if not shown:
        return None
    columns = min(3, len(shown))
    rows = -(-len(shown) // columns)
    figure, axes = _figure(rows, columns, 3.9 * rows)
    for axis, (result, colour) in zip(axes, _coloured(shown), strict=False):
        polygon = result.series["support_polygon"]
        axis.fill(*polygon.T, facecolor="#eef2f6", edgecolor="#9aa7b4", lw=1.2, label="support", zorder=0)
        axis.plot(*result.series["zmp"].T, color=colour, lw=0.7, alpha=0.75, label="ZMP")
        axis.plot(*result.series["com"][:, :2].T, color=INK, lw=1.4, label="CoM")
        axis.set_aspect("equal", adjustable="datalim")
        axis.set_xlabel("x [m]")
        axis.set_ylabel("y [m]")
        axis.set_title(run_title(result))
    for axis in axes[len(shown) :]:
        axis.set_visible(False)
    axes[0].legend(loc="upper right")
    return _finish(figure, [], [])


def com_plot(results: Sequence[RunResult]) -> bytes | None:
    """Error of the centre of mass over time [mm]: sideways (length in the ground plane), and in height."""
    shown = _with_ticks(results)
    if not shown:
        return None
    figure, axes = _figure(1, 2, 3.0, sharex=True)
    for result, colour in _coloured(shown):
        error = 1e3 * (result.series["com"] - result.series["com_ref"])
        axes[0].plot(result.series["time"], np.linalg.norm(error[:, :2], axis=1), color=colour)
        axes[1].plot(result.series["time"], error[:, 2], color=colour)
    axes[0].set_ylim(bottom=0.0)
    axes[0].set_title("in the ground plane")
    axes[1].set_title("in height")
    for axis in axes:
        axis.set_ylabel("CoM error [mm]")
    return _finish(figure, axes, shown)


def filter_plot(results: Sequence[RunResult]) -> bytes | None:
    """How far the filter moves the velocity from what was asked, and one status strip per run."""
    shown = _with_ticks(results)
    if not shown:
        return None
    figure = Figure(figsize=(WIDTH, 2.7 + 0.4 * len(shown)), dpi=DPI, layout="constrained")
    grid = figure.add_gridspec(2, 1, height_ratios=(2.2, 0.4 * len(shown)))
    upper = figure.add_subplot(grid[0])
    lower = figure.add_subplot(grid[1], sharex=upper)
    for k, (result, colour) in enumerate(_coloured(shown)):
        change = np.linalg.norm(result.series["v_safe"] - result.series["v_des"], axis=1)
        upper.plot(result.series["time"], change, color=colour)
        _status_strip(lower, k, result)
    upper.set_ylabel("‖v_safe - v_des‖ [m/s, rad/s]")
    lower.set_yticks(range(len(shown)), [run_title(r) for r in shown], fontsize=8)
    lower.set_ylim(len(shown) - 0.5, -0.5)
    for name, colour in zip(FILTER_STATUSES, STATUS_COLOURS, strict=True):
        upper.fill_between([], [], color=colour, label=name)
    upper.legend(loc="upper right", ncols=6)
    _style([upper, lower])
    lower.grid(False)
    return _finish(figure, [lower], shown)


def tick_plot(results: Sequence[RunResult]) -> bytes | None:
    """Histogram of the time that one control tick took [ms]."""
    shown = _with_ticks(results)
    if not shown:
        return None
    figure, axes = _figure(1, 1, 2.8)
    longest = max(float(np.percentile(r.series["tick_ms"], 99.5)) for r in shown)
    bins = np.linspace(0.0, 1.2 * longest + 1e-6, 70).tolist()
    for result, colour in _coloured(shown):
        ticks = np.minimum(result.series["tick_ms"], bins[-1])
        axes[0].hist(ticks, bins=bins, color=colour, histtype="stepfilled", alpha=0.35)
        axes[0].axvline(float(np.median(ticks)), color=colour, lw=1.4)
    axes[0].set_xlabel("time of one tick [ms]; last bar: that and longer")
    axes[0].set_ylabel("ticks")
    return _finish(figure, [], shown)


def joint_groups(robot: RobotDescription) -> dict[str, list[int]]:
    """Indices of the joints by limb: those on the way from each sole and hand to the torso or the base.

    Returns:
        ``legs``, ``waist`` and ``arms``, and ``other`` for the rest; empty ones are left out.
    """
    parents = {body.name: body for body in robot.bodies}
    index = {name: k for k, name in enumerate(robot.joint_names)}

    def chain(role: str) -> list[int]:
        body = parents[robot.frame(robot.roles[role]).body]
        found = []
        while body.parent is not None and body.joint is not None:
            found += [index[body.joint.name]] if body.joint.name in index else []
            body = parents[body.parent]
        return found

    waist = set(chain("torso"))
    legs = (set(chain("left_sole")) | set(chain("right_sole"))) - waist
    arms = (set(chain("left_hand")) | set(chain("right_hand"))) - waist - legs
    other = set(index.values()) - legs - waist - arms
    groups = {"legs": legs, "waist": waist, "arms": arms, "other": other}
    return {name: sorted(joints) for name, joints in groups.items() if joints}


def _with_ticks(results: Sequence[RunResult]) -> list[RunResult]:
    return [r for r in results if len(r.series["time"])]


def _coloured(results: Sequence[RunResult]) -> Iterator[tuple[RunResult, str]]:
    """Each run with its colour: red without a filter, another for each further run."""
    free = iter(FILTERED * (1 + len(results) // len(FILTERED)))
    unfiltered = False
    for result in results:
        if filter_title(result) == "no filter" and not unfiltered:
            unfiltered = True
            yield result, UNFILTERED
        else:
            yield result, next(free)


def _closest_pairs(results: Sequence[RunResult]) -> list[int]:
    """Indices of the pairs with the smallest barriers: between hand and torso where the run has a hand task."""
    robot = results[0].robot
    smallest = np.min([r.series["h_self_collision"].min(axis=0) for r in results], axis=0)
    order = [int(k) for k in np.argsort(smallest)]
    if "left_hand_ref" not in results[0].series:
        return order[:CLOSEST_PAIRS]
    home = {shape.name: shape.body for shape in robot.collisions}
    hands = {robot.frame(robot.roles[hand]).body for hand in HANDS}
    torso = robot.frame(robot.roles["torso"]).body
    on = [{home[a], home[b]} for a, b in robot.self_collision_pairs]
    first = [k for k in order if torso in on[k] and on[k] & hands]
    return (first + [k for k in order if k not in first])[:CLOSEST_PAIRS]


def _pair_title(robot: RobotDescription, k: int) -> str:
    return " to ".join(name.replace("_", " ") for name in robot.self_collision_pairs[k])


def _torque_share(result: RunResult) -> Array:
    share: Array = np.abs(result.series["torque"]) / result.robot.joint_array("effort")
    return share


def _share_axis(axis: Axes, title: str) -> None:
    axis.axhline(1.0, color=UNSAFE, lw=1.0)
    axis.set_ylim(0.0, max(1.08, axis.get_ylim()[1]))
    axis.set_ylabel("torque / limit")
    axis.set_title(title)


def _status_strip(axis: Axes, row: int, result: RunResult) -> None:
    """One run's filter status as a horizontal strip of coloured stretches."""
    time, status = result.series["time"], result.series["filter_status"]
    starts = np.flatnonzero(np.diff(status, prepend=-1))
    end = float(time[-1]) + (float(time[1] - time[0]) if len(time) > 1 else 1e-3)
    edges = np.append(time[starts], end)
    spans = [(float(a), float(b - a)) for a, b in pairwise(edges)]
    axis.broken_barh(spans, (row - 0.36, 0.72), facecolors=[STATUS_COLOURS[int(status[k])] for k in starts], lw=0)


def _shade_unsafe(axis: Axes) -> None:
    """Red below zero, and a range that shows what happens near zero."""
    low, high = axis.get_ylim()
    nearest = min((np.nanmin(line.get_ydata()) for line in axis.get_lines()), default=0.0)
    low = min(-5.0, low)
    # a little room above, so that a level line does not hide under the frame
    axis.set_ylim(low, max(5.0, min(1.06 * high, max(80.0, -3.0 * low, 2.0 * nearest))))
    axis.axhspan(low, 0.0, color=UNSAFE, alpha=0.09, lw=0)
    axis.axhline(0.0, color=UNSAFE, lw=1.1)


def _figure(rows: int, columns: int, height: float, sharex: bool = False) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(WIDTH, height), dpi=DPI, layout="constrained")
    axes: NDArray[Any] = figure.subplots(rows, columns, sharex=sharex, squeeze=False)
    _style(list(axes.flat))
    return figure, list(axes.flat)


def _style(axes: Sequence[Axes]) -> None:
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


def _finish(figure: Figure, time_axes: Sequence[Axes], results: Sequence[RunResult]) -> bytes:
    """Time labels, one legend of runs over the figure, sizes of text; the PNG."""
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
        handles = [Line2D([], [], color=colour, lw=2.2, label=run_title(r)) for r, colour in _coloured(results)]
        figure.legend(handles=handles, loc="outside upper center", ncols=4, frameon=False, fontsize=9)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()
