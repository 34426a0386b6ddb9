"""Small studies with a picture: their commands, and the plots that ``--out`` writes, each a PNG."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from experiments.benchmarks import recovery, straight_arms
from experiments.benchmarks.crossing import NOISE, crossing_study
from experiments.benchmarks.straight_arms import WAYS, command_steps
from experiments.benchmarks.study_print import Runs, show_study, write_study
from experiments.benchmarks.tracking import follow, print_tracking, study_motions, tracking_study
from experiments.reports.plots.style import FILTERED, INK, as_png, label_time, new_axes, shared_legend
from experiments.running.terminal import make_console
from experiments.scenarios.options import BenchOptions
from robots.loader import load_robot
from safety.tracking import MODELS, TrackerSettings


def bench_straight(options: BenchOptions) -> int:
    """Make all runs and print their table; with ``out`` write it there as JSON, and a plot beside; returns 0."""
    show_study(
        straight_arms.straight_study,
        straight_plot,
        "sending the hands away",
        straight_arms.TITLE,
        straight_arms.COLUMNS,
        options.out,
    )
    return 0


def bench_recovery(options: BenchOptions) -> int:
    """Make all runs and print their table; with ``out`` write it there as JSON, and a plot beside; returns 0."""
    show_study(
        recovery.recovery_study, recovery_plot, "leaving the torso", recovery.TITLE, recovery.COLUMNS, options.out
    )
    return 0


def bench_tracking(options: BenchOptions) -> int:
    """:func:`tracking`, from the command line."""
    return tracking(options.out)


def tracking(out: Path | None, seed: int = 0) -> int:
    """Run both studies and print their tables; with ``out`` write them there as JSON, and a plot beside; returns 0."""
    console = make_console()
    with console.status("tracking obstacles"):
        rows = tracking_study(seed)
    with console.status("crossing the hands"):
        crossings = crossing_study(range(seed, seed + 5))
    print_tracking(console, rows, crossings)
    if out is not None:
        write_study(console, out, {"tracking": rows, "crossing": crossings}, tracking_plot(seed))
    return 0


@as_png
def tracking_plot(seed: int = 0, rate: float = 60.0, duration: float = 6.0) -> Figure:
    """Estimated against true velocity of the three motions, one coordinate, and a part of it up close."""
    drawing, axes = new_axes(4, 1, 9.6)
    motions = study_motions(seed)
    for axis, (name, motion) in zip(axes, motions.items(), strict=False):
        for model, colour in zip(MODELS, FILTERED, strict=False):
            settings = TrackerSettings(position_noise=NOISE, model=model)
            series = follow(motion, rate, settings, seed, duration)
            axis.plot(series["time"], series["estimate"][:, 3], color=colour, lw=1.1, label=model.replace("_", " "))
        axis.plot(series["time"], series["true"][:, 3], color=INK, lw=1.4, label="true")
        axis.set_title(name)
    for blending, style in ((TrackerSettings().blending, "-"), (0.0, ":")):
        settings = TrackerSettings(position_noise=NOISE, blending=blending)
        series = follow(motions["circular"], rate, settings, seed, duration)
        words = "measurements fed in" if blending else "measurements at once"
        axes[3].plot(series["time"], series["estimate"][:, 3], color=FILTERED[0], lw=1.1, ls=style, label=words)
    axes[3].set(xlim=(2.0, 2.3), ylim=(0.25, 0.65))
    axes[3].set_title("circular, constant velocity, up close")
    axes[3].legend(frameon=False, fontsize=8)
    for axis in axes:
        axis.set_ylabel("velocity, x [m/s]")
    shared_legend(drawing, axes[0], 3)
    label_time(axes[-1:])
    return drawing


@as_png
def recovery_plot(runs: Runs, filters: Sequence[str] = ("issf", "ssa")) -> Figure:
    """The smallest h and the largest step of the command over time, strict and eased."""
    robots = list(dict.fromkeys(figures["robot"] for figures, _ in runs))
    drawing, axes = new_axes(2, len(robots), 5.6, sharex=True)
    upper, lower = axes[: len(robots)], axes[len(robots) :]
    for axis, robot in zip(upper, robots, strict=True):
        axis.set_title(robot)
    for figures, series in runs:
        if figures["filter"] not in filters:
            continue
        column, colour = robots.index(figures["robot"]), FILTERED[filters.index(figures["filter"])]
        style: dict[str, Any] = {"color": colour, "lw": 1.3, "ls": "-" if figures["way_out"] == "eased" else ":"}
        label = f"{figures['filter']}, {figures['way_out']}"
        upper[column].plot(series["time"], 1e3 * series["h"], label=label, **style)
        steps = np.abs(np.diff(series["v"], axis=0)).max(axis=1)
        lower[column].semilogy(series["time"][1:], np.maximum(steps, 1e-5), **style)
    upper[0].set_ylabel("smallest h [mm]")
    lower[0].set_ylabel("step of the command [rad/s]")
    shared_legend(drawing, upper[0], 4)
    label_time(lower)
    return drawing


@as_png
def straight_plot(runs: Runs, target: str = "up") -> Figure:
    """Commanded velocity of the left elbow and largest step of all joints' over time, without a filter."""
    robots = list(dict.fromkeys(figures["robot"] for figures, _ in runs))
    drawing, axes = new_axes(2, len(robots), 5.6, sharex=True)
    upper, lower = axes[: len(robots)], axes[len(robots) :]
    for axis, robot in zip(upper, robots, strict=True):
        axis.set_title(robot)
    for figures, series in runs:
        if figures["filter"] != "none" or figures["target"] != target:
            continue
        column, colour = robots.index(figures["robot"]), FILTERED[1 - WAYS.index(figures["singular"])]
        names = load_robot(figures["robot"]).joint_names
        elbow = next(i for i, n in enumerate(names) if "elbow" in n.lower() and n.lower().startswith("l"))
        style = {"color": colour, "lw": 1.0, "label": figures["singular"]}
        upper[column].plot(series["time"], series["v_safe"][:, 6 + elbow], **style)
        lower[column].semilogy(series["time"][1:], np.maximum(command_steps(series), 1e-5), **style)
    upper[0].set_ylabel("left elbow, command [rad/s]")
    lower[0].set_ylabel("step of the command [rad/s]")
    shared_legend(drawing, upper[0], 2)
    label_time(lower)
    return drawing
