"""Plots of finished runs, several runs laid over each other; each function returns a PNG, or ``None`` without data."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.recording.recording import FILTER_STATUSES, Recording, run_title
from experiments.reports.plots.style import (
    INK,
    UNSAFE,
    as_png,
    coloured,
    label_time,
    legend_of_runs,
    new_axes,
    new_figure,
    with_ticks,
)
from robots.description import RobotDescription
from robots.messages import Array

STATUS_COLOURS = ("#e3e7ec", "#7fb0e0", "#e9a13b", "#c62828", "#7b1fa2", "#6b7280")
HANDS = ("left_hand", "right_hand")


@as_png
def hand_plot(results: Sequence[Recording]) -> Figure | None:
    """Hand positions against their references, per axis [m], and the length of the error [mm]."""
    shown = [r for r in results if all(f"{hand}_ref" in r.series for hand in HANDS)]
    if not shown:
        return None
    figure, axes = new_axes(4, 2, 8.0, sharex=True)
    for column, hand in enumerate(HANDS):
        for row, name in enumerate("xyz"):
            axis = axes[2 * row + column]
            for result, colour in coloured(shown):
                axis.plot(result.series["time"], result.series[hand][:, row], color=colour)
            reference = shown[0].series[f"{hand}_ref"][:, row]
            axis.plot(shown[0].series["time"], reference, "--", color=INK, lw=1.0, label="reference")
            axis.set_ylabel(f"{name} [m]")
        for result, colour in coloured(shown):
            error = np.linalg.norm(result.series[hand] - result.series[f"{hand}_ref"], axis=1)
            axes[6 + column].plot(result.series["time"], 1e3 * error, color=colour)
        axes[6 + column].set_ylabel("error [mm]")
        axes[6 + column].set_ylim(bottom=0.0)
        axes[column].set_title(hand.replace("_", " "))
    axes[0].legend(loc="best")
    label_time(axes[-2:])
    legend_of_runs(figure, shown)
    return figure


@as_png
def torque_plot(results: Sequence[Recording]) -> Figure | None:
    """Torque as a fraction of the motor's limit: the largest of each limb over time, and each joint's largest."""
    shown = with_ticks(results)
    if not shown:
        return None
    robot = shown[0].robot
    groups = joint_groups(robot)
    figure = new_figure(6.4)
    grid = figure.add_gridspec(2, len(groups), height_ratios=(1, 1.15))
    axes = [figure.add_subplot(grid[0, k]) for k in range(len(groups))]
    for axis, (name, joints) in zip(axes, groups.items(), strict=True):
        for result, colour in coloured(shown):
            axis.plot(result.series["time"], _torque_fraction(result)[:, joints].max(axis=1), color=colour)
        _one_axis(axis, name)
        axis.set_xlabel("time [s]")
    bars = figure.add_subplot(grid[1, :])
    width = 0.8 / len(shown)
    for k, (result, colour) in enumerate(coloured(shown)):
        place = np.arange(len(robot.joints)) + (k - 0.5 * (len(shown) - 1)) * width
        bars.bar(place, np.max(_torque_fraction(result), axis=0), width, color=colour, edgecolor="white", lw=0.3)
    bars.set_xlim(-0.7, len(robot.joints) - 0.3)
    names = [name.removesuffix("_joint").replace("_", " ") for name in robot.joint_names]
    bars.set_xticks(range(len(names)), names, rotation=60, ha="right", rotation_mode="anchor", fontsize=7)
    _one_axis(bars, "largest of the whole run, by joint")
    bars.grid(False, axis="x")
    legend_of_runs(figure, shown)
    return figure


@as_png
def com_plot(results: Sequence[Recording]) -> Figure | None:
    """Error of the centre of mass over time [mm]: sideways (length in the ground plane), and in height."""
    shown = with_ticks(results)
    if not shown:
        return None
    figure, axes = new_axes(1, 2, 3.0, sharex=True)
    for result, colour in coloured(shown):
        error = 1e3 * (result.series["com"] - result.series["com_ref"])
        axes[0].plot(result.series["time"], np.linalg.norm(error[:, :2], axis=1), color=colour)
        axes[1].plot(result.series["time"], error[:, 2], color=colour)
    axes[0].set_ylim(bottom=0.0)
    axes[0].set_title("in the ground plane")
    axes[1].set_title("in height")
    for axis in axes:
        axis.set_ylabel("CoM error [mm]")
    label_time(axes)
    legend_of_runs(figure, shown)
    return figure


@as_png
def filter_plot(results: Sequence[Recording]) -> Figure | None:
    """How far the filter moves the velocity from what was asked, and one status strip per run."""
    shown = with_ticks(results)
    if not shown:
        return None
    figure = new_figure(2.7 + 0.4 * len(shown))
    grid = figure.add_gridspec(2, 1, height_ratios=(2.2, 0.4 * len(shown)))
    upper = figure.add_subplot(grid[0])
    lower = figure.add_subplot(grid[1], sharex=upper)
    for k, (result, colour) in enumerate(coloured(shown)):
        change = np.linalg.norm(result.series["v_safe"] - result.series["v_des"], axis=1)
        upper.plot(result.series["time"], change, color=colour)
        _status_strip(lower, k, result)
    upper.set_ylabel("‖v_safe - v_des‖ [m/s, rad/s]")
    lower.set_yticks(range(len(shown)), [run_title(r) for r in shown], fontsize=8)
    lower.set_ylim(len(shown) - 0.5, -0.5)
    for name, colour in zip(FILTER_STATUSES, STATUS_COLOURS, strict=True):
        upper.fill_between([], [], color=colour, label=name)
    # room for the legend above the curves
    upper.set_ylim(top=1.25 * upper.get_ylim()[1])
    upper.legend(loc="upper right", ncols=6)
    lower.grid(False)
    label_time([lower])
    legend_of_runs(figure, shown)
    return figure


@as_png
def tick_plot(results: Sequence[Recording]) -> Figure | None:
    """Histogram of the time that one control tick took [ms]."""
    shown = with_ticks(results)
    if not shown:
        return None
    figure, axes = new_axes(1, 1, 2.8)
    longest = max(float(np.percentile(r.series["tick_ms"], 99.5)) for r in shown)
    bins = np.linspace(0.0, 1.2 * longest + 1e-6, 70).tolist()
    for result, colour in coloured(shown):
        ticks = np.minimum(result.series["tick_ms"], bins[-1])
        axes[0].hist(ticks, bins=bins, color=colour, histtype="stepfilled", alpha=0.35)
        axes[0].axvline(float(np.median(ticks)), color=colour, lw=1.4)
    axes[0].set_xlabel("time of one tick [ms]; last bar: that and longer")
    axes[0].set_ylabel("ticks")
    legend_of_runs(figure, shown)
    return figure


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


def _torque_fraction(result: Recording) -> Array:
    fraction: Array = np.abs(result.series["torque"]) / result.robot.joint_array("effort")
    return fraction


def _one_axis(axis: Axes, title: str) -> None:
    axis.axhline(1.0, color=UNSAFE, lw=1.0)
    axis.set_ylim(0.0, max(1.08, axis.get_ylim()[1]))
    axis.set_ylabel("torque / limit")
    axis.set_title(title)


def _status_strip(axis: Axes, row: int, result: Recording) -> None:
    """One run's filter status as a horizontal strip of coloured stretches."""
    time, status = result.series["time"], result.series["filter_status"]
    starts = np.flatnonzero(np.diff(status, prepend=-1))
    end = float(time[-1]) + (float(time[1] - time[0]) if len(time) > 1 else 1e-3)
    edges = np.append(time[starts], end)
    spans = [(float(a), float(b - a)) for a, b in pairwise(edges)]
    axis.broken_barh(spans, (row - 0.36, 0.72), facecolors=[STATUS_COLOURS[int(status[k])] for k in starts], lw=0)
