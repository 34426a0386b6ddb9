"""The corridor: two boards close about the left hand, then a sphere comes to the left elbow."""

from dataclasses import dataclass, field

import numpy as np

from robots.collision_models import with_collision_model
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array
from robots.pinocchio_model import upper_body_joints
from safety.filters.conditions import SET_MARGINS
from safety.geometry.shapes import Obstacle

COLLISION_MODEL = "g1_spheres"
"""Bodies of the robot: the spheres of the p-SSA paper."""

HAND_BODIES = ("left_hand", "right_hand")
HAND_OFFSETS = dict.fromkeys(HAND_BODIES, np.array([0.05, 0.0, 0.0]))
"""What is brought to the goals: the centres of the hands' spheres, in the axes of the bodies that carry them [m]."""
OBSTACLES = ("lower board", "upper board", "sphere")

HAND_RADIUS = 0.05
"""Radius of the hands' spheres [m]."""

D_MIN = {family: SET_MARGINS[family] for family in ("obstacle", "self_collision")}
"""Distances to keep [m]; section V-B of the p-SSA paper."""

WIDE_GAP = 0.30
"""Distance of the boards while they are apart [m]."""
CLEARANCE = 0.005
"""The least that has to be left on either side of the hand [m]."""

GOALS = np.array([[0.32, 0.18, 0.90], [0.188, -0.208, 0.77]])
"""Goals of the left and the right hand, world [m]."""
LIFT = 0.06
"""How far the left goal is moved towards the upper board, and into it where the gap is narrow [m]."""

BOARD_LOW, BOARD_HIGH = np.array([0.18, -0.07]), np.array([0.42, 0.33])
"""Corners (x, y) of both boards [m]."""
BOARD_THICKNESS = 0.02

SPHERE_RADIUS = 0.05
ELBOW = np.array([0.091, 0.205, 0.8575])
"""Where the left elbow is when the hand has reached its goal undisturbed, world [m]."""
SPHERE_NEAREST, SPHERE_AWAY = (ELBOW + np.array([0.0, y, 0.0]) for y in (0.09, 0.34))
"""Centre of the sphere at the elbow, where 1 cm of each would overlap, and far from it, world [m]."""

CLOSING, OPENING = (2.0, 3.5), (10.0, 11.0)
LIFTING, LOWERING = (4.0, 4.5), (9.0, 9.5)
COMING, LEAVING = (5.0, 6.5), (8.0, 9.5)
"""From when to when [s]."""

INSTANTS = (4.75, 7.25, 11.5)
"""Before the sphere comes, while it is at the elbow, after it has left: as the frames of the paper's figure 4 [s]."""

SPREAD = 0.005
"""With a seed: standard deviation by which goals and sphere are moved, each coordinate [m]."""


@dataclass(frozen=True, slots=True)
class Corridor:
    """The scene as a function of time.

    The boards stay ``gap`` apart where the hand, with the distance to keep on either side, needs
    2 (radius + d_min) = 0.2 m: below that, both boards are nearer than allowed and each asks the hand to go to the
    other one. Still nothing has to be hit: the hand has room in the middle, and the elbow has room beside the torso.

    Attributes:
        gap: distance of the boards' faces while they are close [m].
        seed: moves goals and sphere a little; ``None``: where they are designed to be.
        goals: shape (2, 3), of the hands, before the lift [m].
        sphere_nearest: shape (3,) centre of the sphere at the elbow [m].

    Raises:
        ConfigError: the hand does not fit into the gap, or the gap is wider than the boards are apart at first.
    """

    gap: float = 0.14
    seed: int | None = None
    goals: Array = field(init=False)
    sphere_nearest: Array = field(init=False)

    def __post_init__(self) -> None:
        least = 2 * (HAND_RADIUS + CLEARANCE)
        if not least <= self.gap <= WIDE_GAP:
            allowed = f"from {least:g} m, where the hand just fits between the boards, to {WIDE_GAP:g} m"
            raise ConfigError("gap", self.gap, allowed)
        moved = np.zeros((3, 3))
        if self.seed is not None:
            moved = np.random.default_rng(self.seed).normal(scale=SPREAD, size=(3, 3))
        object.__setattr__(self, "goals", GOALS + moved[:2])
        object.__setattr__(self, "sphere_nearest", SPHERE_NEAREST + moved[2])

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of the obstacles, in the order of ``OBSTACLES``."""
        return ("box", "box", "sphere")

    def hand_goals(self, t: float) -> Array:
        """Goals (2, 3) of the left and the right hand at ``t`` [s], world [m]."""
        goals = self.goals.copy()
        goals[0, 2] += LIFT * (ramp(t, *LIFTING)[0] - ramp(t, *LOWERING)[0])
        return goals

    def half_gap(self, t: float) -> tuple[float, float]:
        """Distance of each board's face from the middle at ``t`` [s], and its rate [m, m/s]."""
        fraction, rate = _pulse(t, CLOSING, OPENING)
        return 0.5 * (WIDE_GAP - (WIDE_GAP - self.gap) * fraction), -0.5 * (WIDE_GAP - self.gap) * rate

    def obstacles(self, t: float) -> list[Obstacle]:
        """Lower board, upper board and sphere at ``t`` [s], with their true velocities."""
        half_gap, rate = self.half_gap(t)
        middle = np.append(0.5 * (BOARD_LOW + BOARD_HIGH), GOALS[0, 2])
        size = np.append(0.5 * (BOARD_HIGH - BOARD_LOW), 0.5 * BOARD_THICKNESS)
        up = np.array([0.0, 0.0, 1.0])
        boards = [
            Obstacle.box(middle + side * (half_gap + size[2]) * up, np.eye(3), size, side * rate * up)
            for side in (-1.0, 1.0)
        ]
        fraction, rate = _pulse(t, COMING, LEAVING)
        path = self.sphere_nearest - SPHERE_AWAY
        return [*boards, Obstacle.sphere(SPHERE_AWAY + fraction * path, SPHERE_RADIUS, rate * path)]


def ramp(t: float, start: float, end: float) -> tuple[float, float]:
    """From 0 to 1 between two times, at rest and unaccelerated at both; the value and its rate [1/s]."""
    s = min(max((t - start) / (end - start), 0.0), 1.0)
    return s**3 * (10 - 15 * s + 6 * s**2), 30 * s**2 * (1 - s) ** 2 / (end - start)


def _pulse(t: float, there: tuple[float, float], back: tuple[float, float]) -> tuple[float, float]:
    """From 0 to 1 and back: the value and its rate [1/s]."""
    (up, up_rate), (down, down_rate) = ramp(t, *there), ramp(t, *back)
    return up - down, up_rate - down_rate


def corridor_robot() -> RobotDescription:
    """The G1 with the 19 spheres and 29 pairs of the p-SSA paper."""
    return with_collision_model(load_robot("g1"), COLLISION_MODEL)


def corridor_kinematics(robot: RobotDescription) -> Kinematics:
    """The robot on a fixed base, upper body only: 17 joints."""
    return Kinematics(robot, base="fixed", joints=upper_body_joints(robot))


def start_posture(kin: Kinematics) -> Array:
    """Joint angles (17,) to start from: the left forearm in front, the right arm hanging [rad]."""
    return _with_left_arm(kin, kin.posture("standing"), kin.posture("hands_front"))


def rest_posture(kin: Kinematics) -> Array:
    """Joint angles (17,) that the nominal policy keeps where it can: the left forearm level [rad]."""
    q = start_posture(kin)
    for name, angle in (("left_shoulder_roll_joint", 0.3), ("left_elbow_joint", -0.1)):
        q[kin.joint_names.index(name)] = angle
    return q


def _with_left_arm(kin: Kinematics, q: Array, arm: Array) -> Array:
    left = np.array([name.startswith("left_") for name in kin.joint_names])
    return np.where(left, arm, q)
