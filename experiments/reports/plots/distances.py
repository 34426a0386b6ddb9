"""Plots of distances over time, and of what was guaranteed of them; each returns a PNG, or ``None`` without data."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from experiments.recording.gait_phases import walks
from experiments.recording.recording import GUARANTEED, Recording, family_minima, smallest_self_collision
from experiments.reports.plots.style import (
    INK,
    UNSAFE,
    as_png,
    coloured,
    label_time,
    legend_of_runs,
    new_axes,
    shade_unsafe,
)
from robots.description import RobotDescription

CLOSEST_PAIRS = 3
HANDS = ("left_hand", "right_hand")


@as_png
def barrier_plot(results: Sequence[Recording]) -> Figure | None:
    """Self-collision barriers over time [mm]: of the pairs that get closest, then the smallest of all.

    Where the run has a hand task, the pairs are of hand and torso. The reference motion's is added where it is known.
    """
    shown = [r for r in results if r.series["h_self_collision"].size]
    if not shown:
        return None
    pairs = closest_pairs(shown)
    figure, axes = new_axes(2, 2, 6.0, sharex=True)
    for axis, k in zip(axes, pairs, strict=False):
        for result, colour in coloured(shown):
            axis.plot(result.series["step_time"], 1e3 * result.series["h_self_collision"][:, k], color=colour)
        axis.set_title(_pair_title(shown[0].robot, k))
    for axis in axes[len(pairs) : -1]:
        axis.set_visible(False)
    for result, colour in coloured(shown):
        axes[-1].plot(result.series["step_time"], 1e3 * smallest_self_collision(result), color=colour)
    reference = next((r for r in shown if "h_self_reference" in r.series), None)
    if reference is not None:
        h = 1e3 * reference.series["h_self_reference"]
        axes[-1].plot(reference.series["step_time"], h, ":", color=INK, lw=1.0, label="reference motion")
        axes[-1].legend(loc="best")
    axes[-1].set_title("smallest of all pairs")
    for axis in axes:
        shade_unsafe(axis)
        axis.set_ylabel("distance [mm]")
    label_time(axes[-2:])
    legend_of_runs(figure, shown)
    return figure


@as_png
def guarantee_plot(results: Sequence[Recording]) -> Figure | None:
    """Smallest self-collision barrier, legs apart, with the bounds that the condition guarantees [mm]; |d| below.

    ``None`` where no run has a condition that guarantees one.
    """
    column = GUARANTEED.index("self_collision")
    shown = [r for r in results if "h_bound" in r.series and np.isfinite(r.series["h_bound"][:, column]).any()]
    if not shown:
        return None
    figure, axes = new_axes(2, 1, 5.0, sharex=True)
    for result, colour in coloured(shown):
        series = result.series
        time, h = series["step_time"], family_minima(series, len(result.robot.leg_pairs))[:, column]
        axes[0].plot(time, 1e3 * h, color=colour)
        axes[0].plot(time, 1e3 * series["h_row_bound"], ":", color=colour, lw=1.0)
        axes[0].plot(time, 1e3 * series["h_bound"][:, column], "--", color=colour, lw=1.0)
        axes[1].plot(time, series["disturbance"], color=colour)
    styles = {"solid": "smallest h", "dotted": "bound of the closest pair", "dashed": "bound from |d|"}
    lines = [Line2D([], [], ls=style, color=INK, lw=1.0, label=label) for style, label in styles.items()]
    axes[0].legend(handles=lines, loc="upper right", ncols=3)
    shade_unsafe(axes[0])
    low, high = axes[0].get_ylim()
    axes[0].set_ylim(low, high + 0.2 * (high - low))  # the legend has the room above to itself
    axes[0].set_title("arms, torso and head")
    axes[0].set_ylabel("distance [mm]")
    axes[1].set_ylabel("|d| [m/s, rad/s]")
    axes[1].set_ylim(bottom=0.0)
    label_time(axes[-1:])
    legend_of_runs(figure, shown)
    return figure


@as_png
def obstacle_plot(results: Sequence[Recording]) -> Figure | None:
    """Smallest obstacle barrier over time [mm]; ``None`` where no run has an obstacle."""
    shown = [r for r in results if np.isfinite(r.series.get("h_obstacle", np.empty(0))).any()]
    if not shown:
        return None
    figure, axes = new_axes(1, 1, 3.0)
    for result, colour in coloured(shown):
        axes[0].plot(result.series["step_time"], 1e3 * result.series["h_obstacle"], color=colour)
    shade_unsafe(axes[0])
    axes[0].set_ylabel("distance [mm]")
    label_time(axes)
    legend_of_runs(figure, shown)
    return figure


@as_png
def limits_plot(results: Sequence[Recording]) -> Figure | None:
    """Smallest joint-limit barrier [rad], and the distance that each workspace bound limits, with its bound [m]."""
    shown = [r for r in results if len(r.series["step_time"])]
    if not shown:
        return None
    bounds = shown[0].robot.workspace
    figure, axes = new_axes(1, 1 + len(bounds), 3.0, sharex=True)
    for result, colour in coloured(shown):
        time = result.series["step_time"]
        axes[0].plot(time, result.series["h_joint_limit"], color=colour)
        for axis, bound, h in zip(axes[1:], bounds, result.series["h_workspace"].T, strict=True):
            axis.plot(time, bound.d_max - h, color=colour)
    axes[0].axhline(0.0, color=UNSAFE, lw=1.1)
    axes[0].set_title("smallest room to a joint limit")
    axes[0].set_ylabel("room [rad]")
    for axis, bound in zip(axes[1:], bounds, strict=True):
        axis.axhline(bound.d_max, color=UNSAFE, lw=1.1)
        low, high = axis.get_ylim()
        axis.axhspan(bound.d_max, high, color=UNSAFE, alpha=0.09, lw=0)
        axis.set_ylim(low, high)
        axis.set_title(bound.name.replace("_", " "))
        axis.set_ylabel("distance [m]")
    label_time(axes)
    legend_of_runs(figure, shown)
    return figure


@as_png
def feet_plot(results: Sequence[Recording]) -> Figure | None:
    """Barrier between the feet, and the smallest among all pairs of legs [mm]; ``None`` where no run walks."""
    shown = [r for r in results if walks(r.series) and feet_pairs(r.robot)]
    if not shown:
        return None
    figure, axes = new_axes(1, 2, 3.0, sharex=True)
    for result, colour in coloured(shown):
        time, h = result.series["step_time"], 1e3 * result.series["h_self_collision"]
        axes[0].plot(time, h[:, feet_pairs(result.robot)].min(axis=1), color=colour)
        axes[1].plot(time, h[:, h.shape[1] - len(result.robot.leg_pairs) :].min(axis=1), color=colour)
    axes[0].set_title("left foot to right foot")
    axes[1].set_title("smallest of all pairs of legs")
    for axis in axes:
        shade_unsafe(axis)
        axis.set_ylabel("distance [mm]")
    label_time(axes)
    legend_of_runs(figure, shown)
    return figure


def feet_pairs(robot: RobotDescription) -> list[int]:
    """Columns of ``h_self_collision`` of one foot with the other: bodies with a sole, and below."""
    left, right = (_foot_shapes(robot, robot.frame(sole.frame).body) for sole in robot.soles)
    pairs = enumerate(robot.self_collision_pairs)
    return [k for k, (a, b) in pairs if (a in left and b in right) or (a in right and b in left)]


def _foot_shapes(robot: RobotDescription, top: str) -> set[str]:
    """Names of the collision bodies on the body ``top`` and below it."""
    parents = {body.name: body.parent for body in robot.bodies}

    def within(body: str | None) -> bool:
        return body is not None and (body == top or within(parents[body]))

    return {shape.name for shape in robot.collisions if within(shape.body)}


def closest_pairs(results: Sequence[Recording]) -> list[int]:
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
