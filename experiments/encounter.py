"""An obstacle in a run: how it really moves, what the sensor sees, what the controller believes."""

from dataclasses import dataclass

import numpy as np

from controllers.perception import SphereTracker
from controllers.reference import WholeBodyReference
from robots.messages import Array
from safety.obstacles import Obstacle
from safety.tracking import TrackerSettings
from sims.obstacles import PassingSphere, PositionSensor

RADIUS = 0.08
"""Radius of the passing sphere [m]."""

SPEED = 0.25
"""Its speed, from the robot's left to its right [m/s]."""

DISTANCE = 0.7
"""How far to the left of the left hand it starts [m]."""

AHEAD = 0.06
"""How far in front of the hand's place it passes [m]: less than its radius, so the hand has to give way."""


@dataclass(frozen=True, slots=True)
class SensorSettings:
    """Sensor of obstacle positions: ``rate`` [Hz], ``noise`` [m], blind from ``lost_at`` [s] on."""

    rate: float = 60.0
    noise: float = 0.005
    lost_at: float = float("inf")


class Encounter:
    """One sphere that passes the hands, seen through a noisy sensor and a Kalman filter.

    Attributes:
        sphere: its true motion.
    """

    def __init__(self, sphere: PassingSphere, sensor: PositionSensor, settings: TrackerSettings) -> None:
        self.sphere = sphere
        self._sensor = sensor
        self._tracker = SphereTracker([sphere.radius], settings)

    def sense(self, t: float) -> str | None:
        """Take in what the sensor sees at ``t`` [s]; returns what is wrong with the track, if anything."""
        if (measured := self._sensor.measure(self.sphere.position(t), t)) is not None:
            self._tracker.observe(0, measured, t)
        return self._tracker.fault(t)

    def believed(self, t: float) -> list[Obstacle]:
        """What the controller is given at ``t`` [s]; the track must be fresh."""
        return self._tracker.obstacles(t)

    def true(self, t: float) -> list[Obstacle]:
        """What really is at ``t`` [s]."""
        return [Obstacle.sphere(self.sphere.position(t), self.sphere.radius, self.sphere.velocity)]


def passing_sphere(reference: WholeBodyReference, settings: SensorSettings, rng: np.random.Generator) -> Encounter:
    """A sphere that crosses in front of the robot at the height of its hands, through where they are."""
    assert reference.hands is not None
    hand: Array = reference.hands[0].position
    start = hand + np.array([AHEAD, DISTANCE, 0.0])
    sphere = PassingSphere(start, np.array([0.0, -SPEED, 0.0]), RADIUS)
    sensor = PositionSensor(settings.rate, settings.noise, rng, settings.lost_at)
    return Encounter(sphere, sensor, TrackerSettings(position_noise=max(settings.noise, 1e-4)))
