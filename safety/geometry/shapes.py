"""Obstacles as the filter sees them: spheres, capsules, boxes and half-spaces that move and turn."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin

from robots.checks import all_finite, require_one_of, require_positive
from robots.errors import ConfigError
from robots.messages import Array

KINDS = ("sphere", "capsule", "box", "half_space")
"""What an obstacle may be."""

PACKED_SIZE = 25
"""Numbers in :attr:`Obstacle.packed`."""

PARTS: dict[str, tuple[slice, tuple[int, ...]]] = {
    "position": (slice(0, 3), (3,)),
    "direction": (slice(3, 6), (3,)),
    "rotation": (slice(6, 15), (3, 3)),
    "half_sizes": (slice(15, 18), (3,)),
    "velocity": (slice(19, 22), (3,)),
    "angular_velocity": (slice(22, 25), (3,)),
}
"""Place and shape of each array in :attr:`Obstacle.packed`."""

RADIUS = 18
"""Place of the radius there."""

ZERO, IDENTITY = np.zeros(3), np.eye(3)
"""What is not given; copied, never handed out."""

ORTHONORMAL_TOLERANCE = 1e-6
"""Largest entry by which a box's rotation times its transpose may differ from the identity."""


@dataclass(frozen=True, slots=True)
class Obstacle:
    """One obstacle at one instant. Made by :meth:`sphere`, :meth:`capsule`, :meth:`box` or :meth:`half_space`.

    Attributes:
        kind: one of ``KINDS``.
        position: shape (3,) reference point in the world [m]: centre of a sphere or box, start of a capsule's centre
            line, a point on a half-space's plane.
        direction: shape (3,) from start to end of a capsule's centre line [m]; unit normal of a half-space, pointing to
            the side that is free; zero for the others.
        rotation: shape (3, 3) axes of a box in the columns, world frame; identity for the others.
        half_sizes: shape (3,) of a box along its axes, above 0 [m]; zero for the others.
        radius: of a sphere or capsule, above 0 [m]; zero for the others.
        velocity: shape (3,) of the reference point, as a point fixed to the obstacle [m/s].
        angular_velocity: shape (3,) angular velocity, world axes [rad/s].
        packed: shape (``PACKED_SIZE``,) all numbers in the order above.

    All arrays are read-only: an obstacle elsewhere is another one, see :meth:`after` and :func:`dataclasses.replace`.

    Raises:
        ConfigError: unknown kind, a number that is not finite, a size that is not above 0, a rotation that is not
            one, or a normal without length.
    """

    kind: str
    position: Array
    direction: Array = field(default_factory=lambda: ZERO)
    rotation: Array = field(default_factory=lambda: IDENTITY)
    half_sizes: Array = field(default_factory=lambda: ZERO)
    radius: float = 0.0
    velocity: Array = field(default_factory=lambda: ZERO)
    angular_velocity: Array = field(default_factory=lambda: ZERO)
    packed: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        require_one_of("obstacle kind", self.kind, KINDS)
        packed = np.zeros(PACKED_SIZE)
        object.__setattr__(self, "packed", packed)
        for name, (place, shape) in PARTS.items():
            value = getattr(self, name)
            if np.shape(value) != shape:
                _finite(name, value, shape)
            # a copy: the caller's array may go on to another place while this obstacle stays
            part = packed[place] if len(shape) == 1 else packed[place].reshape(shape)
            part[:] = value
            object.__setattr__(self, name, part)
        if not math.isfinite(np.add.reduce(packed)):
            for name, (_, shape) in PARTS.items():
                _finite(name, getattr(self, name), shape)
        self._check_size()
        packed[RADIUS] = self.radius
        packed.setflags(write=False)
        for name in PARTS:
            getattr(self, name).setflags(write=False)

    def _check_size(self) -> None:
        if self.kind in ("sphere", "capsule"):
            require_positive("obstacle radius", self.radius)
        elif self.kind == "box":
            for size in self.half_sizes:
                require_positive("obstacle half size", float(size))
            off = np.abs(self.rotation @ self.rotation.T - np.eye(3)).max()
            if off > ORTHONORMAL_TOLERANCE or np.linalg.det(self.rotation) < 0:
                raise ConfigError("obstacle rotation", self.rotation.tolist(), "a rotation (orthonormal, right-handed)")
        else:
            length = math.hypot(*self.direction)
            if length == 0:
                raise ConfigError("obstacle normal", self.direction.tolist(), "a vector of some length")
            self.direction[:] /= length

    @staticmethod
    def sphere(center: Array, radius: float, velocity: Array | None = None) -> "Obstacle":
        """A sphere about ``center`` (3,) of ``radius`` [m] moving at ``velocity`` (3,) [m/s], zero if not given."""
        return Obstacle("sphere", center, radius=radius, velocity=_given(velocity))

    @staticmethod
    def capsule(
        start: Array, end: Array, radius: float, velocity: Array | None = None, angular_velocity: Array | None = None
    ) -> "Obstacle":
        """A capsule about the line from ``start`` to ``end`` (3,) [m]; ``velocity`` is that of ``start``."""
        start = _finite("start", start, (3,))
        direction = _finite("end", end, (3,)) - start
        return Obstacle(
            "capsule",
            start,
            direction,
            radius=radius,
            velocity=_given(velocity),
            angular_velocity=_given(angular_velocity),
        )

    @staticmethod
    def box(
        center: Array,
        rotation: Array,
        half_sizes: Array,
        velocity: Array | None = None,
        angular_velocity: Array | None = None,
    ) -> "Obstacle":
        """A box about ``center`` (3,) with axes in the columns of ``rotation`` (3, 3), ``half_sizes`` (3,) [m]."""
        return Obstacle(
            "box",
            center,
            rotation=rotation,
            half_sizes=half_sizes,
            velocity=_given(velocity),
            angular_velocity=_given(angular_velocity),
        )

    @staticmethod
    def half_space(
        point: Array, normal: Array, velocity: Array | None = None, angular_velocity: Array | None = None
    ) -> "Obstacle":
        """All that is behind the plane through ``point`` (3,) [m]; the robot stays where ``normal`` (3,) points."""
        return Obstacle(
            "half_space", point, normal, velocity=_given(velocity), angular_velocity=_given(angular_velocity)
        )

    @property
    def end(self) -> Array:
        """Shape (3,) end of a capsule's centre line [m]; the reference point for spheres and boxes."""
        return self.position if self.kind == "half_space" else self.position + self.direction

    def at_rest(self) -> "Obstacle":
        """The same obstacle where it is, not moving."""
        return replace(self, velocity=np.zeros(3), angular_velocity=np.zeros(3))

    def enlarged(self, margin: float) -> "Obstacle":
        """The same obstacle with its surface ``margin`` [m] further out, 0 or above; edges of a box stay sharp."""
        if margin == 0.0:
            return self
        if self.kind == "half_space":
            return replace(self, position=self.position + margin * self.direction)
        if self.kind == "box":
            return replace(self, half_sizes=self.half_sizes + margin)
        return replace(self, radius=self.radius + margin)

    def clearance(self, point: Array) -> float:
        """Distance of a ``point`` (3,) from the obstacle [m], that of a ball round it for a box; below 0 inside."""
        offset = point - self.position
        if self.kind == "half_space":
            return float(offset @ self.direction)
        if self.kind == "capsule":
            squared = float(self.direction @ self.direction)
            along = float(offset @ self.direction) / squared if squared > 0.0 else 0.0
            offset = offset - min(max(along, 0.0), 1.0) * self.direction
        size = math.hypot(*self.half_sizes) if self.kind == "box" else self.radius
        return math.hypot(*offset) - size

    def after(self, duration: float) -> "Obstacle":
        """The obstacle ``duration`` [s] later, its velocity and angular velocity constant."""
        turn = pin.exp3(self.angular_velocity * duration)
        position = self.position + duration * self.velocity
        return replace(self, position=position, direction=turn @ self.direction, rotation=turn @ self.rotation)


def require_kinds(kinds: Sequence[str]) -> None:
    """Raise :class:`ConfigError` unless each is one of ``KINDS``."""
    for kind in kinds:
        require_one_of("obstacle kind", kind, KINDS)


def _given(vector: Array | None) -> Array:
    return ZERO if vector is None else vector


def _finite(name: str, value: Array, shape: tuple[int, ...]) -> Array:
    if np.shape(value) != shape or not all_finite(np.asarray(value, dtype=float)):
        raise ConfigError(f"obstacle {name}", value, f"finite numbers of shape {shape}")
    return np.array(value, dtype=float)
