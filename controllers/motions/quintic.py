"""Polynomials of degree five: from one state to another, without a jump of the acceleration at either end."""

import numpy as np

from robots.checks import require_positive
from robots.messages import Array

RATE = np.diag([1.0, 2.0, 3.0, 4.0, 5.0], 1)
"""From coefficients of a polynomial of degree five to those of its rate."""


class Quintic:
    """Polynomial of degree five between two states; after its end it goes on at the velocity it has there.

    Args:
        start: shape (3, k) position, velocity, acceleration at time 0.
        end: shape (k,) where it ends, without acceleration.
        duration: above 0 [s].
        end_velocity: shape (k,) at its end, 0 if not given.
    """

    def __init__(
        self, start: Array | tuple[Array, Array, Array], end: Array, duration: float, end_velocity: Array | None = None
    ) -> None:
        require_positive("duration", duration)
        p, v, a = start
        t = self._duration = duration
        w = np.zeros_like(end) if end_velocity is None else end_velocity
        d = end - p
        self._end = np.array([end, w, np.zeros_like(end)])
        coefficients = np.array(
            [
                p,
                v,
                0.5 * a,
                (10 * d - t * (6 * v + 4 * w) - 1.5 * t**2 * a) / t**3,
                (-15 * d + t * (8 * v + 7 * w) + 1.5 * t**2 * a) / t**4,
                (6 * d - 3 * t * (v + w) - 0.5 * t**2 * a) / t**5,
            ]
        )
        # columns: the polynomials, their rates, their second rates
        self._coefficients = np.hstack([coefficients, RATE @ coefficients, RATE @ RATE @ coefficients])

    def evaluate(self, t: float) -> Array:
        """Position, velocity, acceleration at ``t`` [s]: the rows of a new array (3, k)."""
        if t >= self._duration:
            out = self._end.copy()
            out[0] += (t - self._duration) * out[1]
            return out
        t2 = t * t
        t3 = t * t2
        # the method: the operator takes twice as long for arrays this small
        out = np.array((1.0, t, t2, t3, t2 * t2, t2 * t3)).dot(self._coefficients)
        return out.reshape(3, -1)


def quintic(t: float, duration: float) -> tuple[float, float, float]:
    """Value, rate [1/s], second rate [1/s^2] of the quintic from 0 to 1 in ``duration`` [s], at rest at both ends."""
    x = min(max(t / duration, 0.0), 1.0)
    value = x * x * x * (10 - 15 * x + 6 * x * x)
    rate = 30 * x * x * (1 - x) * (1 - x) / duration
    return value, rate, 60 * x * (1 - x) * (1 - 2 * x) / duration**2
