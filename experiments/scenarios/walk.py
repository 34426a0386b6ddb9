"""Walking on command: at a velocity of the body, or by a script, with pushes, with a sphere beside the way."""

import dataclasses
import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from controllers.gaits.commands import CommandProfile, VelocityCommand, between, read_script
from controllers.gaits.foot_state import Feet
from controllers.gaits.walking import CommandedWalk, Walking, walk_tuning, walking_changes
from controllers.motions.hands import CarriedHands, Motion
from controllers.reference import WholeBodyReference
from experiments.metrics.locomotion import walk_figures
from experiments.recording.recording import RunResult
from experiments.running.run import check_options, run
from experiments.scenarios.obstacles import BESIDE, Beside, SensorSettings, sphere_beside
from experiments.scenarios.options import WalkOptions
from experiments.scenarios.scenario import MakeEncounter, Scenario, parse_pushes
from robots.checks import require_one_of
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.messages import Array
from robots.pinocchio_model import standing_configuration

FIRST, LAST = 1.0, 3.0
"""The robot stands for this long at the beginning, and is told to stop this long before the end [s]."""

MEETING_STEPS = 4
"""Steps after the first left support until the left hand meets an obstacle: even, so that it is on the left again."""

PASSED = 2.0
"""How long the robot walks on after it has met an obstacle, at least [s]."""


def run_walk(options: WalkOptions, progress: Callable[[float], None] | None = None) -> RunResult:
    """Walk; see :func:`experiments.running.run.run`.

    The robot stands for the first ``FIRST`` seconds, and the command is stop in the ``LAST`` ones. The result has the
    series ``command`` (T, 3) besides: forward [m/s], left [m/s], turning [rad/s].

    Raises:
        SafeWbcError: an option is not allowed; nothing has run then.
    """
    robot = check_walk(options)
    if options.script is not None:
        options = dataclasses.replace(options, script=options.script.resolve())
    command = command_profile(options, robot)
    scenario = dataclasses.replace(
        walk_scenario(robot, command, options.load_estimate, options.hands),
        encounter=_encounter(options, robot),
        pushes=parse_pushes(options.push, options.duration),
    )
    return with_commands(run(scenario, options, progress), command)


def walk_scenario(
    robot: RobotDescription, command: CommandProfile, load_estimate: bool = True, hands: bool = False
) -> Scenario:
    """The scenario of a walk at the commands of ``command``, without obstacle and pushes.

    Args:
        robot: its tuning is used.
        command: asked at every tick.
        load_estimate: whether the controller's model follows the forces under the feet.
        hands: whether the hands are tasks, held where the posture ``hands_front`` has them.
    """
    tuning, changes = walk_tuning(robot), walking_changes(robot, load_estimate)

    def gait(kin: Kinematics) -> CommandedWalk:
        return CommandedWalk(Walking(kin, tuning), command)

    def figures(robot: RobotDescription, series: dict[str, Array]) -> dict[str, Any]:
        return walk_figures(series, commands_at(command, series["time"]))

    motion = _carried if hands else None
    settings = {"walking": dataclasses.asdict(tuning)}
    return Scenario("walk", _posture(hands), motion, gait, changes=changes, settings=settings, figures=figures)


def _carried(robot: RobotDescription, reference: WholeBodyReference) -> Motion:
    return CarriedHands(reference)


def _posture(hands: bool) -> str:
    return "hands_front" if hands else "standing"


def check_walk(options: WalkOptions) -> RobotDescription:
    """Check every option before anything is made or written; returns the robot.

    Raises:
        SafeWbcError: an option is not allowed.
    """
    robot = check_options(options)
    robot.posture(_posture(options.hands))
    parse_pushes(options.push, options.duration)
    shortest = FIRST + LAST
    if options.duration <= shortest:
        allowed = f"above {shortest:g} s: the robot stands for {FIRST:g} s first and stops {LAST:g} s before the end"
        raise ConfigError("duration", options.duration, allowed)
    command_profile(options, robot)
    _check_obstacle(options, robot)
    return robot


def _check_obstacle(options: WalkOptions, robot: RobotDescription) -> None:
    require_one_of("obstacle", options.obstacle, ("none", *BESIDE))
    if options.obstacle == "none":
        return
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


def command_profile(options: WalkOptions, robot: RobotDescription) -> CommandProfile:
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


def _standing(robot: RobotDescription, options: WalkOptions) -> Feet:
    """The feet at the start."""
    kin = Kinematics(robot)
    kin.update(standing_configuration(robot, _posture(options.hands)), np.zeros(kin.nv))
    return Feet(kin)


def _encounter(options: WalkOptions, robot: RobotDescription) -> MakeEncounter | None:
    """The sphere beside the way."""
    if options.obstacle == "none":
        return None
    return partial(sphere_beside, meeting(options, robot), SensorSettings())


def meeting(options: WalkOptions, robot: RobotDescription) -> Beside:
    """Where the left hand meets the sphere: in the middle of the left foot's third support, swayed to the left."""
    tuning, feet = walk_tuning(robot), _standing(robot, options)
    timing, heeded, wanted = tuning.timing, VelocityCommand(), VelocityCommand(vx=options.vx)
    time, ahead = FIRST + tuning.start_time, 0.0
    for _ in range(MEETING_STEPS):
        heeded = heeded.towards(wanted, tuning.speed_change, tuning.turn_change)
        time += timing.period(heeded.vx)
        ahead += heeded.vx * timing.period(heeded.vx)
    single = timing.single(heeded.vx)
    time += 0.5 * single
    sideways = sway(0.5 * feet.width, feet.omega, single, tuning.double_support)
    return Beside(options.obstacle, ahead, sideways, time, _posture(options.hands))


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


def commands_at(command: CommandProfile, times: Array) -> Array:
    """Commanded velocities at ``times`` (T,) [s]: shape (T, 3), forward [m/s], left [m/s], turning [rad/s]."""
    commands = [command(float(t)) for t in times]
    return np.reshape([(c.vx, c.vy, c.wz) for c in commands], (-1, 3))


def with_commands(result: RunResult, command: CommandProfile) -> RunResult:
    """The result of a walk with the series ``command``."""
    commands = commands_at(command, result.series["time"])
    return dataclasses.replace(result, series={**result.series, "command": commands})
