"""The report of one experiment: a single HTML file that needs nothing else to be read."""

import base64
import html
import json
import os
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

import numpy as np

from experiments.metrics.metric import known_figures
from experiments.recording.gait_phases import swings, walks
from experiments.recording.recording import (
    FILTER_STATUSES,
    GUARANTEED,
    RunResult,
    plain,
    run_title,
    smallest_self_collision,
)
from experiments.reports import balance_plots as balance
from experiments.reports import distance_plots as distances
from experiments.reports import plots
from experiments.reports.page import image, plot_section, section, write_page
from robots.errors import ConfigError

Frames = Sequence[tuple[float, bytes]]

LARGEST_EMBEDDED_VIDEO = 8_000_000
"""Films above this size [bytes] stay beside the report and are linked."""

GUARANTEE_CAPTION = (
    "Smallest distance of arms, torso and head, and what the filter's condition promises of it for the velocity error "
    "d below: the robot's velocity less the filtered one. Dashed: for an error of that size in the worst direction. "
    "Dotted: for the error's own direction, at the closest pair. The solid line has to stay above the dashed one."
)

PLAN_CAPTION = (
    "Seen from above. The zero-moment point has to stay inside the soles that stand, or between them, or they tip. "
    "Dotted: what both soles span at the start."
)

BALANCE_CAPTION = (
    "The ZMP steers the CoM, and has to stay over the soles on the ground. In a walk both are counted from the way of "
    "the robot's base, smoothed."
)

CAPTIONS = (
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
    ("Hands", plots.hand_plot, "Where the hands were and where they were asked to be; the last row is the distance."),
    ("Balance", balance.plan_plot, PLAN_CAPTION),
    ("Balance over time", balance.balance_plot, BALANCE_CAPTION),
    (
        "Feet",
        balance.feet_plot,
        "Force of the ground on each foot, and how high its sole was over where it stood first; dashed: asked for.",
    ),
    (
        "Velocity",
        balance.velocity_plot,
        "Velocity of the body in its own heading, over a left and a right step each, so that its swaying cancels.",
    ),
    ("Centre of mass", plots.com_plot, "How far the centre of mass was from where it was asked to be."),
    ("Filter", plots.filter_plot, "How much the safety filter changed the velocity it was given, and by what means."),
    ("Torques", plots.torque_plot, "Motor torque as a share of the motor's limit."),
    ("Computing time", plots.tick_plot, "Time of one control tick; the line is the median."),
)


def write_report(
    path: Path,
    results: Sequence[RunResult],
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
    parts = [
        _head(results, title, note),
        section("Outcome", _verdicts(results)),
        section("Figures", _table(results)),
        _video(video, path),
        _frame_section(results, frames),
        *(plot_section(heading, plot(results), caption) for heading, plot, caption in CAPTIONS),
        _configuration(results),
    ]
    return write_page(path, title, parts)


def verdict(result: RunResult) -> list[tuple[bool, str]]:
    """What happened in a run, in plain words.

    Args:
        result: the run.

    Returns:
        (whether it is good, sentence) for standing or falling, self-collision, the other barriers, the bounds that
        the filter promises, and the filter.
    """
    if not len(result.series["time"]):
        return [(False, "ended before the first tick")]
    out = [_upright(result)]
    if cause := result.summary.get("stop_cause"):
        out.append((False, f"was stopped: {cause}"))
    out += [(True, f"was pushed with {push}") for push in result.summary.get("pushes", ())]
    if result.series["h_self_collision"].size:
        out.append(_clearance(result))
    out += _other_barriers(result) + _promise(result) + _feet(result)
    counts = np.bincount(result.series["filter_status"].astype(int), minlength=len(FILTER_STATUSES))
    if counts[2]:
        first = result.summary.get("first_relaxed")
        why = f"; the first {' '.join(first.split())}" if first else ""
        out.append((False, f"the filter had to relax its conditions in {_ticks(int(counts[2]))}{why}"))
    if counts[3]:
        out.append((False, f"the filter failed in {_ticks(int(counts[3]))}"))
    return out


def _upright(result: RunResult) -> tuple[bool, str]:
    fell = result.summary["fell"]
    end = f"{float(result.series['time'][-1]):.1f} s"
    return (False, f"fell over; the run ended after {end}") if fell else (True, f"stayed upright for {end}")


def _clearance(result: RunResult) -> tuple[bool, str]:
    h = result.series["h_self_collision"]
    smallest = smallest_self_collision(result)
    if np.isnan(smallest).any():
        return False, "distances between its bodies are not numbers in part of the run"
    step, pair = np.unravel_index(int(np.argmin(h)), h.shape)
    a, b = (name.replace("_", " ") for name in result.robot.self_collision_pairs[int(pair)])
    at = float(result.series["step_time"][step])
    if (worst := float(smallest.min())) < 0:
        share = f"{100.0 * float(np.mean(smallest < 0)):.2g} % of the time"
        return False, f"{a} entered {b} by {_mm(-worst)} (at {at:.1f} s; bodies overlapped for {share})"
    return True, f"bodies stayed clear of each other by {_mm(worst)} (closest: {a} and {b}, at {at:.1f} s)"


def _other_barriers(result: RunResult) -> list[tuple[bool, str]]:
    """Only what was violated: joint limits, obstacles and workspace bounds."""
    out = []
    obstacle = result.series.get("h_obstacle", np.empty(0))
    if obstacle.size and obstacle.min() < 0:
        out.append((False, f"an obstacle entered the robot by {_mm(-float(obstacle.min()))}"))
    joint = result.series["h_joint_limit"]
    if joint.size and joint.min() < 0:
        out.append((False, f"a joint went past its limit by {np.degrees(-joint.min()):.2g}°"))
    workspace = result.series["h_workspace"]
    for bound, h in zip(result.robot.workspace, workspace.T, strict=False):
        if h.size and h.min() < 0:
            out.append((False, f"{bound.name.replace('_', ' ')} went beyond its bound by {_mm(-float(h.min()))}"))
    return out


def _promise(result: RunResult) -> list[tuple[bool, str]]:
    """Only where h fell below what the filter's condition promises."""
    if result.summary.get("bound_held") is not False:
        return []
    out = []
    for family in GUARANTEED:
        unit = "rad" if family == "joint_limit" else "m"
        margin = result.summary.get(f"margin_{family}_{unit}")
        if family != "obstacle" and margin is not None and margin < 0:
            by = f"{np.degrees(-margin):.2g}°" if unit == "rad" else _mm(-margin)
            out.append((False, f"the {family.replace('_', ' ')} barrier fell below its guaranteed bound by {by}"))
    return out


def _feet(result: RunResult) -> list[tuple[bool, str]]:
    """How far the robot walked; or where the plan lifted one foot only, whether the ZMP stayed under the other."""
    way, steps = result.summary.get("distance_m"), result.summary.get("steps")
    if way is not None and steps:
        return [(True, f"walked {way:.2f} m in {steps} step{'s' if steps != 1 else ''}")]
    share = result.summary.get("zmp_inside_single_fraction")
    if share is None or walks(result.series):
        return []
    if share < 1.0:
        return [(False, f"the ZMP left the standing sole for {100.0 * (1.0 - share):.2g} % of the time on one foot")]
    return [(True, "the ZMP stayed within the standing sole all the time on one foot")]


def _mm(length: float) -> str:
    mm = 1e3 * length
    return f"{mm:.0f} mm" if mm >= 10 else f"{mm:.1f} mm" if mm >= 0.1 else f"{mm:.2g} mm"


def _ticks(count: int) -> str:
    return f"{count} tick" + ("s" if count != 1 else "")


def _head(results: Sequence[RunResult], title: str, note: str) -> str:
    robots = ", ".join(dict.fromkeys(r.robot.title for r in results))
    extra = f'<p class="soft">{html.escape(note)}</p>' if note else ""
    return f'<h1>{html.escape(title)}</h1><p class="soft">{html.escape(robots)}</p>{extra}'


def _verdicts(results: Sequence[RunResult]) -> str:
    out = []
    for result in results:
        lines = "".join(
            f'<li><span class="{"good" if good else "bad"}">{"✓" if good else "✗"}</span> {html.escape(text)}</li>'
            for good, text in verdict(result)
        )
        out.append(f'<strong>{html.escape(run_title(result))}</strong><ul class="verdict">{lines}</ul>')
    return "".join(out)


def _table(results: Sequence[RunResult]) -> str:
    head = "".join(f"<th>{html.escape(run_title(r))}</th>" for r in results)
    rows = []
    for figure, values in known_figures(results):
        cells = "".join(
            f'<td class="{"bad" if figure.is_bad(v) else "figure"}">{html.escape(figure.text(v))}</td>'
            for v in map(plain, values)
        )
        unit = f'<td class="unit">{html.escape(figure.unit)}</td>'
        rows.append(f"<tr><td>{html.escape(figure.words)}</td>{cells}{unit}</tr>")
    return f'<div class="scroll"><table><tr><th></th>{head}<th></th></tr>{"".join(rows)}</table></div>'


def _video(video: Path | None, report: Path) -> str:
    if video is None or not video.is_file():
        return ""
    if video.stat().st_size < LARGEST_EMBEDDED_VIDEO:
        source = "data:video/mp4;base64," + base64.b64encode(video.read_bytes()).decode()
    else:
        source = quote(Path(os.path.relpath(video, report.parent)).as_posix())
    return section("Film", f'<video controls muted loop playsinline src="{source}"></video>')


def _frame_section(results: Sequence[RunResult], frames: Sequence[Frames]) -> str:
    if not any(frames):
        return ""
    prints = " Grey plates on the floor: where the soles have stood." if any(swings(r.series) for r in results) else ""
    body = (
        '<p class="soft">Blue: far from every body it must not touch; green, yellow, orange: ever closer; '
        f"red: overlapping. Small green balls: where the hands should be.{prints}</p>"
    )
    for result, pictures in zip(results, frames, strict=True):
        figures = "".join(
            f"<figure>{image(png, f'robot at {t:.2f} s')}<figcaption>{t:.2f} s</figcaption></figure>"
            for t, png in pictures
        )
        body += f'<strong>{html.escape(run_title(result))}</strong><div class="frames">{figures}</div>'
    return section("Pictures", body)


def _configuration(results: Sequence[RunResult]) -> str:
    blocks = ""
    for result in results:
        text = json.dumps({"summary": plain(result.summary), "config": plain(result.config)}, indent=2)
        blocks += f"<p><strong>{html.escape(run_title(result))}</strong></p><pre>{html.escape(text)}</pre>"
    heading = "Every figure, and the resolved configuration"
    return f"<section><details><summary>{heading}</summary>{blocks}</details></section>"
