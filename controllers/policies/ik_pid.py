r"""Nominal policy of SPARK's benchmark: joint angles by inverse kinematics in every tick, and a linear law on them.

.. math:: u = k_p (q^* - q), \qquad \ddot u = 10\,(q^* - q) - 5\,\dot q

for control by velocities and by accelerations, clipped entry by entry. Source: SPARK v1.0
(``intelligent-control-lab/spark``, commit d36e32c), in which k_p is 1/s; its derivative term sees no velocity where the
plant is an integrator of first order. The base's goal enters as it is, turned into the base's own axes.
"""

import math

import numpy as np

from controllers.policies.hand_ik import HandIk
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.messages import Array

GAIN = 1.0
"""k_p of velocities [1/s]."""

STIFFNESS, DAMPING = 10.0, 5.0
"""Gains of accelerations [1/s^2, 1/s]."""


class IkPidPolicy:
    """Hands and base to their goals, and of nothing else does it take account; see the module.

    Args:
        kin: of the robot, on a planar or a fixed base.
        ik: of the hands, for the same joints.
        limits: shape (nv,) bounds on the size of each input, above 0.

    Attributes:
        hand_goals: shape (m, 3) in the base's axes [m]; to be set.
        base_goal: shape (3,) x, y, yaw [m, m, rad]; ``None`` for a base that stays; to be set.

    Raises:
        ConfigError: a floating base, joints of the inverse kinematics that are not those of ``kin``, or limits of
            another shape or not above 0.
    """

    def __init__(self, kin: Kinematics, ik: HandIk, limits: Array) -> None:
        if kin.base == "floating":
            raise ConfigError("base", kin.base, "planar or fixed: nothing here keeps a floating base upright")
        if ik.joint_names != kin.joint_names:
            raise ConfigError("joints of the inverse kinematics", ik.joint_names, ", ".join(kin.joint_names))
        if np.shape(limits) != (kin.nv,) or not (limits > 0.0).all():
            raise ConfigError("limits", limits, f"{kin.nv} numbers above 0")
        self._ik, self._limits = ik, np.array(limits, dtype=float)
        self.hand_goals = ik.places(kin.q[kin.nq_base :])
        self.base_goal: Array | None = None

    def velocity(self, kin: Kinematics) -> Array:
        """Desired velocity (nv,), within the limits [m/s, rad/s]."""
        return np.clip(GAIN * self._errors(kin), -self._limits, self._limits)

    def acceleration(self, kin: Kinematics, v: Array) -> Array:
        """Desired acceleration (nv,) at velocity ``v`` (nv,), within the limits [m/s^2, rad/s^2]."""
        return np.clip(STIFFNESS * self._errors(kin) - DAMPING * v, -self._limits, self._limits)

    def _errors(self, kin: Kinematics) -> Array:
        """From where the robot is to where it is to be (nv,), the base in its own axes [m, rad]."""
        errors = np.zeros(kin.nv)
        q = kin.q[kin.nq_base :]
        errors[kin.nv_base :] = self._ik.solve(q, self.hand_goals) - q
        if kin.nv_base and self.base_goal is not None:
            x, y, c, s = kin.q[:4]
            dx, dy = self.base_goal[0] - x, self.base_goal[1] - y
            errors[:2] = c * dx + s * dy, c * dy - s * dx
            errors[2] = math.remainder(self.base_goal[2] - math.atan2(s, c), math.tau)
        return errors
