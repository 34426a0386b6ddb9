"""Obstacles of the simulated world: how they really move, and the noisy sensor that sees them."""

import math
from dataclasses import dataclass

import numpy as np

from robots.checks import require_non_negative, require_positive
from robots.messages import Array


@dataclass(frozen=True, slots=True)
class PassingSphere:
    """A sphere that moves straight on.

    Attributes:
        start: shape (3,) centre at time zero, world [m].
        velocity: shape (3,) [m/s].
        radius: above 0 [m].
    """

    start: Array
    velocity: Array
    radius: float

    def __post_init__(self) -> None:
        require_positive("sphere radius", self.radius)

    def position(self, t: float) -> Array:
        """Centre (3,) at time ``t`` [s]."""
        return self.start + t * self.velocity


class PositionSensor:
    """Sees a position at a fixed rate with white noise.

    Args:
        rate: of measurements, above 0 [Hz].
        noise: standard deviation of each coordinate, 0 or above [m].
        rng: source of the noise.
        lost_at: time from which it sees nothing more [s].

    Raises:
        ConfigError: a value is not allowed.
    """

    def __init__(self, rate: float, noise: float, rng: np.random.Generator, lost_at: float = math.inf) -> None:
        require_positive("sensor rate", rate)
        require_non_negative("sensor noise", noise)
        self._period = 1.0 / rate
        self._noise = noise
        self._rng = rng
        self._next = 0.0
        self._lost_at = lost_at

    def measure(self, position: Array, t: float) -> Array | None:
        """The measured position (3,) if one is due at ``t`` [s], else ``None``."""
        if t < self._next - 1e-9 or t >= self._lost_at:
            return None
        self._next += self._period
        return position + self._noise * self._rng.standard_normal(3)
