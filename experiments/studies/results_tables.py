"""The tables of the documentation: every run that they quote, made anew."""

import dataclasses

from experiments.metrics.catalogue import column
from experiments.metrics.metric import Metric
from experiments.scenarios.hand_tracking import HandTracking
from experiments.scenarios.options import FilterOptions, PlantOptions
from experiments.scenarios.scenario import Scenario
from experiments.scenarios.stand import Stand
from experiments.scenarios.taichi import Taichi
from experiments.scenarios.walk import Walk
from experiments.studies.command import command_line, study_folder
from experiments.studies.estimation_tables import estimation_runs, sensing_of, task_of
from experiments.studies.runs import run_case
from experiments.studies.safety_tables import friction_runs, safety_runs
from experiments.studies.sections import Section, print_sections
from experiments.studies.study_options import TableOptions
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
    """Run everything, print the tables, save the runs; returns 0, or 1 where runs failed.

    Raises:
        SafeWbcError: an option is not allowed; nothing has run then.
    """
    require_between("jobs", options.work.jobs, 1, 64)
    folder = study_folder(options.work.out, "table")
    command = command_line(f"table {options.what}", options, folder)
    return print_sections(sections(options.what), f"tables of {options.what}", "g1", options.work, folder, command)


def sections(what: str) -> list[Section]:
    """The tables of a page, one of ``PAGES``."""
    groups = PAGES[what]()
    return [
        Section(title, [run_case(s, _labels(s), run_folder(s)) for s in scenarios], shown)
        for title, (scenarios, shown) in groups.items()
    ]


def _labels(scenario: Scenario) -> dict[str, str]:
    """What a table may show of a run that is no figure of its summary."""
    velocity = scenario.obstacle_velocity if isinstance(scenario, HandTracking) else ""
    return {
        "case": describe_case(scenario),
        "velocity": velocity,
        "friction": f"x{scenario.plant.joint_friction_scale:g}",
        "adaptive": "yes" if scenario.safety.adaptive else "no",
        "task": task_of(scenario),
        "sensing": sensing_of(scenario),
    }


def run_folder(options: Scenario) -> str:
    """Name of the folder of one run: robot, filter, motion of the hands or ``stand``, and what else sets it apart."""
    if options.sensing.state != "true" or isinstance(options, Walk | Taichi):
        words = (options.robot, task_of(options), f"mass {options.plant.mass_scale:g}", sensing_of(options))
        return "-".join(word for word in words if word).replace(",", "").replace("/", " per ").replace(" ", "-")
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


PAGES = {"results": runs, "safety": safety_runs, "friction": friction_runs, "estimation": estimation_runs}
"""The runs of each page of the documentation, or part of one."""
