"""The runs behind docs/estimation.md: every task on what the robot's own sensors tell."""

import dataclasses

from experiments.metrics.catalogue import column
from experiments.metrics.metric import Metric
from experiments.scenarios.options import PlantOptions, SensingOptions
from experiments.scenarios.scenario import Scenario
from experiments.scenarios.stand import Stand
from experiments.scenarios.taichi import Taichi
from experiments.scenarios.walk import Walk

ROBOTS = ("g1", "tocabi")
MASS_SCALES = (0.8, 1.0, 1.2)
DRIFT = 0.003
"""Of the gyro's bias in a minute [rad/s]."""

LONG = 60.0
"""Of a run [s]."""

ESTIMATED = SensingOptions(state="estimated", gyro_drift=DRIFT)

ESTIMATION_COLUMNS = (
    column("robot", "robot"),
    Metric("task", "task"),
    column("mass_scale", "mass"),
    Metric("sensing", ""),
    column("fell", "fell"),
    column("stop_cause", "stopped"),
    column("base_velocity_error_m_s", "velocity, RMS"),
    column("tilt_error_rad", "tilt, RMS"),
    column("height_error_m", "height, max"),
    column("position_drift_m", "position, end"),
    column("foot_force_error_n", "force, RMS"),
    column("contact_agreement", "contact"),
    column("min_h_self_collision_m", "min h self-collision"),
)


def estimation_runs() -> dict[str, tuple[list[Scenario], tuple[Metric, ...]]]:
    """All runs by title, with the columns to show."""
    tasks: list[Scenario] = [
        Stand(duration=LONG, sensing=ESTIMATED),
        Taichi(sensing=ESTIMATED),
        Walk(duration=LONG, vx=0.2, sensing=ESTIMATED),
        Walk(duration=LONG, vx=0.15, wz=0.2, sensing=ESTIMATED),
        Walk(duration=LONG, vx=0.3, sensing=ESTIMATED),
    ]
    every: list[Scenario] = [
        dataclasses.replace(task, robot=robot, plant=PlantOptions(mass_scale=mass))
        for robot in ROBOTS
        for task in tasks
        for mass in MASS_SCALES
    ]
    walk = Walk(duration=LONG, vx=0.2, plant=PlantOptions(mass_scale=1.2), sensing=ESTIMATED)
    return {
        "Every task on its own sensors, the gyro's bias drifting": (every, ESTIMATION_COLUMNS),
        "What is estimated, walking at 0.2 m/s, +20 % mass": (_variants(walk, PARTS), ESTIMATION_COLUMNS),
        "Other filters, errors and grounds, likewise": (_variants(walk, OTHERS) + _grounds(walk), ESTIMATION_COLUMNS),
    }


PARTS = (
    SensingOptions(),
    dataclasses.replace(ESTIMATED, state="estimated-base"),
    dataclasses.replace(ESTIMATED, state="estimated-forces"),
    ESTIMATED,
)
"""True and estimated base, each with true and estimated forces."""

OTHERS = (
    dataclasses.replace(ESTIMATED, estimator="simple"),
    dataclasses.replace(ESTIMATED, sensor_errors=2.0),
    dataclasses.replace(ESTIMATED, torque_constant=0.9),
    dataclasses.replace(ESTIMATED, torque_constant=1.1),
)


def _variants(walk: Walk, sensings: tuple[SensingOptions, ...]) -> list[Scenario]:
    return [dataclasses.replace(walk, robot=robot, sensing=sensing) for robot in ROBOTS for sensing in sensings]


def _grounds(walk: Walk) -> list[Scenario]:
    return [
        dataclasses.replace(walk, robot=robot, plant=dataclasses.replace(walk.plant, friction=friction))
        for robot in ROBOTS
        for friction in (0.5, 1.0)
    ]


def task_of(scenario: Scenario) -> str:
    """What the robot does, in words."""
    if not isinstance(scenario, Walk):
        return f"{scenario.name} {scenario.duration:g} s"
    turn = f", {scenario.wz:g} rad/s" if scenario.wz else ""
    return f"walk {scenario.vx:g} m/s{turn}, {scenario.duration:g} s"


def sensing_of(scenario: Scenario) -> str:
    """What the controller is told, and of what robot, where that is not as usual."""
    sensing, usual = scenario.sensing, ESTIMATED
    words = [] if sensing.state == "estimated" else [sensing.state.replace("estimated-", "estimated ")]
    words += [sensing.estimator] if sensing.estimator != usual.estimator else []
    words += [f"errors x{sensing.sensor_errors:g}"] if sensing.sensor_errors != 1 else []
    words += [f"torque constant x{sensing.torque_constant:g}"] if sensing.torque_constant != 1 else []
    words += [f"friction {scenario.plant.friction:g}"] if scenario.plant.friction != PlantOptions().friction else []
    return ", ".join(words)
