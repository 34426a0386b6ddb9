"""The path of a swinging foot, which may be sent elsewhere on its way."""

import numpy as np

from robots.checks import require_positive
from robots.messages import Array


class Quintic:
    """Polynomial of degree five between two states (position, velocity, acceleration), held at rest after its end.

    Args:
        start: three arrays of one shape: position, velocity, acceleration at time 0.
        end: where it ends, at rest.
        duration: above 0 [s].
    """

    def __init__(self, start: tuple[Array, Array, Array], end: Array, duration: float) -> None:
        require_positive("duration", duration)
        p, v, a = start
        t = self._duration = duration
        d = end - p
        self._end = end
        self._coefficients = (
            p,
            v,
            0.5 * a,
            (10 * d - 6 * t * v - 1.5 * t**2 * a) / t**3,
            (-15 * d + 8 * t * v + 1.5 * t**2 * a) / t**4,
            (6 * d - 3 * t * v - 0.5 * t**2 * a) / t**5,
        )

    def evaluate(self, t: float) -> tuple[Array, Array, Array]:
        """Position, velocity, acceleration at ``t`` [s]."""
        if t >= self._duration:
            return self._end, np.zeros_like(self._end), np.zeros_like(self._end)
        c0, c1, c2, c3, c4, c5 = self._coefficients
        position = c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5))))
        velocity = c1 + t * (2 * c2 + t * (3 * c3 + t * (4 * c4 + t * 5 * c5)))
        return position, velocity, 2 * c2 + t * (6 * c3 + t * (12 * c4 + t * 20 * c5))


class SwingPath:
    """Foot from where it is to a foothold: x, y, yaw on one quintic, the height up and down on two.

    x, y and yaw arrive at ``ARRIVAL`` of the time, so that the foot comes down straight.

    Args:
        start: shape (4,) x, y, height [m] and yaw [rad] at the start, at rest.
        target: shape (4,) the same at the end, at rest.
        apex: height over the higher of start and target [m], above 0.
        duration: above 0 [s].
    """

    ARRIVAL = 0.92
    RISE = 0.45

    def __init__(self, start: Array, target: Array, apex: float, duration: float) -> None:
        require_positive("apex", apex)
        self.duration = duration
        self.target = target.copy()
        self._flat_since = 0.0
        rest = np.zeros(3)
        self._flat = Quintic((start[[0, 1, 3]], rest, rest), target[[0, 1, 3]], self.ARRIVAL * duration)
        top = np.array([max(start[2], target[2]) + apex])
        none = np.zeros(1)
        self._top_at = self.RISE * duration
        self._up = Quintic((start[2:3], none, none), top, self._top_at)
        self._down = Quintic((top, none, none), target[2:3], duration - self._top_at)

    def send_to(self, target: Array, t: float) -> None:
        """Change x, y, yaw of the target (4,) at ``t`` [s], without a jump of the acceleration."""
        left = max(self.ARRIVAL * self.duration - t, 0.05 * self.duration)
        now = self._flat.evaluate(t - self._flat_since)
        self._flat = Quintic(now, target[[0, 1, 3]], left)
        self._flat_since = t
        self.target = target.copy()

    def evaluate(self, t: float) -> tuple[Array, Array, Array]:
        """Position, velocity, acceleration at ``t`` [s], each (4,): x, y, height, yaw."""
        flat = self._flat.evaluate(t - self._flat_since)
        high = self._up.evaluate(t) if t < self._top_at else self._down.evaluate(t - self._top_at)
        position, velocity, acceleration = (np.array([f[0], f[1], h[0], f[2]]) for f, h in zip(flat, high, strict=True))
        return position, velocity, acceleration
