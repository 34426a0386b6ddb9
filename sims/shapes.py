"""Shapes beside the robot that a picture shows."""

from dataclasses import dataclass, field

import numpy as np

from robots.checks import all_finite, require_one_of
from robots.errors import ConfigError
from robots.messages import Array

SHAPES = {"sphere": 1, "capsule": 2, "box": 3}
"""Kinds of shape, and how many sizes each has: radius; radius and half length along its z axis; half sizes."""


@dataclass(frozen=True, slots=True)
class Shape:
    """One shape in the world.

    Attributes:
        kind: one of ``SHAPES``.
        size: as many as ``SHAPES`` says, each above 0 [m].
        center: shape (3,) [m].
        rotation: shape (3, 3), its axes in the world.
    """

    kind: str
    size: tuple[float, ...]
    center: Array
    rotation: Array = field(default_factory=lambda: np.eye(3))

    def __post_init__(self) -> None:
        require_one_of("shape", self.kind, tuple(SHAPES))
        if len(self.size) != SHAPES[self.kind] or not all(np.isfinite(s) and s > 0 for s in self.size):
            raise ConfigError(f"size of the {self.kind}", self.size, f"{SHAPES[self.kind]} numbers above 0")
        for name, shape in (("center", (3,)), ("rotation", (3, 3))):
            value = getattr(self, name)
            if np.shape(value) != shape or not all_finite(np.asarray(value, dtype=float)):
                raise ConfigError(f"{self.kind} {name}", value, f"finite numbers of shape {shape}")
