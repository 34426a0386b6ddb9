"""Spheres that come near the hands of a robot: across their place while it stands, and beside its way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from experiments.scenarios.world import Sensor, Sphere, Straight, Vector, WorldObject
from robots.checks import require_between, require_non_negative, require_one_of, require_positive
from robots.errors import ConfigError

if TYPE_CHECKING:
    from robots.description import RobotDescription
    from robots.messages import Array

RADIUS = 0.08
"""Radius of the passing sphere [m]."""

SPEED = 0.25
"""Its speed [m/s]."""

DISTANCE = 0.7
"""How far beside the hand that it comes to first it starts [m]."""

AHEAD = 0.06
"""How far in front of the hand's place it passes [m]: less than its radius, so the hand has to give way."""

NAME = "obstacle 0"
"""Of either sphere, as a stop tells it."""

OVERLAP = 0.04
"""How far a sphere beside the way reaches into where the left hand goes [m]."""

BESIDE = {"static": 0.0, "moving": 0.25}
"""Spheres beside the way, and how fast each comes towards the robot [m/s]."""


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


def passing_sphere(robot: RobotDescription, passage: Passage, sensor: Sensor) -> WorldObject:
    """A sphere that crosses in front of the robot at about the height of its hands, through where they are."""
    import numpy as np

    from controllers.reference import reference_here
    from experiments.scenarios.hand_motions import start_posture
    from robots.kinematics import Kinematics
    from robots.pinocchio_model import standing_configuration

    kin = Kinematics(robot)
    kin.update(standing_configuration(robot, start_posture(robot)), np.zeros(kin.nv))
    hands = reference_here(kin, with_hands=True).hands
    assert hands is not None
    side = 1.0 if passage.from_left else -1.0
    start = hands[0 if passage.from_left else 1].position + np.array([AHEAD, side * DISTANCE, passage.height])
    motion = Straight(_vector(start), (0.0, -side * passage.speed, 0.0))
    return WorldObject(NAME, Sphere(passage.radius), motion, sensor)


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


def sphere_beside(robot: RobotDescription, place: Beside, sensor: Sensor) -> WorldObject:
    """A sphere to the left of the way, at the height of the left hand, ``OVERLAP`` into where the hand goes.

    Raises:
        ConfigError: no collision body is attached to the left hand.
    """
    import numpy as np

    hand = _hand_shape(robot, place.posture)
    centre, radius = hand[:3], float(hand[3])
    meeting = centre + np.array([place.ahead, place.sideways + radius + RADIUS - OVERLAP, 0.0])
    velocity = np.array([-BESIDE[place.kind], 0.0, 0.0])
    motion = Straight(_vector(meeting - place.time * velocity), _vector(velocity))
    return WorldObject(NAME, Sphere(RADIUS), motion, sensor)


def _vector(values: Array) -> Vector:
    x, y, z = (float(value) for value in values)
    return x, y, z


def _hand_shape(robot: RobotDescription, posture: str) -> Array:
    """Outermost end of the left hand's collision body in a posture: centre and radius, shape (4,) [m]."""
    import numpy as np

    from robots.kinematics import Kinematics
    from robots.pinocchio_model import standing_configuration

    kin = Kinematics(robot)
    kin.update_geometry(standing_configuration(robot, posture))
    body = robot.frame(robot.roles["left_hand"]).body
    shapes = [c for c in robot.collisions if c.body == body]
    if not shapes:
        raise ConfigError("obstacle", robot.name, "given only where the left hand has a collision body")
    rotation, position = kin.frame_placement(kin.frame_id(body))
    ends = [np.append(position + rotation @ end, c.radius) for c in shapes for end in (c.start, c.end)]
    return max(ends, key=lambda end: float(end[1] + end[3]))
