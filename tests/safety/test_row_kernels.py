"""Compiled passes over all rows: against numpy, and against linear programming."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linprog

from robots.messages import Array
from safety.filters.condition_kernels import add_violated, least_violation, near_zero_rows
from safety.geometry.contact_rows import all_numbers, obstacle_motion, room
from safety.geometry.shapes import Obstacle


@pytest.mark.parametrize("shape", [(0, 3), (1, 1), (7, 4), (979, 20), (979, 35)])
def test_room_is_that_of_numpy(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    A, v, b = rng.normal(size=shape), rng.normal(size=shape[1]), rng.normal(size=shape[0])
    expected = A @ v - b
    np.testing.assert_allclose(room(A, v, b), expected, rtol=0, atol=1e-13)
    # whatever the layout, and however many columns between two rows
    np.testing.assert_allclose(room(np.asfortranarray(A), v, b), expected, rtol=0, atol=1e-13)
    np.testing.assert_allclose(room(np.repeat(A, 2, axis=1)[:, ::2], v, b), expected, rtol=0, atol=1e-13)


def test_violated_rows_are_added_to_those_chosen() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        A, v, b = rng.normal(size=(50, 6)), rng.normal(size=6), rng.normal(size=50)
        chosen, out = rng.random(50) < 0.3, np.empty(50)
        violated = A @ v - b < -0.1
        expected, news = chosen | violated, bool((violated & ~chosen).any())
        assert add_violated(A, v, b, 0.1, chosen, out) == news
        np.testing.assert_array_equal(chosen, expected)
        np.testing.assert_allclose(out, A @ v - b, rtol=0, atol=1e-13)
        assert not add_violated(A, v, b, 0.1, chosen, out)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_one_number_that_is_not_finite_is_found_wherever_it_is(bad: float) -> None:
    rng = np.random.default_rng(2)
    for place in range(3):
        for _ in range(30):
            arrays = [rng.normal(size=50), rng.normal(size=50), rng.normal(size=(50, 21))]
            assert all_numbers(*arrays)
            arrays[place].flat[rng.integers(arrays[place].size)] = bad
            assert not all_numbers(*arrays)
    # two that would cancel
    assert not all_numbers(np.array([np.inf]), np.array([-np.inf]), np.zeros((1, 2)))


def test_rows_near_zero_rows_are_those_that_bounds_cannot_ease() -> None:
    rng = np.random.default_rng(3)
    lower, upper = rng.uniform(-2, -1, 5), rng.uniform(1, 2, 5)
    A = rng.normal(size=(200, 5)) * 10.0 ** rng.uniform(-8, 0, (200, 1))
    b = rng.normal(size=200) * 10.0 ** rng.uniform(-6, 0, 200)
    best, least = np.maximum(A * lower, A * upper).sum(axis=1), np.minimum(A * lower, A * upper).sum(axis=1)
    expected = (best - least <= 1e-4 * (upper - lower).max()) & (best - least <= 1e-3 * (b - best))
    np.testing.assert_array_equal(near_zero_rows(A, b, lower, upper, 1e-4, 1e-3), np.flatnonzero(expected))
    assert 10 < expected.sum() < 150


def least_violation_by_lp(A: Array, b: Array, bound: float) -> float:
    """Smallest largest violation of A v >= b over |v| <= bound, below 0 where all can hold with room to spare."""
    n, nv = A.shape
    cost, rows = np.append(np.zeros(nv), 1.0), np.hstack([-A, -np.ones((n, 1))])
    return float(linprog(cost, rows, -b, bounds=[(-bound, bound)] * nv + [(None, None)]).fun)


def test_the_least_violation_is_never_above_what_linear_programming_finds() -> None:
    rng = np.random.default_rng(4)
    proofs = 0
    for _ in range(100):
        A, b, v = rng.normal(size=(12, 4)), rng.normal(size=12), rng.uniform(-1, 1, 4)
        b -= rng.uniform(-0.5, 1.5)
        bound = least_violation(A, b, np.full(4, -1.0), np.full(4, 1.0), b - A @ v)
        assert bound <= max(0.0, least_violation_by_lp(A, b, 1.0)) + 1e-12
        proofs += bound > 0
    assert least_violation(A, A @ v - 1.0, -np.ones(4), np.ones(4), -np.ones(12)) == 0.0
    # two rows that ask for opposite motion: each velocity is short of one by at least the mean demand
    A, b = np.array([[1.0], [-1.0]]), np.array([0.3, 0.2])
    assert least_violation(A, b, -np.ones(1), np.ones(1), np.array([0.25, 0.25])) == pytest.approx(0.25, abs=1e-15)


def _capsule(rng: np.random.Generator, radius: float) -> Obstacle:
    start, end, velocity, rate = rng.normal(size=(4, 3))
    return Obstacle.capsule(start, end, radius, velocity, rate)


def test_obstacle_motion_is_that_of_a_rigid_body() -> None:
    rng = np.random.default_rng(6)
    obstacles = [_capsule(rng, 0.1 + i) for i in range(4)]
    radius, which = rng.uniform(0.05, 0.2, 9), rng.integers(0, 4, 9)
    reach, twists, rates = np.empty(9), np.empty((4, 6)), np.empty((4, 6))
    obstacle_motion(np.stack([o.packed for o in obstacles]), radius, which, reach, twists, rates)
    np.testing.assert_array_equal(reach, radius + np.array([obstacles[o].radius for o in which]))
    for o, twist, rate in zip(obstacles, twists, rates, strict=True):
        np.testing.assert_allclose(twist[:3], o.velocity - np.cross(o.angular_velocity, o.position), rtol=0, atol=1e-14)
        np.testing.assert_array_equal(twist[3:], o.angular_velocity)
        # by finite differences along its own motion
        later, before = (o.velocity - np.cross(o.angular_velocity, o.position + t * o.velocity) for t in (1e-3, -1e-3))
        np.testing.assert_allclose(rate[:3], (later - before) / 2e-3, rtol=0, atol=1e-11)
        np.testing.assert_array_equal(rate[3:], np.zeros(3))


def test_an_obstacles_numbers_are_its_fields_one_after_the_other() -> None:
    given = [np.array([1.0, 2, 3]), np.eye(3), np.array([0.1, 0.2, 0.3]), np.array([4.0, 5, 6]), np.array([7.0, 8, 9])]
    box = Obstacle.box(*given)
    for array in given:
        array[:] = -1.0
    expected = [1, 2, 3, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0.1, 0.2, 0.3, 0, 4, 5, 6, 7, 8, 9]
    np.testing.assert_array_equal(box.packed, expected)
    fields = (
        box.position,
        box.direction,
        box.rotation.ravel(),
        box.half_sizes,
        [box.radius],
        box.velocity,
        box.angular_velocity,
    )
    np.testing.assert_array_equal(np.concatenate(fields), expected)


def test_an_obstacle_cannot_be_moved_in_place() -> None:
    three = np.array([1.0, 2.0, 3.0])
    made = (
        Obstacle.sphere(three, 0.1, three),
        Obstacle.capsule(three, 2 * three, 0.1, three, three),
        Obstacle.box(three, np.eye(3), three, three, three),
        Obstacle.half_space(three, three, three, three),
    )
    for obstacle in (o for one in made for o in (one, one.at_rest(), one.after(0.5), replace(one, position=-three))):
        for name in ("position", "direction", "rotation", "half_sizes", "velocity", "angular_velocity", "packed"):
            array = getattr(obstacle, name)
            with pytest.raises(ValueError, match="read-only"):
                array.flat[0] = 5.0
            with pytest.raises(ValueError, match="read-only"):
                array += 1.0
    # the caller's own arrays stay as they were
    three[0] = 7.0
    assert made[0].position[0] == 1.0
