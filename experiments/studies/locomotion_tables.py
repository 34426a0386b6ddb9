"""What the tables on locomotion are made of: runs and searches, and the columns to show."""

import itertools
from pathlib import Path
from typing import Any

from experiments.metrics.catalogue import column
from experiments.metrics.metric import Metric
from experiments.scenarios.lateral_steps import LateralSteps
from experiments.scenarios.options import FilterOptions, PlantOptions
from experiments.scenarios.scenario import Scenario
from experiments.scenarios.taichi import Taichi
from experiments.scenarios.walk import Walk
from experiments.studies.case import Case
from experiments.studies.pushes import PUSH_COLUMNS, push_cases
from experiments.studies.random_walks import RANDOM_WALK_COLUMNS, falls, random_walk_cases
from experiments.studies.runs import run_case
from experiments.studies.sections import Section
from experiments.studies.speed import SPEED_COLUMNS, WALK_TIME, FastestWalk
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


def chosen_tables(options: LocomotionTableOptions, below: str = "") -> list[Section]:
    """The tables of the chosen sections, the runs of each in folders ``below`` one of its own."""
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
    return [make(options, f"{below}{name}/") for name, make in makers.items() if name in options.only]


def robots(options: LocomotionTableOptions) -> tuple[str, ...]:
    """The robots to show."""
    return ROBOTS[:1] if options.quick else ROBOTS


def masses(options: LocomotionTableOptions) -> tuple[float, ...]:
    """Mass scales of the simulated robots."""
    return MASS_SCALES[:1] if options.quick else MASS_SCALES


def taichi_table(options: LocomotionTableOptions, below: str) -> Section:
    """On one leg: masses and grounds, then without filter, then without DynWBC's torques."""
    variants = [("issf", "full", mass, mu) for mass in (0.9, 1.0, 1.2) for mu in (0.5, 1.0)]
    variants += [("none", "full", mass, 1.0) for mass in MASS_SCALES]
    variants += [("issf", torque, 1.0, 1.0) for torque in ("pd-only", "gravity")]
    if options.quick:
        variants = variants[-2:-1]
    found = []
    for robot, (name, torque, mass, mu) in itertools.product(robots(options), variants):
        plant, safety = PlantOptions(mass_scale=mass, friction=mu), FilterOptions(filter=name)
        run = Taichi(robot=robot, torque=torque, plant=plant, safety=safety)
        place = f"{below}{robot}-{name}-{torque}-mass-{mass:g}-friction-{mu:g}"
        found.append(run_case(run, {"torque": torque, "friction": mu}, place, options.series))
    return Section("Standing on one leg, hands to far targets (TAICHI), 30 s", found, TAICHI_COLUMNS)


def lateral_table(options: LocomotionTableOptions, below: str) -> Section:
    """Side steps whose footholds collide."""
    variants = itertools.product(
        robots(options), ("issf", "cbf", "none"), MASS_SCALES[:1] if options.quick else MASS_SCALES
    )
    found = [
        run_case(
            LateralSteps(robot=robot, plant=PlantOptions(mass_scale=mass), safety=FilterOptions(filter=name)),
            {},
            f"{below}{robot}-{name}-mass-{mass:g}",
            options.series,
        )
        for robot, name, mass in variants
    ]
    return Section("Side steps to footholds that collide", found, LATERAL_COLUMNS)


def walk_table(options: LocomotionTableOptions, below: str) -> Section:
    """Walks of a minute."""
    gaits = {"forward": GAITS["forward"]} if options.quick else GAITS
    duration = 10.0 if options.quick else 60.0
    found = []
    for robot, (gait, how), mass in itertools.product(robots(options), gaits.items(), MASS_SCALES):
        run = Walk(robot=robot, duration=duration, plant=PlantOptions(mass_scale=mass), **how)
        place = f"{below}{robot}-{gait}-mass-{mass:g}".replace(" ", "-")
        found.append(run_case(run, {"gait": gait}, place, options.series))
    return Section(f"Walks of {duration:g} s", found, WALK_COLUMNS)


def speed_table(options: LocomotionTableOptions, below: str) -> Section:
    """The fastest walks."""
    duration = 10.0 if options.quick else WALK_TIME
    pairs = itertools.product(robots(options), masses(options))
    found = [FastestWalk(robot, mass, duration, below).case() for robot, mass in pairs]
    return Section(f"Fastest walk forward, {duration:g} s", found, SPEED_COLUMNS)


def push_table(options: LocomotionTableOptions, below: str) -> Section:
    """The strongest pushes."""
    search = PushSearchOptions(robots=robots(options))
    if options.quick:
        search = PushSearchOptions(robots=robots(options), stances=("standing",), resolution=0.1)
    return Section("Strongest push of 0.1 s at the torso", push_cases(search, below), PUSH_COLUMNS)


def obstacle_table(options: LocomotionTableOptions, below: str) -> Section:
    """Past a sphere."""
    variants = [("issf", 1.0), ("none", 1.0)] + ([] if options.quick else [("issf", 1.2)])
    found = []
    for robot, kind, (name, mass) in itertools.product(robots(options), ("static", "moving"), variants):
        plant, safety = PlantOptions(mass_scale=mass), FilterOptions(filter=name)
        run = Walk(robot=robot, duration=14.0, obstacle=kind, plant=plant, safety=safety)
        place = f"{below}{robot}-{kind}-{name}-mass-{mass:g}"
        found.append(run_case(run, {"obstacle": kind}, place, options.series))
    return Section("Walking past a sphere, 0.2 m/s", found, OBSTACLE_COLUMNS)


def random_table(options: LocomotionTableOptions, below: str) -> Section:
    """Random walks of the G1."""
    study = RandomWalksOptions(runs=4, duration=8.0) if options.quick else RandomWalksOptions()
    title = f"{study.runs} random walks of {study.duration:g} s, {study.robot}"
    return Section(title, random_walk_cases(study, below), RANDOM_WALK_COLUMNS, falls)


def tick_table(options: LocomotionTableOptions, below: str) -> Section:
    """Times of a tick; in TAICHI up to four seconds on one leg."""
    found: list[Case] = []
    for robot in robots(options):
        runs: dict[str, Scenario] = {"walking": Walk(robot=robot, duration=10.0)}
        if not options.quick:
            runs["one leg"] = Taichi(robot=robot, duration=16.0)
        found += [
            run_case(run, {"run": name}, f"{below}{robot}-{name}".replace(" ", "-"), options.series, alone=True)
            for name, run in runs.items()
        ]
    return Section("Time of a tick, one process alone", found, TICK_COLUMNS)
