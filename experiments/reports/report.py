"""The report of one experiment: a single HTML file that needs nothing else to be read."""

import json
import os
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

from experiments.recording.gait_phases import swings
from experiments.recording.plain import plain
from experiments.recording.recording import Recording, run_title
from experiments.reports.metric_tables import runs_table
from experiments.reports.page import PlotPart, data_uri, write_page
from experiments.reports.plots import balance, distances, estimate, signals
from experiments.reports.verdicts import verdict
from robots.errors import ConfigError

Frames = Sequence[tuple[float, bytes]]

LARGEST_EMBEDDED_VIDEO = 8_000_000
"""Films above this size [bytes] stay beside the report and are linked."""

GUARANTEE_CAPTION = (
    "Smallest distance of arms, torso and head, and what the filter's condition guarantees of it for the velocity "
    "error d below: the robot's velocity less the filtered one. Dashed: for an error of that size in the worst "
    "direction. Dotted: for the error's own direction, at the closest pair. The solid line has to stay "
    "above the dashed one."
)

PLAN_CAPTION = (
    "Seen from above. The zero-moment point has to stay inside the soles that stand, or between them, or they tip. "
    "Dotted: what both soles span at the start."
)

BALANCE_CAPTION = (
    "The ZMP steers the CoM, and has to stay over the soles on the ground. In a walk both are counted from the way of "
    "the robot's base, smoothed."
)

PICTURES_CAPTION = (
    "Blue: far from every body it must not touch; green, yellow, orange: ever closer; red: overlapping. Small green "
    "balls: where the hands should be."
)

PLOTS = (
    (
        "Distances",
        distances.barrier_plot,
        "Distance of hands and torso where they came closest, then the smallest of all pairs; negative: overlapping.",
    ),
    ("Guarantee", distances.guarantee_plot, GUARANTEE_CAPTION),
    (
        "Obstacle",
        distances.obstacle_plot,
        "Distance between the obstacle and the closest body; below zero they overlap.",
    ),
    ("Feet apart", distances.feet_plot, "Distance between the feet, and of the legs; below zero they overlap."),
    (
        "Limits",
        distances.limits_plot,
        "Room to the nearest joint limit, and the distance of each shoulder and hand; the red line is its bound.",
    ),
    ("Hands", signals.hand_plot, "Where the hands were and where they were asked to be; the last row is the distance."),
    ("Balance", balance.plan_plot, PLAN_CAPTION),
    ("Balance over time", balance.balance_plot, BALANCE_CAPTION),
    (
        "Feet",
        balance.feet_plot,
        "Force of the ground on each foot, and how high its sole was over where it stood first; dashed: asked for.",
    ),
    (
        "State estimate",
        estimate.estimate_plot,
        "What the controller was told of the base, less the truth: velocity along the world's axes, tilt, height.",
    ),
    (
        "Contacts",
        estimate.contact_plot,
        "Estimated force on each sole, dashed the true one, and the probability that the foot stands.",
    ),
    (
        "Velocity",
        balance.velocity_plot,
        "Velocity of the body in its own heading, over a left and a right step each, so that its swaying cancels.",
    ),
    ("Centre of mass", signals.com_plot, "How far the centre of mass was from where it was asked to be."),
    ("Filter", signals.filter_plot, "How much the safety filter changed the velocity it was given, and by what means."),
    ("Torques", signals.torque_plot, "Motor torque as a fraction of the motor's limit."),
    ("Computing time", signals.tick_plot, "Time of one control tick; the line is the median."),
)


def write_report(
    path: Path,
    results: Sequence[Recording],
    title: str,
    frames: Sequence[Frames] = (),
    video: Path | None = None,
    note: str = "",
) -> Path:
    """Write the report.

    Args:
        path: the HTML file.
        results: at least one run; several are shown side by side.
        title: heading.
        frames: pictures (time [s], PNG) of each run, in the order of ``results``; may be empty.
        video: film of the runs; put into the file unless it is large, then linked by its relative path.
        note: a sentence under the heading, for example why there are no pictures.

    Returns:
        ``path``.

    Raises:
        ConfigError: there is no run, ``frames`` has another length, or the file cannot be written.
    """
    if not results:
        raise ConfigError("results", [], "at least one run")
    if frames and len(frames) != len(results):
        raise ConfigError("frames", len(frames), f"one list of pictures per run, {len(results)} in all")
    return write_page(
        path,
        "run.html.jinja",
        title=title,
        lead=", ".join(dict.fromkeys(r.robot.title for r in results)),
        note=note,
        runs=[{"title": run_title(r), "verdict": verdict(r)} for r in results],
        table=runs_table(results),
        video=_video(video, path),
        pictures_caption=_pictures_caption(results),
        frames=frames,
        plots=_plots(results),
        settings=[(run_title(r), _settings(r)) for r in results],
    )


def _plots(results: Sequence[Recording]) -> list[PlotPart]:
    return [PlotPart(heading, plot(results), caption) for heading, plot, caption in PLOTS]


def _video(video: Path | None, report: Path) -> str:
    """Where the page has its film from; empty for none."""
    if video is None or not video.is_file():
        return ""
    if video.stat().st_size < LARGEST_EMBEDDED_VIDEO:
        return data_uri(video.read_bytes(), "video/mp4")
    return quote(Path(os.path.relpath(video, report.parent)).as_posix())


def _pictures_caption(results: Sequence[Recording]) -> str:
    prints = " Grey plates on the floor: where the soles have stood." if any(swings(r.series) for r in results) else ""
    return PICTURES_CAPTION + prints


def _settings(result: Recording) -> str:
    return json.dumps({"summary": plain(result.summary), "config": plain(result.config)}, indent=2)
