"""Plots of a deployment, its stages as bands behind them; each returns a PNG, or ``None`` without data."""

from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.metrics.deployment import CONTROLLED, tilt
from experiments.recording.recording import Recording
from experiments.reports.plots.signals import joint_groups
from experiments.reports.plots.style import INK, UNSAFE, as_png, label_time, new_axes, new_figure
from robots.messages import Array, Mask

FEET = ("left", "right")
PERIOD_MS = 2.0
BANDS = ("#dfe7f1", "#f4f6f9")
"""Colours of stages, one after the other; those under control are darker."""

CONTROLLED_BANDS = ("#cfe6d4", "#e3f1e6")


def stage_spans(recording: Recording) -> Iterator[tuple[str, float, float]]:
    """Name, beginning and end [s] of every stage, in their order."""
    time, stage = recording.series["time"], recording.series["stage"]
    starts = np.flatnonzero(np.diff(stage, prepend=-1))
    ends = [*time[starts[1:]], time[-1]]
    for first, end in zip(starts, ends, strict=True):
        yield recording.config["stages"][int(stage[first])], float(time[first]), float(end)


def shade_stages(axes: Sequence[Axes], recording: Recording) -> None:
    """A band for every stage behind all of ``axes``, with its name over the first of them."""
    whole = float(recording.series["time"][-1])
    for i, (name, begin, end) in enumerate(stage_spans(recording)):
        colour = (CONTROLLED_BANDS if name in CONTROLLED else BANDS)[i % 2]
        for axis in axes:
            axis.axvspan(begin, end, color=colour, lw=0, zorder=0)
        wide = end - begin > 0.12 * whole
        look = {"ha": "center"} if wide else {"ha": "left", "rotation": 60, "rotation_mode": "anchor"}
        place = 0.5 * (begin + end), 1.03
        axes[0].text(*place, name, transform=axes[0].get_xaxis_transform(), fontsize=7, va="bottom", **look)
    for axis in axes:
        axis.set_xlim(0.0, max(whole, 1e-3))


@as_png
def base_plot(recording: Recording) -> Figure | None:
    """Estimated height [m], tilt [mrad] and velocity in its own axes [m/s] of the base."""
    series = recording.series
    if not _any(series["q_estimated"]):
        return None
    figure, axes = new_axes(3, 1, 5.4, sharex=True)
    time, q = series["time"], series["q_estimated"]
    axes[0].plot(time, q[:, 2], lw=0.9)
    axes[1].plot(time, 1e3 * tilt(q), lw=0.9)
    for values, name in zip(series["v_estimated"][:, :3].T, ("forward", "left", "up"), strict=True):
        axes[2].plot(time, values, lw=0.8, label=name)
    axes[2].legend(loc="upper left", ncols=3)
    _finish(axes, ("height [m]", "tilt [mrad]", "velocity [m/s]"), recording)
    return figure


@as_png
def feet_plot(recording: Recording) -> Figure | None:
    """Estimated force on each sole [N], and the probability that it stands."""
    series = recording.series
    if not _any(series["foot_force_estimated"]):
        return None
    figure, axes = new_axes(2, 1, 4.4, sharex=True)
    for foot, name in enumerate(FEET):
        axes[0].plot(series["time"], series["foot_force_estimated"][:, foot], lw=0.8, label=name)
        axes[1].plot(series["time"], series["contact_estimated"][:, foot], lw=0.8, label=name)
    axes[0].legend(loc="upper left", ncols=2)
    _finish(axes, ("force [N]", "stands"), recording)
    return figure


@as_png
def torque_plot(recording: Recording) -> Figure | None:
    """Measured torque as a fraction of the limit: the largest of each limb over time, and of each joint on its feet."""
    series, robot = recording.series, recording.robot
    if not _any(series["torque"]):
        return None
    fraction = np.abs(series["torque"]) / robot.joint_array("effort")
    figure = new_figure(6.2)
    grid = figure.add_gridspec(2, 1, height_ratios=(1, 1.1))
    upper, lower = figure.add_subplot(grid[0]), figure.add_subplot(grid[1])
    for name, joints in joint_groups(robot).items():
        upper.plot(series["time"], fraction[:, joints].max(axis=1), lw=0.8, label=name)
    upper.axhline(1.0, color=UNSAFE, lw=1.0)
    upper.legend(loc="upper left", ncols=4)
    _finish([upper], ("torque / limit",), recording)
    controlled = _controlled(recording)
    shown = fraction[controlled] if controlled.any() else fraction
    lower.bar(range(len(robot.joints)), np.nanmax(shown, axis=0), 0.8)
    lower.axhline(1.0, color=UNSAFE, lw=1.0)
    names = [name.removesuffix("_joint").replace("_", " ") for name in robot.joint_names]
    lower.set_xticks(range(len(names)), names, rotation=60, ha="right", rotation_mode="anchor", fontsize=7)
    lower.set_title("largest " + ("on its feet" if controlled.any() else "of all periods") + ", by joint")
    lower.set_ylabel("torque / limit")
    lower.grid(False, axis="x")
    return figure


@as_png
def clock_plot(recording: Recording) -> Figure | None:
    """Time of each period, age of the state at its command [ms], and periods without a state."""
    series = recording.series
    figure, axes = new_axes(3, 1, 5.6, sharex=True)
    time, late = series["time"], series["sent"] == 0
    axes[0].plot(time, series["tick_ms"], lw=0.5)
    axes[0].plot(time[late], series["tick_ms"][late], "x", color=UNSAFE, ms=4, label="not sent")
    axes[1].plot(time, series["age_ms"], lw=0.5)
    axes[2].plot(time, series["missing"], lw=0.9)
    for axis in axes[:2]:
        axis.axhline(PERIOD_MS, color=INK, lw=0.9, ls="--", label="a period")
        axis.set_ylim(bottom=0.0)
    axes[2].set_ylim(bottom=0.0, top=max(3.0, 1.1 * float(series["missing"].max())))
    axes[0].legend(loc="upper left", ncols=2)
    _finish(axes, ("look to command [ms]", "age of state [ms]", "without a state"), recording)
    return figure


@as_png
def barrier_plot(recording: Recording) -> Figure | None:
    """Smallest barrier of each family at the estimated state: distances [mm], joint limits [degrees]."""
    series, families = recording.series, recording.config["families"]
    if not _any(series["h_estimated"]):
        return None
    figure, axes = new_axes(2, 1, 4.8, sharex=True)
    for family, h in zip(families, series["h_estimated"].T, strict=True):
        if _any(h):
            axis, factor = (axes[1], np.degrees(1.0)) if family == "joint_limit" else (axes[0], 1e3)
            axis.plot(series["time"], factor * h, lw=0.9, label=family.replace("_", " "))
    for axis in axes:
        axis.axhline(0.0, color=UNSAFE, lw=1.1)
    axes[0].legend(loc="upper left", ncols=4)
    _finish(axes, ("distance [mm]", "joint limits [°]"), recording)
    return figure


@as_png
def filter_plot(recording: Recording) -> Figure | None:
    """How far the filter moved the velocity, and how far the estimated CoM was from its reference in the plane [mm]."""
    series = recording.series
    if not _any(series["v_safe"]):
        return None
    figure, axes = new_axes(2, 1, 4.0, sharex=True)
    axes[0].plot(series["time"], np.linalg.norm(series["v_safe"] - series["v_des"], axis=1), lw=0.8)
    # hung, nothing holds the estimate of the base
    error = np.where(_controlled(recording)[:, None], series["com_estimated"] - series["com_ref"], np.nan)
    axes[1].plot(series["time"], 1e3 * np.linalg.norm(error[:, :2], axis=1), lw=0.8)
    for axis in axes:
        axis.set_ylim(bottom=0.0)
    _finish(axes, ("change [m/s, rad/s]", "CoM error [mm]"), recording)
    return figure


@as_png
def condition_plot(recording: Recording) -> Figure | None:
    """Hottest motor [degrees Celsius] and charge of the battery [%]."""
    series = recording.series
    if not (_any(series["temperature"]) or _any(series["battery"])):
        return None
    figure, axes = new_axes(2, 1, 3.8, sharex=True)
    axes[0].plot(series["time"], series["temperature"])
    axes[1].plot(series["time"], series["battery"])
    axes[1].set_ylim(0.0, 105.0)
    _finish(axes, ("hottest motor [°C]", "battery [%]"), recording)
    return figure


def _finish(axes: Sequence[Axes], labels: Sequence[str], recording: Recording) -> None:
    for axis, label in zip(axes, labels, strict=True):
        axis.set_ylabel(label)
    shade_stages(axes, recording)
    label_time(axes[-1:])


def _controlled(recording: Recording) -> Mask:
    numbers = [recording.config["stages"].index(name) for name in CONTROLLED]
    return np.isin(recording.series["stage"], numbers)


def _any(values: Array) -> bool:
    return bool(np.isfinite(values).any())
