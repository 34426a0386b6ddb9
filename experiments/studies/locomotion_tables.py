"""What the tables on locomotion are made of: runs and searches, and the columns to show."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from experiments.metrics.metric import Metric, column
from experiments.running.pool import Row, RunTask, Task
from experiments.scenarios.lateral_steps import LateralSteps
from experiments.scenarios.options import FilterOptions, PlantOptions
from experiments.scenarios.scenario import Scenario
from experiments.scenarios.taichi import Taichi
from experiments.scenarios.walk import Walk
from experiments.studies.pushes import PUSH_COLUMNS, push_tasks
from experiments.studies.random_walks import RANDOM_WALK_COLUMNS, falls, random_walk_tasks
from experiments.studies.speed import SPEED_COLUMNS, WALK_TIME, fastest_walk
from experiments.studies.study_options import LocomotionTableOptions, PushSearchOptions, RandomWalksOptions

ROBOTS = ("g1", "tocabi")
MASS_SCALES = (1.0, 1.2)
MIXED = Path(__file__).parents[1] / "data" / "mixed.txt"
"""Script of the walk with everything in it."""

GAITS: dict[str, dict[str, Any]] = {
    "on the spot": {"vx": 0.0},
    "forward": {"vx": 0.3},
    "sideways": {"vx": 0.0, "vy": 0.1},
    "turning": {"vx": 0.0, "wz": 0.3},
    "mixed": {"script": MIXED},
}
"""Walks by name: options that differ from those of a walk."""

ROBOT, MASS, FELL = Metric("robot", "robot"), Metric("mass_scale", "mass"), Metric("ended", "fell")
FILTER, FAILURES = Metric("filter", "filter"), column("qp_failures", "QP failures")
ON_ONE = Metric("zmp_inside_single_fraction", "ZMP inside, on one foot", "%", 1e2)
SLIDE = Metric("foot_slide_max_m", "stance foot slides, max", "mm", 1e3)
TAICHI_COLUMNS = (
    *(ROBOT, FILTER, Metric("torque", "torque"), MASS, Metric("friction", "friction"), FELL),
    Metric("foot_up_s", "foot up", "s"),
    ON_ONE,
    column("min_h_workspace_m", "min h workspace"),
    column("com_error_settled_max_m", "CoM error, max"),
    Metric("torque_step_max", "torque step / limit, max", "%", 1e2),
    Metric("tick_double_ms", "tick on two feet", "ms"),
    Metric("tick_single_ms", "on one", "ms"),
    FAILURES,
)
LATERAL_COLUMNS = (
    *(ROBOT, FILTER, MASS, FELL),
    Metric("steps", "steps"),
    Metric("min_h_feet_m", "min h feet", "mm", 1e3),
    Metric("feet_penetrate_fraction", "feet in each other", "%", 1e2),
    Metric("min_h_legs_m", "min h legs", "mm", 1e3),
    ON_ONE,
    FAILURES,
)
WALK_COLUMNS = (
    *(ROBOT, Metric("gait", "walk"), MASS, FELL),
    Metric("steps", "steps"),
    Metric("distance_m", "way", "m"),
    Metric("velocity_error_x_mps", "v error forward", "m/s"),
    Metric("velocity_error_y_mps", "left", "m/s"),
    Metric("velocity_error_wz_radps", "turning", "rad/s"),
    SLIDE,
    ON_ONE,
    column("min_h_self_collision_m", "min h self-collision"),
    column("max_torque_fraction", "torque / limit, max"),
    FAILURES,
)
OBSTACLE_COLUMNS = (
    *(ROBOT, Metric("obstacle", "sphere"), FILTER, MASS, FELL),
    column("min_h_obstacle_m", "min h obstacle"),
    column("min_h_self_collision_m", "min h self-collision"),
    Metric("velocity_error_x_mps", "v error forward", "m/s"),
    Metric("steps", "steps"),
    FAILURES,
)
TICK_COLUMNS = (
    *(ROBOT, Metric("run", "run")),
    Metric("tick_double_ms", "on two feet, median", "ms"),
    Metric("tick_double_p99_ms", "99 %", "ms"),
    Metric("tick_single_ms", "on one foot, median", "ms"),
    Metric("tick_single_p99_ms", "99 %", "ms"),
    FAILURES,
)


@dataclass(frozen=True, slots=True)
class StudyTable:
    """One table.

    Attributes:
        title: above it.
        tasks: one a line.
        columns: to show.
        note: a sentence below it, from its lines.
        alone: whether its tasks are run by one process while no other runs.
    """

    title: str
    tasks: Sequence[Task]
    columns: tuple[Metric, ...]
    note: Callable[[Sequence[Row]], str] | None = None
    alone: bool = False


def chosen_tables(options: LocomotionTableOptions, folder: Path) -> list[StudyTable]:
    """The tables of the chosen sections, their runs in folders below ``folder``."""
    makers = {
        "taichi": taichi_table,
        "lateral-steps": lateral_table,
        "walks": walk_table,
        "speed": speed_table,
        "pushes": push_table,
        "obstacle": obstacle_table,
        "random-walks": random_table,
        "ticks": tick_table,
    }
    return [make(options, folder / name) for name, make in makers.items() if name in options.only]


def robots(options: LocomotionTableOptions) -> tuple[str, ...]:
    """The robots to show."""
    return ROBOTS[:1] if options.quick else ROBOTS


def masses(options: LocomotionTableOptions) -> tuple[float, ...]:
    """Mass scales of the simulated robots."""
    return MASS_SCALES[:1] if options.quick else MASS_SCALES


def taichi_table(options: LocomotionTableOptions, folder: Path) -> StudyTable:
    """On one leg: masses and grounds, then without filter, then without DynWBC's torques."""
    variants = [("issf", "full", mass, mu) for mass in (0.9, 1.0, 1.2) for mu in (0.5, 1.0)]
    variants += [("none", "full", mass, 1.0) for mass in MASS_SCALES]
    variants += [("issf", torque, 1.0, 1.0) for torque in ("pd-only", "gravity")]
    if options.quick:
        variants = variants[-2:-1]
    tasks = []
    for robot, (name, torque, mass, mu) in itertools.product(robots(options), variants):
        plant, safety = PlantOptions(mass_scale=mass, friction=mu), FilterOptions(filter=name)
        run = Taichi(robot=robot, torque=torque, plant=plant, safety=safety)
        place = folder / f"{robot}-{name}-{torque}-mass-{mass:g}-friction-{mu:g}"
        tasks.append(RunTask(run, place, {"torque": torque, "friction": mu}, options.series))
    return StudyTable("Standing on one leg, hands to far targets (TAICHI), 30 s", tasks, TAICHI_COLUMNS)


def lateral_table(options: LocomotionTableOptions, folder: Path) -> StudyTable:
    """Side steps whose footholds collide."""
    variants = itertools.product(
        robots(options), ("issf", "cbf", "none"), MASS_SCALES[:1] if options.quick else MASS_SCALES
    )
    tasks = [
        RunTask(
            LateralSteps(robot=robot, plant=PlantOptions(mass_scale=mass), safety=FilterOptions(filter=name)),
            folder / f"{robot}-{name}-mass-{mass:g}",
            {},
            options.series,
        )
        for robot, name, mass in variants
    ]
    return StudyTable("Side steps to footholds that collide", tasks, LATERAL_COLUMNS)


def walk_table(options: LocomotionTableOptions, folder: Path) -> StudyTable:
    """Walks of a minute."""
    gaits = {"forward": GAITS["forward"]} if options.quick else GAITS
    duration = 10.0 if options.quick else 60.0
    tasks = []
    for robot, (gait, how), mass in itertools.product(robots(options), gaits.items(), MASS_SCALES):
        run = Walk(robot=robot, duration=duration, plant=PlantOptions(mass_scale=mass), **how)
        place = folder / f"{robot}-{gait}-mass-{mass:g}".replace(" ", "-")
        tasks.append(RunTask(run, place, {"gait": gait}, options.series))
    return StudyTable(f"Walks of {duration:g} s", tasks, WALK_COLUMNS)


def speed_table(options: LocomotionTableOptions, folder: Path) -> StudyTable:
    """The fastest walks."""
    duration = 10.0 if options.quick else WALK_TIME
    pairs = itertools.product(robots(options), masses(options))
    tasks = [partial(fastest_walk, robot, mass, duration, folder) for robot, mass in pairs]
    return StudyTable(f"Fastest walk forward, {duration:g} s", tasks, SPEED_COLUMNS)


def push_table(options: LocomotionTableOptions, folder: Path) -> StudyTable:
    """The strongest pushes."""
    search = PushSearchOptions(robots=robots(options))
    if options.quick:
        search = PushSearchOptions(robots=robots(options), stances=("standing",), resolution=0.1)
    return StudyTable("Strongest push of 0.1 s at the torso", push_tasks(search, folder), PUSH_COLUMNS)


def obstacle_table(options: LocomotionTableOptions, folder: Path) -> StudyTable:
    """Past a sphere."""
    variants = [("issf", 1.0), ("none", 1.0)] + ([] if options.quick else [("issf", 1.2)])
    tasks = []
    for robot, kind, (name, mass) in itertools.product(robots(options), ("static", "moving"), variants):
        plant, safety = PlantOptions(mass_scale=mass), FilterOptions(filter=name)
        run = Walk(robot=robot, duration=14.0, obstacle=kind, plant=plant, safety=safety)
        place = folder / f"{robot}-{kind}-{name}-mass-{mass:g}"
        tasks.append(RunTask(run, place, {"obstacle": kind}, options.series))
    return StudyTable("Walking past a sphere, 0.2 m/s", tasks, OBSTACLE_COLUMNS)


def random_table(options: LocomotionTableOptions, folder: Path) -> StudyTable:
    """Random walks of the G1."""
    study = RandomWalksOptions(runs=4, duration=8.0) if options.quick else RandomWalksOptions()
    title = f"{study.runs} random walks of {study.duration:g} s, {study.robot}"
    return StudyTable(title, random_walk_tasks(study, folder), RANDOM_WALK_COLUMNS, falls)


def tick_table(options: LocomotionTableOptions, folder: Path) -> StudyTable:
    """Times of a tick; in TAICHI up to four seconds on one leg."""
    tasks: list[Task] = []
    for robot in robots(options):
        runs: dict[str, Scenario] = {"walking": Walk(robot=robot, duration=10.0)}
        if not options.quick:
            runs["one leg"] = Taichi(robot=robot, duration=16.0)
        tasks += [
            RunTask(run, folder / f"{robot}-{name}".replace(" ", "-"), {"run": name}, options.series)
            for name, run in runs.items()
        ]
    return StudyTable("Time of a tick, one process alone", tasks, TICK_COLUMNS, alone=True)
