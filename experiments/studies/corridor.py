"""Filters side by side where conditions conflict: the scenes of figures 2(b) and 4 of the p-SSA paper in one run."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from experiments.recording.recording import write_recording
from experiments.recording.store import add_file, write_json, write_run
from experiments.reports.corridor_table import corridor_table
from experiments.reports.table import show
from experiments.running.corridor_loop import (
    DT,
    MARGINS,
    VARIANTS,
    CorridorLoop,
    CorridorRun,
    corridor_loop,
    recording_of,
    variant_title,
)
from experiments.running.ending import INTERRUPTED
from experiments.running.terminal import ask_to_stop, make_console, progress, results_folder
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
from experiments.scenarios.corridor_case import CorridorCase
from experiments.scenarios.options import CorridorOptions, OutputOptions
from robots.checks import require_between, require_one_of, require_positive
from robots.description import RobotDescription
from robots.errors import ConfigError

if TYPE_CHECKING:
    from experiments.reports.corridor import CorridorScene


def corridor(options: CorridorOptions) -> int:
    """Run all filters, print a table, write results and report; returns 0, or 130 where a person stopped it."""
    scene, cases = check_corridor(options), corridor_cases(options)
    console = make_console()
    robot = corridor_robot()
    bars = progress(console, [variant_title(name) for name in options.filters], options.duration)
    with results_folder(OutputOptions(out=options.out, overwrite=options.overwrite), "corridor") as folder:
        loops = [corridor_loop(case) for case in cases]
        runs: list[CorridorRun] = []
        with bars as advance, ask_to_stop() as asked:
            for loop, bar in zip(loops, advance, strict=True):
                runs.append(loop.run(options.duration, bar, asked.is_set))
                if asked.is_set():
                    break
        save_corridor(folder, cases, loops, runs)
        show(corridor_table(runs, [run.name for run in runs]), console)
        if options.report:
            _report(folder, scene, robot, runs, console)
    console.print(f"results: {folder}")
    return 130 if runs[-1].summary["stop_cause"] == INTERRUPTED else 0


def corridor_cases(options: CorridorOptions) -> list[CorridorCase]:
    """One for each filter."""
    shared = {name: getattr(options, name) for name in ("duration", "seed", "weight", "margins", "gap")}
    return [CorridorCase(filter=name, **shared) for name in options.filters]


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


def save_corridor(
    folder: Path, cases: Sequence[CorridorCase], loops: Sequence[CorridorLoop], runs: Sequence[CorridorRun]
) -> None:
    """Write each run into a folder of its own, and ``filters.json``: their summaries in a list.

    Raises:
        ConfigError: the folder cannot be written.
    """
    for case, loop, run in zip(cases, loops, runs, strict=False):
        write_recording(recording_of(case, loop, run), folder / run.name)
    # pictures of earlier runs go with them
    write_run(folder, {})
    add_file(folder, "filters.json", write_json("filters", [run.summary for run in runs]))


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
        write = partial(write_corridor_report, scene=shown, robot=robot, runs=runs, frames=frames, note=problem or "")
        add_file(folder, "report.html", write)
    console.print(f"report:  {folder / 'report.html'}")
