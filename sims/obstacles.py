"""Obstacles of the simulated world: how they really move, and the noisy sensor that sees them."""

import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from robots.checks import all_finite, require_between, require_non_negative, require_positive
from robots.errors import ConfigError
from robots.messages import Array

BROWNIAN_STEP = 0.005
"""Interval between the random velocities of a Brownian motion [s]."""

BROWNIAN_BLOCK = 512
"""Number of random velocities drawn at a time."""


class ObstacleMotion(Protocol):
    """How the centre of an obstacle moves, exactly, from time zero on."""

    def position(self, t: float) -> Array:
        """Centre (3,) at time ``t`` [s], world [m]."""
        ...

    def velocity(self, t: float) -> Array:
        """Its velocity (3,) at time ``t`` [s], world [m/s]."""
        ...


@dataclass(frozen=True, slots=True)
class StraightMotion:
    """Straight on.

    Attributes:
        start: shape (3,) centre at time zero, world [m].
        rate: shape (3,) its constant velocity [m/s].
    """

    start: Array
    rate: Array

    def __post_init__(self) -> None:
        _require_vectors("straight motion", start=self.start, rate=self.rate)

    def position(self, t: float) -> Array:
        """See :class:`ObstacleMotion`."""
        return self.start + t * self.rate

    def velocity(self, t: float) -> Array:
        """See :class:`ObstacleMotion`."""
        return np.array(self.rate, dtype=float)


@dataclass(frozen=True, slots=True)
class CircularMotion:
    """A circle at constant speed, counter-clockwise about ``normal``.

    Attributes:
        center: shape (3,) of the circle, world [m].
        radius: of the circle, above 0 [m].
        speed: above 0 [m/s].
        normal: shape (3,) of the circle's plane, of any length but zero.
    """

    center: Array
    radius: float
    speed: float
    normal: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))

    def __post_init__(self) -> None:
        _require_vectors("circular motion", center=self.center, normal=self.normal)
        require_positive("circular motion radius", self.radius)
        require_positive("circular motion speed", self.speed)
        if not np.linalg.norm(self.normal) > 0:
            raise ConfigError("circular motion normal", self.normal, "not zero")

    def _axes(self) -> tuple[Array, Array]:
        """Unit vectors (3,) in the plane: where the motion starts, and where it first goes."""
        n = self.normal / np.linalg.norm(self.normal)
        across = np.cross(n, np.eye(3)[int(np.argmin(np.abs(n)))])
        ahead = across / np.linalg.norm(across)
        return ahead, np.cross(n, ahead)

    def position(self, t: float) -> Array:
        """See :class:`ObstacleMotion`."""
        angle = self.speed / self.radius * t
        out, along = self._axes()
        return self.center + self.radius * (math.cos(angle) * out + math.sin(angle) * along)

    def velocity(self, t: float) -> Array:
        """See :class:`ObstacleMotion`."""
        angle = self.speed / self.radius * t
        out, along = self._axes()
        return self.speed * (-math.sin(angle) * out + math.cos(angle) * along)


@dataclass(frozen=True, slots=True)
class StopAndGo:
    r"""Goes, rests, comes back, rests, and so on; every start and stop is smooth.

    .. math:: v(s) = \pm \tfrac{1}{2} v_{peak} (1 - \cos(2 \pi s / T)),\quad 0 \le s \le T

    Attributes:
        start: shape (3,) centre at time zero, world [m].
        peak: shape (3,) velocity in the middle of going [m/s].
        going: duration T of going, above 0 [s].
        resting: duration of each rest, 0 or above [s].
    """

    start: Array
    peak: Array
    going: float
    resting: float

    def __post_init__(self) -> None:
        _require_vectors("stop and go", start=self.start, peak=self.peak)
        require_positive("stop and go going", self.going)
        require_non_negative("stop and go resting", self.resting)

    def _phase(self, t: float) -> tuple[bool, float]:
        """Whether it is on its way back, and for how long it has been going this time, at most ``going`` [s]."""
        leg, since = divmod(t, self.going + self.resting)
        return int(leg) % 2 == 1, min(since, self.going)

    def position(self, t: float) -> Array:
        """See :class:`ObstacleMotion`."""
        back, s = self._phase(t)
        travelled = 0.5 * (s - self.going / (2 * math.pi) * math.sin(2 * math.pi * s / self.going))
        return self.start + self.peak * (0.5 * self.going - travelled if back else travelled)

    def velocity(self, t: float) -> Array:
        """See :class:`ObstacleMotion`."""
        back, s = self._phase(t)
        return self.peak * (0.5 * (1 - math.cos(2 * math.pi * s / self.going)) * (-1 if back else 1))


@dataclass(frozen=True, slots=True)
class WaypointMotion:
    r"""From point to point, at rest and unaccelerated at each: :math:`10 s^3 - 15 s^4 + 6 s^5` of each way.

    Before the first time it is at the first point, after the last one at the last.

    Attributes:
        times: shape (n,) when it is at each point, increasing [s].
        points: shape (n, 3), n at least 1, world [m].
    """

    times: Array
    points: Array

    def __post_init__(self) -> None:
        if np.shape(self.points) != (len(self.times), 3) or not len(self.times):
            raise ConfigError("waypoints", self.points, "one point of three numbers for each time, at least one")
        if not (all_finite(self.times, self.points) and (np.diff(self.times) > 0).all()):
            raise ConfigError("waypoint times", self.times, "finite and increasing, their points finite")

    def _leg(self, t: float) -> tuple[int, float, float]:
        """Index of the way that ``t`` [s] is on, the part of it that has passed, and how long it takes [s]."""
        last = len(self.times) - 2
        i = min(max(int(np.searchsorted(self.times, t, side="right")) - 1, 0), last)
        duration = float(self.times[i + 1] - self.times[i])
        return i, min(max((t - float(self.times[i])) / duration, 0.0), 1.0), duration

    def position(self, t: float) -> Array:
        """See :class:`ObstacleMotion`."""
        if len(self.times) == 1:
            return np.array(self.points[0])
        i, s, _ = self._leg(t)
        way = self.points[i + 1] - self.points[i]
        return self.points[i] + s**3 * (10 - 15 * s + 6 * s**2) * way

    def velocity(self, t: float) -> Array:
        """See :class:`ObstacleMotion`."""
        if len(self.times) == 1:
            return np.zeros(3)
        i, s, duration = self._leg(t)
        return 30 * s**2 * (1 - s) ** 2 / duration * (self.points[i + 1] - self.points[i])


class BrownianMotion:
    r"""Wanders about in a box: an Ornstein-Uhlenbeck velocity, turned round at the walls.

    .. math:: dv = -v / \tau\, dt + \sigma \sqrt{2 / \tau}\, dW

    The velocity is drawn every ``BROWNIAN_STEP``, linear in between, and the position is its exact integral. The motion
    is a function of time and seed alone: in what order it is asked does not matter.

    Args:
        low: shape (3,) lower corner of the box, world [m].
        high: shape (3,) upper corner, above ``low`` [m].
        speed: standard deviation sigma of each coordinate of the velocity, above 0 [m/s].
        memory: correlation time tau of the velocity, above 0 [s].
        seed: of the random numbers.

    Raises:
        ConfigError: a value is not allowed.
    """

    def __init__(self, low: Array, high: Array, speed: float, memory: float, seed: int) -> None:
        _require_vectors("Brownian motion", low=low, high=high)
        if not (np.asarray(high) > np.asarray(low)).all():
            raise ConfigError("Brownian motion high", high, f"above low = {low!r} in every coordinate")
        require_positive("Brownian motion speed", speed)
        require_positive("Brownian motion memory", memory)
        self._low = np.array(low, dtype=float)
        self._size = np.array(high, dtype=float) - self._low
        self._speed = speed
        self._decay = math.exp(-BROWNIAN_STEP / memory)
        self._rng = np.random.default_rng(seed)
        self._velocity = self._rng.normal(scale=speed, size=(1, 3))
        self._place = self._rng.uniform(size=(1, 3)) * self._size

    def _extend(self) -> None:
        """Draw one more block of velocities, and integrate them."""
        kick = self._speed * math.sqrt(1 - self._decay**2) * self._rng.standard_normal((BROWNIAN_BLOCK, 3))
        velocity = np.vstack([self._velocity[-1:], kick])
        for k in range(1, len(velocity)):
            velocity[k] += self._decay * velocity[k - 1]
        moved = 0.5 * BROWNIAN_STEP * np.cumsum(velocity[:-1] + velocity[1:], axis=0)
        self._velocity = np.vstack([self._velocity, velocity[1:]])
        self._place = np.vstack([self._place, self._place[-1] + moved])

    def _free(self, t: float) -> tuple[Array, Array]:
        """Place from the lower corner, and velocity, as if there were no walls."""
        if not 0 <= t < math.inf:
            raise ConfigError("time of a Brownian motion", t, "finite, 0 or above")
        k = int(t / BROWNIAN_STEP)
        while k + 1 >= len(self._velocity):
            self._extend()
        s = t - k * BROWNIAN_STEP
        slope = (self._velocity[k + 1] - self._velocity[k]) / BROWNIAN_STEP
        return self._place[k] + s * (self._velocity[k] + 0.5 * s * slope), self._velocity[k] + s * slope

    def position(self, t: float) -> Array:
        """See :class:`ObstacleMotion`."""
        folded = np.mod(self._free(t)[0], 2 * self._size)
        return self._low + np.minimum(folded, 2 * self._size - folded)

    def velocity(self, t: float) -> Array:
        """See :class:`ObstacleMotion`; its sign jumps where the obstacle bounces off a wall."""
        place, velocity = self._free(t)
        return np.where(np.mod(place, 2 * self._size) < self._size, velocity, -velocity)


class PositionSensor:
    """Sees a position at a fixed rate with white noise, now and then not at all or somewhere else.

    Args:
        rate: of measurements, above 0 [Hz].
        noise: standard deviation of each coordinate, 0 or above [m].
        rng: source of the noise.
        lost_at: time from which it sees nothing more [s].
        dropout: probability that a measurement is missing, 0 to 1.
        outlier: probability that a measurement is an outlier, 0 to 1.
        outlier_size: distance of an outlier from where it should be, in a random direction, 0 or above [m].

    Raises:
        ConfigError: a value is not allowed.
    """

    def __init__(
        self,
        rate: float,
        noise: float,
        rng: np.random.Generator,
        lost_at: float = math.inf,
        dropout: float = 0.0,
        outlier: float = 0.0,
        outlier_size: float = 0.5,
    ) -> None:
        require_positive("sensor rate", rate)
        require_non_negative("sensor noise", noise)
        require_between("sensor dropout", dropout, 0.0, 1.0)
        require_between("sensor outlier", outlier, 0.0, 1.0)
        require_non_negative("sensor outlier_size", outlier_size)
        self._period = 1.0 / rate
        self._noise = noise
        self._rng = rng
        # apart from the noise, so that faults do not change the noise of what is still seen
        self._faults = rng.spawn(1)[0]
        self._next = 0.0
        self._lost_at = lost_at
        self._dropout = dropout
        self._outlier = outlier
        self._outlier_size = outlier_size

    def measure(self, position: Array, t: float) -> Array | None:
        """The measured position (3,) if one is due at ``t`` [s] and not missing, else ``None``."""
        if t < self._next - 1e-9 or t >= self._lost_at:
            return None
        self._next += self._period
        measured = position + self._noise * self._rng.standard_normal(3)
        missing, elsewhere = self._faults.uniform(size=2) < (self._dropout, self._outlier)
        direction = self._faults.standard_normal(3)
        if elsewhere:
            measured += self._outlier_size * direction / np.linalg.norm(direction)
        return None if missing else measured


def _require_vectors(owner: str, **vectors: Array) -> None:
    for name, value in vectors.items():
        if np.shape(value) != (3,) or not all_finite(np.asarray(value, dtype=float)):
            raise ConfigError(f"{owner} {name}", value, "three finite numbers")
