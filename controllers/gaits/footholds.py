"""Where a foot stands."""

import math
from dataclasses import dataclass

import numpy as np

from robots.messages import Array

LEFT, RIGHT = 0, 1
"""Feet, in the order of the description's soles."""


@dataclass(frozen=True, slots=True)
class Foothold:
    """A sole on the ground: centre ``x``, ``y`` [m] and direction ``yaw`` [rad] in the world."""

    x: float
    y: float
    yaw: float

    @property
    def point(self) -> Array:
        """Its centre, shape (2,) [m]."""
        return np.array([self.x, self.y])

    @property
    def axes(self) -> Array:
        """Its forward and left directions as columns, shape (2, 2)."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return np.array([[c, -s], [s, c]])

    def compose(self, x: float, y: float, yaw: float) -> "Foothold":
        """The foothold at ``x``, ``y``, ``yaw`` as seen from this one."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return Foothold(self.x + c * x - s * y, self.y + s * x + c * y, self.yaw + yaw)

    def relative(self, other: "Foothold") -> tuple[float, float, float]:
        """``other`` as seen from this one: x, y [m], yaw in (-pi, pi] [rad]."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        dx, dy = other.x - self.x, other.y - self.y
        return c * dx + s * dy, c * dy - s * dx, math.remainder(other.yaw - self.yaw, math.tau)
