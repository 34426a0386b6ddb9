"""What motors are told beside the controller's commands: nothing, to brake, to go to a posture; and mixtures of two."""

import numpy as np

from controllers.motions.quintic import quintic
from robots.description import RobotDescription
from robots.messages import Array, MotorCommand


def limp(joints: int, stamp: float) -> MotorCommand:
    """All gains and torques zero."""
    zero = np.zeros(joints)
    return MotorCommand(zero, zero, zero, zero, zero, stamp)


def brake(robot: RobotDescription, stamp: float) -> MotorCommand:
    """Velocity gains of the description, and nothing else."""
    zero = np.zeros(len(robot.joints))
    return MotorCommand(zero, zero, zero, zero, robot.joint_array("kd"), stamp)


class PostureRamp:
    """From where the joints are to a posture, and held there, with the description's gains.

    The position gains come up over the first quarter of the way.
    """

    def __init__(self, robot: RobotDescription, start: Array, target: Array, began: float, duration: float) -> None:
        """From ``start`` (nj,) at time ``began`` [s] to ``target`` (nj,) [rad] in ``duration`` [s]."""
        self._start, self.target, self._began, self._duration = start.copy(), target, began, duration
        self._kp, self._kd = robot.joint_array("kp"), robot.joint_array("kd")

    def command(self, stamp: float) -> MotorCommand:
        """At a time [s]."""
        t = stamp - self._began
        s, rate, _ = quintic(t, self._duration)
        way = self.target - self._start
        stiffness = min(1.0, 4.0 * max(0.0, t) / self._duration)
        q, v = self._start + s * way, rate * way
        return MotorCommand(q, v, np.zeros_like(q), stiffness * self._kp, self._kd, stamp)

    def arrived(self, stamp: float) -> bool:
        """Whether the way is over."""
        return stamp >= self._began + self._duration


def mix(before: MotorCommand, after: MotorCommand, share: float) -> MotorCommand:
    """The command whose torque is ``1 - share`` times that of one and ``share`` times that of another."""
    rest = 1.0 - share
    kp, kd = rest * before.kp + share * after.kp, rest * before.kd + share * after.kd
    stiff, viscous = rest * before.kp * before.q, rest * before.kd * before.v
    q = _divided(stiff + share * after.kp * after.q, kp, after.q)
    v = _divided(viscous + share * after.kd * after.v, kd, after.v)
    return MotorCommand(q, v, rest * before.tau + share * after.tau, kp, kd, after.stamp)


def _divided(numerator: Array, gain: Array, otherwise: Array) -> Array:
    """Quotient, and ``otherwise`` where the gain is zero."""
    return np.divide(numerator, gain, out=otherwise.copy(), where=gain > 0.0)
