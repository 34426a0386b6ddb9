"""The report of the corridor: what came out, in words, figures, plots and pictures."""

import html
import io
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Plot
from matplotlib.lines import Line2D
from PIL import Image

from experiments.recording.recording import plain
from experiments.reports.media import distance_colours, obstacle_shapes
from experiments.reports.page import image, plot_section, section, write_page
from experiments.reports.plot_style import DPI, FILTERED, INK, UNFILTERED, UNSAFE, WIDTH, style_axes
from experiments.running.corridor_loop import DT, NAIVE, CorridorRun
from experiments.scenarios.corridor import (
    CLOSING,
    COMING,
    D_MIN,
    INSTANTS,
    LEAVING,
    OPENING,
    Corridor,
    corridor_kinematics,
)
from experiments.studies.corridor import FIGURES, figure_text, is_bad
from experiments.studies.corridor_findings import findings
from robots.description import RobotDescription
from robots.messages import Array
from sims.rendering import Camera, RobotRenderer, rendering_problem

WIDE = ".frames figure.wide { max-width: 32%; }"
"""Three pictures in a row."""

Style = dict[str, Any]
Frames = list[tuple[float, bytes]]

LEFT_HAND, LEFT_ELBOW, LEFT_SHOULDER_ROLL = "left_hand", "left_elbow_joint", "left_shoulder_roll_joint"

CAMERA = Camera(azimuth=205.0, elevation=-8.0, distance=0.62, look_at=(0.17, 0.12), height=0.70)

LEGEND = (
    "J: tracking of the goals, [P14]. C: how little conditions were violated where they were, [P15]. S: how little of "
    "a margin was used where it was entered, [P16]. All three: 1 is best. R_feas: share of ticks without violation, "
    "[P17]. Infeasible ticks: no velocity met all conditions (for SSA and its kin those of SSA). phi = d_min - d, with "
    "5 cm for obstacles and 1 cm for own bodies (with --margins own CBF and ISSf-CBF only promise d >= 0, which is "
    "phi <= 5 cm). Nearest hand, nearest body: smallest distance to an obstacle. Own bodies: smallest distance between "
    "two. Violation: sum over all conditions, mean over ticks. Excess: root of the sum of its squares, less what p-SSA "
    "would have at the same state, mean. Switches: pairs that enter or leave a margin. Jumps: largest change of a "
    "joint's velocity from tick to tick, RMS. [P n]: equations of Chen, Sun and Liu's paper on p-SSA."
)


def write_corridor_report(
    path: Path,
    scene: Corridor,
    robot: RobotDescription,
    runs: Sequence[CorridorRun],
    frames: Sequence[Frames] = (),
    note: str = "",
) -> Path:
    """Write the report.

    Args:
        path: the HTML file.
        scene: that was run.
        robot: that ran.
        runs: at least one.
        frames: pictures (time [s], PNG) of each run, in their order; may be empty.
        note: a sentence under the heading, for example why there are no pictures.

    Returns:
        ``path``.

    Raises:
        ConfigError: the file cannot be written.
    """
    joints = corridor_kinematics(robot).joint_names
    hand = [c.name for c in robot.collisions].index(LEFT_HAND)
    parts = [
        f'<h1>Corridor</h1><p class="soft">{html.escape(_scene_in_words(scene))}</p>',
        f'<p class="soft">{html.escape(note)}</p>' if note else "",
        section("What came out", "<ul>" + "".join(f"<li>{html.escape(s)}</li>" for s in findings(runs)) + "</ul>"),
        section("Figures", _table(runs) + f'<p class="soft">{html.escape(LEGEND)}</p>'),
        _pictures(runs, frames),
        plot_section(
            "phi of the left hand and its nearest obstacle", hand_plot(runs, hand), "As figure 10 of the paper."
        ),
        plot_section("Left elbow", joint_plot(runs, joints.index(LEFT_ELBOW)), "As figure 11 of the paper."),
        plot_section(
            "Left shoulder roll", joint_plot(runs, joints.index(LEFT_SHOULDER_ROLL)), "As figure 12 of the paper."
        ),
        plot_section("Total violation", violation_plot(runs), "Sum over all conditions of the filter, tick by tick."),
        section("Conflicts", _explanations(runs)),
        _raw(runs),
    ]
    return write_page(path, "Corridor", parts, WIDE)


def _scene_in_words(scene: Corridor) -> str:
    return (
        f"G1 on a fixed base, 17 joints, 19 spheres. Two boards close to {100 * scene.gap:g} cm about the left hand, "
        "whose sphere takes 10 cm and wants 5 cm on either side; its goal is then moved up 6 cm. A sphere comes to the "
        "left elbow from outside, stays and leaves. Nothing has to be hit. The robot follows the filter exactly, at "
        f"{1 / DT:g} Hz; bodies pass through each other, and collisions are counted."
    )


def corridor_frames(scene: Corridor, robot: RobotDescription, runs: Sequence[CorridorRun]) -> list[Frames]:
    """Pictures of each run before the sphere comes, while it is there and after it has left; none without OpenGL."""
    if rendering_problem() is not None:
        return []
    kin = corridor_kinematics(robot)
    out: list[Frames] = []
    with RobotRenderer(robot, 420, 360) as renderer:
        for run in runs:
            time = run.series["time"]
            ticks = [int(np.argmin(np.abs(time - t))) for t in INSTANTS if t <= time[-1] + 0.5 * DT]
            out.append([(float(time[k]), _picture(renderer, scene, kin.full_configuration, run, k)) for k in ticks])
    return out


def _picture(
    renderer: RobotRenderer, scene: Corridor, full: Callable[[Array], Array], run: CorridorRun, tick: int
) -> bytes:
    robot, series = renderer.robot, run.series
    nearest = series["h_obstacle"][tick].min(axis=1)
    index = {shape.name: i for i, shape in enumerate(robot.collisions)}
    for pair, h in zip(robot.self_collision_pairs, series["h_self_collision"][tick], strict=True):
        for name in pair:
            nearest[index[name]] = min(nearest[index[name]], h)
    shapes = obstacle_shapes(scene.obstacles(float(series["time"][tick])))
    q = full(series["q"][tick])
    image = renderer.image(q, distance_colours(nearest), CAMERA, series["goals"][tick], shapes=shapes)
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, format="PNG", optimize=True)
    return buffer.getvalue()


def hand_plot(runs: Sequence[CorridorRun], hand: int) -> bytes:
    """Index phi of body ``hand`` and its nearest obstacle over time [mm]."""

    def draw(axis: Axes, run: CorridorRun, style: Style) -> None:
        phi = D_MIN["obstacle"] - run.series["h_obstacle"][:, hand].min(axis=1)
        axis.plot(run.series["time"], 1e3 * phi, **style)

    def finish(axis: Axes) -> None:
        axis.set_ylabel("phi [mm]")
        contact, top = 1e3 * D_MIN["obstacle"], axis.get_ylim()[1]
        # where all is well is not worth most of the picture
        axis.set_ylim(-contact, max(top, 1.2 * contact))
        axis.axhspan(contact, axis.get_ylim()[1], color=UNSAFE, alpha=0.09, lw=0)
        axis.axhline(0.0, color=INK, lw=0.8, ls=":")
        axis.annotate("contact", (0.0, contact), (3, 3), textcoords="offset points", fontsize=8, color=UNSAFE)
        axis.annotate("d_min", (0.0, 0.0), (3, 3), textcoords="offset points", fontsize=8, color=INK)

    return _overlay(runs, draw, finish)


def joint_plot(runs: Sequence[CorridorRun], joint: int) -> bytes:
    """Position of one joint over time [rad]."""
    return _overlay(
        runs,
        lambda axis, run, style: _line(axis, run, run.series["q"][:, joint], style),
        lambda axis: _label(axis, "position [rad]"),
    )


def violation_plot(runs: Sequence[CorridorRun]) -> bytes:
    """Total violation over time [m/s]."""
    return _overlay(
        runs,
        lambda axis, run, style: _line(axis, run, run.series["violation"], style),
        lambda axis: _label(axis, "total violation [m/s]"),
    )


def _line(axis: Axes, run: CorridorRun, values: Array, style: Style) -> None:
    axis.plot(run.series["time"], values, **style)


def _label(axis: Axes, text: str) -> None:
    axis.set_ylabel(text)


def _overlay(
    runs: Sequence[CorridorRun],
    draw: Callable[[Axes, CorridorRun, Style], None],
    finish: Callable[[Axes], None],
) -> bytes:
    """One axes with all runs, the scene's phases shaded; ``draw`` adds one run, ``finish`` the rest; the PNG."""
    figure = Plot(figsize=(WIDTH, 3.4), dpi=DPI, layout="constrained")
    axis = figure.subplots()
    styles = _styles(runs)
    for run, style in zip(runs, styles, strict=True):
        draw(axis, run, style)
    for line in axis.get_lines():
        line.set_linewidth(1.3)
    finish(axis)
    end = float(max(run.series["time"][-1] for run in runs))
    for start, stop, shade, words in (
        (CLOSING[1], OPENING[0], 0.05, "boards closed"),
        (COMING[1], LEAVING[0], 0.09, "sphere at the elbow"),
    ):
        if start < end:
            axis.axvspan(start, min(stop, end), color=INK, alpha=shade, lw=0)
            place = (start, 1.0 if shade < 0.06 else 0.93)
            style = {"textcoords": "offset points", "fontsize": 8, "color": INK, "va": "top"}
            axis.annotate(words, place, (4, -3), xycoords=axis.get_xaxis_transform(), **style)
    axis.set_xlim(0.0, end)
    axis.set_xlabel("time [s]", fontsize=8.5, color=INK)
    axis.yaxis.label.set(fontsize=8.5, color=INK)
    style_axes([axis])
    handles = [Line2D([], [], lw=2.2, label=run.title, **style) for run, style in zip(runs, styles, strict=True)]
    figure.legend(handles=handles, loc="outside upper center", ncols=6, frameon=False, fontsize=9)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def _styles(runs: Sequence[CorridorRun]) -> list[Style]:
    """Red for naive SSA and for no filter, another colour for each other; SSA is dashed and over p-SSA."""
    free = iter(FILTERED)
    out = []
    for run in runs:
        colour = UNFILTERED if run.name in {NAIVE, "none"} else next(free)
        dashes = {"ssa": (0, (4, 4)), "none": (0, (1, 1))}.get(run.name, "-")
        out.append({"color": colour, "ls": dashes, "zorder": 3 if run.name == "ssa" else 2})
    return out


def _table(runs: Sequence[CorridorRun]) -> str:
    head = "".join(f"<th>{html.escape(run.title)}</th>" for run in runs)
    rows = []
    for figure in FIGURES:
        looks = ["bad" if is_bad(figure, run) else "figure" for run in runs]
        cells = "".join(f'<td class="{k}">{figure_text(figure, run)}</td>' for k, run in zip(looks, runs, strict=True))
        rows.append(f'<tr><td>{html.escape(figure.words)}</td>{cells}<td class="unit">{figure.unit}</td></tr>')
    return f'<div class="scroll"><table><tr><th></th>{head}<th></th></tr>{"".join(rows)}</table></div>'


def _pictures(runs: Sequence[CorridorRun], frames: Sequence[Frames]) -> str:
    if not any(frames):
        return ""
    body = (
        '<p class="soft">Grey: boards and sphere. Green balls: goals of the hands. Bodies are blue where nothing is '
        "within 5 cm; green, yellow, orange: ever closer; red: overlapping.</p>"
    )
    for run, pictures in zip(runs, frames, strict=True):
        figures = "".join(
            f'<figure class="wide">{image(png, f"robot at {t:.2f} s")}<figcaption>{t:.2f} s</figcaption></figure>'
            for t, png in pictures
        )
        body += f'<strong>{html.escape(run.title)}</strong><div class="frames">{figures}</div>'
    return section("Before, with and after the sphere", body)


def _explanations(runs: Sequence[CorridorRun]) -> str:
    return "".join(
        f"<details{' open' if run is runs[0] else ''}><summary>{html.escape(run.title)}</summary>"
        f"<pre>{html.escape(run.explanation)}</pre></details>"
        for run in runs
    )


def _raw(runs: Sequence[CorridorRun]) -> str:
    text = html.escape(json.dumps(plain([run.summary for run in runs]), indent=2))
    return f"<section><details><summary>Every figure</summary><pre>{text}</pre></details></section>"
