"""Where the feet stand and where the CoM is, as measured."""

import math

import numpy as np

from controllers.gaits.footsteps import LEFT, RIGHT, Foothold
from robots.description import RobotDescription
from robots.kinematics import Kinematics
from robots.messages import Array, RobotState
from wbc.wrench import GRAVITY


class Feet:
    r"""The soles where they last came down, and the divergent component of motion of every tick.

    Attributes:
        kin: kinematics at the state of the last :meth:`update`: placements and CoM only.
        holds: foothold of left and right sole: where each was when it was last kept.
        heights: of both soles there [m].
        com_height: of the CoM over the soles at the beginning [m].
        omega: :math:`\sqrt{g / z}` of a pendulum of that height [1/s].
        dcm: shape (2,) measured divergent component of motion [m].
    """

    def __init__(self, robot: RobotDescription, state: RobotState) -> None:
        """Both feet on the ground in ``state``."""
        self.kin = kin = Kinematics(robot)
        self._ids = [kin.frame_id(robot.roles[r]) for r in ("left_sole", "right_sole")]
        kin.update_center_of_mass(state.q, state.v)
        self.holds = [self._foothold(LEFT), self._foothold(RIGHT)]
        self.heights = [self._height(LEFT), self._height(RIGHT)]
        self.com_height = float(kin.com[2]) - 0.5 * sum(self.heights)
        self.omega = math.sqrt(GRAVITY / self.com_height)
        self.dcm = kin.com[:2].copy()

    def update(self, state: RobotState) -> None:
        """Take in a measured state."""
        self.kin.update_center_of_mass(state.q, state.v)
        self.dcm = self.kin.com[:2] + self.kin.com_velocity[:2] / self.omega

    def keep(self) -> None:
        """Keep where both soles are now."""
        self.holds = [self._foothold(LEFT), self._foothold(RIGHT)]
        self.heights = [self._height(LEFT), self._height(RIGHT)]

    def _sole(self, foot: int) -> tuple[Array, Array]:
        return self.kin.frame_placement(self._ids[foot])

    def _foothold(self, foot: int) -> Foothold:
        rotation, position = self._sole(foot)
        return Foothold(float(position[0]), float(position[1]), math.atan2(rotation[1, 0], rotation[0, 0]))

    def _height(self, foot: int) -> float:
        return float(self._sole(foot)[1][2])

    @property
    def places(self) -> list[Array]:
        """Centres of left and right sole where they were last kept, (3,) each, world [m]."""
        return [np.array([hold.x, hold.y, z]) for hold, z in zip(self.holds, self.heights, strict=True)]

    @property
    def middle(self) -> Array:
        """Between the soles' centres, shape (2,) [m]."""
        return 0.5 * (self.holds[LEFT].point + self.holds[RIGHT].point)

    @property
    def width(self) -> float:
        """Sideways distance of the soles' centres [m]."""
        return abs(self.holds[RIGHT].relative(self.holds[LEFT])[1])

    @property
    def centres(self) -> Array:
        """Soles' centres, shape (2, 2) [m]."""
        return np.array([hold.point for hold in self.holds])

    @property
    def yaws(self) -> Array:
        """Soles' directions, shape (2,) [rad]."""
        return np.array([hold.yaw for hold in self.holds])
