"""Watches the controller: what is wrong ends in a stop that is not left again, with its cause kept."""

import logging
import math
from collections.abc import Sequence

import numpy as np

from controllers.motion_limits import MotionWatch
from controllers.reference import WholeBodyReference
from controllers.whole_body.controller import TickResult, WholeBodyController
from robots.checks import all_finite
from robots.description import RobotDescription
from robots.messages import Array, Mask, MotorCommand, RobotState
from safety.filters.safety_filter import FilterStatus
from safety.geometry.shapes import Obstacle

LOGGER = logging.getLogger(__name__)

MAX_FAILURES = 10
"""Ticks in a row without an answer of filter or DynWBC, or without a new state, after which the robot is stopped."""

HOLD_TIME = 0.5
"""How long a fade-out holds the motors where they are [s]."""

FADE_TIME = 1.5
"""How long it then takes to fade torques and position gains [s]."""

LARGEST = 1e6
"""Positions and velocities beyond this [m, rad, m/s, rad/s] are no measurement: squared, they would overflow."""

BEYOND_LIMITS = 0.5
"""A joint cannot be farther outside its limits than this [rad]: its encoder has jumped, by a turn for example."""

QUATERNION_TOLERANCE = 1e-3
"""By how much the squared length of the base's quaternion may differ from 1."""


class Supervisor:
    """Runs the controller's tick and fades the motors out for good when something is wrong.

    That happens where the state cannot be one, the same old state keeps coming, the controller refuses what it is
    given, a command is not finite, or a solver has not answered for ``MAX_FAILURES`` ticks (its last torques hold
    meanwhile). Nothing is computed any more: motors hold their last set-points, feed-forward torques and gains for
    ``HOLD_TIME``, then torques and position gains fade over ``FADE_TIME`` and the velocity gains brake what is left. No
    biped stands for long without its state: this gives a person time, and lets the robot down instead of dropping it.

    Where the robot has passed a limit of tilt, height or rate (:mod:`controllers.motion_limits`), or somebody asks for
    it (:meth:`damp`), the motors brake at once, with the description's velocity gains and nothing else.

    A stop that keeps balance, where the state is sound but the task cannot go on, is the agent's
    (:meth:`controllers.agent.Agent.hold`); its cause is latched here, so that the first cause of either kind stays.

    How old a state is, nothing here can tell: its stamp is the only clock of a tick. Noticed is a stamp that stands
    still or goes back; a state that arrives late, but in order, is for whoever reads the sensors to refuse. For the
    same reason the filter's ``age`` is left at zero.

    Attributes:
        controller: the controller that is watched.
        cause: why the robot was stopped; ``None`` while it runs.
        last_cause: why it was stopped last, where one stop followed another.
        stopped_at: stamp of the state at which it was stopped [s].
    """

    def __init__(self, controller: WholeBodyController) -> None:
        self.controller = controller
        self.cause: str | None = None
        self.last_cause: str | None = None
        self.stopped_at = float("nan")
        self._fading_ticks = -1
        self._lost: Mask = np.zeros(len(controller.robot.joints), dtype=bool)
        self._failures = 0
        self._stamp = -np.inf
        self._repeated = 0
        self._last: MotorCommand | None = None
        kin = controller.kin
        self._soles = [kin.frame_id(sole.frame) for sole in controller.robot.soles]
        self._watch = MotionWatch(controller.config.limits, controller.robot.posture("standing").base_height)

    @property
    def last(self) -> MotorCommand:
        """The command that was handed on last; before the first one, with nothing to hold, a brake."""
        if self._last is not None:
            return self._last
        zero = np.zeros(len(self.controller.robot.joints))
        kd = self.controller.config.gain_scale * self.controller.robot.joint_array("kd")
        return MotorCommand(zero, zero, zero, zero, kd, 0.0)

    @property
    def fading(self) -> bool:
        """Whether the motors are being faded out."""
        return self._fading_ticks >= 0

    @property
    def damping(self) -> bool:
        """Whether the motors only brake: at once, or once they have been faded out."""
        return self._fading_ticks * self.controller.config.dt >= HOLD_TIME + FADE_TIME

    def latch(self, cause: str, stamp: float) -> None:
        """Keep ``cause`` and ``stamp`` [s] of a stop, unless there was one before."""
        if not self.fading:
            self.last_cause = cause
        if self.cause is None:
            self.cause, self.stopped_at = cause, stamp

    def inspect(self, state: RobotState) -> bool:
        """Whether the controller may be given a measured state; where not, the motors fade out from now on."""
        fault = describe_fault(self.controller.robot, state) or self._describe_age(state.stamp)
        if fault is not None:
            if state.q.size == 7 + self._lost.size:
                # the drive reads the same encoder: told to go where that one is not, it would slam the joint
                self._lost |= _outside(self.controller.robot, state.q[7:]) > BEYOND_LIMITS
            self.fade(fault, state.stamp)
        elif self._repeated == 0 and (beyond := self._watch.inspect(state, self._height(state))) is not None:
            # while the motors fade out too: stiff legs of a robot that lies down help nobody
            self.damp(beyond, state.stamp)
        return not self.fading

    def _height(self, state: RobotState) -> float:
        """Of the base over the lower sole, where the soles were in the last tick [m]."""
        kin = self.controller.kin
        return float(state.q[2]) - min(float(kin.frame_placement(sole)[1][2]) for sole in self._soles)

    def tick(
        self, state: RobotState, reference: WholeBodyReference, obstacles: Sequence[Obstacle] = ()
    ) -> tuple[MotorCommand, TickResult | None]:
        """Command for a measured state, and the controller's result; ``None`` once the motors fade out."""
        if self.inspect(state):
            self.controller.update(state)
        return self.respond(state, reference, obstacles)

    def respond(
        self, state: RobotState, reference: WholeBodyReference, obstacles: Sequence[Obstacle] = ()
    ) -> tuple[MotorCommand, TickResult | None]:
        """As :meth:`tick`, for a state that was inspected and that the controller was brought up to.

        Whatever the controller raises fades the motors out, with the words of the error as the cause: the motors get a
        command in every tick. What is no refusal of its own (obstacles of another kind than announced, missing hands)
        but a mistake in a program, a barrier or task of one's own say, is logged with where it came from.
        """
        if self.fading:
            return self._fading_command(state.stamp), None
        try:
            result = self.controller.respond(state, reference, obstacles)
        except (ValueError, np.linalg.LinAlgError) as error:
            self.fade(f"the controller gives no command: {error}", state.stamp)
            return self._fading_command(state.stamp), None
        except Exception as error:
            LOGGER.exception("the controller gives no command: the motors fade out")
            self.fade(f"the controller gives no command: {type(error).__name__}: {error}", state.stamp)
            return self._fading_command(state.stamp), None
        if not all_finite(result.command.q, result.command.v, result.command.tau):
            self.fade("the controller's command is not finite", state.stamp)
            return self._fading_command(state.stamp), result
        self._last = result.command
        self._count_failures(result, state.stamp)
        return result.command, result

    def _count_failures(self, result: TickResult, stamp: float) -> None:
        failed = result.safety.status == FilterStatus.FAILED or result.dynwbc.status != "optimal"
        self._failures = self._failures + 1 if failed else 0
        if self._failures >= MAX_FAILURES:
            why = f": {result.safety.cause}" if result.safety.cause else ""
            what = f"filter {result.safety.status.name.lower()}{why}, DynWBC {result.dynwbc.status}"
            self.fade(f"no solution for {MAX_FAILURES} ticks ({what})", stamp)

    def fade(self, cause: str, stamp: float, lost: Mask | None = None, sent: MotorCommand | None = None) -> None:
        """Fade the motors out for good.

        Args:
            cause: in words.
            stamp: of the state at which it was found [s].
            lost: shape (nj,) joints whose position is not known: they are only braked.
            sent: command to fade out from, where it is not the last one that was handed on.
        """
        if sent is not None and not self.fading:
            self._last = sent
        if lost is not None:
            self._lost |= lost
        self.latch(cause, stamp)
        self._fading_ticks = max(0, self._fading_ticks)

    def damp(self, cause: str, stamp: float) -> None:
        """Only brake from now on, for good, for ``cause``; ``stamp`` of the state at which it was found [s]."""
        self.latch(cause, stamp)
        self.last_cause = cause
        self._fading_ticks = max(self._fading_ticks, math.ceil((HOLD_TIME + FADE_TIME) / self.controller.config.dt))

    def _fading_command(self, stamp: float) -> MotorCommand:
        """The last command with its velocities at zero, held, then faded out."""
        t = self._fading_ticks * self.controller.config.dt
        self._fading_ticks += 1
        fraction = min(1.0, max(0.0, 1.0 - (t - HOLD_TIME) / FADE_TIME))
        last = self.last
        tau, kp = fraction * last.tau, fraction * last.kp
        # joints whose position is not known are only braked
        tau[self._lost], kp[self._lost] = 0.0, 0.0
        return MotorCommand(last.q, np.zeros_like(last.v), tau, kp, last.kd, stamp)

    def _describe_age(self, stamp: float) -> str | None:
        """What is wrong with the stamp of a measured state, in words; ``None`` where all is well."""
        if not stamp >= self._stamp:
            return f"measured state has stamp {stamp:g} s after one of {self._stamp:g} s"
        self._repeated = self._repeated + 1 if stamp == self._stamp else 0
        self._stamp = stamp
        if self._repeated >= MAX_FAILURES:
            return f"measured state is stale: stamp {stamp:g} s for {self._repeated + 1} ticks"
        return None


def describe_fault(robot: RobotDescription, state: RobotState) -> str | None:
    """What cannot be in a measured state, by name; ``None`` where all is well.

    Every number has to be finite and below ``LARGEST``, joints no farther outside their limits than ``BEYOND_LIMITS``,
    and the base's quaternion of length one; forces under the feet may be missing.
    """
    nj = len(robot.joint_names)
    for values, size in ((state.q, 7 + nj), (state.v, 6 + nj)):
        if values.shape != (size,):
            return f"measured state has {values.size} numbers instead of {size}"
    for values, names in ((state.q, _names_of_q), (state.v, _names_of_v)):
        sound = np.abs(values) <= LARGEST
        if not sound.all():
            i = int(np.argmin(sound))
            return f"measured {names(robot)[i]} is {values[i]:g}"
    outside = _outside(robot, state.q[7:])
    i = int(np.argmax(outside))
    if outside[i] > BEYOND_LIMITS:
        lower, upper = (limits[i] for limits in robot.position_limits)
        name, value = robot.joint_names[i], state.q[7 + i]
        return f"measured position of {name} is {value:.3g}, far outside its limits of {lower:.3g} to {upper:.3g}"
    if fault := _describe_forces(robot, state):
        return fault
    length = float(state.q[3:7] @ state.q[3:7])
    if abs(length - 1) > QUATERNION_TOLERANCE:
        return f"measured base quaternion has length {length**0.5:g} instead of 1"
    return None


def _outside(robot: RobotDescription, q: Array) -> Array:
    """How far joints (nj,) are outside their limits [rad]; below 0 inside, NaN for a position that is none."""
    lower, upper = robot.position_limits
    return np.maximum(lower - q, q - upper)


def _describe_forces(robot: RobotDescription, state: RobotState) -> str | None:
    """What cannot be in measured torques, and forces under the feet, which may be missing."""
    nj = len(robot.joint_names)
    if state.tau.shape != (nj,):
        return f"measured state has {state.tau.size} torques instead of {nj}"
    if not all_finite(state.tau):
        i = int(np.argmin(np.isfinite(state.tau)))
        return f"measured torque of {robot.joint_names[i]} is {state.tau[i]:g}"
    if state.foot_forces is not None:
        if state.foot_forces.shape != (2,):
            return f"measured foot forces have {state.foot_forces.size} numbers instead of 2"
        for foot, force in zip(("left", "right"), state.foot_forces, strict=True):
            if not abs(force) <= LARGEST:
                return f"measured force on the {foot} sole is {force:g}"
    return None


def _names_of_q(robot: RobotDescription) -> list[str]:
    base = ("x", "y", "z", "quaternion x", "quaternion y", "quaternion z", "quaternion w")
    return [f"base {n}" for n in base] + [f"position of {n}" for n in robot.joint_names]


def _names_of_v(robot: RobotDescription) -> list[str]:
    rates = [f"{kind} velocity {axis}" for kind in ("linear", "angular") for axis in "xyz"]
    return [f"base {n}" for n in rates] + [f"velocity of {n}" for n in robot.joint_names]
