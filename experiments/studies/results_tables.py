"""The tables of the documentation: every run that they quote, made anew."""

import dataclasses
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from rich.console import Console
from rich.progress import Progress

from experiments.cli.console import results_folder
from experiments.metrics.metric import Metric, column
from experiments.recording.recording import RunResult, save_result
from experiments.reports.metric_tables import rows_table
from experiments.reports.table import show
from experiments.running.run import run
from experiments.running.warmup import warm_up
from experiments.scenarios.hand_tracking import HandTracking
from experiments.scenarios.options import FilterOptions, OutputOptions, PlantOptions, TableOptions
from experiments.scenarios.scenario import Scenario
from experiments.scenarios.stand import Stand
from experiments.studies.safety_tables import friction_runs, safety_runs
from experiments.studies.tuning_scenarios import payload
from robots.checks import require_between
from robots.loader import load_robot

ROBOTS = ("g1", "tocabi")
MASS_SCALES = (0.9, 1.0, 1.2)

USUAL_MASS_SCALE = 1.2
"""Mass scale of the runs with moving hands, if nothing else is said."""

PAYLOAD = 0.5
"""Mass that the model does not know of, at each hand [kg]."""

STAND_COLUMNS = (
    column("robot", "robot"),
    column("mass_scale", "mass"),
    column("fell", "fell"),
    column("com_error_settled_max_m", "CoM error after 3 s, max"),
    column("foot_slide_max_m", "foot slide, max"),
    column("zmp_inside_fraction", "ZMP inside"),
    column("max_torque_fraction", "torque / limit, max"),
    column("qp_failures", "QP failures"),
)
HAND_COLUMNS = (
    column("robot", "robot"),
    column("filter", "filter"),
    column("fell", "fell"),
    column("min_h_self_collision_m", "min h self-collision"),
    column("collision_ratio", "collision ratio"),
    column("min_h_workspace_m", "min h workspace"),
    column("hand_rmse_m", "hand RMSE"),
    column("hand_rmse_outside_conflict_m", "outside conflict"),
    column("com_error_settled_max_m", "CoM error, max"),
    column("foot_slide_max_m", "foot slide, max"),
    column("max_torque_fraction", "torque / limit, max"),
    column("qp_failures", "QP failures"),
)


def table(options: TableOptions) -> int:
    """Run everything, print the tables, save the runs; returns 0."""
    require_between("jobs", options.jobs, 1, 64)
    console = Console(stderr=True, markup=False, soft_wrap=True)
    groups = {"results": runs, "safety": safety_runs, "friction": friction_runs}[options.what]()
    with results_folder(OutputOptions(out=options.out, overwrite=options.overwrite), "table") as folder:
        # once, here: otherwise every process would compile the same kernels
        warm_up(console, load_robot("g1"))
        done = _run_all([scenario for group, _ in groups.values() for scenario in group], options.jobs, console)
        for title, (group, columns) in groups.items():
            results = [next(done) for _ in group]
            for scenario, result in zip(group, results, strict=True):
                save_result(result, folder / run_folder(scenario))
            rows = [{**r.summary, **_words(scenario)} for scenario, r in zip(group, results, strict=True)]
            show(rows_table(rows, columns, title))
    console.print(f"runs: {folder}")
    return 0


def _words(scenario: Scenario) -> dict[str, str]:
    """What a table may show of a run that is no figure of its summary."""
    velocity = scenario.obstacle_velocity if isinstance(scenario, HandTracking) else ""
    words = {"case": describe_case(scenario), "velocity": velocity}
    return words | {
        "friction": f"x{scenario.plant.joint_friction_scale:g}",
        "adaptive": "yes" if scenario.safety.adaptive else "no",
    }


def _run_all(tasks: Sequence[Scenario], jobs: int, console: Console) -> Iterator[RunResult]:
    """Results in the order of the tasks, some at a time."""
    # spawned, not forked: numba and MuJoCo do not survive a fork of a process that has used them
    with ProcessPoolExecutor(jobs, get_context("spawn")) as pool, Progress(console=console) as bar:
        task = bar.add_task(f"{len(tasks)} runs", total=len(tasks))
        for result in pool.map(_one, tasks):
            bar.advance(task)
            yield result


def _one(options: Scenario) -> RunResult:
    return run(options)


def run_folder(options: Scenario) -> str:
    """Name of the folder of one run: robot, filter, motion of the hands or ``stand``, and what else sets it apart."""
    motion = f"stand-{options.plant.mass_scale:g}"
    if isinstance(options, HandTracking):
        motion = options.motion if options.obstacle_velocity == "estimated" else f"hold-{options.obstacle_velocity}"
        motion += "" if options.plant.mass_scale == USUAL_MASS_SCALE else f"-mass-{options.plant.mass_scale:g}"
    case = f"-{describe_case(options)}" if options.plant.link_mass or options.plant.noise_scale else ""
    case += f"-friction-{options.plant.joint_friction_scale:g}" if options.plant.joint_friction_scale != 1 else ""
    for name in ("alpha", "epsilon", "layer"):
        case += f"-{name}-{value:g}" if (value := getattr(options.safety, name)) is not None else ""
    case += "-adaptive" if options.safety.adaptive else ""
    return f"{options.robot}-{options.safety.filter}-{motion}{case}".replace(" ", "-").replace(",", "")


def describe_case(options: Scenario) -> str:
    """What differs between the plant and the model, in words."""
    plant = options.plant
    words = [f"noise x{plant.noise_scale:g}"] if plant.noise_scale else []
    words += [f"delay {1e3 * plant.actuator_delay:g} ms"] if plant.actuator_delay else []
    words += [f"payload {PAYLOAD:g} kg a hand"] if plant.link_mass else []
    words += [f"mass x{plant.mass_scale:g}"] if plant.mass_scale != 1 else []
    return ", ".join(words)


def other_differences() -> list[Scenario]:
    """Noise and delay; a payload in each hand, with the robot's own parameters and with a larger epsilon."""
    out: list[Scenario] = []
    for name in ROBOTS:
        noisy = PlantOptions(mass_scale=1.2, noise_scale=1.0, actuator_delay=0.004)
        out.append(HandTracking(robot=name, plant=noisy))
        loaded = PlantOptions(link_mass=payload(load_robot(name), PAYLOAD))
        for safety in (FilterOptions(), FilterOptions(alpha=5.0, epsilon=2.0)):
            out.append(HandTracking(robot=name, plant=loaded, safety=safety))
    return out


def runs() -> dict[str, tuple[list[Scenario], tuple[Metric, ...]]]:
    """All runs by title, with the columns to show."""
    stand: list[Scenario] = [
        Stand(robot=robot, plant=PlantOptions(mass_scale=m)) for robot in ROBOTS for m in MASS_SCALES
    ]
    circles = HandTracking(plant=PlantOptions(mass_scale=1.2))
    hands: list[Scenario] = [
        dataclasses.replace(circles, robot=robot, safety=FilterOptions(filter=name))
        for robot in ROBOTS
        for name in ("none", "cbf", "issf")
    ]
    reach: list[Scenario] = [
        dataclasses.replace(circles, robot=robot, motion="beyond-reach", safety=FilterOptions(filter=name))
        for robot in ROBOTS
        for name in ("none", "issf")
    ]
    sphere: list[Scenario] = [
        dataclasses.replace(hand, motion="hold", obstacle=True, duration=7.0)
        for hand in hands
        if isinstance(hand, HandTracking)
    ]
    case = (HAND_COLUMNS[0], column("case", "robot differs by"), column("epsilon", "epsilon"), *HAND_COLUMNS[2:])
    return {
        "Standing for 10 s": (stand, STAND_COLUMNS),
        "Hand circles through the torso, +20 % mass, 12 s": (hands, HAND_COLUMNS),
        "Hand targets 30 cm beyond reach, +20 % mass, 12 s": (reach, HAND_COLUMNS),
        "A sphere passes through where the hands are, velocity from a Kalman filter, +20 % mass, 7 s": (
            sphere,
            (*HAND_COLUMNS[:3], column("min_h_obstacle_m", "min h obstacle"), *HAND_COLUMNS[3:]),
        ),
        "Hand circles, other differences between robot and model, ISSf-CBF, 12 s": (other_differences(), case),
    }
