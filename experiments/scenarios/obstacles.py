"""An obstacle in a run: how it really moves, what the sensor sees, what the controller believes."""

from dataclasses import dataclass

import numpy as np

from controllers.perception import Detection
from controllers.reference import WholeBodyReference
from robots.checks import require_between, require_non_negative, require_one_of, require_positive
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.messages import Array
from robots.pinocchio_model import standing_configuration
from safety.geometry.shapes import Obstacle
from sims.obstacles import PassingSphere, PositionSensor

RADIUS = 0.08
"""Radius of the passing sphere [m]."""

SPEED = 0.25
"""Its speed [m/s]."""

DISTANCE = 0.7
"""How far beside the hand that it comes to first it starts [m]."""

VELOCITIES = ("estimated", "zero", "true")
"""What the filter may be told of an obstacle's velocity."""

AHEAD = 0.06
"""How far in front of the hand's place it passes [m]: less than its radius, so the hand has to give way."""


@dataclass(frozen=True, slots=True)
class Passage:
    """How a sphere passes the hands.

    Attributes:
        radius: above 0 [m].
        speed: above 0 [m/s].
        height: of its centre above the hand's place [m].
        from_left: whether it comes from the robot's left, to its right; else the other way.
    """

    radius: float = RADIUS
    speed: float = SPEED
    height: float = 0.0
    from_left: bool = True

    def __post_init__(self) -> None:
        require_positive("passing sphere radius", self.radius)
        require_positive("passing sphere speed", self.speed)
        require_between("passing sphere height", self.height, -self.radius, self.radius)


OVERLAP = 0.04
"""How far a sphere beside the way reaches into where the left hand goes [m]."""

BESIDE = {"static": 0.0, "moving": 0.25}
"""Spheres beside the way, and how fast each comes towards the robot [m/s]."""


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
    """One sphere that passes the hands, seen through a noisy sensor.

    Attributes:
        sphere: its true motion.
        tracking: how it is to be tracked.
    """

    NAME = "obstacle 0"

    def __init__(self, sphere: PassingSphere, sensor: PositionSensor, seen: SensorSettings) -> None:
        self.sphere = sphere
        self._sensor = sensor
        self._looked_for = False
        # here, because the tracks' filter brings scipy.stats with it, which a run without obstacles need not wait for
        from controllers.obstacle_tracker import TrackingSettings
        from safety.tracking import TrackerSettings

        velocity = "measured" if seen.velocity == "true" else seen.velocity
        self.tracking = TrackingSettings(TrackerSettings(position_noise=max(seen.noise, 1e-4)), seen.kappa, velocity)

    def detections(self, t: float) -> list[Detection]:
        """What the sensor sees at ``t`` [s], its velocity without error."""
        place = self.sphere.position(t)
        measured = self._sensor.measure(place, t)
        # an obstacle that is there from the start is looked for from the start
        first, self._looked_for = not self._looked_for, True
        if measured is None and not first:
            return []
        shape = Obstacle.sphere(place if measured is None else measured, self.sphere.radius, self.sphere.velocity(t))
        return [Detection(self.NAME, t, shape, seen=measured is not None)]

    def true(self, t: float) -> list[Obstacle]:
        """What really is at ``t`` [s]."""
        return [Obstacle.sphere(self.sphere.position(t), self.sphere.radius, self.sphere.velocity(t))]


def passing_sphere(
    settings: SensorSettings,
    robot: RobotDescription,
    reference: WholeBodyReference,
    rng: np.random.Generator,
    passage: Passage | None = None,
) -> Encounter:
    """A sphere that crosses in front of the robot at about the height of its hands, through where they are."""
    assert reference.hands is not None
    passage = passage or Passage()
    side = 1.0 if passage.from_left else -1.0
    hand: Array = reference.hands[0 if passage.from_left else 1].position
    start = hand + np.array([AHEAD, side * DISTANCE, passage.height])
    sphere = PassingSphere(start, np.array([0.0, -side * passage.speed, 0.0]), passage.radius)
    sensor = PositionSensor(settings.rate, settings.noise, rng, settings.lost_at)
    return Encounter(sphere, sensor, settings)


@dataclass(frozen=True, slots=True)
class Beside:
    """Where a sphere meets the left hand of a robot that walks straight on.

    Attributes:
        kind: one of ``BESIDE``.
        ahead: how far the robot has walked when the two meet [m].
        sideways: how far it has swayed to the left then [m].
        time: when that is [s].
        posture: from which it starts.
    """

    kind: str
    ahead: float
    sideways: float
    time: float
    posture: str = "standing"

    def __post_init__(self) -> None:
        require_one_of("obstacle", self.kind, tuple(BESIDE))
        for name in ("ahead", "sideways", "time"):
            require_non_negative(f"obstacle {name}", getattr(self, name))


def sphere_beside(
    place: Beside,
    settings: SensorSettings,
    robot: RobotDescription,
    reference: WholeBodyReference,
    rng: np.random.Generator,
) -> Encounter:
    """A sphere to the left of the way, at the height of the left hand, ``OVERLAP`` into where the hand goes.

    Raises:
        ConfigError: no collision body is attached to the left hand.
    """
    hand = _hand_shape(robot, place.posture)
    centre, radius = hand[:3], float(hand[3])
    meeting = centre + np.array([place.ahead, place.sideways + radius + RADIUS - OVERLAP, 0.0])
    velocity = np.array([-BESIDE[place.kind], 0.0, 0.0])
    sphere = PassingSphere(meeting - place.time * velocity, velocity, RADIUS)
    return Encounter(sphere, PositionSensor(settings.rate, settings.noise, rng, settings.lost_at), settings)


def _hand_shape(robot: RobotDescription, posture: str) -> Array:
    """Outermost end of the left hand's collision body in a posture: centre and radius, shape (4,) [m]."""
    kin = Kinematics(robot)
    kin.update_geometry(standing_configuration(robot, posture))
    body = robot.frame(robot.roles["left_hand"]).body
    shapes = [c for c in robot.collisions if c.body == body]
    if not shapes:
        raise ConfigError("obstacle", robot.name, "given only where the left hand has a collision body")
    rotation, position = kin.frame_placement(kin.frame_id(body))
    ends = [np.append(position + rotation @ end, c.radius) for c in shapes for end in (c.start, c.end)]
    return max(ends, key=lambda end: float(end[1] + end[3]))
