"""Both hands follow references while the robot stands: section 5.2.1 of Lee et al."""

from collections.abc import Callable, Sequence

import numpy as np

from controllers.motions import HandCircles, HandsToTargets, Motion, circle_settings
from controllers.reference import WholeBodyReference
from controllers.whole_body import WholeBodyController
from experiments.options import HandTrackingOptions
from experiments.results import RunResult
from experiments.session import run
from robots.checks import require_one_of
from robots.description import RobotDescription
from robots.kinematics import Kinematics
from robots.messages import Array
from robots.pinocchio_model import standing_configuration

MOTIONS = ("circles", "beyond-reach")

BEYOND = 0.3
"""How far beyond the outstretched arm the targets of ``beyond-reach`` lie [m]."""

APPROACH = 4.0
"""Time in which the targets of ``beyond-reach`` are approached [s]."""


def run_hand_tracking(options: HandTrackingOptions, progress: Callable[[float], None] | None = None) -> RunResult:
    """Track with both hands; see :func:`experiments.session.run`.

    Raises:
        ConfigError: unknown motion.
    """
    require_one_of("motion", options.motion, MOTIONS)
    make = _circles if options.motion == "circles" else _beyond_reach
    return run("hand-tracking", options, "hands_front", make, reference_motion, progress)


def _start(reference: WholeBodyReference) -> tuple[Array, Array]:
    assert reference.hands is not None
    left, right = reference.hands
    return left.position.copy(), right.position.copy()


def _circles(robot: RobotDescription, reference: WholeBodyReference) -> Motion:
    return HandCircles(circle_settings(robot), _start(reference))


def _beyond_reach(robot: RobotDescription, reference: WholeBodyReference) -> Motion:
    """Targets ahead and outward of the shoulders, ``BEYOND`` further away than an outstretched arm reaches."""
    kin = Kinematics(robot)
    kin.update(standing_configuration(robot, "hands_front"), np.zeros(kin.nv))
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


def reference_motion(
    controller: WholeBodyController, reference: WholeBodyReference, motions: Sequence[Motion], duration: float
) -> dict[str, Array]:
    """Smallest self-collision barrier of the reference motion: KinWBC alone, integrated exactly, no filter.

    This is the motion in which the paper's remaining collision ratio counts "the collisions in the reference hand
    trajectory".

    Returns:
        ``h_self_reference``: shape (T,), one per control tick [m].
    """
    kin, dt = controller.kin, controller.config.dt
    cut = slice(controller.barriers.slices["self_collision"].start, controller.barriers.slices["leg_collision"].stop)
    q = standing_configuration(controller.robot, "hands_front")
    out = np.zeros(round(duration / dt))
    rest = np.zeros(kin.nv)
    for i in range(out.size):
        for motion in motions:
            motion.apply(reference, i * dt)
        kin.update(q, rest)
        out[i] = controller.barriers.evaluate(kin).h[cut].min()
        q = kin.integrate(q, controller.desired_velocity(reference), dt)
    return {"h_self_reference": out}
