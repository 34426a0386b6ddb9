"""Plots of distances over time, and of what was promised of them; each returns a PNG, or ``None`` without data."""

from collections.abc import Sequence

import numpy as np
from matplotlib.lines import Line2D

from experiments.plot_style import INK, UNSAFE, coloured, finish, new_figure, shade_unsafe
from experiments.results import GUARANTEED, RunResult, family_minima, smallest_self_collision
from robots.description import RobotDescription

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
    figure, axes = new_figure(2, 2, 6.0, sharex=True)
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
    return finish(figure, axes[-2:], shown)


def guarantee_plot(results: Sequence[RunResult]) -> bytes | None:
    """Smallest self-collision barrier, legs apart, with the bounds that the condition promises [mm]; |d| below.

    ``None`` where no run has a condition that promises one.
    """
    column = GUARANTEED.index("self_collision")
    shown = [r for r in results if "h_bound" in r.series and np.isfinite(r.series["h_bound"][:, column]).any()]
    if not shown:
        return None
    figure, axes = new_figure(2, 1, 5.0, sharex=True)
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
    return finish(figure, axes[-1:], shown)


def obstacle_plot(results: Sequence[RunResult]) -> bytes | None:
    """Smallest obstacle barrier over time [mm]; ``None`` where no run has an obstacle."""
    shown = [r for r in results if np.isfinite(r.series.get("h_obstacle", np.empty(0))).any()]
    if not shown:
        return None
    figure, axes = new_figure(1, 1, 3.0)
    for result, colour in coloured(shown):
        axes[0].plot(result.series["step_time"], 1e3 * result.series["h_obstacle"], color=colour)
    shade_unsafe(axes[0])
    axes[0].set_ylabel("distance [mm]")
    return finish(figure, axes, shown)


def limits_plot(results: Sequence[RunResult]) -> bytes | None:
    """Smallest joint-limit barrier [rad] and each workspace barrier [mm] over time."""
    shown = [r for r in results if len(r.series["step_time"])]
    if not shown:
        return None
    figure, axes = new_figure(1, 2, 3.0, sharex=True)
    for result, colour in coloured(shown):
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
    return finish(figure, axes, shown)


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
