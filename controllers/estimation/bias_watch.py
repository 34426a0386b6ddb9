r"""Whether the gyro's bias has jumped: soles that stand seem to turn, and go on doing so.

The filter takes the bias for something that drifts slowly, and rightly so: one that is free to move takes up what soles
do as they roll on their edges. A bias that jumps by 0.05 rad/s would then be followed in minutes, and a walk falls
within two seconds. What tells a jump from soles that roll is that it lasts:
with the rate :math:`\omega_i` of each standing sole as gyro and legs together have it, in the IMU's axes, and the bias
:math:`b`,

.. math:: \dot{\bar\omega} = \frac{1}{\tau} \left( \frac{1}{n} \sum_{standing} \omega_i - \bar\omega \right), \qquad
    |\bar\omega| > \omega_0: \quad P_{bb} \leftarrow P_{bb} + \sigma^2 I, \quad \bar\omega \leftarrow 0

A covariance that is raised where innovations show the model to be wrong, and that the filter itself then lowers:
Bar-Shalom, Li and Kirubarajan, *Estimation with applications to tracking and navigation*, Wiley 2001, chapter 11
(adjustable level of the process noise).
"""

from dataclasses import dataclass

import numpy as np

from robots.checks import require_positive
from robots.messages import Array, Mask


@dataclass(frozen=True, slots=True)
class BiasDoubt:
    """When the gyro's bias is doubted, and how much.

    Attributes:
        rate: of standing soles on average, from which on [rad/s].
        memory: time constant of that average [s].
        deviation: that the bias is then taken to have [rad/s].
    """

    rate: float = 0.04
    memory: float = 0.4
    deviation: float = 0.05

    def __post_init__(self) -> None:
        for name in self.__slots__:
            require_positive(f"bias doubt {name}", getattr(self, name))


class BiasWatch:
    """Follows the rate that standing soles seem to have.

    Attributes:
        mean: shape (3,) of that rate, over time, in the IMU's axes [rad/s].
        doubts: how often the bias was doubted.
    """

    def __init__(self, doubt: BiasDoubt) -> None:
        """``doubt``: when."""
        self.doubt = doubt
        self.mean, self._sum = np.zeros(3), np.zeros(3)
        self.doubts = 0

    def reset(self) -> None:
        """Begin with soles that do not turn."""
        self.mean[:] = 0.0

    def update(self, turns: Array, rates: Array, standing: Mask, dt: float) -> bool:
        """Take in one tick; returns whether the bias is to be doubted.

        Args:
            turns: shape (2, 3, 3) rotations of the soles in the IMU's axes.
            rates: shape (2, 3) of the soles in their own axes, as gyro and legs together have them [rad/s].
            standing: shape (2,) which feet stand; with none, what was known is forgotten.
            dt: since the last tick [s].
        """
        total, count = self._sum, 0
        total[:] = 0.0
        for foot in range(2):
            if standing[foot]:
                total += turns[foot] @ rates[foot]
                count += 1
        if not count:
            self.reset()
            return False
        total /= count
        total -= self.mean
        total *= min(1.0, dt / self.doubt.memory)
        self.mean += total
        if self.mean @ self.mean <= self.doubt.rate**2:
            return False
        self.doubts += 1
        self.reset()
        return True
