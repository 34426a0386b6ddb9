"""Kalman filters of the obstacles that are detected, by name."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from controllers.perception import Detection
from robots.checks import require_non_negative, require_one_of
from safety.geometry.shapes import Obstacle
from safety.tracking import ObstacleTrack, TrackerSettings

VELOCITIES = ("estimated", "zero", "measured")
"""What velocity the obstacles are given: the tracks' estimate; none, to see what the estimate is worth; or that of the
detection, where a sensor measures it."""


@dataclass(frozen=True, slots=True)
class TrackingSettings:
    """How detections become obstacles.

    Attributes:
        track: of each obstacle's Kalman filter.
        kappa: by how many standard deviations of its position each obstacle is enlarged, 0 or above. The enlargement
            grows while an obstacle is not seen; that growth is not part of its velocity.
        velocity: one of ``VELOCITIES``.

    Raises:
        ConfigError: a value is not allowed.
    """

    track: TrackerSettings = field(default_factory=TrackerSettings)
    kappa: float = 0.0
    velocity: str = "estimated"

    def __post_init__(self) -> None:
        require_non_negative("tracker kappa", self.kappa)
        require_one_of("tracker velocity", self.velocity, VELOCITIES)


class ObstacleTracker:
    """Tracks obstacles by name; each gets a Kalman filter of its own with its first detection.

    Orientation and size are those of the last detection that its track accepted.

    Attributes:
        tracks: by name, in the order in which the obstacles were first detected.
    """

    def __init__(self, settings: TrackingSettings | Mapping[str, TrackingSettings] | None = None) -> None:
        """``settings``: of all obstacles, or of each by its name; the usual ones where none are given."""
        usual, own = (settings, {}) if isinstance(settings, TrackingSettings) else (None, settings or {})
        self._usual, self._own = usual or TrackingSettings(), dict(own)
        self.tracks: dict[str, ObstacleTrack] = {}
        self._shapes: dict[str, Obstacle] = {}
        self._asked: float | None = None

    def observe(self, detection: Detection) -> bool:
        """Take in a detection. What it changes is fed in from what :meth:`obstacles` gave last on.

        Returns:
            Whether the track accepted a measurement; see :meth:`ObstacleTrack.measure`.

        Raises:
            ConfigError: the stamp is not finite or of the past; everything is as it was.
        """
        name = detection.name
        track = self.tracks.get(name) or ObstacleTrack(self._settings(name).track)
        position = detection.shape.position if detection.seen else None
        accepted = track.measure(position, detection.stamp, self._asked)
        self.tracks[name] = track
        if accepted or name not in self._shapes:
            self._shapes[name] = detection.shape
        return accepted

    def _settings(self, name: str) -> TrackingSettings:
        return self._own.get(name, self._usual)

    def forget(self, name: str) -> None:
        """The obstacle of this name is gone; nothing happens where there is none."""
        self.tracks.pop(name, None)
        self._shapes.pop(name, None)

    def kind(self, name: str) -> str:
        """What kind of obstacle a track is of."""
        return self._shapes[name].kind

    def faults(self, stamp: float) -> dict[str, str]:
        """Which tracks are too old for ``stamp`` [s], or ahead of it: why, in words, by name."""
        found = ((name, track.fault(stamp)) for name, track in self.tracks.items())
        return {name: f"track of {name} is {fault}" for name, fault in found if fault}

    def obstacles(self, stamp: float, without: Collection[str] = ()) -> dict[str, Obstacle]:
        """The obstacles predicted to ``stamp`` [s], by name, but those ``without``.

        Raises:
            ConfigError: a track is too old, or ahead; :meth:`faults` tells beforehand.
        """
        out = {}
        for name, track in self.tracks.items():
            if name in without:
                continue
            kappa, velocities = self._settings(name).kappa, self._settings(name).velocity
            position, velocity = track.estimate(stamp)
            # without kappa the covariance is not needed
            margin = kappa * track.position_sigma(stamp) if kappa else 0.0
            shape = self._shapes[name]
            if velocities == "zero":
                velocity = np.zeros(3)
            elif velocities == "measured":
                velocity = shape.velocity
            out[name] = replace(shape, position=position, velocity=velocity).enlarged(margin)
        # not before: what a refused stamp asked for was not handed out
        self._asked = stamp
        return out
