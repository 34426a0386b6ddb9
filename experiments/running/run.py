"""From options to a finished run: builds robot, plant and controller, runs, sums up."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from controllers.motions.hands import CenterOfMassShift, Motion
from controllers.reference import reference_here
from controllers.supervisor import Supervisor
from controllers.whole_body.config import ControllerConfig
from controllers.whole_body.controller import WholeBodyController
from controllers.whole_body.robot_config import controller_config
from controllers.whole_body.tuning_file import read_tuning
from experiments.metrics.balance import convex_polygon, guarantee_figures, summarise, versions
from experiments.recording.recording import RunResult
from experiments.running.laps import Laps
from experiments.running.loop import ClosedLoop
from experiments.scenarios.options import FilterOptions, PlantOptions, RunOptions
from experiments.scenarios.scenario import Cast, Scenario
from robots.checks import require_between, require_non_negative
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.loader import load_robot
from robots.messages import Array, RobotState
from robots.mujoco_spec import PhysicalChanges, build_mujoco_spec
from robots.pinocchio_model import standing_configuration
from safety.barriers.rows import FAMILIES
from sims.plant import MujocoPlant, PlantConfig, SensorNoise

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

MAX_STEPS = 600_000
"""Most physics steps of one run; each leaves 2 to 4 kB behind."""

SETTLE = 1.5
"""Time over which the CoM goes from where the posture has it to over the middle of the feet [s]."""


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


def filter_changes(robot: RobotDescription, options: FilterOptions) -> dict[str, Any]:
    """Changes to a robot's controller configuration that the filter's options ask for.

    Raises:
        ConfigError: alpha or epsilon is not positive and finite, the layer not 0 or above, or the file of parameters
            not as it should be.
    """
    base = controller_config(robot, filter=options.filter)
    safety = base.safety
    if options.tuning is not None:
        safety = read_tuning(options.tuning, robot.name).applied(safety)
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


def control_config(robot: RobotDescription, options: RunOptions, scenario: Scenario | None = None) -> ControllerConfig:
    """The controller's configuration of a run, with what its scenario sets.

    Raises:
        ConfigError: a value is not allowed, or the control period is no whole number of physics steps.
    """
    require_between("control_rate", options.control_rate, 50.0, 10000.0)
    dt = 1.0 / options.control_rate
    steps = dt / options.plant.physics_dt
    if steps < 0.999 or abs(steps - round(steps)) > 1e-6:
        allowed = f"such that its period is a whole number of physics steps of {options.plant.physics_dt:g} s"
        raise ConfigError("control_rate", options.control_rate, allowed)
    own = {} if scenario is None else dict(scenario.changes)
    config = controller_config(robot, dt=dt, **(filter_changes(robot, options.safety) | own))
    if options.singular is None:
        return config
    return dataclasses.replace(config, tasks=dataclasses.replace(config.tasks, singular=options.singular))


def check_options(options: RunOptions) -> RobotDescription:
    """Check every option of a run before anything is made or written; returns the robot.

    Raises:
        SafeWbcError: an option is not allowed.
    """
    changes = plant_config(options.plant).changes
    require_between("duration", options.duration, 0.1, 3600.0)
    if options.duration / options.plant.physics_dt > MAX_STEPS:
        longest = MAX_STEPS * options.plant.physics_dt
        allowed = f"at most {longest:g} s at a physics step of {options.plant.physics_dt:g} s: all is kept in memory"
        raise ConfigError("duration", options.duration, allowed)
    require_between("seed", options.seed, 0, 2**63 - 1)
    if options.nan_at is not None:
        require_non_negative("nan_at", options.nan_at)
    robot = load_robot(options.robot)
    control_config(robot, options)
    build_mujoco_spec(robot, changes)
    return robot


def run(
    scenario: Scenario,
    options: RunOptions,
    progress: Callable[[float], None] | None = None,
    laps: Laps | None = None,
) -> RunResult:
    """Run one experiment from its options.

    Args:
        scenario: what happens.
        options: of the run.
        progress: called with the simulated time now and then.
        laps: books where the time goes.

    Returns:
        The result, not yet saved.

    Raises:
        SafeWbcError: an option is not allowed; nothing has run then.
    """
    laps = Laps() if laps is None else laps
    loop = _make_loop(scenario, options, progress, laps)
    plant, control = loop.plant, loop.supervisor.controller.config
    polygon = convex_polygon(plant.sole_corners().reshape(-1, 3)[:, :2])
    laps.book("set-up")
    shadow = _shadow(scenario, plant, control, options.duration)
    laps.book("reference motion")
    loop.supervisor.controller.warm_up()
    laps.book("set-up")
    outcome = loop.run(options.duration)
    series = loop.series() | {"support_polygon": polygon}
    steps, ticks = len(series["step_time"]), len(series["time"])
    series |= {name: np.repeat(values, steps // ticks)[:steps] for name, values in shadow.items()}
    measured = summarise(series, outcome) | {"first_relaxed": loop.first_relaxed}
    measured |= guarantee_figures(series, control, len(plant.robot.leg_pairs))
    if scenario.figures is not None:
        measured |= scenario.figures(plant.robot, series)
    summary = _head(scenario, options, control, loop.supervisor) | measured | {"versions": versions()}
    config = resolved_config(scenario.experiment, options, control, plant.config) | dict(scenario.settings)
    laps.book("series and summary")
    return RunResult(plant.robot, config, summary, series)


def _make_loop(
    scenario: Scenario, options: RunOptions, progress: Callable[[float], None] | None, laps: Laps
) -> ClosedLoop:
    """Plant at its first posture, controller, references and what moves them."""
    robot = check_options(options)
    control = control_config(robot, options, scenario)
    plant = MujocoPlant(robot, plant_config(options.plant), np.random.default_rng(options.seed))
    plant.reset(standing_configuration(robot, scenario.posture))
    kinds = () if scenario.encounter is None else ("sphere",)
    supervisor = Supervisor(WholeBodyController(robot, control, scenario.hands is not None, obstacle_kinds=kinds))
    cast = _cast(scenario, supervisor.controller, plant.true_state())
    encounter = None
    if scenario.encounter is not None:
        encounter = scenario.encounter(robot, cast.reference, np.random.default_rng([options.seed, 1]))
    return ClosedLoop(plant, supervisor, cast, encounter, options.nan_at, progress, scenario.pushes, laps)


def _shadow(scenario: Scenario, plant: MujocoPlant, control: ControllerConfig, duration: float) -> dict[str, Array]:
    """The scenario's further series, from a controller and a cast of their own."""
    if scenario.extra is None:
        return {}
    controller = WholeBodyController(plant.robot, control, with_hands=scenario.hands is not None)
    start = plant.true_state()
    return scenario.extra(controller, _cast(scenario, controller, start), start.q, duration)


def _cast(scenario: Scenario, controller: WholeBodyController, state: RobotState) -> Cast:
    """References of a robot at rest in ``state``, and what the scenario lets move them."""
    robot, kin = controller.robot, controller.kin
    kin.update(state.q, state.v)
    reference = reference_here(kin, with_hands=scenario.hands is not None)
    gait = None if scenario.gait is None else scenario.gait(kin)
    motions: list[Motion] = []
    if gait is None:
        motions.append(CenterOfMassShift(kin.com.copy(), reference.com.position, SETTLE))
    if scenario.hands is not None:
        motions.append(scenario.hands(robot, reference))
    return Cast(reference, gait, motions)


def _head(scenario: Scenario, options: RunOptions, control: ControllerConfig, supervisor: Supervisor) -> dict[str, Any]:
    """What a summary begins with."""
    return {
        "experiment": scenario.experiment,
        "robot": supervisor.controller.robot.name,
        "filter": control.filter,
        "mass_scale": options.plant.mass_scale,
        "alpha": control.safety.self_collision.alpha if control.filter in {"cbf", "issf", "ecbf"} else None,
        "epsilon": control.safety.self_collision.epsilon if control.filter == "issf" else None,
        "layer": control.safety.self_collision.layer if control.filter in LAYERED else None,
        "seed": options.seed,
        "pushes": [f"{p.force:.3g} N towards {p.direction:.3g} deg at {p.time:.3g} s" for p in scenario.pushes],
        "stop_cause": supervisor.cause,
        "stop_time_s": supervisor.stopped_at if supervisor.cause else None,
    }


def resolved_config(
    experiment: str, options: RunOptions, control: ControllerConfig, plant: PlantConfig
) -> dict[str, Any]:
    """Everything that decides a run, as plain tables."""
    settings = dataclasses.asdict(options)
    settings.pop("output")
    return {
        "experiment": experiment,
        "robot": options.robot,
        "options": settings,
        "controller": dataclasses.asdict(control),
        "plant": dataclasses.asdict(plant),
    }


def default_folder(experiment: str, stamp: str) -> Path:
    """Folder of a run that was given none."""
    return Path("runs") / f"{experiment}-{stamp}"
