"""Filters side by side where conditions conflict: the scenes of figures 2(b) and 4 of the p-SSA paper in one run."""

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console

from experiments.cli.console import make_console, progress, results_folder
from experiments.recording.recording import plain
from experiments.reports.corridor_table import corridor_table
from experiments.reports.table import show
from experiments.running.corridor_loop import DT, MARGINS, VARIANTS, CorridorLoop, CorridorRun, variant_title
from experiments.scenarios.corridor import (
    CLOSING,
    COMING,
    D_MIN,
    INSTANTS,
    LEAVING,
    OPENING,
    Corridor,
    corridor_kinematics,
    corridor_robot,
)
from experiments.scenarios.options import CorridorOptions, OutputOptions
from robots.checks import require_between, require_one_of, require_positive
from robots.description import RobotDescription
from robots.errors import ConfigError

if TYPE_CHECKING:
    from experiments.reports.corridor import CorridorScene


def corridor(options: CorridorOptions) -> int:
    """Run all filters, print a table, write results and report; returns 0."""
    scene = check_corridor(options)
    console = make_console()
    titles = [variant_title(name) for name in options.filters]
    robot = corridor_robot()
    bars = progress(console, titles, options.duration)
    with results_folder(OutputOptions(out=options.out), "corridor") as folder:
        loops = [CorridorLoop(robot, scene, name, options.weight, options.margins) for name in options.filters]
        with bars as advance:
            runs = [loop.run(options.duration, a) for loop, a in zip(loops, advance, strict=True)]
    save_corridor(folder, options, runs, loops[0].labels)
    show(corridor_table(runs, [run.name for run in runs]), console)
    if options.report:
        _report(folder, scene, robot, runs, console)
    console.print(f"results: {folder}")
    return 0


def check_corridor(options: CorridorOptions) -> Corridor:
    """Check every option before anything is made or written; returns the scene.

    Raises:
        ConfigError: an option is not allowed.
    """
    if not options.filters:
        raise ConfigError("filters", options.filters, "at least one of " + ", ".join(VARIANTS))
    for name in options.filters:
        require_one_of("filters", name, VARIANTS)
    if len(set(options.filters)) != len(options.filters):
        raise ConfigError("filters", " ".join(options.filters), "each of them once")
    require_between("duration", options.duration, 0.1, 120.0)
    require_positive("weight", options.weight)
    require_one_of("margins", options.margins, MARGINS)
    if options.seed is not None:
        require_between("seed", options.seed, 0, 2**63 - 1)
    return Corridor(options.gap, options.seed)


def save_corridor(folder: Path, options: CorridorOptions, runs: Sequence[CorridorRun], labels: Sequence[str]) -> None:
    """Write ``config.json``, ``summary.json`` (a list, one entry per run) and ``<name>/series.npz`` of each run.

    Raises:
        ConfigError: the folder cannot be written.
    """
    settings = {k: v for k, v in dataclasses.asdict(options).items() if k not in {"out", "report"}}
    config = {"experiment": "corridor", "robot": "g1", "options": settings, "dt": DT, "d_min": D_MIN, "rows": labels}
    try:
        for name, content in (("config", config), ("summary", [run.summary for run in runs])):
            text = json.dumps(plain(content), indent=2, allow_nan=False)
            (folder / f"{name}.json").write_text(text + "\n", encoding="utf-8")
        for run in runs:
            (folder / run.name).mkdir(exist_ok=True)
            arrays: dict[str, Any] = dict(run.series)
            np.savez_compressed(folder / run.name / "series.npz", **arrays)
    except OSError as error:
        raise ConfigError("out", str(folder), f"a folder that can be written ({error.strerror or error})") from error


def report_scene(scene: Corridor, robot: RobotDescription) -> "CorridorScene":
    """What the report has to know of the scene."""
    from experiments.reports.corridor import CorridorScene
    from experiments.reports.plots.corridor import Phase

    kin = corridor_kinematics(robot)
    words = (
        f"G1 on a fixed base, 17 joints, 19 spheres. Two boards close to {100 * scene.gap:g} cm about the left hand, "
        "whose sphere takes 10 cm and wants 5 cm on either side; its goal is then moved up 6 cm. A sphere comes to the "
        "left elbow from outside, stays and leaves. Nothing has to be hit. The robot follows the filter exactly, at "
        f"{1 / DT:g} Hz; bodies pass through each other, and collisions are counted."
    )
    return CorridorScene(
        words=words,
        phases=(Phase(CLOSING[1], OPENING[0], "boards closed"), Phase(COMING[1], LEAVING[0], "sphere at the elbow")),
        instants=tuple(INSTANTS),
        margin=D_MIN["obstacle"],
        joint_names=tuple(kin.joint_names),
        configuration=kin.full_configuration,
        obstacles=scene.obstacles,
    )


def _report(
    folder: Path, scene: Corridor, robot: RobotDescription, runs: Sequence[CorridorRun], console: Console
) -> None:
    from experiments.reports.corridor import corridor_frames, write_corridor_report
    from sims.rendering import rendering_problem

    if problem := rendering_problem():
        console.print(f"no pictures: {problem}", style="yellow")
    with console.status("rendering and writing the report"):
        shown = report_scene(scene, robot)
        frames = corridor_frames(shown, robot, runs)
        path = write_corridor_report(folder / "report.html", shown, robot, runs, frames, note=problem or "")
    console.print(f"report:  {path}")
