"""Both hands follow references while the robot stands: section 5.2.1 of Lee et al."""

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from controllers.agent import MakeMotion
from controllers.motions.hands import MIRROR, HandCircles, HandsAt, HandsToTargets, Motion, circle_settings
from controllers.reference import WholeBodyReference
from experiments.recording.recording import RunResult
from experiments.running.reference_motion import reference_motion
from experiments.running.run import check_options, run
from experiments.scenarios.obstacles import SensorSettings, passing_sphere
from experiments.scenarios.options import HandTrackingOptions
from experiments.scenarios.scenario import Scenario
from robots.checks import require_one_of
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.messages import Array
from robots.pinocchio_model import standing_configuration

MOTIONS = ("circles", "beyond-reach", "target", "cross", "hold")

BEYOND = 0.3
"""How far beyond the outstretched arm the targets of ``beyond-reach`` lie [m]."""

APPROACH = 4.0
"""Time in which the targets of ``beyond-reach`` are approached [s]."""

CROSS = 2.0
"""Time in which the hands change places [s]."""


def run_hand_tracking(options: HandTrackingOptions, progress: Callable[[float], None] | None = None) -> RunResult:
    """Track with both hands; see :func:`experiments.running.run.run`.

    Raises:
        SafeWbcError: an option is not allowed; nothing has run then.
    """
    return run(hand_scenario(check_hand_tracking(options), options), options, progress)


def hand_scenario(robot: RobotDescription, options: HandTrackingOptions) -> Scenario:
    """What happens in a run with these options, which have been checked."""
    motions: dict[str, MakeMotion] = {
        "circles": _circles,
        "beyond-reach": _beyond_reach,
        "target": partial(_target, np.array(options.target)),
        "cross": _cross,
        "hold": _hold,
    }
    obstacle = obstacle_settings(options)
    encounter = None if obstacle is None else partial(passing_sphere, obstacle)
    posture, hands = start_posture(robot), motions[options.motion]
    return Scenario("hand-tracking", posture, hands, encounter=encounter, extra=reference_motion)


def check_hand_tracking(options: HandTrackingOptions) -> RobotDescription:
    """Check every option before anything is made or written; returns the robot.

    Raises:
        SafeWbcError: an option is not allowed, or the robot's description lacks what hand tracking needs.
    """
    require_one_of("motion", options.motion, MOTIONS)
    if not all(math.isfinite(x) for x in options.target):
        raise ConfigError("target", options.target, "three finite numbers [m]")
    robot = check_options(options)
    obstacle_settings(options)
    robot.posture(start_posture(robot))
    if options.motion == "circles":
        circle_settings(robot)
    return robot


def obstacle_settings(options: HandTrackingOptions) -> SensorSettings | None:
    """How the obstacle is seen; ``None`` where there is none.

    Raises:
        ConfigError: a value is not allowed.
    """
    settings = SensorSettings(
        options.obstacle_rate,
        options.obstacle_noise,
        math.inf if options.obstacle_lost_at is None else options.obstacle_lost_at,
        options.obstacle_velocity,
        options.obstacle_kappa,
    )
    return settings if options.obstacle else None


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
