"""The path of a swinging foot, which may be sent elsewhere on its way."""

import numpy as np

from robots.checks import require_non_negative, require_positive
from robots.messages import Array


class Quintic:
    """Polynomial of degree five between two states; after its end it goes on at the velocity it has there.

    Args:
        start: three arrays of one shape: position, velocity, acceleration at time 0.
        end: where it ends, without acceleration.
        duration: above 0 [s].
        end_velocity: at its end, 0 if not given.
    """

    def __init__(
        self, start: tuple[Array, Array, Array], end: Array, duration: float, end_velocity: Array | None = None
    ) -> None:
        require_positive("duration", duration)
        p, v, a = start
        t = self._duration = duration
        w = np.zeros_like(end) if end_velocity is None else end_velocity
        d = end - p
        self._end, self._end_velocity = end, w
        self._coefficients = (
            p,
            v,
            0.5 * a,
            (10 * d - t * (6 * v + 4 * w) - 1.5 * t**2 * a) / t**3,
            (-15 * d + t * (8 * v + 7 * w) + 1.5 * t**2 * a) / t**4,
            (6 * d - 3 * t * (v + w) - 0.5 * t**2 * a) / t**5,
        )

    def evaluate(self, t: float) -> tuple[Array, Array, Array]:
        """Position, velocity, acceleration at ``t`` [s]."""
        if t >= self._duration:
            late = t - self._duration
            return self._end + late * self._end_velocity, self._end_velocity, np.zeros_like(self._end)
        c0, c1, c2, c3, c4, c5 = self._coefficients
        position = c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5))))
        velocity = c1 + t * (2 * c2 + t * (3 * c3 + t * (4 * c4 + t * 5 * c5)))
        return position, velocity, 2 * c2 + t * (6 * c3 + t * (12 * c4 + t * 20 * c5))


class SwingPath:
    """Foot from where it is to a foothold: x, y, yaw on one quintic, the height up and down on two.

    x, y and yaw arrive at ``ARRIVAL`` of the time, so that the foot comes down straight; and it goes on down at
    ``touch_speed`` until the ground stops it.

    Args:
        start: shape (4,) x, y, height [m] and yaw [rad] at the start, at rest.
        target: shape (4,) the same at the end.
        apex: height over the higher of start and target [m], above 0.
        duration: above 0 [s].
        touch_speed: downward speed at the end, 0 or above [m/s].
    """

    ARRIVAL = 0.88
    RISE = 0.45

    def __init__(self, start: Array, target: Array, apex: float, duration: float, touch_speed: float = 0.0) -> None:
        require_positive("apex", apex)
        require_non_negative("touch_speed", touch_speed)
        self._touch = np.array([-touch_speed])
        self.duration = duration
        self.target = target.copy()
        self._flat_since = 0.0
        rest = np.zeros(3)
        self._flat = Quintic((start[[0, 1, 3]], rest, rest), target[[0, 1, 3]], self.ARRIVAL * duration)
        self._top = top = np.array([max(start[2], target[2]) + apex])
        self._ground = target[2:3].copy()
        self._up_since = 0.0
        none = np.zeros(1)
        self._top_at = self.RISE * duration
        self._up = Quintic((start[2:3], none, none), top, self._top_at)
        self._down = Quintic((top, none, none), self._ground, duration - self._top_at, self._touch)

    def send_to(self, target: Array, t: float, left: float) -> None:
        """Change target (4,) and arrival at time ``t`` [s]: ``left`` [s] from then, without a jump of acceleration."""
        now = self._flat.evaluate(t - self._flat_since)
        early = (1.0 - self.ARRIVAL) * self.duration
        self._flat = Quintic(now, target[[0, 1, 3]], max(left - early, 0.5 * left))
        self._flat_since = t
        if abs(t + left - self.duration) > 1e-9:
            self._land_at(t, left)
        self.target = target.copy()

    def _land_at(self, t: float, left: float) -> None:
        """New heights: on to the top if there is time for it, and down."""
        high = self._height(t)
        top_at = self.RISE * (t + left)
        if top_at - t > 0.1 * (t + left):
            self._up, self._up_since, self._top_at = Quintic(high, self._top, top_at - t), t, top_at
            self._down = Quintic((self._top, np.zeros(1), np.zeros(1)), self._ground, t + left - top_at, self._touch)
        else:
            self._down, self._top_at = Quintic(high, self._ground, left, self._touch), t
        self.duration = t + left

    def _height(self, t: float) -> tuple[Array, Array, Array]:
        return self._up.evaluate(t - self._up_since) if t < self._top_at else self._down.evaluate(t - self._top_at)

    def evaluate(self, t: float) -> tuple[Array, Array, Array]:
        """Position, velocity, acceleration at ``t`` [s], each (4,): x, y, height, yaw."""
        flat = self._flat.evaluate(t - self._flat_since)
        high = self._height(t)
        position, velocity, acceleration = (np.array([f[0], f[1], h[0], f[2]]) for f, h in zip(flat, high, strict=True))
        return position, velocity, acceleration
