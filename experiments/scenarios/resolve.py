"""From the options of a scenario to the configuration of controller and plant."""

import dataclasses
from typing import Any

from controllers.whole_body.config import ControllerConfig
from controllers.whole_body.robot_config import controller_config
from controllers.whole_body.tuning_file import Tuning, read_tuning
from experiments.scenarios.options import FilterOptions, PlantOptions, SensingOptions, refuse_without
from experiments.scenarios.scenario import Scenario, Setup
from robots.checks import require_between
from robots.description import RobotDescription
from robots.errors import ConfigError, WithoutEffectError
from robots.mujoco_spec import PhysicalChanges
from safety.barriers.rows import FAMILIES
from safety.filters.registry import FILTERS
from sims.plant import PlantConfig, SensorNoise
from sims.sensors import SensorErrors

STANDARD_NOISE = SensorNoise(
    joint_position=1e-4,
    joint_velocity=0.01,
    base_position=2e-4,
    base_orientation=3e-4,
    base_linear_velocity=0.005,
    base_angular_velocity=0.005,
)
"""Sensor noise of ``--noise-scale 1``: what is left, tick to tick, behind encoders and a state estimator."""

LAYERED = ("ssa", "rssa", "pssa", "sss")
"""Filters whose conditions switch on at a margin, and may do so over a layer."""

READERS = {"alpha": ("cbf", "issf", "ecbf"), "epsilon": ("issf",), "layer": LAYERED}
"""Filters of the project whose condition reads each parameter; it has no effect on its others."""


def reads(filter_name: str, parameter: str) -> bool:
    """Whether a parameter, one of ``READERS``, has an effect on a filter; on one from outside the project it may."""
    return filter_name in READERS[parameter] or filter_name not in FILTERS


def plant_config(options: PlantOptions) -> PlantConfig:
    """The plant's configuration of command-line options.

    Raises:
        ConfigError: a value is not allowed.
    """
    changes = PhysicalChanges(
        mass_scale=options.mass_scale,
        link_mass_scale=dict(options.link_mass),
        com_shift=options.com_shift,
        sole_friction=options.friction,
        joint_friction_scale=options.joint_friction_scale,
        armature_scale=options.armature_scale,
    )
    require_between("noise_scale", options.noise_scale, 0.0, 100.0)
    require_between("physics_dt", options.physics_dt, 1e-4, 0.005)
    scaled = {f.name: options.noise_scale * getattr(STANDARD_NOISE, f.name) for f in dataclasses.fields(SensorNoise)}
    return PlantConfig(options.physics_dt, changes, options.actuator_delay, SensorNoise(**scaled))


def sensor_errors(options: SensingOptions) -> SensorErrors:
    """Errors of the robot's own sensors.

    Raises:
        ConfigError: a value is not allowed, or has no effect.
    """
    names = ("sensor_errors", "gyro_drift", "torque_constant", "estimator")
    refuse_without(options, options.state != "true", names, "--state estimated")
    require_between("sensor_errors", options.sensor_errors, 0.0, 20.0)
    require_between("gyro_drift", options.gyro_drift, 0.0, 1.0)
    require_between("torque_constant", options.torque_constant, 0.5, 2.0)
    standard = SensorErrors()
    scaled = {f.name: options.sensor_errors * getattr(standard, f.name) for f in dataclasses.fields(SensorErrors)}
    drift, scale = options.gyro_drift / 60.0, options.torque_constant
    return SensorErrors(**scaled | {"gyro_drift": drift, "torque_scale": scale})


def filter_changes(robot: RobotDescription, options: FilterOptions) -> dict[str, Any]:
    """Changes to a robot's controller configuration that the filter's options ask for.

    Raises:
        ConfigError: alpha or epsilon is not positive and finite, the layer not 0 or above, one of them has no effect on
            the filter, or the file of parameters is not as it should be.
    """
    base = controller_config(robot, filter=options.filter)
    _refuse_without_effect(options)
    safety = base.safety
    if options.tuning is not None:
        tuning = read_tuning(options.tuning, robot.name)
        _refuse_unread(tuning, options)
        safety = tuning.applied(safety)
    if options.layer is not None:
        families = {f: dataclasses.replace(getattr(safety, f), layer=options.layer) for f in FAMILIES}
        safety = dataclasses.replace(safety, **families)
    given = {name: value for name in ("alpha", "epsilon") if (value := getattr(options, name)) is not None}
    pairs = dataclasses.replace(safety.self_collision, **given)
    return {
        "filter": options.filter,
        "adaptive": options.adaptive or base.adaptive,
        "safety": dataclasses.replace(safety, self_collision=pairs),
    }


def _refuse_without_effect(options: FilterOptions) -> None:
    for name, readers in READERS.items():
        value = getattr(options, name)
        if value is not None and not reads(options.filter, name):
            raise WithoutEffectError(
                name, value, f"left out with --filter {options.filter}: only {', '.join(readers)} read it"
            )


def _refuse_unread(tuning: Tuning, options: FilterOptions) -> None:
    """A file for another filter may hold more than this one reads, but must not be without effect."""
    given = {name for values in tuning.families.values() for name in values}
    read = {name for name in given if name not in READERS or reads(options.filter, name)}
    if given and (options.filter == "none" or not read):
        raise WithoutEffectError(
            "tuning",
            str(options.tuning),
            f"left out with --filter {options.filter}, which reads none of {sorted(given)}",
        )


def control_config(robot: RobotDescription, scenario: Scenario, setup: Setup | None = None) -> ControllerConfig:
    """The controller's configuration of a run, with what its set-up changes.

    Raises:
        ConfigError: a value is not allowed, or the control period is no whole number of physics steps.
    """
    require_between("control_rate", scenario.control_rate, 50.0, 10000.0)
    dt = 1.0 / scenario.control_rate
    steps = dt / scenario.plant.physics_dt
    if steps < 0.999 or abs(steps - round(steps)) > 1e-6:
        allowed = f"such that its period is a whole number of physics steps of {scenario.plant.physics_dt:g} s"
        raise ConfigError("control_rate", scenario.control_rate, allowed)
    own = {} if setup is None else dict(setup.changes)
    config = controller_config(robot, dt=dt, **(filter_changes(robot, scenario.safety) | own))
    if scenario.singular is None:
        return config
    return dataclasses.replace(config, tasks=dataclasses.replace(config.tasks, singular=scenario.singular))
