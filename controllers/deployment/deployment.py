"""The stages from the first command to latched damping: states and a person's wishes in, a motor command out.

A pure function of what it has been given: it reads no clock but the stamps of the states and talks to no network. So a
recorded deployment, fed to it again, gives the same commands bit by bit.
"""

import logging
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from controllers.agent import Agent
from controllers.deployment.motor_check import MotorCheck
from controllers.deployment.motors import PostureRamp, brake, limp, mix
from controllers.deployment.protection import (
    Protection,
    ProtectionLimits,
    Reaction,
    ReadingCheck,
    Surroundings,
    Verdict,
)
from controllers.deployment.rest import SHORT, RestWatch
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

OLD_BIAS = 30.0
"""After which a bias that could not be taken anew is too old for a hand-over [s]."""

CARRIES, CARRIES_NOTHING = 0.5, 0.15
"""Fractions of the weight: the feet carry the robot above one, and nothing any more below the other."""

TAKE_OVER, CHANGE_OVER = 0.5, 0.1
"""How long the controller's commands take to replace those of the posture, and the task's those of standing [s]."""

SEEN = 0.5
"""How long a stage has lasted before a go can be meant for it: one said twice, or too soon, skips none [s]."""

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
        cause: why it stopped, the first cause; ``None`` before.
        end_cause: why it ended in latched damping; ``None`` before.
        stream: of the states.
        estimator: of the state.
        state: the last estimate; ``None`` before the calibration.
        missing: periods in a row without a new sound state.
        bridged: number of periods without one, in all.
        let_go: whether a person has said go in latched damping.
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
        self.end_cause: str | None = None
        self.state: RobotState | None = None
        self._reading: SensorReading | None = None
        self._fault, self._faulty, self._fresh = "", 0, False
        self.missing = self.bridged = 0
        self._periods, self._began = 0, 0.0
        self._buttons = 0
        self._ramp: PostureRamp | None = None
        self._rest = RestWatch()
        self._gyro_bias, self._learnt = np.zeros(3), 0.0
        self._armed, self._carries, self._hangs = False, 0, 0
        self._before: MotorCommand | None = None
        self._blend, self._gap = 0.0, 0
        self._told: str | None = None
        self._effort, self._speed = robot.joint_array("effort"), robot.joint_array("velocity")
        self._last: MotorCommand | None = None
        self._task_done = self._dry = self._told_early = self.let_go = False
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
            doubts = self.estimator.bias_watch.doubts
            try:
                self.state = self.estimator.update(reading)
            except Exception as error:
                # the state is as unknown then as without a reading
                self._fault, self._fresh = f"estimator: {type(error).__name__}: {error}", False
            if self.estimator.bias_watch.doubts > doubts:
                self._say("the gyro's bias seems to have jumped: soles that stand seem to turn; it is learnt anew")

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
        if not self._periods:
            self._began = self.stamp
        self.bridged += not self._fresh
        new, self._fresh = self._fresh, False
        try:
            go, stop = self._wishes(around)
            go = go and self._seen()
            self._react(self._verdict(around, new), stop)
            command = self._checked(self._steps[self.stage](self.stamp, go))
            return self._written(brake(self.robot, self.stamp) if self.damped else command)
        except Exception as error:
            # a mistake in a program is no reason to leave the motors alone
            self.damp(f"{type(error).__name__}: {error}")
            LOGGER.exception("the deployment gives no command: the motors brake")
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

    def _seen(self) -> bool:
        """Whether the stage has lasted for long enough that a go can mean it, and is not one of the stage before."""
        if self.stamp - self._began >= SEEN:
            return True
        if self.asks and not self._told_early:
            self._told_early = True
            self._say(f"not yet: {self.stage.value} has only begun")
        return False

    def _verdict(self, around: Surroundings, new: bool) -> Verdict:
        verdict = self._protection.inspect(self.stream.message, around, self._periods > COMMANDED, new)
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
        if not self._has_control or supervisor.last_cause is None:
            return
        if supervisor.damping:
            self.damp(supervisor.last_cause)
        elif self.stage is not Stage.STOPPING:
            self._to(Stage.STOPPING, supervisor.last_cause)
        elif supervisor.last_cause != self._told:
            self._say(f"besides: {supervisor.last_cause}")
        self._told = supervisor.last_cause

    def damp(self, cause: str) -> None:
        """Brake from now on, for good."""
        self._to(Stage.DAMPED, cause)
        self.end_cause = self.end_cause or cause

    def _fade(self, cause: str) -> None:
        """Fade out where the controller has the robot; a hanging robot is damped."""
        if self._has_control:
            self._agent.supervisor.fade(cause, self.stamp, self._check.lost, self._last)
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
        self.stage, self._began, self._told_early = stage, self.stamp, False
        self._say(f"{stage.value}{'' if cause is None else ': ' + cause}")

    def _checked(self, command: MotorCommand) -> MotorCommand:
        """The command, unless it would make a joint jump; where a joint's position is not known, it is only braked."""
        last, gap = self._last, self._gap + 1
        self._gap = self.missing
        if last is not None and self._has_control and (jump := self._describe_jump(last, command, gap)):
            # what jumps is not sent: fade out from what was
            self._agent.supervisor.fade(jump, self.stamp, sent=last)
            return last
        if self._faulty and self._check.lost.any():
            return _without(command, self._check.lost)
        return command

    def _describe_jump(self, last: MotorCommand, command: MotorCommand, periods: int) -> str:
        """Which joint jumps from one command to the next, in words; empty where none does."""
        limits, dt = self.limits, self._agent.dt
        moved = np.where((last.kp > 0.0) & (command.kp > 0.0), np.abs(command.q - last.q), 0.0)
        beyond = moved - limits.set_point_jump - periods * dt * self._speed
        i = int(np.argmax(beyond))
        if beyond[i] > 0.0:
            return f"set-point of {self.robot.joint_names[i]} jumps by {moved[i]:.2f} rad"
        torque = np.abs(command.tau - last.tau) / self._effort
        i = int(np.argmax(torque))
        if torque[i] > limits.torque_jump:
            return f"torque of {self.robot.joint_names[i]} jumps by {100 * torque[i]:.0f} % of its limit"
        return ""

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
        self._watch_rest()
        if self._rest.full:
            if motion := self._rest.describe_motion():
                self._say(f"the calibration begins again: {motion}")
                self._rest.restart()
            else:
                self._learn(stamp)
                self._say("bias of the gyro: " + ", ".join(f"{b:.4f}" for b in self._gyro_bias) + " rad/s")
                self._to(Stage.HUNG)
        return self._hold_posture(stamp)

    def _watch_rest(self) -> None:
        if self.missing == 0 and self._reading is not None:
            self._rest.add(self._reading)

    def _learn(self, stamp: float) -> None:
        """Take bias and tilt from a robot at rest; the controller beside it begins anew."""
        self._gyro_bias, self._learnt = self._rest.bias(), stamp
        self.state = self.estimator.calibrate(self._rest.recent(), gyro_bias=self._gyro_bias, standing=False)
        self._agent.reset(self.state)
        self._rest.restart()

    def _computes_beside(self, stamp: float) -> None:
        """The controller computes what it would say, which is thrown away.

        In the air nothing corrects tilt and velocity, and the bias drifts: whenever the robot hung still for a while,
        they are taken anew.
        """
        assert self.state is not None
        self._watch_rest()
        if self._rest.full and self._load() < CARRIES_NOTHING:
            if self._rest.describe_motion():
                self._rest.restart()
            else:
                self._learn(stamp)
        self._agent.tick(self.state)

    def _not_ready(self, stamp: float) -> str:
        """Why the controller must not have the robot, in words; empty where it may."""
        if (cause := self._agent.supervisor.cause) is not None:
            return f"the controller beside it has stopped: {cause}"
        if stamp - self._learnt > OLD_BIAS:
            return f"the robot has not hung still for {stamp - self._learnt:.0f} s: the gyro's bias is too old"
        return ""

    def _hung(self, stamp: float, go: bool) -> MotorCommand:
        self._computes_beside(stamp)
        if go:
            if why := self._not_ready(stamp):
                self._say(f"not yet: {why}")
            else:
                self._to(Stage.LOWERED)
        return self._hold_posture(stamp)

    def _lowered(self, stamp: float, go: bool) -> MotorCommand:
        """A go arms the hand-over; then it waits for feet that carry."""
        self._computes_beside(stamp)
        if go and not self._armed:
            self._armed = True
            self._say("the controller takes over as soon as the feet carry: lower the robot")
        if self.missing == 0:
            self._carries = self._carries + 1 if self._load() > CARRIES else 0
        if self._armed and self._carries >= SHORT and self._rest.calm():
            if why := self._not_ready(stamp):
                self._armed = False
                self._say(f"not yet: {why}")
            else:
                self.state = self.estimator.calibrate(self._rest.recent(), gyro_bias=self._gyro_bias)
                self._take_over(self._standing, Stage.STANDING, TAKE_OVER)
        return self._hold_posture(stamp)

    def _take_over(self, agent: Agent, stage: Stage, duration: float) -> None:
        """Let an agent have the robot, from where it is; its commands replace the last one over ``duration`` [s]."""
        assert self.state is not None
        agent.reset(self.state)
        self._agent, self._has_control = agent, True
        self._before, self._blend = self._last, duration
        self._to(stage)

    def _load(self) -> float:
        """What the feet carry, as a fraction of the model's weight."""
        return float(self.estimator.wrenches[:, 2].sum()) / self._weight

    def _controlled(self, stamp: float) -> MotorCommand:
        """The agent's command, which takes the place of what was told before little by little."""
        assert self.state is not None
        command = self._agent.tick(self.state).command
        since = stamp - self._began
        if self._before is None or self._agent.supervisor.fading or since >= self._blend:
            self._before = None
            return command
        return mix(self._before, command, since / self._blend)

    def _stands(self, stamp: float, go: bool) -> MotorCommand:
        if go and stamp - self._began > TAKE_OVER:
            self._take_over(self._task, Stage.TASK, CHANGE_OVER)
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
            self._hangs = self._hangs + 1 if self._load() < CARRIES_NOTHING else 0
        if self._hangs >= SHORT:
            self.damp("at rest")
        elif go and self._load() < CARRIES:
            self.damp("at rest")
        elif go:
            self._say("not yet: the feet carry the robot; raise the hoist first, or damp it")
        return self._controlled(stamp)

    def _damped(self, stamp: float, go: bool) -> MotorCommand:
        self.let_go = self.let_go or go
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
