"""A G1 that does what it is told at once, without physics: for tests of stages, protection and logs."""

from collections.abc import Callable
from functools import cache

import numpy as np

from controllers.agent import Agent
from controllers.deployment.deployment import SEEN, Deployment
from controllers.deployment.motor_check import MotorCheck
from controllers.deployment.protection import Surroundings
from controllers.deployment.stages import Stage
from controllers.whole_body.robot_config import controller_config
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array, SensorReading
from robots.pinocchio_model import standing_configuration
from robots.unitree.g1 import G1Joints
from robots.unitree.messages import CommandMessage, StateMessage
from robots.unitree.remote import Remote, write_remote

ROBOT = load_robot("g1")
PERIOD = 0.002
UP = np.array([0.0, 0.0, 9.81])


@cache
def made_agents() -> tuple[Agent, Agent]:
    """Once: a deployment resets them."""
    config = controller_config(ROBOT, drives="hardware")
    return Agent(ROBOT, config), Agent(ROBOT, config)


class FakeG1:
    """States for a deployment, and its commands."""

    def __init__(self, check: MotorCheck | None = None, say: Callable[[str], None] | None = None) -> None:
        self.said: list[str] = []
        agents = made_agents()
        posture = standing_configuration(ROBOT)[7:]
        self.deployment = Deployment(ROBOT, *agents, posture, 5.0, say or self.said.append, check=check)
        self.joints, self.message = G1Joints(ROBOT), StateMessage()
        self.q = 0.8 * posture
        self.gyro, self.tick = np.zeros(3), 0
        self.buttons: frozenset[str] = frozenset()
        self.heard = True
        self.command = CommandMessage()
        self._rng = np.random.default_rng(0)
        self._kin, self._base = Kinematics(ROBOT), np.array([0.0, 0.0, 0.9, 0.0, 0.0, 0.0, 1.0])
        self._held_at, self._torque = np.full(29, np.nan), np.zeros(29)
        self.follows = True

    @property
    def time(self) -> float:
        return PERIOD * self.tick

    def state(self) -> bytes:
        """The next state, sealed."""
        self.tick += 1
        zero, torque = np.zeros(29), self._holding()
        noise = 1e-3 * self._rng.standard_normal(6)
        reading = SensorReading(self.q, zero, torque, self.gyro + noise[:3], UP + noise[3:], self.time)
        write_remote(self.message.remote, Remote(self.buttons, (0.0, 0.0), (0.0, 0.0), self.heard))
        mode = self.message.mode_machine
        self.joints.write_state(reading, np.array([0.0, 0.0, 0.0, 1.0]), self.message, self.tick)
        if self.tick > 1 and mode:
            self.message.mode_machine = mode
        return self.message.sealed()

    def _holding(self) -> Array:
        """Torques (29,) that hold the limbs of a robot that hangs upright."""
        if not np.array_equal(self.q, self._held_at, equal_nan=True):
            self._held_at = self.q.copy()
            if np.isfinite(self.q).all():
                self._kin.update(np.concatenate([self._base, self.q]), np.zeros(35))
                self._torque = self._kin.bias[6:].copy()
        return self._torque

    def period(self, around: Surroundings | None = None, data: bytes | None = None) -> bytes:
        """One period: a state in, the answer out, which is done."""
        self.deployment.take(self.state() if data is None else data, self.time)
        return self.answer(around)

    def answer(self, around: Surroundings | None = None) -> bytes:
        """A period without a state."""
        command = self.deployment.step(around or Surroundings())
        assert self.command.read(command)
        motors = self.command.motors[self.joints.slots]
        if self.follows and motors["kp"].any():
            self.q = motors["q"].astype(float)
        return command

    def periods(self, count: int, around: Surroundings | None = None) -> None:
        for _ in range(count):
            self.period(around)

    def go(self) -> None:
        """A person's go, once the stage has lasted for long enough, and a period after it."""
        self.periods(round(SEEN / PERIOD))
        self.period(Surroundings(go=True))
        self.period()

    def to_posture(self) -> None:
        """On to the posture while hung, arrived."""
        self.periods(5)
        self.go()
        self.go()
        self.periods(2100)

    def to_hung(self) -> None:
        """On to the control while hung."""
        self.to_posture()
        self.go()
        self.periods(1010)

    def is_at(self, stage: Stage) -> bool:
        """Whether the deployment is there."""
        return self.deployment.stage is stage

    @property
    def gains(self) -> tuple[float, float, float]:
        """Largest kp, kd and torque of the last command."""
        motors = self.command.motors
        return tuple(float(np.abs(motors[name]).max()) for name in ("kp", "kd", "tau"))

    @property
    def brakes(self) -> bool:
        """Whether the last command only brakes."""
        kp, kd, tau = self.gains
        return kp == 0.0 and tau == 0.0 and kd > 0.0
