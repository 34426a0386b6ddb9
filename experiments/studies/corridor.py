"""Filters side by side where conditions conflict: the scenes of figures 2(b) and 4 of the p-SSA paper in one run."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.recording.recording import Recording, load_recording
from experiments.recording.store import add_file
from experiments.reports.corridor_table import FIGURES, corridor_table
from experiments.reports.table import show
from experiments.running.corridor_loop import DT, MARGINS, VARIANTS, CorridorRun, variant_title
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
from experiments.studies.case import Case, Study
from experiments.studies.command import command_line, run_study, study_folder, tell_failures
from experiments.studies.progress import study_console
from experiments.studies.runs import run_case
from experiments.studies.study_options import CorridorOptions
from robots.checks import require_between, require_one_of, require_positive
from robots.description import RobotDescription
from robots.errors import ConfigError

if TYPE_CHECKING:
    from experiments.reports.corridor import CorridorScene

REPORT = "report.html"


def corridor(options: CorridorOptions) -> int:
    """Run every filter, print their table, write the report; returns 0, or 1 where runs failed.

    Raises:
        SafeWbcError: an option is not allowed; nothing has run then.
    """
    scene = check_corridor(options)
    folder = study_folder(options.work.out, "corridor")
    command = command_line("run corridor", options, folder)
    study = Study("Filters in the corridor", corridor_cases(options), command=command, metrics=FIGURES)
    rows = list(run_study(study, options.work, folder))
    runs = [filter_run(load_recording(folder / str(row.folder))) for row in rows if row.error is None]
    if runs:
        show(corridor_table(runs, [run.name for run in runs]))
        # one of an earlier call may be of other filters
        (folder / REPORT).unlink(missing_ok=True)
        if options.report:
            _report(folder, scene, runs)
    return tell_failures(rows, folder)


def corridor_cases(options: CorridorOptions) -> list[Case]:
    """One for each filter."""
    shared = {name: getattr(options, name) for name in ("duration", "seed", "weight", "margins", "gap")}
    return [
        run_case(CorridorCase(filter=name, **shared), {"filter": name}, name, measure=corridor_row)
        for name in options.filters
    ]


def corridor_row(result: Recording) -> dict[str, Any]:
    """The figures of merit of a run."""
    left_out = ("scenario", "name", "versions")
    return {name: value for name, value in result.summary.items() if name not in left_out}


def filter_run(result: Recording) -> CorridorRun:
    """A saved run as table and report show it."""
    name = result.summary["name"]
    return CorridorRun(name, variant_title(name), result.summary, result.series, result.summary["explanation"])


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
    require_between("jobs", options.work.jobs, 1, 64)
    require_positive("weight", options.weight)
    require_one_of("margins", options.margins, MARGINS)
    if options.seed is not None:
        require_between("seed", options.seed, 0, 2**63 - 1)
    return Corridor(options.gap, options.seed)


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


def _report(folder: Path, scene: Corridor, runs: Sequence[CorridorRun]) -> None:
    from experiments.reports.corridor import corridor_frames, write_corridor_report
    from sims.rendering import rendering_problem

    console, robot = study_console(), corridor_robot()
    if problem := rendering_problem():
        console.print(f"no pictures: {problem}", style="yellow")
    with console.status("rendering and writing the report"):
        shown = report_scene(scene, robot)
        frames = corridor_frames(shown, robot, runs)
        write = partial(write_corridor_report, scene=shown, robot=robot, runs=runs, frames=frames, note=problem or "")
        add_file(folder, REPORT, write)
    console.print(f"report:  {folder / REPORT}")
