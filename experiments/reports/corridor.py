"""The report of filters in one scene where conditions conflict: figures, plots, pictures, and what was in conflict."""

import io
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from experiments.recording.plain import plain
from experiments.reports.corridor_table import LEGEND, FilterRun, corridor_table
from experiments.reports.media import distance_colours, obstacle_shapes
from experiments.reports.page import PlotPart, write_page
from experiments.reports.plots.corridor import Phase, hand_plot, joint_plot, violation_plot
from robots.description import RobotDescription
from robots.messages import Array
from safety.geometry.shapes import Obstacle
from sims.rendering import Camera, RobotRenderer, rendering_problem

Frames = list[tuple[float, bytes]]

LEFT_HAND, LEFT_ELBOW, LEFT_SHOULDER_ROLL = "left_hand", "left_elbow_joint", "left_shoulder_roll_joint"

CAMERA = Camera(azimuth=205.0, elevation=-8.0, distance=0.62, look_at=(0.17, 0.12), height=0.70)

PICTURES_CAPTION = (
    "Grey: boards and sphere. Green balls: goals of the hands. Bodies are blue where nothing is within 5 cm; green, "
    "yellow, orange: ever closer; red: overlapping."
)


@dataclass(frozen=True, slots=True)
class CorridorScene:
    """What the report has to know of the scene.

    Attributes:
        words: what happens in it.
        phases: stretches of time to shade.
        instants: of the pictures [s].
        margin: distance to keep from obstacles [m].
        joint_names: of the joints that move, in the order of ``q`` in the series.
        configuration: from these joints' positions (n,) [rad] to the robot's whole configuration.
        obstacles: from time [s] to where the obstacles are.
    """

    words: str
    phases: tuple[Phase, ...]
    instants: tuple[float, ...]
    margin: float
    joint_names: tuple[str, ...]
    configuration: Callable[[Array], Array]
    obstacles: Callable[[float], Sequence[Obstacle]]


def write_corridor_report(
    path: Path,
    scene: CorridorScene,
    robot: RobotDescription,
    runs: Sequence[FilterRun],
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
    return write_page(
        path,
        "corridor.html.jinja",
        title="Corridor",
        lead=scene.words,
        note=note,
        runs=runs,
        table=corridor_table(runs, [run.title for run in runs], LEGEND),
        pictures_caption=PICTURES_CAPTION,
        frames=frames,
        plots=_plots(scene, robot, runs),
        settings=json.dumps(plain([run.summary for run in runs]), indent=2),
    )


def _plots(scene: CorridorScene, robot: RobotDescription, runs: Sequence[FilterRun]) -> list[PlotPart]:
    """Those of the paper on p-SSA, and the violation."""
    hand = [shape.name for shape in robot.collisions].index(LEFT_HAND)
    elbow, roll = (scene.joint_names.index(name) for name in (LEFT_ELBOW, LEFT_SHOULDER_ROLL))
    phi = hand_plot(runs, scene.phases, hand, scene.margin)
    return [
        PlotPart("phi of the left hand and its nearest obstacle", phi, "As figure 10 of the paper."),
        PlotPart("Left elbow", joint_plot(runs, scene.phases, elbow), "As figure 11 of the paper."),
        PlotPart("Left shoulder roll", joint_plot(runs, scene.phases, roll), "As figure 12 of the paper."),
        PlotPart(
            "Total violation",
            violation_plot(runs, scene.phases),
            "Sum over all conditions of the filter, tick by tick.",
        ),
    ]


def corridor_frames(scene: CorridorScene, robot: RobotDescription, runs: Sequence[FilterRun]) -> list[Frames]:
    """Pictures of each run at the scene's instants; none without OpenGL."""
    if rendering_problem() is not None:
        return []
    with RobotRenderer(robot, 420, 360) as renderer:
        return [[(t, _picture(renderer, scene, run, k)) for t, k in _instants(scene, run)] for run in runs]


def _instants(scene: CorridorScene, run: FilterRun) -> list[tuple[float, int]]:
    """Time [s] and number of the tick nearest to each instant that the run got to."""
    time = run.series["time"]
    period = float(time[1] - time[0]) if len(time) > 1 else 0.0
    ticks = [int(np.argmin(np.abs(time - t))) for t in scene.instants if t <= time[-1] + 0.5 * period]
    return [(float(time[k]), k) for k in ticks]


def _picture(renderer: RobotRenderer, scene: CorridorScene, run: FilterRun, tick: int) -> bytes:
    series = run.series
    colours = distance_colours(_nearest(renderer.robot, run, tick))
    shapes = obstacle_shapes(scene.obstacles(float(series["time"][tick])))
    image = renderer.image(
        scene.configuration(series["q"][tick]), colours, CAMERA, series["goals"][tick], shapes=shapes
    )
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, format="PNG", optimize=True)
    return buffer.getvalue()


def _nearest(robot: RobotDescription, run: FilterRun, tick: int) -> Array:
    """Distance of each body from what is nearest to it, obstacles and own bodies, shape (bodies,) [m]."""
    nearest: Array = run.series["h_obstacle"][tick].min(axis=1)
    index = {shape.name: i for i, shape in enumerate(robot.collisions)}
    for pair, h in zip(robot.self_collision_pairs, run.series["h_self_collision"][tick], strict=True):
        for name in pair:
            nearest[index[name]] = min(nearest[index[name]], h)
    return nearest
