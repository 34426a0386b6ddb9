"""Watches the controller: a cause for concern ends in a damped stop, latched, with its cause kept."""

from collections.abc import Sequence

import numpy as np

from controllers.reference import WholeBodyReference
from controllers.whole_body import TickResult, WholeBodyController
from robots.checks import all_finite
from robots.description import RobotDescription
from robots.messages import MotorCommand, RobotState
from safety.filters import FilterStatus
from safety.obstacles import Obstacle

MAX_FAILURES = 10
"""Ticks in a row without an answer of filter or DynWBC, or without a new state, after which the robot is stopped."""

LARGEST = 1e6
"""Positions and velocities beyond this [m, rad, m/s, rad/s] are no measurement: squared, they would overflow."""

QUATERNION_TOLERANCE = 1e-3
"""By how much the squared length of the base's quaternion may differ from 1."""


class Supervisor:
    """Runs the controller's tick and stops for good when something is wrong.

    The stop: no feed-forward torque, no position gains, the motors' velocity gains brake every joint. A state that
    cannot be one stops at once and is never used, and a command that is not finite is never sent; a solver without
    answer may fail ``MAX_FAILURES`` times in a row (its last torques hold meanwhile), and so often may the state be the
    same old one.

    Attributes:
        controller: the controller that is watched.
        cause: why the robot was stopped; ``None`` while it runs.
        stopped_at: stamp of the state at which it was stopped [s].
    """

    def __init__(self, controller: WholeBodyController) -> None:
        self.controller = controller
        self.cause: str | None = None
        self.stopped_at = float("nan")
        self._failures = 0
        self._stamp = -np.inf
        self._repeated = 0
        robot = controller.robot
        self._kd = controller.config.gain_scale * robot.joint_array("kd")
        self._hold = np.zeros(len(robot.joints))

    def tick(
        self, state: RobotState, reference: WholeBodyReference, obstacles: Sequence[Obstacle] = ()
    ) -> tuple[MotorCommand, TickResult | None]:
        """Command for a measured state, and the controller's result; ``None`` once stopped."""
        fault = describe_fault(self.controller.robot, state) or self._describe_age(state.stamp)
        if fault is not None:
            self.stop(fault, state.stamp)
        if self.cause is not None:
            return self._brake(state.stamp), None
        result = self.controller.tick(state, reference, obstacles)
        if not all_finite(result.command.q, result.command.v, result.command.tau):
            self.stop("the controller's command is not finite", state.stamp)
            return self._brake(state.stamp), result
        self._hold = result.command.q
        failed = result.safety.status == FilterStatus.FAILED or result.dynwbc.status != "optimal"
        self._failures = self._failures + 1 if failed else 0
        if self._failures >= MAX_FAILURES:
            what = f"filter {result.safety.status.name.lower()}, DynWBC {result.dynwbc.status}"
            self.stop(f"no solution for {MAX_FAILURES} ticks ({what})", state.stamp)
        return result.command, result

    def _describe_age(self, stamp: float) -> str | None:
        """What is wrong with the stamp of a measured state, in words; ``None`` where all is well."""
        if not stamp >= self._stamp:
            return f"measured state has stamp {stamp:g} s after one of {self._stamp:g} s"
        self._repeated = self._repeated + 1 if stamp == self._stamp else 0
        self._stamp = stamp
        if self._repeated >= MAX_FAILURES:
            return f"measured state is stale: stamp {stamp:g} s for {self._repeated + 1} ticks"
        return None

    def stop(self, cause: str, stamp: float) -> None:
        """Stop the robot, for ``cause``; the first cause is kept."""
        if self.cause is None:
            self.cause, self.stopped_at = cause, stamp

    def _brake(self, stamp: float) -> MotorCommand:
        zero = np.zeros_like(self._hold)
        return MotorCommand(self._hold, zero, zero, zero, self._kd, stamp)


def describe_fault(robot: RobotDescription, state: RobotState) -> str | None:
    """What cannot be in a measured state, by name; ``None`` where all is well.

    Every number has to be finite and below ``LARGEST``, and the base's quaternion of length one.
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
    length = float(state.q[3:7] @ state.q[3:7])
    if abs(length - 1) > QUATERNION_TOLERANCE:
        return f"measured base quaternion has length {length**0.5:g} instead of 1"
    return None


def _names_of_q(robot: RobotDescription) -> list[str]:
    base = ("x", "y", "z", "quaternion x", "quaternion y", "quaternion z", "quaternion w")
    return [f"base {n}" for n in base] + [f"position of {n}" for n in robot.joint_names]


def _names_of_v(robot: RobotDescription) -> list[str]:
    rates = [f"{kind} velocity {axis}" for kind in ("linear", "angular") for axis in "xyz"]
    return [f"base {n}" for n in rates] + [f"velocity of {n}" for n in robot.joint_names]
