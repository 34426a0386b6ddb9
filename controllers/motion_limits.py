"""Limits of tilt, height and rate, beyond which nothing but a fall can follow: the motors are only to brake then."""

import math
from dataclasses import dataclass

from robots.checks import require_between, require_positive
from robots.messages import Array, RobotState

IN_A_ROW = 2
"""States beyond a limit, one after the other, from which it counts: one alone may be a broken measurement."""


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """What a robot that is controlled does not exceed.

    Tilt and rate are the manufacturer's of the G1 (unitree_sdk2, robot/g1/common/terminations.hpp). Its 10 rad/s of any
    joint are watched where a G1 is driven (:mod:`controllers.deployment.protection`): how fast joints may be is a
    matter of the robot.

    Attributes:
        tilt: of the base from upright, in (0, pi) [rad].
        rate: of the base's turning, above 0 [rad/s].
        height: of the base over the lower sole, as a fraction of that in the posture ``standing``, in (0, 1).
    """

    tilt: float = 1.0
    rate: float = 6.0
    height: float = 0.6

    def __post_init__(self) -> None:
        require_between("limit of tilt", self.tilt, 1e-3, math.pi)
        require_between("limit of height", self.height, 1e-3, 1.0)
        require_positive("limit of rate", self.rate)


class MotionWatch:
    """Tells when a limit is passed for good."""

    def __init__(self, limits: MotionLimits, stands_at: float) -> None:
        """``stands_at``: height of the base over the lower sole while the robot stands [m]."""
        self._limits = limits
        self._least_height = limits.height * stands_at
        self._least_upright = math.cos(limits.tilt)
        self._beyond = 0

    def inspect(self, state: RobotState, height: float) -> str | None:
        """What is beyond its limit, in words, once it has been so ``IN_A_ROW`` times; ``None`` before and otherwise.

        Args:
            state: measured, every number finite.
            height: of the base over the lower sole, NaN where it is not known [m].
        """
        fault = self._describe(state.q, state.v, height)
        self._beyond = 0 if fault is None else self._beyond + 1
        return fault if self._beyond >= IN_A_ROW else None

    def _describe(self, q: Array, v: Array, height: float) -> str | None:
        limits = self._limits
        upright = 1.0 - 2.0 * (q[3] * q[3] + q[4] * q[4])
        if upright < self._least_upright:
            return f"the base is tilted by {math.acos(max(-1.0, upright)):.2f} rad, over {limits.tilt:g}"
        turning = math.sqrt(v[3:6] @ v[3:6])
        if turning > limits.rate:
            return f"the base turns at {turning:.1f} rad/s, over {limits.rate:g}"
        if height < self._least_height:
            return f"the base is {height:.2f} m over the soles, under {self._least_height:.2f}"
        return None
