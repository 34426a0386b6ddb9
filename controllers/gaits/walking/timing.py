"""How long a step takes: the faster the walk, the longer a foot is on its way."""

import math
from dataclasses import dataclass

from controllers.gaits.walking.swing_path import PEAK_ACCELERATION, SwingPath
from robots.checks import require_positive


@dataclass(frozen=True, slots=True)
class StepTiming:
    r"""Times of a step, by the speed that the feet have to keep up with.

    At speed v a swinging foot goes :math:`D = 2 v (T_s + T_d)` over the ground, in a fraction :math:`\rho` of the time
    on one foot, on a quintic whose acceleration peaks at :math:`10 D / (\sqrt 3 (\rho T_s)^2)`. What accelerates the
    leg drives the rest of the robot back, and more than a sole can resist makes it fall. So T_s is the time of slow
    walking, or the shortest that keeps the peak within a bound. A step between two speeds takes the time of the faster
    one.

    Attributes:
        single_support: T_s of slow walking, above 0 [s].
        double_support: T_d, above 0 [s].
        swing_acceleration: bound of a foot's horizontal acceleration, above 0 [m/s^2].
    """

    single_support: float
    double_support: float
    swing_acceleration: float

    def __post_init__(self) -> None:
        for name in self.__slots__:
            require_positive(f"step {name}", getattr(self, name))

    def single(self, speed: float) -> float:
        """T_s at a speed, 0 or above [m/s]."""
        # the bound, a quadratic in T_s: bound T_s^2 - stride T_s - stride T_d = 0
        stride, bound = 2.0 * PEAK_ACCELERATION * speed, self.swing_acceleration * SwingPath.ARRIVAL**2
        root = math.sqrt(stride * stride + 4.0 * bound * stride * self.double_support)
        return max(self.single_support, 0.5 * (stride + root) / bound)

    def period(self, speed: float) -> float:
        """Time of a whole step at a speed, 0 or above [m/s]."""
        return self.single(speed) + self.double_support

    def speed(self, length: float) -> float:
        """The speed [m/s] at which each step goes on by ``length``, 0 or above [m]."""
        shortest = math.sqrt(2.0 * PEAK_ACCELERATION * length / self.swing_acceleration) / SwingPath.ARRIVAL
        return length / (max(self.single_support, shortest) + self.double_support)
