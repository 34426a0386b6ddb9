"""What walking on command means for a robot: gait, commands, and where a sphere beside the way meets the hand."""

from __future__ import annotations

import dataclasses
import math
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from controllers.gaits.commands import CommandProfile, VelocityCommand, between, read_script
from controllers.gaits.foot_state import Feet
from controllers.gaits.walking import CommandedWalk, Walking, walk_tuning, walking_changes
from controllers.gaits.walking.footsteps import FootstepPlanner
from controllers.motions.hands import CarriedHands, Motion
from controllers.reference import WholeBodyReference
from experiments.scenarios.passing_sphere import Beside
from experiments.scenarios.scenario import Setup
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.pinocchio_model import standing_configuration

if TYPE_CHECKING:
    from experiments.scenarios.walk import Walk

FIRST, LAST = 1.0, 3.0
"""The robot stands for this long at the beginning, and is told to stop this long before the end [s]."""

MEETING_STEPS = 4
"""Steps after the first left support until the left hand meets an obstacle: even, so that it is on the left again."""

PASSED = 2.0
"""How long the robot walks on after it has met an obstacle, at least [s]."""


def walk_setup(
    robot: RobotDescription,
    command: CommandProfile,
    load_estimate: bool = True,
    hands: bool = False,
    planner: FootstepPlanner | None = None,
) -> Setup:
    """The set-up of a walk at the commands of ``command``.

    Args:
        robot: its tuning is used.
        command: asked at every tick.
        load_estimate: whether the controller's model follows the forces under the feet.
        hands: whether the hands are tasks, held where the posture ``hands_front`` has them.
        planner: says where the next foot comes down; one that follows the commands if not given.
    """
    tuning, changes = walk_tuning(robot), walking_changes(robot, load_estimate)

    def gait(kin: Kinematics) -> CommandedWalk:
        return CommandedWalk(Walking(kin, tuning, planner), command)

    settings = {"walking": dataclasses.asdict(tuning)}
    motion = _carried if hands else None
    return Setup(walk_posture(hands), motion, gait=gait, command=command, changes=changes, settings=settings)


def _carried(robot: RobotDescription, reference: WholeBodyReference) -> Motion:
    return CarriedHands(reference)


def walk_posture(hands: bool) -> str:
    """Name of the posture from which a walk starts; ``hands``: whether they are tasks."""
    return "hands_front" if hands else "standing"


def check_obstacle(options: Walk, robot: RobotDescription) -> None:
    """Raise :class:`ConfigError` where the sphere beside the way does not go with the other options."""
    if options.script is not None:
        raise ConfigError("obstacle", options.obstacle, "none with --script: it stands beside a straight way")
    if options.vx <= 0.0 or options.vy != 0.0 or options.wz != 0.0:
        velocity = (options.vx, options.vy, options.wz)
        raise ConfigError("vx, vy, wz", velocity, "straight forward (vx above 0, the others 0) with --obstacle")
    shortest = meeting(options, robot).time + PASSED + LAST
    if options.duration < shortest:
        raise ConfigError(
            "duration", options.duration, f"at least {shortest:.3g} s with --obstacle: it has to be passed"
        )


def command_profile(options: Walk, robot: RobotDescription) -> CommandProfile:
    """The commands of a walk by its options.

    Raises:
        ConfigError: the script cannot be read, or a velocity is not within reach of the robot's longest steps.
    """
    check = partial(walk_tuning(robot).require_reachable, width=_standing(robot, options).width)
    if options.script is not None:
        wanted: CommandProfile = read_script(options.script, check)
    else:
        command = VelocityCommand(options.vx, options.vy, options.wz, stepping=True)
        check(command)
        wanted = partial(_always, command)
    return between(wanted, FIRST, options.duration - LAST)


def _always(command: VelocityCommand, t: float) -> VelocityCommand:
    return command


def _standing(robot: RobotDescription, options: Walk) -> Feet:
    """The feet at the start."""
    kin = Kinematics(robot)
    kin.update(standing_configuration(robot, walk_posture(options.hands)), np.zeros(kin.nv))
    return Feet(kin)


def meeting(options: Walk, robot: RobotDescription) -> Beside:
    """Where the left hand meets the sphere: in the middle of the left foot's third support, swayed to the left."""
    tuning, feet = walk_tuning(robot), _standing(robot, options)
    timing, limited, command = tuning.timing, VelocityCommand(), VelocityCommand(vx=options.vx)
    time, ahead = FIRST + tuning.start_time, 0.0
    for _ in range(MEETING_STEPS):
        limited = limited.towards(command, tuning.speed_change, tuning.turn_change)
        time += timing.period(limited.vx)
        ahead += limited.vx * timing.period(limited.vx)
    single = timing.single(limited.vx)
    time += 0.5 * single
    sideways = sway(0.5 * feet.width, feet.omega, single, tuning.double_support)
    return Beside(options.obstacle, ahead, sideways, time, walk_posture(options.hands))


def sway(half_width: float, omega: float, single: float, double: float) -> float:
    r"""How far the CoM goes to each side in steady stepping, by the linear inverted pendulum.

    The ZMP is at :math:`\pm p` for the time ``single`` and goes linearly from one to the other in the time ``double``.
    About the middle of single support :math:`y = p + A \cosh \omega t`, about that of double support
    :math:`y = B \sinh \omega t - 2 p t / T_d`; place and velocity agree where one becomes the other.

    Args:
        half_width: p, half the distance of the feet [m].
        omega: of the pendulum, above 0 [1/s].
        single: time of single support, above 0 [s].
        double: time of double support, above 0 [s].

    Returns:
        p + A [m].
    """
    a, b = 0.5 * omega * single, 0.5 * omega * double
    return half_width * (1.0 - 1.0 / (b * (math.cosh(a) / math.tanh(b) + math.sinh(a))))
