"""What the whole body is asked to do at one instant."""

import copy
from dataclasses import dataclass, field

import numpy as np

from controllers.balance.dcm_plan import DcmReference
from robots.kinematics import Kinematics
from robots.messages import Array, Mask


@dataclass(slots=True)
class PointReference:
    """A point's path: ``position`` (3,) [m], ``velocity`` [m/s], ``acceleration`` [m/s^2], world axes."""

    position: Array
    velocity: Array = field(default_factory=lambda: np.zeros(3))
    acceleration: Array = field(default_factory=lambda: np.zeros(3))


@dataclass(slots=True)
class WholeBodyReference:
    """References of all tasks at one instant, world frame.

    Attributes:
        com: centre of mass.
        soles: left and right sole's centres.
        sole_rotations: their axes, (3, 3) each.
        base_rotation: (3, 3) axes of the base.
        torso_rotation: (3, 3) axes of the torso.
        hands: left and right hand, or ``None``: the posture then decides where the arms are.
        hand_rotations: axes of left and right hand, (3, 3) each, for a controller whose hands are pose tasks; ``None``:
            none are given.
        hand_turns: shape (2, 3) angular velocity of each hand [rad/s].
        joints: shape (nj,) posture [rad].
        in_contact: shape (2,) whether each foot is meant to be on the ground.
        sole_turns: shape (2, 2) rate [rad/s] and second rate [rad/s^2] at which each sole turns about the vertical.
        load_limits: shape (2,) largest fraction of the robot's weight that each foot may carry; 1 and above is no
            limit.
        turn_rate: rate at which base and torso turn about the vertical [rad/s].
        dcm: divergent component of motion; where it is given, the horizontal motion of the CoM follows from it by the
            feedback of :mod:`controllers.balance.dcm_feedback`, and ``com`` only gives the height.
        extra: targets of further tasks by their name, each what the task's ``set_target`` takes; a task that is not
            named keeps the target it has.
    """

    com: PointReference
    soles: tuple[PointReference, PointReference]
    sole_rotations: tuple[Array, Array]
    base_rotation: Array
    torso_rotation: Array
    hands: tuple[PointReference, PointReference] | None
    joints: Array
    in_contact: Mask
    hand_rotations: tuple[Array, Array] | None = None
    hand_turns: Array = field(default_factory=lambda: np.zeros((2, 3)))
    sole_turns: Array = field(default_factory=lambda: np.zeros((2, 2)))
    load_limits: Array = field(default_factory=lambda: np.ones(2))
    turn_rate: float = 0.0
    dcm: DcmReference | None = None
    extra: dict[str, tuple[Array, ...]] = field(default_factory=dict)

    def at_rest(self) -> "WholeBodyReference":
        """A copy that stays where this one is: points, hands and turns without velocity and acceleration.

        Targets of further tasks are copied as they are.
        """
        frozen = copy.deepcopy(self)
        for point in (frozen.com, *frozen.soles, *(frozen.hands or ())):
            point.velocity, point.acceleration = np.zeros(3), np.zeros(3)
        frozen.hand_turns, frozen.sole_turns, frozen.turn_rate = np.zeros((2, 3)), np.zeros((2, 2)), 0.0
        return frozen


def reference_here(kin: Kinematics, with_hands: bool) -> WholeBodyReference:
    """Reference that keeps the robot where its kinematics are: both feet on the ground, everything at rest.

    The CoM is put over the middle of the soles, at its present height.
    """
    roles = kin.robot.roles
    rotation = {r: kin.frame_placement(kin.frame_id(roles[r]))[0].copy() for r in ("base", "torso")}
    left, right = (kin.frame_id(roles[r]) for r in ("left_sole", "right_sole"))
    soles = [kin.frame_placement(i) for i in (left, right)]
    middle = 0.5 * (soles[0][1] + soles[1][1])
    com = np.array([middle[0], middle[1], kin.com[2]])
    held = [kin.frame_placement(kin.frame_id(roles[r])) for r in ("left_hand", "right_hand")]
    hands = [PointReference(position.copy()) for _, position in held]
    return WholeBodyReference(
        com=PointReference(com),
        soles=(PointReference(soles[0][1].copy()), PointReference(soles[1][1].copy())),
        sole_rotations=(soles[0][0].copy(), soles[1][0].copy()),
        base_rotation=rotation["base"],
        torso_rotation=rotation["torso"],
        hands=(hands[0], hands[1]) if with_hands else None,
        hand_rotations=(held[0][0].copy(), held[1][0].copy()) if with_hands else None,
        joints=kin.q[7:].copy(),
        in_contact=np.array([True, True]),
    )
