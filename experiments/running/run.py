"""From a scenario to its recording: builds robot, plant and controller, runs, sums up."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from controllers.agent import Agent
from controllers.estimation.estimated_body import EstimatedBody
from controllers.estimation.estimator import EstimatorSettings, StateEstimator
from controllers.gaits.commands import CommandProfile
from controllers.whole_body.config import ControllerConfig
from experiments.metrics.balance import convex_polygon, guarantee_figures, summarise, versions
from experiments.metrics.catalogue import in_order
from experiments.metrics.estimate import estimate_figures
from experiments.recording.recording import Recording, description_digest, robot_reference
from experiments.running.ending import UNSTABLE, Ending
from experiments.running.faults import BrokenEncoder, partly
from experiments.running.guarded import Guarded, raise_errors_of
from experiments.running.laps import Laps
from experiments.running.loop import ClosedLoop, Observer
from experiments.running.recorder import Recorder
from experiments.running.reference_motion import reference_motion
from experiments.running.world import RunWorld, World
from experiments.scenarios.corridor_case import CorridorCase
from experiments.scenarios.registry import SCENARIOS, folder_reference
from experiments.scenarios.resolve import control_config, plant_config, reads, sensor_errors
from experiments.scenarios.scenario import Runnable, Scenario, Setup, reference_to
from robots.checks import require_between, require_non_negative
from robots.description import RobotDescription
from robots.errors import ConfigError, WithoutEffectError
from robots.loader import load_robot
from robots.messages import Array, Mask, MotorCommand, RobotState
from robots.mujoco_spec import build_mujoco_spec
from robots.pinocchio_model import standing_configuration
from robots.ports import Body
from sims.plant import MujocoPlant, PlantConfig
from sims.sensors import Sensors

ESTIMATE_STREAM = 5
"""Second entry of the seed of the errors of the robot's own sensors."""

CALIBRATION = 1000
"""Readings at rest from which the gyro's bias is known: two seconds of them."""

MAX_STEPS = 600_000
"""Most physics steps of one run; each leaves 2 to 4 kB behind."""


@dataclasses.dataclass(frozen=True, slots=True)
class Prepared:
    """A scenario that has been checked, and what it came to."""

    scenario: Scenario
    robot: RobotDescription
    setup: Setup
    control: ControllerConfig
    plant: PlantConfig
    world: World


def prepare(scenario: Scenario) -> Prepared:
    """Check every option of a scenario before anything is made or written, and work out what it means.

    Raises:
        SafeWbcError: an option is not allowed, or the robot's description lacks what the scenario needs.
    """
    _check(scenario)
    robot = load_robot(scenario.robot)
    control_config(robot, scenario)
    setup = scenario.setup(robot)
    plant = plant_config(scenario.mismatch(robot))
    build_mujoco_spec(robot, plant.changes)
    for push in scenario.all_pushes(robot):
        _require_within("push time", push.time, scenario.duration)
    world = World(scenario.objects(robot), scenario.seed)
    return Prepared(scenario, robot, setup, control_config(robot, scenario, setup), plant, world)


def _check(scenario: Scenario) -> None:
    """What can be said without a robot."""
    plant_config(scenario.plant)
    sensor_errors(scenario.sensing)
    if scenario.sensing.state != "true" and scenario.plant.noise_scale > 0:
        raise WithoutEffectError("noise_scale", scenario.plant.noise_scale, "left out without --state true")
    require_between("duration", scenario.duration, 0.1, 3600.0)
    if scenario.duration / scenario.plant.physics_dt > MAX_STEPS:
        longest = MAX_STEPS * scenario.plant.physics_dt
        allowed = f"at most {longest:g} s at a physics step of {scenario.plant.physics_dt:g} s: all is kept in memory"
        raise ConfigError("duration", scenario.duration, allowed)
    require_between("seed", scenario.seed, 0, 2**63 - 1)
    if scenario.nan_at is not None:
        require_non_negative("nan_at", scenario.nan_at)
        _require_within("nan_at", scenario.nan_at, scenario.duration)


def _require_within(name: str, time: float, duration: float) -> None:
    if time >= duration:
        raise ConfigError(name, time, f"within the run's {duration:g} s: it has no effect later")


def run(scenario: Runnable, observers: Sequence[Observer] = (), laps: Laps | None = None) -> Recording:
    """Run a scenario.

    Args:
        scenario: what happens.
        observers: of the closed loop, after those that record it and end it; one may end the run.
        laps: books where the time goes.

    Returns:
        The recording, not yet saved.

    Raises:
        ObserverError: an observer raised; it holds the recording up to there.
        SafeWbcError: an option is not allowed; nothing has run then.
    """
    if isinstance(scenario, CorridorCase):
        from experiments.running.corridor_loop import run_case

        return run_case(scenario, observers, laps)
    if not isinstance(scenario, Scenario):
        raise ConfigError("scenario", type(scenario).__name__, "a Scenario, or a CorridorCase")
    return run_prepared(prepare(scenario), observers, laps)


def run_prepared(given: Prepared, observers: Sequence[Observer] = (), laps: Laps | None = None) -> Recording:
    """Run a scenario of the whole body that has been checked; arguments and result as of :func:`run`."""
    scenario, robot, setup, laps = given.scenario, given.robot, given.setup, Laps() if laps is None else laps
    plant, agent, body = _body_and_agent(given)
    polygon = convex_polygon(plant.sole_corners().reshape(-1, 3)[:, :2])
    laps.book("set-up")
    reference_series = _reference_series(given, plant.true_state())
    laps.book("reference motion")
    agent.warm_up()
    estimated = body if isinstance(body, EstimatedBody) else None
    recorder = Recorder(plant, agent, scenario.duration, given.world.true, laps, estimated)
    ending, world = Ending(plant), RunWorld(plant, agent, scenario.all_pushes(robot), given.world)
    if scenario.nan_at is not None:
        body = BrokenEncoder(body, scenario.nan_at)
    steps = round(agent.dt / plant.config.dt)
    guarded = [Guarded(observer) for observer in observers]
    loop = ClosedLoop(body, agent, world, [recorder, *guarded, ending], steps, laps)
    laps.book("set-up")
    loop.run(scenario.duration)
    series = recorder.series() | {"support_polygon": polygon}
    steps, ticks = len(series["step_time"]), len(series["time"])
    series |= {name: np.repeat(values, steps // ticks)[:steps] for name, values in reference_series.items()}
    if setup.command is not None:
        series["command"] = commands_at(setup.command, series["time"])
    measured = summarise(series, ending.outcome) | estimate_figures(series)
    measured |= {"first_relaxed": recorder.first_relaxed, "filter_changed_at_s": recorder.filter_changed_at}
    measured |= guarantee_figures(series, given.control, len(robot.leg_pairs)) | scenario.measure(robot, series)
    cause = agent.stop_cause or next((o.ended_by for o in guarded if o.ended_by), None)
    if plant.unstable:
        cause = UNSTABLE
    stopped_at = agent.supervisor.stopped_at if agent.stop_cause else ending.outcome.duration
    summary = _head(given, cause, stopped_at) | measured | {"versions": versions()}
    laps.book("series and summary")
    recording = Recording(robot, resolved_config(given), in_order(summary), series)
    raise_errors_of(guarded, recording)
    return recording


def _body_and_agent(given: Prepared) -> tuple[MujocoPlant, Agent, Body[MotorCommand]]:
    """Plant and agent at the first posture, and the body that the agent is to be told of."""
    rng = np.random.default_rng(given.scenario.seed)
    plant = MujocoPlant(given.robot, given.plant, rng, given.world.physical(0.0))
    start = standing_configuration(given.robot, given.setup.posture)
    plant.reset(start)
    agent = make_agent(given, given.world.kinds)
    if given.scenario.sensing.state == "true":
        agent.reset(plant.state(), start)
        return plant, agent, plant
    body, state = estimated_body(given, plant, lambda: agent.reference.in_contact)
    agent.reset(state, start)
    return plant, agent, body


def estimated_body(given: Prepared, plant: MujocoPlant, plan: Callable[[], Mask]) -> tuple[EstimatedBody, RobotState]:
    """The plant as its own sensors have it, calibrated while it is held still, and its state then."""
    sensing = given.scenario.sensing
    rng = np.random.default_rng([given.scenario.seed, ESTIMATE_STREAM])
    sensors = Sensors(plant, sensor_errors(sensing), rng)
    estimator = StateEstimator(given.robot, EstimatorSettings(base=sensing.estimator), plan)
    state = estimator.calibrate([sensors.read_at_rest() for _ in range(CALIBRATION)], plant.true_state().q[:7])
    return EstimatedBody(plant, sensors.read, estimator, partly(sensing.state, plant)), state


def make_agent(given: Prepared, obstacle_slots: Sequence[str] = ()) -> Agent:
    """What drives the robot in a scenario."""
    setup = given.setup
    return Agent(
        given.robot,
        given.control,
        gait=setup.gait,
        motions=setup.motions if setup.hands is None else (setup.hands, *setup.motions),
        with_hands=setup.hands is not None,
        obstacle_slots=obstacle_slots,
        tracking=given.world.tracking() if obstacle_slots else None,
        extra_barriers=given.scenario.extra_barriers,
        extra_tasks=given.scenario.extra_tasks,
    )


def _reference_series(given: Prepared, start: RobotState) -> dict[str, Array]:
    """The motion that the references ask for, from an agent of their own, where the set-up wants it."""
    if not given.setup.reference_motion:
        return {}
    agent = make_agent(given)
    agent.reset(start)
    return reference_motion(agent, start.q, given.scenario.duration)


def commands_at(command: CommandProfile, times: Array) -> Array:
    """Commanded velocities at ``times`` (T,) [s]: shape (T, 3), forward [m/s], left [m/s], turning [rad/s]."""
    commands = [command(float(t)) for t in times]
    return np.reshape([(c.vx, c.vy, c.wz) for c in commands], (-1, 3))


def _head(given: Prepared, cause: str | None, stopped_at: float) -> dict[str, Any]:
    """What a summary begins with."""
    control, scenario = given.control, given.scenario
    pairs = control.safety.self_collision
    pushes = scenario.all_pushes(given.robot)
    return {
        "scenario": reference_to(type(scenario)),
        "robot": given.robot.name,
        "filter": control.filter,
        "mass_scale": given.plant.changes.mass_scale,
        "alpha": pairs.alpha if reads(control.filter, "alpha") else None,
        "epsilon": pairs.epsilon if reads(control.filter, "epsilon") else None,
        "layer": pairs.layer if reads(control.filter, "layer") else None,
        "seed": scenario.seed if scenario.is_random(given.robot) else None,
        "pushes": [f"{p.force:.3g} N towards {p.direction:.3g} deg at {p.time:.3g} s" for p in pushes],
        "stop_cause": cause,
        "stop_time_s": stopped_at if cause else None,
    }


def resolved_config(given: Prepared) -> dict[str, Any]:
    """Everything that decides a run, as plain tables."""
    scenario = given.scenario
    declared = () if type(scenario) in SCENARIOS else scenario.metrics
    return {
        "scenario": scenario.to_json(),
        **folder_reference(type(scenario)),
        **robot_reference(scenario.robot),
        "robot_digest": description_digest(given.robot),
        "controller": dataclasses.asdict(given.control),
        "plant": dataclasses.asdict(given.plant),
        "metrics": [dataclasses.asdict(metric) for metric in declared],
        **given.setup.settings,
    }
