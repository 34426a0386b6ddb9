"""From options to a finished run: builds robot, plant and controller, runs, sums up."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from controllers.agent import Agent
from controllers.reference import reference_here
from controllers.supervisor import Supervisor
from controllers.whole_body.config import ControllerConfig
from controllers.whole_body.robot_config import controller_config
from controllers.whole_body.tuning_file import read_tuning
from experiments.metrics.balance import convex_polygon, guarantee_figures, summarise, versions
from experiments.recording.recording import RunResult
from experiments.running.ending import Ending
from experiments.running.faults import BrokenEncoder
from experiments.running.laps import Laps
from experiments.running.loop import ClosedLoop
from experiments.running.recorder import Progress, Recorder
from experiments.running.world import RunWorld
from experiments.scenarios.obstacles import Encounter
from experiments.scenarios.options import FilterOptions, PlantOptions, RunOptions
from experiments.scenarios.scenario import Scenario
from robots.checks import require_between, require_non_negative
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.kinematics import Kinematics
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
    robot = check_options(options)
    control = control_config(robot, options, scenario)
    plant = MujocoPlant(robot, plant_config(options.plant), np.random.default_rng(options.seed))
    start = standing_configuration(robot, scenario.posture)
    plant.reset(start)
    encounter = make_encounter(robot, scenario, start, options.seed)
    agent = make_agent(robot, control, scenario, encounter)
    agent.reset(plant.state(), start)
    polygon = convex_polygon(plant.sole_corners().reshape(-1, 3)[:, :2])
    laps.book("set-up")
    reference_series = _reference_series(robot, control, scenario, plant.true_state(), options.duration)
    laps.book("reference motion")
    agent.warm_up()
    world = RunWorld(plant, scenario.pushes, encounter)
    recorder, ending = Recorder(plant, agent, options.duration, world.true, laps), Ending(plant)
    body = plant if options.nan_at is None else BrokenEncoder(plant, options.nan_at)
    observers = [recorder, ending] if progress is None else [recorder, Progress(progress), ending]
    loop = ClosedLoop(body, agent, world, observers, round(control.dt / plant.config.dt), laps)
    laps.book("set-up")
    loop.run(options.duration)
    series = recorder.series() | {"support_polygon": polygon}
    steps, ticks = len(series["step_time"]), len(series["time"])
    series |= {name: np.repeat(values, steps // ticks)[:steps] for name, values in reference_series.items()}
    measured = summarise(series, ending.outcome) | {"first_relaxed": recorder.first_relaxed}
    measured |= guarantee_figures(series, control, len(robot.leg_pairs))
    if scenario.figures is not None:
        measured |= scenario.figures(robot, series)
    summary = _head(scenario, options, control, agent.supervisor) | measured | {"versions": versions()}
    config = resolved_config(scenario.experiment, options, control, plant.config) | dict(scenario.settings)
    laps.book("series and summary")
    return RunResult(robot, config, summary, series)


def make_encounter(robot: RobotDescription, scenario: Scenario, start: Array, seed: int) -> Encounter | None:
    """What passes a robot that starts at ``start`` (nq,)."""
    if scenario.encounter is None:
        return None
    kin = Kinematics(robot)
    kin.update(start, np.zeros(kin.nv))
    reference = reference_here(kin, with_hands=scenario.hands is not None)
    return scenario.encounter(robot, reference, np.random.default_rng([seed, 1]))


def make_agent(
    robot: RobotDescription, control: ControllerConfig, scenario: Scenario, encounter: Encounter | None = None
) -> Agent:
    """What drives the robot in a scenario."""
    return Agent(
        robot,
        control,
        gait=scenario.gait,
        motions=() if scenario.hands is None else (scenario.hands,),
        with_hands=scenario.hands is not None,
        obstacle_slots=() if encounter is None else ("sphere",),
        tracking=None if encounter is None else encounter.tracking,
    )


def _reference_series(
    robot: RobotDescription, control: ControllerConfig, scenario: Scenario, start: RobotState, duration: float
) -> dict[str, Array]:
    """The scenario's further series, from an agent of their own."""
    if scenario.extra is None:
        return {}
    agent = make_agent(robot, control, scenario)
    agent.reset(start)
    return scenario.extra(agent, start.q, duration)


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
