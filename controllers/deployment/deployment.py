"""The stages from the first command to latched damping: states and a person's wishes in, a motor command out.

A pure function of what it has been given: it reads no clock but the stamps of the states and talks to no network. So a
recorded deployment, fed to it again, gives the same commands bit by bit.
"""

import logging
from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from controllers.agent import Agent
from controllers.deployment.motor_check import MotorCheck
from controllers.deployment.motors import PostureRamp, brake, largest_jump, limp, mix
from controllers.deployment.protection import (
    Protection,
    ProtectionLimits,
    Reaction,
    ReadingCheck,
    Surroundings,
    Verdict,
)
from controllers.deployment.stages import Stage, row_of
from controllers.estimation.estimator import EstimatorSettings, StateEstimator
from robots.description import RobotDescription
from robots.messages import Array, Mask, MotorCommand, RobotState, SensorReading
from robots.unitree.g1 import MODE_MACHINE, G1Joints
from robots.unitree.messages import CommandMessage
from robots.unitree.remote import button_bits
from robots.unitree.stream import StateStream
from wbc.wrench import GRAVITY

LOGGER = logging.getLogger(__name__)

MISSING_IN_A_ROW = 10
"""Periods in a row without a new sound state, after which the motors fade out."""

JUMPS_IN_A_ROW = 3
"""States in a row with a joint that has jumped, after which the motors fade out."""

POSTURE_TIME = 4.0
"""How long the way to the posture takes [s]."""

FAR_FROM_POSTURE = 0.3
"""A joint this far from the posture at the end of the way has not arrived [rad]."""

STILL_READINGS = 1000
"""Readings in a row without motion that a calibration takes."""

STILL_RATE = 0.1
"""Largest difference of two rates of the gyro among them, per axis [rad/s]."""

SET_DOWN_READINGS = 125
"""Readings over which the feet have to carry the robot, before the controller takes over."""

CARRIES, CARRIES_NOTHING = 0.5, 0.15
"""Fractions of the weight: the feet carry the robot above one, and nothing any more below the other."""

TAKE_OVER = 0.5
"""How long the controller's commands take to replace those before [s]."""

COMMANDED = 250
"""Periods after which a motor that still says that it waits for a command has a fault."""

GO, STOP = button_bits("A"), button_bits("select")


class Deployment:
    """Stages, estimator, agents and protection of one robot.

    Call :meth:`take` with every state as it comes in, and :meth:`step` once a period.

    Args:
        robot: the description.
        standing: agent that stands in the task's posture.
        task: agent that does the task, from standing.
        posture: shape (nj,) of the task [rad].
        duration: of the task [s].
        say: is told what happens, in words.
        limits: of protection.
        estimator: settings of the estimator.
        check: a check of one motor, in place of the task, while the robot hangs.

    Attributes:
        stage: now.
        cause: why it stopped; ``None`` before.
        stream: of the states.
        estimator: of the state.
        state: the last estimate; ``None`` before the calibration.
        missing: periods in a row without a new sound state.
        bridged: number of periods without one, in all.
    """

    def __init__(
        self,
        robot: RobotDescription,
        standing: Agent,
        task: Agent,
        posture: Array,
        duration: float,
        say: Callable[[str], None],
        limits: ProtectionLimits | None = None,
        estimator: EstimatorSettings | None = None,
        check: MotorCheck | None = None,
    ) -> None:
        self.robot, self.duration, self._say = robot, duration, say
        self._standing, self._task, self._posture, self._motor = standing, task, posture, check
        self.limits = limits or ProtectionLimits()
        self.joints = G1Joints(robot)
        self.stream = StateStream(self.joints)
        self._check, self._protection = ReadingCheck(self.joints, limits), Protection(self.joints, limits)
        self.estimator = StateEstimator(robot, estimator, lambda: self._agent.reference.in_contact)
        self._agent, self._has_control = standing, False
        self._message = CommandMessage()
        self.stage = Stage.ZERO_TORQUE
        self.cause: str | None = None
        self.state: RobotState | None = None
        self._reading: SensorReading | None = None
        self._fault, self._faulty, self._fresh = "", 0, False
        self.missing = self.bridged = 0
        self._periods, self._began = 0, 0.0
        self._buttons = 0
        self._ramp: PostureRamp | None = None
        self._rates, self._still = np.zeros((STILL_READINGS, 3)), 0
        self._recent: deque[SensorReading] = deque(maxlen=SET_DOWN_READINGS)
        self._carried, self._gyro_bias = 0, np.zeros(3)
        self._before: MotorCommand | None = None
        self._last: MotorCommand | None = None
        self._task_done = self._dry = False
        self._weight = robot.total_mass * GRAVITY
        self._steps: dict[Stage, Callable[[float, bool], MotorCommand]] = {
            Stage.ZERO_TORQUE: self._zero_torque,
            Stage.DAMPING: self._damping,
            Stage.POSTURE: self._to_posture,
            Stage.CALIBRATION: self._calibrate,
            Stage.HUNG: self._hung,
            Stage.LOWERED: self._lowered,
            Stage.STANDING: self._stands,
            Stage.TASK: self._does_task,
            Stage.STOPPING: self._comes_to_rest,
            Stage.DAMPED: self._damped,
        }

    # -- states in

    def take(self, data: bytes, arrived: float) -> None:
        """Take in a state as it came, at ``arrived`` of this machine's monotonic clock [s]."""
        reading = self.stream.take(data, arrived)
        if reading is None:
            return
        fault = self._check.inspect(reading)
        if fault is not None:
            self._fault, self._faulty = fault, self._faulty + 1
            return
        self._fault, self._faulty, self._fresh, self._reading = "", 0, True, reading
        if self.state is not None:
            try:
                self.state = self.estimator.update(reading)
            except (ValueError, np.linalg.LinAlgError) as error:
                self._fault, self._fresh = f"estimator: {error}", False

    @property
    def begun(self) -> bool:
        """Whether a sound state has come; before, there is nothing to answer."""
        return self._reading is not None

    @property
    def stamp(self) -> float:
        """Of the last sound state, and what has passed without one [s]."""
        taken = 0.0 if self._reading is None else self._reading.stamp
        return taken + self.missing * self._agent.dt

    # -- commands out

    def step(self, around: Surroundings) -> bytes:
        """The command of a period, sealed.

        Whatever is wrong with a program in here brakes the motors: they get a command in every period.

        Args:
            around: what is known beside the states.
        """
        self.missing = 0 if self._fresh else self.missing + 1
        self.bridged += not self._fresh
        self._fresh = False
        try:
            go, stop = self._wishes(around)
            self._react(self._verdict(around), stop)
            command = self._checked(self._steps[self.stage](self.stamp, go))
            return self._written(command)
        except Exception as error:
            # a mistake in a program is no reason to leave the motors alone
            LOGGER.exception("the deployment gives no command: the motors brake")
            self.damp(f"{type(error).__name__}: {error}")
            return self._written(brake(self.robot, self.stamp))

    def _written(self, command: MotorCommand) -> bytes:
        self._last = command
        self._periods += 1
        variant = self.stream.message.mode_machine if self.damped else MODE_MACHINE
        self.joints.write(command, self._message, variant, any_variant=self.damped)
        return self._message.sealed()

    def _wishes(self, around: Surroundings) -> tuple[bool, bool]:
        """A person's go and stop, each once for a press."""
        pressed = self.stream.message.buttons
        new, self._buttons = pressed & ~self._buttons, pressed
        return around.go or bool(new & GO), around.stop or bool(new & STOP)

    def _verdict(self, around: Surroundings) -> Verdict:
        verdict = self._protection.inspect(self.stream.message, around, self._periods > COMMANDED)
        if verdict.reaction < Reaction.FADE and (why := self._unseen()):
            return Verdict(Reaction.FADE, why)
        return verdict

    def _unseen(self) -> str:
        """Why the state is not known, in words; empty while it is."""
        if self._check.lost.any() and self._faulty >= JUMPS_IN_A_ROW:
            return self._fault
        if self.missing < MISSING_IN_A_ROW:
            return ""
        why = self._fault or f"{self.stream.broken} with a wrong check sum, {self.stream.repeated} repeated or old"
        return f"no new sound state for {1e3 * self.missing * self._agent.dt:.0f} ms ({why})"

    @property
    def damped(self) -> bool:
        """Whether it has ended in latched damping."""
        return self.stage is Stage.DAMPED

    def _react(self, verdict: Verdict, stop: bool) -> None:
        """Go to where the verdict, or a person, leads."""
        if self.damped:
            return
        if verdict.reaction is Reaction.DAMP:
            self.damp(verdict.cause)
        elif verdict.reaction is Reaction.FADE:
            self._fade(verdict.cause)
        elif verdict.reaction is Reaction.HOLD or stop:
            self._hold(verdict.cause or "stop")
        supervisor = self._agent.supervisor
        if self._has_control and supervisor.cause is not None:
            if supervisor.damping:
                self.damp(supervisor.cause)
            elif self.stage is not Stage.STOPPING:
                self._to(Stage.STOPPING, supervisor.cause)

    def damp(self, cause: str) -> None:
        """Brake from now on, for good."""
        self._to(Stage.DAMPED, cause)

    def _fade(self, cause: str) -> None:
        """Fade out where the controller has the robot; a hanging robot is damped."""
        if self._has_control:
            self._agent.supervisor.fade(cause, self.stamp, self._check.lost)
        else:
            self.damp(cause)

    def _hold(self, cause: str) -> None:
        """End the task and keep balance; a hanging robot is damped."""
        if self._has_control:
            self._agent.hold(cause)
        else:
            self.damp(cause)

    def _to(self, stage: Stage, cause: str | None = None) -> None:
        """Begin a stage; the first cause of a stop stays, and so does latched damping."""
        if self.damped:
            return
        if cause is not None and self.cause is None:
            self.cause = cause
        self.stage, self._began = stage, self.stamp
        self._say(f"{stage.value}{'' if cause is None else ': ' + cause}")

    def _checked(self, command: MotorCommand) -> MotorCommand:
        """The command, unless it would make a joint jump; where a joint's position is not known, it is only braked."""
        last = self._last
        if last is not None and not self.damped:
            i, jump = largest_jump(last, command)
            if jump > self.limits.set_point_jump:
                self._fade(f"set-point of {self.robot.joint_names[i]} jumps by {jump:.2f} rad")
                return brake(self.robot, command.stamp) if self.damped else last
        if self._faulty and self._check.lost.any():
            return _without(command, self._check.lost)
        return command

    # -- stages

    def _zero_torque(self, stamp: float, go: bool) -> MotorCommand:
        if go:
            self._to(Stage.DAMPING)
        return limp(len(self.robot.joints), stamp)

    def _damping(self, stamp: float, go: bool) -> MotorCommand:
        if go and self._reading is not None:
            self._ramp = PostureRamp(self.robot, self._reading.joint_position, self._posture, stamp, POSTURE_TIME)
            self._to(Stage.POSTURE)
        return brake(self.robot, stamp)

    def _hold_posture(self, stamp: float) -> MotorCommand:
        if self._dry:
            return brake(self.robot, stamp)
        assert self._ramp is not None
        return self._ramp.command(stamp)

    def _to_posture(self, stamp: float, go: bool) -> MotorCommand:
        assert self._ramp is not None and self._reading is not None
        if go and self._ramp.arrived(stamp):
            away = np.abs(self._reading.joint_position - self._posture)
            i = int(np.argmax(away))
            if away[i] > FAR_FROM_POSTURE:
                self._say(f"not yet: {self.robot.joint_names[i]} is {away[i]:.2f} rad from the posture")
            else:
                self._to(Stage.CALIBRATION if self._motor is None else Stage.TASK)
        return self._hold_posture(stamp)

    def begin_dry(self) -> None:
        """Begin with the calibration, where the robot is: for a run in which nothing is sent."""
        self._dry, self.stage = True, Stage.CALIBRATION

    def _calibrate(self, stamp: float, go: bool) -> MotorCommand:
        if self.missing == 0 and self._reading is not None:
            self._rates[self._still % STILL_READINGS] = self._reading.gyro
            self._still += 1
            self._recent.append(self._reading)
        if self._still >= STILL_READINGS:
            if (np.ptp(self._rates, axis=0) < STILL_RATE).all():
                self._gyro_bias = self._rates.mean(axis=0)
                self.state = self.estimator.calibrate(list(self._recent), gyro_bias=self._gyro_bias)
                self._agent.reset(self.state)
                self._say("bias of the gyro: " + ", ".join(f"{b:.4f}" for b in self._gyro_bias) + " rad/s")
                self._to(Stage.HUNG)
            else:
                self._still = 0
                self._say("not still: the calibration begins again")
        return self._hold_posture(stamp)

    def _hung(self, stamp: float, go: bool) -> MotorCommand:
        """The controller computes what it would say; that is thrown away."""
        assert self.state is not None
        self._agent.tick(self.state)
        if go:
            self._recent.clear()
            self._to(Stage.LOWERED)
        return self._hold_posture(stamp)

    def _lowered(self, stamp: float, go: bool) -> MotorCommand:
        assert self._reading is not None and self.state is not None
        self._agent.tick(self.state)
        if self.missing == 0:
            self._recent.append(self._reading)
            self._carried = self._carried + 1 if self._load() > CARRIES else 0
        if self._carried >= SET_DOWN_READINGS:
            self._carried = 0
            self.state = self.estimator.calibrate(list(self._recent), gyro_bias=self._gyro_bias)
            self._take_over(self._standing, Stage.STANDING)
        return self._hold_posture(stamp)

    def _take_over(self, agent: Agent, stage: Stage) -> None:
        """Let an agent have the robot, from where it is."""
        assert self.state is not None
        agent.reset(self.state)
        self._agent, self._has_control, self._before = agent, True, self._last
        self._to(stage)

    def _load(self) -> float:
        """What the feet carry, as a fraction of the model's weight."""
        return float(self.estimator.wrenches[:, 2].sum()) / self._weight

    def _controlled(self, stamp: float) -> MotorCommand:
        """The agent's command, which takes the place of what was told before little by little."""
        assert self.state is not None
        command = self._agent.tick(self.state).command
        since = stamp - self._began
        if self._before is None or self._agent.supervisor.fading or since >= TAKE_OVER:
            self._before = None
            return command
        return mix(self._before, command, since / TAKE_OVER)

    def _stands(self, stamp: float, go: bool) -> MotorCommand:
        if go and stamp - self._began > TAKE_OVER:
            self._take_over(self._task, Stage.TASK)
        return self._controlled(stamp)

    def _does_task(self, stamp: float, go: bool) -> MotorCommand:
        if self._motor is not None:
            assert self._reading is not None
            since = stamp - self._began
            if since > self._motor.duration:
                self.damp("the motor check is over")
            return self._motor.command(self._hold_posture(stamp), self._reading, since)
        if stamp - self._began >= self.duration and not self._task_done:
            self._task_done = True
            self._agent.hold("the task is over")
        return self._controlled(stamp)

    def _comes_to_rest(self, stamp: float, go: bool) -> MotorCommand:
        if self.missing == 0:
            self._carried = self._carried + 1 if self._load() < CARRIES_NOTHING else 0
        if go or self._carried >= SET_DOWN_READINGS:
            self.damp("at rest")
        return self._controlled(stamp)

    def _damped(self, stamp: float, go: bool) -> MotorCommand:
        return brake(self.robot, stamp)

    @property
    def asks(self) -> bool:
        """Whether the stage waits for a person's go."""
        return row_of(self.stage).asks


def _without(command: MotorCommand, lost: Mask) -> MotorCommand:
    """A command that only brakes some joints."""
    tau, kp = command.tau.copy(), command.kp.copy()
    tau[lost], kp[lost] = 0.0, 0.0
    return replace(command, tau=tau, kp=kp)
