"""Scenes of the benchmarks: obstacles and goals drawn from a seed, in SPARK's order of draws.

The order is that of SPARK version 1.0 (``intelligent-control-lab/spark``, commit d36e32c), so that a seed gives the
scene that it gives there. With a generator of numpy's older kind, made anew of the seed: for every candidate of an
obstacle three numbers of its direction, then its place; a candidate is dropped where it is too close to the robot, or
to an obstacle that was taken. Then three numbers for each hand that nobody uses, candidates of the left hand's goal
until one is clear, of the right hand's likewise; and where the base has a goal three more unused, candidates of it, and
its yaw.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import RandomState

from experiments.scenarios.benchmark_case import BenchmarkCase, BenchmarkRobot, CaseBook
from robots.collision_models import with_collision_model
from robots.description import Posture, RobotDescription
from robots.errors import ConfigError, SafeWbcError, UnknownNameError
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array
from safety.barriers.barrier import CollisionBodies

START = "benchmark"
"""Posture of the description in which the robot begins."""

CANDIDATES = 10_000
"""Of an obstacle or a goal, after which it is given up, as there."""


class CrowdedError(SafeWbcError):
    """A scene cannot be drawn: nothing more fits into it."""


@dataclass(frozen=True, slots=True)
class DrawnScene:
    """What was drawn from a seed.

    Attributes:
        seed: of it.
        obstacles: shape (n, 3) centres at the start, world [m].
        directions: shape (n, 3) of numbers in [-1, 1] that came with each, by which SPARK tells filters a velocity.
        hand_goals: shape (2, 3), left first, axes of the base [m].
        base_goal: shape (3,) x, y, yaw [m, m, rad]; ``None`` where the base has none.
        generator: as it is after the draws, of further goals.
    """

    seed: int
    obstacles: Array
    directions: Array
    hand_goals: Array
    base_goal: Array | None
    generator: RandomState


def benchmark_robot(robot: BenchmarkRobot) -> RobotDescription:
    """The description with the benchmark's spheres, and with the posture ``START``.

    Raises:
        SafeWbcError: the description cannot be read, or has no such joint or body.
    """
    described = with_collision_model(load_robot(robot.description), robot.collision_model)
    for name in robot.joints:
        if name not in described.joint_names:
            raise UnknownNameError("joint", name, list(described.joint_names))
    joints = np.array([robot.joints.get(name, 0.0) for name in described.joint_names])
    return replace(described, postures={**described.postures, START: Posture(robot.base_height, joints)})


def benchmark_kinematics(robot: RobotDescription, case: BenchmarkCase) -> Kinematics:
    """Kinematics of what moves in a case, on a fixed or a planar base, the others locked as at the start."""
    base = "fixed" if case.configuration.base == "fixed" else "planar"
    return Kinematics(robot, base=base, joints=case.configuration.joints, posture=START)


def robot_spheres(book: CaseBook, robot: RobotDescription) -> tuple[Array, Array]:
    """Centres (n, 3) [m] and radii (n,) [m] of all the robot's spheres at the start, in the world.

    Raises:
        UnknownNameError: a sphere is on a body that the robot does not have.
    """
    kin = Kinematics(robot, base="fixed", posture=START)
    kin.update_geometry(kin.posture(START))
    bodies = CollisionBodies(kin)
    bodies.place(kin)
    names = [body.name for body in robot.bodies]
    centres, radii = [*bodies.origin], [*bodies.radius]
    for sphere in book.keep_out:
        if sphere.body not in names:
            raise UnknownNameError("body of a sphere", sphere.body, names)
        rotation, origin = kin.frame_placement(kin.frame_id(sphere.body))
        centres.append(origin + rotation @ np.array(sphere.center))
        radii.append(sphere.radius)
    return np.array(centres), np.array(radii)


def draw_scene(
    case: BenchmarkCase, seed: int, spheres: tuple[Array, Array], base_height: float, number: int | None = None
) -> DrawnScene:
    """The scene of a seed.

    Args:
        case: with its boxes and keep-outs.
        seed: 0 to 2^32 - 1.
        spheres: centres (n, 3) and radii (n,) of the robot at the start [m].
        base_height: of the base's origin, from which the goals of hands are measured [m].
        number: of obstacles; the case's own if not given.

    Raises:
        ConfigError: the seed is not allowed.
        CrowdedError: an obstacle or a goal finds no place.
    """
    if not 0 <= seed < 2**32:
        raise ConfigError("seed", seed, "from 0 to 4294967295")
    generator = RandomState(seed)
    obstacles, directions = _obstacles(case, generator, spheres, case.obstacles.number if number is None else number)
    # drawn there too, and thrown away
    generator.uniform(size=6)
    goals = _hand_goals(case, generator, obstacles - np.array([0.0, 0.0, base_height]))
    if case.goals.base_low is not None:
        generator.uniform(size=3)
    return DrawnScene(seed, obstacles, directions, goals, _base_goal(case, generator, obstacles), generator)


def _obstacles(
    case: BenchmarkCase, generator: RandomState, spheres: tuple[Array, Array], number: int
) -> tuple[Array, Array]:
    drawn, (centres, radii) = case.obstacles, spheres
    places, directions = np.zeros((number, 3)), np.zeros((number, 3))
    for i in range(number):
        for _ in _candidates(case, f"obstacle {i + 1} of {number}"):
            directions[i] = generator.uniform(-1.0, 1.0, 3)
            place = generator.uniform(drawn.low, drawn.high)
            to_robot = np.linalg.norm(centres - place, axis=1) - radii - drawn.radius
            to_others = np.linalg.norm(places[:i] - place, axis=1) - 2.0 * drawn.radius
            if (to_robot >= drawn.robot_keep_out).all() and (to_others >= drawn.keep_out).all():
                places[i] = place
                break
    return places, directions


def redraw_goals(case: BenchmarkCase, scene: DrawnScene, obstacles: Array, base: tuple[Array, Array]) -> DrawnScene:
    """The scene with further goals, drawn by its generator where obstacles are now.

    Args:
        case: with its boxes and keep-outs.
        scene: whose generator goes on.
        obstacles: shape (n, 3) centres now, world [m].
        base: rotation (3, 3) and origin (3,) of the base's axes now [m].

    Raises:
        CrowdedError: a goal finds no place.
    """
    rotation, origin = base
    hands = _hand_goals(case, scene.generator, (obstacles - origin) @ rotation)
    return replace(scene, hand_goals=hands, base_goal=_base_goal(case, scene.generator, obstacles))


def _hand_goals(case: BenchmarkCase, generator: RandomState, obstacles: Array) -> Array:
    """Goals (2, 3); they and ``obstacles`` (n, 3) in the base's axes [m]."""
    goals, drawn = np.zeros((2, 3)), case.goals
    boxes = (drawn.left_low, drawn.left_high), (drawn.right_low, drawn.right_high)
    for hand, box in enumerate(boxes):
        for _ in _candidates(case, f"goal of the {('left', 'right')[hand]} hand"):
            goals[hand] = generator.uniform(*box)
            if (np.linalg.norm(obstacles - goals[hand], axis=1) >= drawn.hand_keep_out).all():
                break
    return goals


def _base_goal(case: BenchmarkCase, generator: RandomState, obstacles: Array) -> Array | None:
    drawn = case.goals
    if drawn.base_low is None or drawn.base_high is None:
        return None
    goal = np.zeros(3)
    for _ in _candidates(case, "goal of the base"):
        goal[:2] = generator.uniform(drawn.base_low, drawn.base_high)
        # its height is drawn there too, from an interval of no length
        generator.uniform()
        if (np.linalg.norm(obstacles[:, :2] - goal[:2], axis=1) >= drawn.base_keep_out).all():
            break
    goal[2] = generator.uniform(-np.pi, np.pi)
    return goal


def _candidates(case: BenchmarkCase, what: str) -> Iterator[int]:
    """Numbers of candidates, until there have been too many."""
    yield from range(CANDIDATES)
    raise CrowdedError(
        f"case {case.name}: {what} finds no place in {CANDIDATES} draws: fewer obstacles, or a larger box"
    )
