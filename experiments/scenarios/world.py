"""What surrounds a robot in a scenario, as data: bodies, how they move, how they are seen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from robots.checks import require_between, require_finite, require_non_negative, require_one_of, require_positive
from robots.errors import ConfigError

if TYPE_CHECKING:
    from robots.messages import Array
    from safety.geometry.shapes import Obstacle
    from sims.obstacles import ObstacleMotion

Vector = tuple[float, float, float]

VELOCITIES = ("estimated", "zero", "true")
"""What the filter may be told of an obstacle's velocity."""


def _require_vector(name: str, value: Vector) -> None:
    if len(value) != 3:
        raise ConfigError(name, value, "three numbers: x, y and z")
    for x in value:
        require_finite(name, x)


@dataclass(frozen=True, slots=True)
class Sphere:
    """A sphere of ``radius`` [m] about the moving point."""

    kind: ClassVar[str] = "sphere"
    radius: float

    def __post_init__(self) -> None:
        require_positive("sphere radius", self.radius)

    def at(self, position: Array, velocity: Array) -> Obstacle:
        """The body with its reference point (3,) there [m], moving [m/s]."""
        from safety.geometry.shapes import Obstacle

        return Obstacle.sphere(position, self.radius, velocity)


@dataclass(frozen=True, slots=True)
class Capsule:
    """A capsule whose centre line begins at the moving point and goes along ``axis``, world axes [m]."""

    kind: ClassVar[str] = "capsule"
    radius: float
    axis: Vector

    def __post_init__(self) -> None:
        require_positive("capsule radius", self.radius)
        _require_vector("capsule axis", self.axis)
        if not any(self.axis):
            raise ConfigError("capsule axis", self.axis, "of some length; without any it is a sphere")

    def at(self, position: Array, velocity: Array) -> Obstacle:
        """As :meth:`Sphere.at`."""
        import numpy as np

        from safety.geometry.shapes import Obstacle

        return Obstacle.capsule(position, position + np.array(self.axis), self.radius, velocity)


@dataclass(frozen=True, slots=True)
class Box:
    """A box about the moving point: half its sizes [m], and roll, pitch and yaw of its axes [rad]."""

    kind: ClassVar[str] = "box"
    half_sizes: Vector
    rpy: Vector = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        _require_vector("box half sizes", self.half_sizes)
        for size in self.half_sizes:
            require_positive("box half size", size)
        _require_vector("box rpy", self.rpy)

    def at(self, position: Array, velocity: Array) -> Obstacle:
        """As :meth:`Sphere.at`."""
        import numpy as np
        import pinocchio

        from safety.geometry.shapes import Obstacle

        rotation = pinocchio.rpy.rpyToMatrix(*self.rpy)
        return Obstacle.box(position, rotation, np.array(self.half_sizes), velocity)


@dataclass(frozen=True, slots=True)
class HalfSpace:
    """All that is behind the plane through the moving point; ``normal`` points to the side that is free."""

    kind: ClassVar[str] = "half_space"
    normal: Vector

    def __post_init__(self) -> None:
        _require_vector("half space normal", self.normal)
        if not any(self.normal):
            raise ConfigError("half space normal", self.normal, "of some length")

    def at(self, position: Array, velocity: Array) -> Obstacle:
        """As :meth:`Sphere.at`."""
        import numpy as np

        from safety.geometry.shapes import Obstacle

        return Obstacle.half_space(position, np.array(self.normal), velocity)


Shape = Sphere | Capsule | Box | HalfSpace


@dataclass(frozen=True, slots=True)
class Straight:
    """From ``start`` [m] at time zero on at a constant ``velocity`` [m/s]; at rest if none is given."""

    kind: ClassVar[str] = "straight"
    start: Vector
    velocity: Vector = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        _require_vector("straight motion start", self.start)
        _require_vector("straight motion velocity", self.velocity)

    def motion(self) -> ObstacleMotion:
        """The motion that the simulator asks for place and velocity."""
        import numpy as np

        from sims.obstacles import StraightMotion

        return StraightMotion(np.array(self.start), np.array(self.velocity))


@dataclass(frozen=True, slots=True)
class Circle:
    """A circle of ``radius`` [m] at ``speed`` [m/s] about ``center`` [m], counter-clockwise about ``normal``."""

    kind: ClassVar[str] = "circle"
    center: Vector
    radius: float
    speed: float
    normal: Vector = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        self.motion()

    def motion(self) -> ObstacleMotion:
        """As :meth:`Straight.motion`."""
        import numpy as np

        from sims.obstacles import CircularMotion

        return CircularMotion(np.array(self.center), self.radius, self.speed, np.array(self.normal))


@dataclass(frozen=True, slots=True)
class BackAndForth:
    """Smoothly from ``start`` [m] by half of ``peak`` [m/s] times ``going`` [s], a rest of ``resting`` [s], back."""

    kind: ClassVar[str] = "back-and-forth"
    start: Vector
    peak: Vector
    going: float
    resting: float = 0.0

    def __post_init__(self) -> None:
        self.motion()

    def motion(self) -> ObstacleMotion:
        """As :meth:`Straight.motion`."""
        import numpy as np

        from sims.obstacles import StopAndGo

        return StopAndGo(np.array(self.start), np.array(self.peak), self.going, self.resting)


@dataclass(frozen=True, slots=True)
class Wandering:
    """About at random between the corners ``low`` and ``high`` [m]: see :class:`sims.obstacles.BrownianMotion`."""

    kind: ClassVar[str] = "wandering"
    low: Vector
    high: Vector
    speed: float
    memory: float
    seed: int = 0

    def __post_init__(self) -> None:
        self.motion()

    def motion(self) -> ObstacleMotion:
        """As :meth:`Straight.motion`."""
        import numpy as np

        from sims.obstacles import BrownianMotion

        return BrownianMotion(np.array(self.low), np.array(self.high), self.speed, self.memory, self.seed)


@dataclass(frozen=True, slots=True)
class Waypoints:
    """Through ``points`` [m] at ``times`` [s], at rest at each of them, before the first and after the last."""

    kind: ClassVar[str] = "waypoints"
    times: tuple[float, ...]
    points: tuple[Vector, ...]

    def __post_init__(self) -> None:
        for point in self.points:
            _require_vector("waypoint", point)
        self.motion()

    def motion(self) -> ObstacleMotion:
        """As :meth:`Straight.motion`."""
        import numpy as np

        from sims.obstacles import WaypointMotion

        return WaypointMotion(np.array(self.times), np.reshape(self.points, (-1, 3)))


Motion = Straight | Circle | BackAndForth | Wandering | Waypoints


@dataclass(frozen=True, slots=True)
class Sensor:
    """How a body is seen, by its reference point.

    Attributes:
        rate: of the measurements [Hz].
        noise: standard deviation of each measured coordinate [m].
        lost_at: when its sensor loses it for good [s]; ``None`` for never.
        velocity: what the filter is told of its velocity, one of ``VELOCITIES``.
        kappa: by how many standard deviations of its position it is taken as larger.
    """

    rate: float = 60.0
    noise: float = 0.005
    lost_at: float | None = None
    velocity: str = "estimated"
    kappa: float = 0.0

    def __post_init__(self) -> None:
        # slower than this, the track would be stale between two measurements
        require_between("obstacle_rate", self.rate, 10.0, 1000.0)
        require_between("obstacle_noise", self.noise, 0.0, 0.1)
        if self.lost_at is not None:
            require_non_negative("obstacle_lost_at", self.lost_at)
        require_one_of("obstacle_velocity", self.velocity, VELOCITIES)
        require_between("obstacle_kappa", self.kappa, 0.0, 100.0)


@dataclass(frozen=True, slots=True)
class WorldObject:
    """One body of the world.

    Attributes:
        name: tells it apart from the others.
        shape: what it is.
        motion: how its reference point moves.
        sensor: how the controller sees it; ``None``: it is known exactly.
        physical: whether the robot can touch it; otherwise the distance to it is only measured.
    """

    name: str
    shape: Shape
    motion: Motion
    sensor: Sensor | None = None
    physical: bool = False


def require_unique_names(objects: tuple[WorldObject, ...]) -> None:
    """Raise :class:`ConfigError` unless every body has a name of its own."""
    names = [o.name for o in objects]
    if len(set(names)) != len(names):
        raise ConfigError("names of the world's bodies", names, "all different")
