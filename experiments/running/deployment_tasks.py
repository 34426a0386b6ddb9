"""Tasks of a deployment: the agents and the posture that a scenario, or the check of one motor, comes to on a robot."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from controllers.agent import Agent
from controllers.deployment.deployment import Deployment
from controllers.deployment.motor_check import MotorCheck, MotorCheckSettings
from controllers.whole_body.robot_config import controller_config
from experiments.running.run import Prepared, make_agent, prepare
from experiments.scenarios.hardware_options import MotorCheckOptions
from experiments.scenarios.options import refuse_without
from experiments.scenarios.registry import read_scenario
from experiments.scenarios.scenario import SCENARIO, Scenario
from experiments.scenarios.stand import Stand
from robots.description import RobotDescription
from robots.errors import ConfigError, WithoutEffectError
from robots.messages import Array, SensorReading
from robots.pinocchio_model import standing_configuration
from robots.unitree.stream import PERIOD

LOG = "log.bin"
"""File of a deployment in its folder: everything in and out, see :mod:`controllers.deployment.ring`."""


@dataclasses.dataclass(frozen=True)
class Built:
    """What a task needs, made and not yet started."""

    robot: RobotDescription
    standing: Agent
    task: Agent
    posture: Array
    duration: float
    scenario: dict[str, Any]
    motor: MotorCheck | None

    def deployment(self, say: Callable[[str], None]) -> Deployment:
        """The deployment of the task."""
        made = Deployment(
            self.robot, self.standing, self.task, self.posture, self.duration, say, None, None, self.motor
        )
        warm_estimator(made)
        return made


def name_of(task: Any) -> str:
    """A task in files and folders."""
    return "motor-check" if isinstance(task, MotorCheckOptions) else str(task.name)


def build(task: Any) -> Built:
    """Agents and posture of a task.

    Raises:
        SafeWbcError: an option of the task is not allowed, or has no effect on a robot.
    """
    scenario: Scenario = Stand() if isinstance(task, MotorCheckOptions) else task
    refuse_simulated(scenario)
    given = on_hardware(prepare(scenario))
    robot, motor = given.robot, None
    if isinstance(task, MotorCheckOptions):
        motor = MotorCheck(robot, MotorCheckSettings(task.joint, task.torque, task.low_pass))
    standing = Agent(robot, controller_config(robot, dt=given.control.dt, drives="hardware"))
    posture = robot.posture(given.setup.posture).joints
    plain = dataclasses.asdict(task) if isinstance(task, MotorCheckOptions) else scenario.to_json()
    return Built(robot, standing, make_agent(given), np.asarray(posture), scenario.duration, plain, motor)


def refuse_simulated(scenario: Scenario) -> None:
    """Raise where an option is of the simulation."""
    for options in (scenario.plant, scenario.sensing):
        names = [field.name for field in dataclasses.fields(options)]
        refuse_without(options, False, names, "a simulation")
    if scenario.nan_at is not None:
        raise WithoutEffectError("nan_at", scenario.nan_at, "left out without a simulation: it has no effect")
    if scenario.robot != "g1":
        raise ConfigError("robot", scenario.robot, "g1")
    if scenario.control_rate != 500.0:
        raise ConfigError("control_rate", scenario.control_rate, "500 Hz, the rate of the robot's states")


def on_hardware(given: Prepared) -> Prepared:
    """The scenario for a controller that drives hardware.

    Raises:
        ConfigError: there are obstacles or pushes in it.
    """
    if given.world.kinds or given.scenario.all_pushes(given.robot):
        raise ConfigError("scenario", given.scenario.name, "one without simulated obstacles and pushes")
    return dataclasses.replace(given, control=dataclasses.replace(given.control, drives="hardware"))


def warm_estimator(deployment: Deployment) -> None:
    """Take the estimator down its paths once, with a robot at rest."""
    robot = deployment.robot
    q, zero, still = standing_configuration(robot)[7:], np.zeros(len(robot.joints)), np.zeros(3)
    up = np.array([0.0, 0.0, 9.81])
    readings = [SensorReading(q, zero, zero, still, up, PERIOD * i) for i in range(50)]
    deployment.estimator.calibrate(readings[:1])
    for reading in readings[1:]:
        deployment.estimator.update(reading)


def read_task(table: Mapping[str, Any]) -> Any:
    """The task from what :attr:`Built.scenario` says of it, as the head of a log has it.

    Raises:
        SafeWbcError: no such scenario, a field is unknown or not of its type, or it is no task of a robot.
    """
    if SCENARIO in table:
        scenario = read_scenario(dict(table))
        if isinstance(scenario, Scenario):
            return scenario
        raise ConfigError("task", table[SCENARIO], "a scenario of one robot")
    known = {field.name for field in dataclasses.fields(MotorCheckOptions)}
    if set(table) != known:
        raise ConfigError("task", sorted(table), f"a scenario, or the check of a motor with {sorted(known)}")
    return MotorCheckOptions(**table)
