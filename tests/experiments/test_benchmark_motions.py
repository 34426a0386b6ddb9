"""Motions of the benchmarks' obstacles, against what was measured of SPARK's and against their own mathematics."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.random import RandomState

from experiments.scenarios.benchmark_case import ObstacleDraw, load_cases
from experiments.scenarios.benchmark_motions import CIRCLE, TURNS_EVERY, ObstacleMotion, motion_of, reflected
from experiments.scenarios.benchmark_scene import DrawnScene, benchmark_robot, draw_scene, robot_spheres
from robots.errors import ConfigError
from robots.messages import Array

BOOK = load_cases()
CASE = BOOK.case("G1MobileBase_D1_WG_DO_v1")
SCENE = draw_scene(CASE, 0, robot_spheres(BOOK, benchmark_robot(BOOK.robot)), BOOK.robot.base_height)
DT = 0.01


def way(drawn: ObstacleDraw, steps: int, scene: DrawnScene = SCENE) -> tuple[Array, ObstacleMotion]:
    """Positions (steps + 1, n, 3), and the motion after them."""
    motion = motion_of(drawn, scene, DT)
    positions = [motion.positions]
    for _ in range(steps):
        motion.step()
        positions.append(motion.positions)
    return np.array(positions), motion


def test_sparks_motion_is_a_straight_line_of_four_tenths_of_a_metre_a_second() -> None:
    """Measured there: 0.004 m in the first step, and in each of those that follow for as long as no wall is met."""
    positions, motion = way(CASE.obstacles, 20)
    steps = np.diff(positions, axis=0)
    free = ((positions[1:] > CASE.obstacles.low) & (positions[1:] < CASE.obstacles.high)).all(axis=(0, 2))
    assert free.sum() > 30
    np.testing.assert_allclose(np.linalg.norm(steps[:, free], axis=2), 0.004, rtol=1e-9)
    np.testing.assert_allclose(steps[:, free], steps[:1, free].repeat(20, axis=0), rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(motion.velocities[free], axis=1), 0.4, rtol=1e-9)
    # obstacle i by a generator of seed + i
    for i in np.flatnonzero(free)[:5]:
        drawn = RandomState(SCENE.seed + i).normal(size=3)
        np.testing.assert_allclose(steps[0, i], 0.004 * drawn / np.linalg.norm(drawn), rtol=1e-9)


def test_sparks_obstacles_end_on_the_faces_of_the_box_and_slide_there() -> None:
    """Measured there: 80 to 100 % lie on a face after 200 to 300 steps."""
    positions, motion = way(CASE.obstacles, 300)
    at_face = (positions[-1] == CASE.obstacles.low) | (positions[-1] == CASE.obstacles.high)
    assert at_face.any(axis=1).mean() > 0.75
    assert (positions >= CASE.obstacles.low).all() and (positions <= CASE.obstacles.high).all()
    assert np.linalg.norm(motion.velocities, axis=1).max() <= 0.4 + 1e-9


def test_sparks_obstacles_turn_after_so_many_steps() -> None:
    positions, _ = way(CASE.obstacles, TURNS_EVERY + 10)
    before, at, after = (positions[k + 1] - positions[k] for k in (0, TURNS_EVERY, TURNS_EVERY + 1))
    generator = RandomState(SCENE.seed)
    first, second = (generator.normal(size=3) for _ in range(2))
    np.testing.assert_allclose(before[0], 0.004 * first / np.linalg.norm(first), rtol=1e-9)
    kept = 0.2 * before[0] + 0.004 * second / np.linalg.norm(second)
    inside = (positions[TURNS_EVERY + 1, 0] > CASE.obstacles.low) & (
        positions[TURNS_EVERY + 1, 0] < CASE.obstacles.high
    )
    np.testing.assert_allclose(at[0][inside], kept[inside], rtol=1e-6)
    assert np.linalg.norm(after) > 0.0


def test_what_spark_tells_of_the_velocity_has_nothing_to_do_with_it() -> None:
    """Measured there: 0.0024 to 0.0067 m/s, in a direction unrelated to the motion, which is of 0.4 m/s."""
    _, motion = way(CASE.obstacles, 3)
    sizes = np.linalg.norm(motion.told, axis=1)
    assert sizes.max() <= 0.005 * np.sqrt(3.0) and np.median(sizes) < 0.006
    cosines = np.sum(motion.told * motion.velocities, axis=1) / sizes / np.linalg.norm(motion.velocities, axis=1)
    assert abs(cosines.mean()) < 0.3 and cosines.std() > 0.3


def test_brownian_motion_spreads_with_the_root_of_time_and_stays_in_the_box() -> None:
    wide = replace(CASE.obstacles, motion="brownian", speed=0.1, low=(-9.0, -9.0, -9.0), high=(9.0, 9.0, 9.0))
    many = replace(SCENE, obstacles=np.zeros((400, 3)), directions=np.zeros((400, 3)))
    positions, _ = way(wide, 100, many)
    for k in (1, 25, 100):
        # 1200 draws: the deviation is known to 2 %
        assert positions[k].std() == pytest.approx(0.1 * np.sqrt(k * DT), rel=0.08)
    positions, motion = way(replace(CASE.obstacles, motion="brownian", speed=2.0), 200)
    assert (positions >= CASE.obstacles.low).all() and (positions <= CASE.obstacles.high).all()
    assert not ((positions[-1] == CASE.obstacles.low) | (positions[-1] == CASE.obstacles.high)).any()
    assert not motion.told.any()


def test_faces_reflect_as_mirrors_do() -> None:
    low, high = np.array([0.0, -1.0, 2.0]), np.array([1.0, 1.0, 2.0])
    given = np.array([[0.25, 0.5, 2.0], [-0.25, 1.5, 2.5], [1.25, -1.5, 1.0], [2.25, 5.25, 2.0]])
    expected = [[0.25, 0.5, 2.0], [0.25, 0.5, 2.0], [0.75, -0.5, 2.0], [0.25, 0.75, 2.0]]
    np.testing.assert_allclose(reflected(given, low, high), expected, atol=1e-12)


def test_circles_pass_through_where_they_were_drawn_and_their_velocity_is_their_derivative() -> None:
    drawn = replace(CASE.obstacles, motion="circle", speed=0.2)
    positions, motion = way(drawn, 400)
    np.testing.assert_array_equal(positions[0], SCENE.obstacles)
    np.testing.assert_allclose(np.linalg.norm(motion.velocities, axis=1), 0.2, rtol=1e-9)
    central = (positions[101] - positions[99]) / (2.0 * DT)
    _, at = way(drawn, 100)
    np.testing.assert_allclose(at.velocities, central, rtol=0.0, atol=1e-4)
    np.testing.assert_allclose(np.ptp(positions, axis=0)[:, :2], 2.0 * CIRCLE, rtol=1e-3)
    assert not np.ptp(positions[:, :, 2], axis=0).any()


def test_a_still_one_is_still_and_a_period_that_is_none_is_refused() -> None:
    positions, motion = way(replace(CASE.obstacles, motion="still"), 5)
    assert not np.ptp(positions, axis=0).any() and not motion.velocities.any() and not motion.told.any()
    with pytest.raises(ConfigError, match="dt"):
        motion_of(CASE.obstacles, SCENE, 0.0)
