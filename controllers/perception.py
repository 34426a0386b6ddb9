"""From measured positions of obstacles to what the safety filter is given."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robots.checks import require_non_negative, require_one_of, require_positive
from robots.messages import Array
from safety.geometry.shapes import Obstacle
from safety.tracking import ObstacleTrack, TrackerSettings


@dataclass(frozen=True, slots=True)
class Detection:
    """One obstacle as a sensor reports it at one instant.

    Attributes:
        name: tells obstacles apart from one detection to the next.
        stamp: when it was measured [s].
        shape: kind, size and orientation; its ``position`` is the measured place of its reference point, its velocity
            is not read: the track of that name estimates it.
        seen: whether it was found; where not, ``shape`` only says what was looked for.
    """

    name: str
    stamp: float
    shape: Obstacle
    seen: bool = True


VELOCITIES = ("estimated", "zero")
"""What velocity the obstacles are given: the tracks' estimate, or none, to see what the estimate is worth."""


class SphereTracker:
    """Tracks spheres of known radius; each gets a Kalman filter of its own.

    Args:
        radii: of the spheres, above 0 [m].
        settings: of the tracks.
        kappa: by how many standard deviations of its position each sphere is enlarged, 0 or above. The enlargement
            grows while a sphere is not seen; that growth is not part of the sphere's velocity.
        velocity: one of ``VELOCITIES``.

    Raises:
        ConfigError: a value is not allowed.
    """

    def __init__(
        self,
        radii: Sequence[float],
        settings: TrackerSettings | None = None,
        kappa: float = 0.0,
        velocity: str = "estimated",
    ) -> None:
        for i, radius in enumerate(radii):
            require_positive(f"radius of tracked sphere {i}", radius)
        require_non_negative("tracker kappa", kappa)
        require_one_of("tracker velocity", velocity, VELOCITIES)
        self._radii = tuple(radii)
        self._kappa = kappa
        self._moving = velocity == "estimated"
        self._told: float | None = None
        self.tracks = tuple(ObstacleTrack(settings) for _ in radii)

    def observe(self, index: int, position: Array | None, stamp: float) -> bool:
        """A measured position (3,) [m] of sphere ``index`` at ``stamp`` [s], or ``None`` where it was not seen.

        What it changes is fed in from what :meth:`obstacles` gave last on.

        Returns:
            Whether the track accepted a measurement; see :meth:`ObstacleTrack.measure`.
        """
        return self.tracks[index].measure(position, stamp, self._told)

    def fault(self, stamp: float) -> str | None:
        """Which track is too old for ``stamp`` [s], or ahead of it, in words; ``None`` where all can be used."""
        faults = (track.fault(stamp) for track in self.tracks)
        return next((f"track of obstacle {i} is {fault}" for i, fault in enumerate(faults) if fault), None)

    def obstacles(self, stamp: float) -> list[Obstacle]:
        """The spheres predicted to ``stamp`` [s].

        Raises:
            ConfigError: a track is too old, or ahead; :meth:`fault` tells beforehand.
        """
        out = []
        for radius, track in zip(self._radii, self.tracks, strict=True):
            position, velocity = track.estimate(stamp)
            # without kappa the covariance is not needed
            margin = self._kappa * track.position_sigma(stamp) if self._kappa else 0.0
            out.append(Obstacle.sphere(position, radius + margin, velocity if self._moving else np.zeros(3)))
        # not before: what a refused stamp asked for was not handed out
        self._told = stamp
        return out
