"""Where and when a foot has to come down, for a robot that was pushed."""

import math
from dataclasses import dataclass, field

from controllers.gaits.footholds import Foothold
from controllers.gaits.walking.footsteps import StepLimits
from robots.messages import Array

TIME_FRACTIONS = tuple(1.0 - i / 8 for i in range(9))
"""Times to touchdown that are tried, from the present one (1) to the shortest (0)."""

EARLY_STEP_COST = 0.25
"""What a step that is shorter by a second costs, as metres of footholds out of reach [m/s]."""


@dataclass(frozen=True, slots=True)
class StepAdjustment:
    r"""Moves a foothold, and its time, with the part of the DCM's error that the ZMP cannot take back within the sole.

    On one foot at :math:`r` the DCM goes, under a ZMP at :math:`r + \delta`, to

    .. math:: \xi(T) = r + (\xi - r) e^{\omega T} - \delta (e^{\omega T} - 1)

    in the time T until the other foot lands. If that foothold and all after it move by :math:`\Delta`, the DCM that the
    plan has at touchdown moves by :math:`f \Delta`, :math:`f = (1 - e^{-\omega T_{ds}}) / (\omega T_{ds})`: the ZMP
    goes over from the old foot in the time :math:`T_{ds}`. The smallest :math:`|\Delta|` over the sole is taken, axis
    by axis of the standing foot. Where that is out of reach, earlier touchdowns are tried.

    Attributes:
        limits: of footholds.
        omega: of the pendulum [1/s].
        zmp_range: how far the ZMP may go from the sole's centre, forward and sideways [m].
        double_support: T_ds [s].
    """

    limits: StepLimits
    omega: float
    zmp_range: tuple[float, float]
    double_support: float
    _effect: float = field(init=False, repr=False)

    def __post_init__(self) -> None:
        transfer = self.omega * self.double_support
        object.__setattr__(self, "_effect", (1.0 - math.exp(-transfer)) / transfer)

    def shift(
        self, dcm: Array, stance: Foothold, dcm_at_touchdown: Array, time_to_touchdown: float
    ) -> tuple[float, float]:
        """Smallest shift of the foothold, forward and to the left in the standing foot's axes [m].

        Args:
            dcm: shape (2,) measured [m].
            stance: standing foot.
            dcm_at_touchdown: shape (2,) in the plan, with the foothold where it was planned [m].
            time_to_touchdown: T [s].
        """
        # plain floats: this is asked in every tick on one foot, and numpy's calls would cost more than the sums
        (x, y), (planned_x, planned_y), rx, ry = dcm.tolist(), dcm_at_touchdown.tolist(), stance.x, stance.y
        growth = math.exp(self.omega * time_to_touchdown)
        ex = rx + growth * (x - rx) - planned_x
        ey = ry + growth * (y - ry) - planned_y
        c, s = math.cos(stance.yaw), math.sin(stance.yaw)
        forward, sideways = c * ex + s * ey, c * ey - s * ex
        most_forward, most_sideways = (growth - 1.0) * self.zmp_range[0], (growth - 1.0) * self.zmp_range[1]
        if abs(forward) <= most_forward and abs(sideways) <= most_sideways:
            return 0.0, 0.0
        return _beyond(forward, most_forward) / self._effect, _beyond(sideways, most_sideways) / self._effect

    def adjust(
        self,
        dcm: Array,
        stance: Foothold,
        swing: int,
        planned: Foothold,
        dcm_at_touchdown: Array,
        time_to_touchdown: float,
        shortest: float,
    ) -> tuple[Foothold, float]:
        """Foothold and time to touchdown [s]: those planned, as they are, where the ZMP can do it.

        Args:
            dcm: shape (2,) measured [m].
            stance: standing foot.
            swing: the other foot.
            planned: its foothold in the plan.
            dcm_at_touchdown: shape (2,) in the plan [m].
            time_to_touchdown: planned [s].
            shortest: time that the foot needs at least [s].
        """
        # nearly every tick: the plan stays as it is, to the last digit
        if self.shift(dcm, stance, dcm_at_touchdown, time_to_touchdown) == (0.0, 0.0):
            return planned, time_to_touchdown
        best, best_cost, best_time = planned, math.inf, time_to_touchdown
        c, s = math.cos(stance.yaw), math.sin(stance.yaw)
        for fraction in TIME_FRACTIONS:
            time = shortest + fraction * (time_to_touchdown - shortest)
            forward, sideways = self.shift(dcm, stance, dcm_at_touchdown, time)
            ideal = Foothold(
                planned.x + c * forward - s * sideways, planned.y + s * forward + c * sideways, planned.yaw
            )
            reached = self.limits.clamp(stance, ideal, swing)
            missing = math.hypot(ideal.x - reached.x, ideal.y - reached.y)
            # what is missing grows into the next step's error; what is early costs the leg acceleration
            cost = missing + EARLY_STEP_COST * (time_to_touchdown - time)
            if cost < best_cost:
                best, best_cost, best_time = reached, cost, time
            # within reach no earlier time is better, and where there is only one time there is no other
            if missing < 1e-9 or time_to_touchdown <= shortest:
                break
        return best, best_time


def _beyond(error: float, most: float) -> float:
    """The part of an error that is left when ``most`` of it is taken back."""
    return math.copysign(max(abs(error) - most, 0.0), error)
