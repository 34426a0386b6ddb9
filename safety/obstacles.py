"""Obstacles as the filter sees them."""

from dataclasses import dataclass, field

import numpy as np

from robots.checks import all_finite, require_positive
from robots.errors import ConfigError
from robots.messages import Array


@dataclass(frozen=True, slots=True)
class Obstacle:
    """A capsule in the world, or a sphere where ``start`` and ``end`` coincide.

    Attributes:
        start: shape (3,) one end of the centre line [m].
        end: shape (3,) the other end [m].
        radius: above 0 [m].
        velocity: shape (3,) of the point ``start`` [m/s].
        spin: shape (3,) angular velocity, world axes [rad/s].
    """

    start: Array
    end: Array
    radius: float
    velocity: Array = field(default_factory=lambda: np.zeros(3))
    spin: Array = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        require_positive("obstacle radius", self.radius)
        for name in ("start", "end", "velocity", "spin"):
            value = getattr(self, name)
            if np.shape(value) != (3,) or not all_finite(np.asarray(value, dtype=float)):
                raise ConfigError(f"obstacle {name}", value, "three finite numbers")
            # a copy: the caller's array may go on to another place while this obstacle stays
            object.__setattr__(self, name, np.array(value, dtype=float))

    @staticmethod
    def sphere(center: Array, radius: float, velocity: Array | None = None) -> "Obstacle":
        """A sphere about ``center`` (3,) moving at ``velocity`` (3,), zero if not given."""
        return Obstacle(center, center, radius, np.zeros(3) if velocity is None else velocity)
