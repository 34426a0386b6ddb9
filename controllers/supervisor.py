"""Watches the controller: a cause for concern ends in a damped stop, latched, with its cause kept."""

from collections.abc import Sequence

import numpy as np

from controllers.reference import WholeBodyReference
from controllers.whole_body import TickResult, WholeBodyController
from robots.description import RobotDescription
from robots.messages import MotorCommand, RobotState
from safety.filters import FilterStatus
from safety.obstacles import Obstacle

MAX_FAILURES = 10
"""Ticks in a row without an answer of the filter or of DynWBC after which the supervisor stops the robot."""


class Supervisor:
    """Runs the controller's tick and stops for good when something is wrong.

    The stop: no feed-forward torque, no position gains, the motors' velocity gains brake every joint. A state that is
    not finite stops at once and is never used; a solver without answer may fail ``MAX_FAILURES`` times in a row (its
    last torques hold meanwhile).

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
        robot = controller.robot
        self._kd = controller.config.gain_scale * robot.joint_array("kd")
        self._hold = np.zeros(len(robot.joints))

    def tick(
        self, state: RobotState, reference: WholeBodyReference, obstacles: Sequence[Obstacle] = ()
    ) -> tuple[MotorCommand, TickResult | None]:
        """Command for a measured state, and the controller's result; ``None`` once stopped."""
        if self.cause is None and (fault := describe_fault(self.controller.robot, state)):
            self.stop(fault, state.stamp)
        if self.cause is not None:
            return self._brake(state.stamp), None
        result = self.controller.tick(state, reference, obstacles)
        self._hold = result.command.q
        failed = result.safety.status == FilterStatus.FAILED or result.dynwbc.status != "optimal"
        self._failures = self._failures + 1 if failed else 0
        if self._failures >= MAX_FAILURES:
            what = f"filter {result.safety.status.name.lower()}, DynWBC {result.dynwbc.status}"
            self.stop(f"no solution for {MAX_FAILURES} ticks ({what})", state.stamp)
        return result.command, result

    def stop(self, cause: str, stamp: float) -> None:
        """Stop the robot, for ``cause``; the first cause is kept."""
        if self.cause is None:
            self.cause, self.stopped_at = cause, stamp

    def _brake(self, stamp: float) -> MotorCommand:
        zero = np.zeros_like(self._hold)
        return MotorCommand(self._hold, zero, zero, zero, self._kd, stamp)


def describe_fault(robot: RobotDescription, state: RobotState) -> str | None:
    """What is not finite in a measured state, by name; ``None`` where all is well."""
    base = ("x", "y", "z", "quaternion x", "quaternion y", "quaternion z", "quaternion w")
    names_q = [f"base {n}" for n in base] + [f"position of {n}" for n in robot.joint_names]
    rates = [f"{kind} velocity {axis}" for kind in ("linear", "angular") for axis in "xyz"]
    names_v = [f"base {n}" for n in rates] + [f"velocity of {n}" for n in robot.joint_names]
    for names, values in ((names_q, state.q), (names_v, state.v)):
        if len(values) != len(names):
            return f"measured state has {len(values)} numbers instead of {len(names)}"
        if not np.isfinite(values).all():
            i = int(np.argmin(np.isfinite(values)))
            return f"measured {names[i]} is {values[i]}"
    return None
