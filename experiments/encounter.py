"""An obstacle in a run: how it really moves, what the sensor sees, what the controller believes."""

from dataclasses import dataclass, replace

import numpy as np

from controllers.perception import SphereTracker
from controllers.reference import WholeBodyReference
from robots.checks import require_between, require_non_negative, require_one_of
from robots.description import RobotDescription
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

VELOCITIES = ("estimated", "zero", "true")
"""What the filter may be told of an obstacle's velocity."""

AHEAD = 0.06
"""How far in front of the hand's place it passes [m]: less than its radius, so the hand has to give way."""


@dataclass(frozen=True, slots=True)
class SensorSettings:
    """How an obstacle is seen.

    Attributes:
        rate: of the measurements [Hz].
        noise: standard deviation of each measured coordinate [m].
        lost_at: it is not seen any more from then on [s].
        velocity: what the filter is told of its velocity, one of ``VELOCITIES``.
        kappa: by how many standard deviations of its position it is taken as larger.
    """

    rate: float = 60.0
    noise: float = 0.005
    lost_at: float = float("inf")
    velocity: str = "estimated"
    kappa: float = 0.0

    def __post_init__(self) -> None:
        # slower than this, the track would be stale between two measurements
        require_between("obstacle_rate", self.rate, 10.0, 1000.0)
        require_between("obstacle_noise", self.noise, 0.0, 0.1)
        require_non_negative("obstacle_lost_at", 0.0 if self.lost_at == float("inf") else self.lost_at)
        require_one_of("obstacle_velocity", self.velocity, VELOCITIES)
        require_between("obstacle_kappa", self.kappa, 0.0, 100.0)


class Encounter:
    """One sphere that passes the hands, seen through a noisy sensor and a Kalman filter.

    Attributes:
        sphere: its true motion.
    """

    def __init__(self, sphere: PassingSphere, sensor: PositionSensor, seen: SensorSettings) -> None:
        self.sphere = sphere
        self._sensor = sensor
        self._true_velocity = seen.velocity == "true"
        settings = TrackerSettings(position_noise=max(seen.noise, 1e-4))
        told = "zero" if seen.velocity == "zero" else "estimated"
        self._tracker = SphereTracker([sphere.radius], settings, seen.kappa, told)

    def sense(self, t: float) -> str | None:
        """Take in what the sensor sees at ``t`` [s]; returns what is wrong with the track, if anything."""
        if (measured := self._sensor.measure(self.sphere.position(t), t)) is not None:
            self._tracker.observe(0, measured, t)
        return self._tracker.fault(t)

    def believed(self, t: float) -> list[Obstacle]:
        """What the controller is given at ``t`` [s]; the track must be fresh."""
        obstacles = self._tracker.obstacles(t)
        if self._true_velocity:
            return [replace(o, velocity=self.sphere.velocity(t)) for o in obstacles]
        return obstacles

    def true(self, t: float) -> list[Obstacle]:
        """What really is at ``t`` [s]."""
        return [Obstacle.sphere(self.sphere.position(t), self.sphere.radius, self.sphere.velocity(t))]


def passing_sphere(
    settings: SensorSettings, robot: RobotDescription, reference: WholeBodyReference, rng: np.random.Generator
) -> Encounter:
    """A sphere that crosses in front of the robot at the height of its hands, through where they are."""
    assert reference.hands is not None
    hand: Array = reference.hands[0].position
    start = hand + np.array([AHEAD, DISTANCE, 0.0])
    sphere = PassingSphere(start, np.array([0.0, -SPEED, 0.0]), RADIUS)
    sensor = PositionSensor(settings.rate, settings.noise, rng, settings.lost_at)
    return Encounter(sphere, sensor, settings)
