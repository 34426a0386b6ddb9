"""Motions of the hands of a robot that stands, by name: section 5.2.1 of Lee et al."""

from functools import partial

import numpy as np

from controllers.agent import MakeMotion
from controllers.motions.hands import MIRROR, HandCircles, HandsAt, HandsToTargets, Motion, circle_settings
from controllers.reference import WholeBodyReference
from robots.description import RobotDescription
from robots.kinematics import Kinematics
from robots.messages import Array
from robots.pinocchio_model import standing_configuration

BEYOND = 0.3
"""How far beyond the outstretched arm the targets of ``beyond-reach`` lie [m]."""

APPROACH = 4.0
"""Time in which the targets of ``beyond-reach`` are approached [s]."""

CROSS = 2.0
"""Time in which the hands change places [s]."""


def hand_motion(name: str, target: tuple[float, float, float]) -> MakeMotion:
    """What makes the motions that a :class:`HandTracking` names; ``target`` is that of the motion of this name [m]."""
    makers: dict[str, MakeMotion] = {
        "circles": _circles,
        "beyond-reach": _beyond_reach,
        "target": partial(_target, np.array(target)),
        "cross": _cross,
        "hold": _hold,
    }
    return makers[name]


def start_posture(robot: RobotDescription) -> str:
    """Name of the posture from which the hands start: ``[tuning.hand_tracking]`` may name one."""
    return str(robot.tuning.get("hand_tracking", {}).get("posture", "hands_front"))


def _start(reference: WholeBodyReference) -> tuple[Array, Array]:
    assert reference.hands is not None
    left, right = reference.hands
    return left.position.copy(), right.position.copy()


def _circles(robot: RobotDescription, reference: WholeBodyReference) -> Motion:
    return HandCircles(circle_settings(robot), _start(reference))


def _hold(robot: RobotDescription, reference: WholeBodyReference) -> Motion:
    start = _start(reference)
    return HandsToTargets(start, start, APPROACH)


def _target(offset: Array, robot: RobotDescription, reference: WholeBodyReference) -> Motion:
    """Both hands to ``offset`` (3,) from the torso's frame and to its mirror image [m], at once."""
    kin = Kinematics(robot)
    kin.update_geometry(standing_configuration(robot, start_posture(robot)))
    torso = kin.frame_placement(kin.frame_id(robot.roles["torso"]))[1]
    return HandsAt((torso + offset, torso + MIRROR * offset))


def _cross(robot: RobotDescription, reference: WholeBodyReference) -> Motion:
    left, right = _start(reference)
    return HandsToTargets((left, right), (right, left), CROSS)


def _beyond_reach(robot: RobotDescription, reference: WholeBodyReference) -> Motion:
    """Targets ahead and outward of the shoulders, ``BEYOND`` further away than an outstretched arm reaches."""
    kin = Kinematics(robot)
    kin.update(standing_configuration(robot, start_posture(robot)), np.zeros(kin.nv))
    targets = []
    for side, sign in (("left", 1.0), ("right", -1.0)):
        shoulder = kin.frame_placement(kin.frame_id(robot.roles[f"{side}_shoulder"]))[1]
        direction = np.array([0.9, 0.4 * sign, 0.15])
        distance = arm_length(kin, side) + BEYOND
        targets.append(shoulder + direction / np.linalg.norm(direction) * distance)
    return HandsToTargets(_start(reference), (targets[0], targets[1]), APPROACH)


def arm_length(kin: Kinematics, side: str) -> float:
    """Upper bound of the distance from shoulder to hand [m]: the lengths of the links between them, summed."""
    roles = kin.robot.roles
    hand, shoulder = kin.frame_id(roles[f"{side}_hand"]), kin.frame_id(roles[f"{side}_shoulder"])
    joint, stop = kin.frame_joint(hand), kin.frame_joint(shoulder)
    length = float(np.linalg.norm(kin.model.frames[hand].placement.translation))
    while joint != stop:
        length += float(np.linalg.norm(kin.model.jointPlacements[joint].translation))
        joint = kin.model.parents[joint]
    return length
