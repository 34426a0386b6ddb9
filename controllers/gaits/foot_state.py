"""Where the feet stand and where the CoM is, as measured."""

import math
from typing import Protocol

import numpy as np

from controllers.gaits.footholds import LEFT, RIGHT, Foothold
from robots.description import RobotDescription
from robots.messages import Array
from wbc.wrench import GRAVITY


class BodyKinematics(Protocol):
    """What a gait reads of a body's kinematics at the measured state.

    :class:`robots.kinematics.Kinematics` is one; anything that estimates the same quantities can take its place.
    """

    robot: RobotDescription

    @property
    def com(self) -> Array:
        """Centre of mass in the world, shape (3,) [m]."""
        ...

    @property
    def com_velocity(self) -> Array:
        """Its velocity, shape (3,) [m/s]."""
        ...

    def frame_id(self, name: str) -> int:
        """Index of a frame."""
        ...

    def frame_placement(self, frame_id: int) -> tuple[Array, Array]:
        """Rotation (3, 3) and position (3,) [m] of a frame in the world."""
        ...


class Feet:
    r"""The soles where they last came down, and the divergent component of motion of every tick.

    Nothing of the kinematics is kept: they are read when they are handed in.

    Attributes:
        footholds: of left and right sole: where each was when it was last latched.
        centres: of left and right sole there, (3,) each, world [m]; not to be written to.
        com_height: of the CoM over the soles at the beginning [m].
        omega: :math:`\sqrt{g / z}` of a pendulum of that height [1/s].
        dcm: shape (2,) measured divergent component of motion [m].
    """

    def __init__(self, kin: BodyKinematics) -> None:
        """Both feet on the ground, at rest, at the state of ``kin``."""
        roles = kin.robot.roles
        self._ids = (kin.frame_id(roles["left_sole"]), kin.frame_id(roles["right_sole"]))
        self.latch(kin)
        self.com_height = float(kin.com[2]) - self.height
        self.omega = math.sqrt(GRAVITY / self.com_height)
        self.dcm = kin.com[:2].copy()

    def update(self, kin: BodyKinematics) -> None:
        """Take in the kinematics of a tick."""
        # plain floats: numpy's calls would cost more than the sums
        (x, y, _), (vx, vy, _) = kin.com.tolist(), kin.com_velocity.tolist()
        self.dcm = np.array([x + vx / self.omega, y + vy / self.omega])

    def latch(self, kin: BodyKinematics) -> None:
        """Take where both soles are now for their footholds."""
        left, right = (kin.frame_placement(i) for i in self._ids)
        self.footholds = _foothold(*left), _foothold(*right)
        self.centres = _read_only(left[1].copy()), _read_only(right[1].copy())

    @property
    def middle(self) -> Array:
        """Between the soles' centres, shape (2,) [m]."""
        return 0.5 * (self.footholds[LEFT].point + self.footholds[RIGHT].point)

    @property
    def width(self) -> float:
        """Sideways distance of the soles' centres [m]."""
        return abs(self.footholds[RIGHT].relative(self.footholds[LEFT])[1])

    @property
    def height(self) -> float:
        """Of the soles, on average [m]."""
        return 0.5 * (float(self.centres[LEFT][2]) + float(self.centres[RIGHT][2]))

    @property
    def yaws(self) -> tuple[float, float]:
        """Directions of left and right sole [rad]."""
        return self.footholds[LEFT].yaw, self.footholds[RIGHT].yaw


def _read_only(array: Array) -> Array:
    array.setflags(write=False)
    return array


def _foothold(rotation: Array, position: Array) -> Foothold:
    return Foothold(float(position[0]), float(position[1]), math.atan2(rotation[1, 0], rotation[0, 0]))
