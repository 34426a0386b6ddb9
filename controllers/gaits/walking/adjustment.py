"""Where and when a foot has to come down, for a robot that was pushed."""

import math
from dataclasses import dataclass

from controllers.gaits.footholds import Foothold
from controllers.gaits.walking.footsteps import StepLimits
from robots.messages import Array

GRID = tuple(1.0 - i / 8 for i in range(9))
"""Times to landing that are tried, from the present one to the shortest."""

RELUCTANCE = 0.25
"""What a step that is shorter by a second costs, as metres of footholds out of reach [m/s]."""


@dataclass(frozen=True, slots=True)
class StepAdjustment:
    r"""Moves a foothold, and its time, with the part of the DCM's error that the ZMP cannot take back within the sole.

    On one foot at :math:`r` the DCM goes, under a ZMP at :math:`r + \delta`, to

    .. math:: \xi(T) = r + (\xi - r) e^{\omega T} - \delta (e^{\omega T} - 1)

    in the time T until the other foot lands. If the landing and all footholds after it move by :math:`\Delta`, the DCM
    that the plan wants there moves by :math:`f \Delta`, :math:`f = (1 - e^{-\omega T_{ds}}) / (\omega T_{ds})`: the ZMP
    goes over from the old foot in the time :math:`T_{ds}`. The smallest :math:`|\Delta|` over the sole is taken, axis
    by axis of the standing foot. Where that is out of reach, earlier landings are tried.

    Attributes:
        limits: of footholds.
        omega: of the pendulum [1/s].
        room: shape (2,) how far the ZMP may go from the sole's centre, forward and sideways [m].
        double_support: T_ds [s].
    """

    limits: StepLimits
    omega: float
    room: Array
    double_support: float

    def shift(self, dcm: Array, stance: Foothold, wanted: Array, left: float) -> tuple[float, float]:
        """Smallest shift of the foothold, forward and to the left in the standing foot's axes [m].

        Args:
            dcm: shape (2,) measured [m].
            stance: standing foot.
            wanted: shape (2,) DCM that the plan has at the landing, with the foothold where it was planned [m].
            left: T, time until the landing [s].
        """
        growth = math.exp(self.omega * left)
        rx, ry = stance.x, stance.y
        ex = rx + growth * (float(dcm[0]) - rx) - float(wanted[0])
        ey = ry + growth * (float(dcm[1]) - ry) - float(wanted[1])
        c, s = math.cos(stance.yaw), math.sin(stance.yaw)
        turn = self.omega * self.double_support
        share = (1.0 - math.exp(-turn)) / turn
        errors = (c * ex + s * ey, c * ey - s * ex)
        rooms = ((growth - 1.0) * float(self.room[0]), (growth - 1.0) * float(self.room[1]))
        x, y = (math.copysign(max(abs(e) - r, 0.0), e) / share for e, r in zip(errors, rooms, strict=True))
        return x, y

    def adjust(
        self, dcm: Array, stance: Foothold, swing: int, planned: Foothold, wanted: Array, left: float, shortest: float
    ) -> tuple[Foothold, float]:
        """Foothold and time until the landing [s]: those planned, as they are, where the ZMP can do it.

        Args:
            dcm: shape (2,) measured [m].
            stance: standing foot.
            swing: the other foot.
            planned: its foothold in the plan.
            wanted: shape (2,) DCM that the plan has at the landing [m].
            left: planned time until then [s].
            shortest: time that the foot needs at least [s].
        """
        if self.shift(dcm, stance, wanted, left) == (0.0, 0.0):
            return planned, left
        best, best_cost, best_left = planned, math.inf, left
        c, s = math.cos(stance.yaw), math.sin(stance.yaw)
        for share in GRID:
            time = shortest + share * (left - shortest)
            forward, sideways = self.shift(dcm, stance, wanted, time)
            ideal = Foothold(
                planned.x + c * forward - s * sideways, planned.y + s * forward + c * sideways, planned.yaw
            )
            near = self.limits.clamp(stance, ideal, swing)
            missing = math.hypot(ideal.x - near.x, ideal.y - near.y)
            cost = missing + RELUCTANCE * (left - time)
            if cost < best_cost:
                best, best_cost, best_left = near, cost, time
            if missing < 1e-9 or left <= shortest:
                break
        return best, best_left
