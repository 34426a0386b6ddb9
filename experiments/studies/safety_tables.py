"""The runs behind the tables of the documentation's safety page."""

import dataclasses

from experiments.metrics.catalogue import column
from experiments.metrics.metric import Metric
from experiments.scenarios.hand_tracking import HandTracking
from experiments.scenarios.options import FilterOptions, PlantOptions
from experiments.scenarios.resolve import LAYERED
from experiments.scenarios.scenario import Scenario
from safety.filters.safety_filter import FILTERS

ROBOTS = ("g1", "tocabi")
MASS_SCALES = (1.0, 1.1, 1.2, 1.3, 1.4)
VELOCITIES = ("zero", "estimated", "true")

FILTER_COLUMNS = (
    column("filter", "filter"),
    Metric("layer", "layer", "mm", 1e3),
    column("fell", "fell"),
    column("min_h_self_collision_m", "min h self-collision"),
    column("collision_ratio", "collision ratio"),
    column("hand_rmse_m", "hand RMSE"),
    column("hand_rmse_outside_conflict_m", "outside conflict"),
    column("filtered_fraction", "filter acts"),
    column("relaxed_fraction", "relaxed"),
    column("command_step_rms", "step of the command, RMS"),
    column("command_step_max", "largest"),
    column("max_torque_fraction", "torque / limit, max"),
    column("com_error_settled_max_m", "CoM error, max"),
    column("qp_failures", "QP failures"),
)
GUARANTEE_COLUMNS = (
    column("robot", "robot"),
    column("filter", "filter"),
    column("mass_scale", "mass"),
    column("min_h_self_collision_m", "min h self-collision"),
    column("disturbance_max", "sup of size of d"),
    column("bound_m", "bound from it"),
    column("bound_running_min_m", "running bound, min"),
    column("row_bound_min_m", "row bound, min"),
    column("bound_held", "held"),
)
VELOCITY_COLUMNS = (
    column("robot", "robot"),
    column("filter", "filter"),
    column("velocity", "velocity told"),
    column("min_h_obstacle_m", "min h obstacle"),
    column("min_h_self_collision_m", "min h self-collision"),
    column("command_step_rms", "step of the command, RMS"),
    column("hand_rmse_m", "hand RMSE"),
    column("fell", "fell"),
)
FRICTION_COLUMNS = (
    column("friction", "joints' friction"),
    column("filter", "filter"),
    column("alpha", "alpha"),
    column("epsilon", "epsilon"),
    column("adaptive", "adaptive"),
    column("min_h_self_collision_m", "min h self-collision"),
    column("collision_ratio", "collision ratio"),
    column("hand_rmse_m", "hand RMSE"),
    column("hand_rmse_outside_conflict_m", "outside conflict"),
    column("command_step_rms", "step of the command, RMS"),
    column("max_torque_fraction", "torque / limit, max"),
)
FRICTION_SCALES = (1.0, 2.0)
FRICTION_FILTERS = (
    FilterOptions(filter="cbf", alpha=10.0),
    FilterOptions(filter="cbf", alpha=50.0),
    FilterOptions(alpha=10.0, epsilon=10.0),
    FilterOptions(alpha=10.0, epsilon=10.0, adaptive=True),
    FilterOptions(),
    FilterOptions(adaptive=True),
)
"""On dry friction: the CBF, epsilon as it is in the paper and as the robot has it, each fixed and adapted."""


def friction_runs() -> dict[str, tuple[list[Scenario], tuple[Metric, ...]]]:
    """Hand circles of TOCABI, by how much friction its joints have, with the columns to show."""
    runs: list[Scenario] = [
        HandTracking(robot="tocabi", plant=PlantOptions(joint_friction_scale=scale), safety=safety)
        for scale in FRICTION_SCALES
        for safety in FRICTION_FILTERS
    ]
    return {"Dry friction, TOCABI, hand circles, 12 s": (runs, FRICTION_COLUMNS)}


def safety_runs() -> dict[str, tuple[list[Scenario], tuple[Metric, ...]]]:
    """All runs by title, with the columns to show."""
    circles = HandTracking(plant=PlantOptions(mass_scale=1.2))
    groups: dict[str, tuple[list[Scenario], tuple[Metric, ...]]] = {}
    for robot in ROBOTS:
        runs: list[Scenario] = [
            dataclasses.replace(circles, robot=robot, safety=FilterOptions(filter=name, layer=layer))
            for name in FILTERS
            for layer in ((0.0, None) if name in LAYERED else (None,))
        ]
        groups[f"Every filter, {robot}, hand circles through the torso, +20 % mass, 12 s"] = (runs, FILTER_COLUMNS)
    heavier: list[Scenario] = [
        dataclasses.replace(
            circles, robot=robot, plant=PlantOptions(mass_scale=mass), safety=FilterOptions(filter=name)
        )
        for robot in ROBOTS
        for name in ("cbf", "issf")
        for mass in MASS_SCALES
    ]
    groups["The guarantee, hand circles, 12 s"] = (heavier, GUARANTEE_COLUMNS)
    passing: list[Scenario] = [
        dataclasses.replace(
            circles,
            robot=robot,
            motion="hold",
            obstacle=True,
            duration=7.0,
            obstacle_velocity=velocity,
            safety=FilterOptions(filter=name),
        )
        for robot in ROBOTS
        for name in ("cbf", "issf")
        for velocity in VELOCITIES
    ]
    groups["What the obstacle's velocity is worth, a sphere passes the hands, +20 % mass, 7 s"] = (
        passing,
        VELOCITY_COLUMNS,
    )
    return groups
