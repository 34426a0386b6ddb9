"""From measured positions of obstacles to what the safety filter is given."""

from collections.abc import Sequence

from robots.messages import Array
from safety.obstacles import Obstacle
from safety.tracking import ObstacleTrack, TrackerSettings


class SphereTracker:
    """Tracks spheres of known radius; each gets a Kalman filter of its own.

    Args:
        radii: of the spheres, above 0 [m].
        settings: of the tracks.
    """

    def __init__(self, radii: Sequence[float], settings: TrackerSettings | None = None) -> None:
        self._radii = tuple(radii)
        self._tracks = [ObstacleTrack(settings) for _ in radii]

    def observe(self, index: int, position: Array, stamp: float) -> None:
        """A measured position (3,) [m] of sphere ``index`` at ``stamp`` [s]; see :meth:`ObstacleTrack.measure`."""
        self._tracks[index].measure(position, stamp)

    def fault(self, stamp: float) -> str | None:
        """Which track is too old to be used at ``stamp`` [s], in words; ``None`` where all are fresh."""
        for i, track in enumerate(self._tracks):
            if not track.age(stamp) <= track.settings.max_age:
                return (
                    f"track of obstacle {i} is {track.age(stamp):.3g} s old, allowed are {track.settings.max_age:g} s"
                )
        return None

    def obstacles(self, stamp: float) -> list[Obstacle]:
        """The spheres predicted to ``stamp`` [s], with their estimated velocities.

        Raises:
            ConfigError: a track is too old; :meth:`fault` tells beforehand.
        """
        out = []
        for radius, track in zip(self._radii, self._tracks, strict=True):
            position, velocity = track.estimate(stamp)
            out.append(Obstacle.sphere(position, radius, velocity))
        return out
