"""The contact wrench cone is exactly the set of sums of corner forces in their friction pyramids."""

from itertools import product

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linprog

from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.messages import Array
from wbc.contact import SoleContact, sole_corners, wrench_cone

contacts = st.builds(
    SoleContact, st.just("sole"), st.floats(0.02, 0.2), st.floats(0.02, 0.2), friction=st.floats(0.1, 1.5)
)
seeds = st.integers(0, 2**32 - 1)


def corner_matrix(contact: SoleContact) -> Array:
    """Map (6, 12) from forces at the four corners to the wrench about the sole's centre."""
    x, y = contact.half_length, contact.half_width
    corners = [np.array([a * x, b * y, 0.0]) for a, b in product((1, -1), repeat=2)]
    return np.hstack([np.vstack([np.eye(3), pin.skew(p)]) for p in corners])


def pyramid(friction: float) -> Array:
    """Rows (20, 12) that are not positive exactly where each corner's force lies in its pyramid."""
    one = np.array([[s, 0.0, -friction] for s in (1.0, -1.0)] + [[0.0, s, -friction] for s in (1.0, -1.0)])
    return np.kron(np.eye(4), np.vstack([one, [[0.0, 0.0, -1.0]]]))


def decomposes(contact: SoleContact, wrench: Array) -> bool:
    """Whether corner forces in their pyramids add up to the wrench: a linear program."""
    rows = pyramid(contact.friction)
    answer = linprog(
        np.zeros(12),
        A_ub=rows,
        b_ub=np.zeros(rows.shape[0]),
        A_eq=corner_matrix(contact),
        b_eq=wrench,
        bounds=(None, None),
        options={"primal_feasibility_tolerance": 1e-10},
    )
    assert answer.status in {0, 2}, answer.message
    return bool(answer.status == 0)


def normalised_cone(contact: SoleContact) -> Array:
    rows = wrench_cone(contact)
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def random_corner_forces(rng: np.random.Generator, friction: float) -> Array:
    """Forces (12,) in the pyramids, of which some lie on faces, edges, or are zero."""
    vertical = rng.exponential(100.0, 4) * (rng.random(4) < 0.7)
    fraction = np.clip(rng.uniform(-1.6, 1.6, (4, 2)), -1.0, 1.0)
    return np.column_stack([friction * fraction * vertical[:, None], vertical]).ravel()


def random_wrench(rng: np.random.Generator, contact: SoleContact) -> Array:
    """A wrench whose components are of the order that the cone allows."""
    x, y, mu = contact.half_length, contact.half_width, contact.friction
    return rng.uniform(-1.0, 1.0, 6) * np.array([mu, mu, 0.0, y, x, mu * (x + y)]) + np.eye(6)[2]


@given(contacts)
def test_there_are_sixteen_rows_and_the_unloaded_foot_is_on_all_of_them(contact: SoleContact) -> None:
    rows = wrench_cone(contact)
    assert rows.shape == (16, 6)
    assert np.isfinite(rows).all()
    assert (rows[:, 2] < 0).all()  # a pure push is inside every row, a pure pull outside
    assert len(np.unique(rows, axis=0)) == 16


@given(contacts, seeds)
def test_sums_of_corner_forces_lie_in_the_cone(contact: SoleContact, seed: int) -> None:
    forces = random_corner_forces(np.random.default_rng(seed), contact.friction)
    wrench = corner_matrix(contact) @ forces
    assert (normalised_cone(contact) @ wrench).max() <= 1e-12 * max(1.0, np.linalg.norm(wrench))


@given(contacts, seeds)
def test_wrenches_in_the_cone_are_sums_of_corner_forces_and_others_are_not(contact: SoleContact, seed: int) -> None:
    wrench = random_wrench(np.random.default_rng(seed), contact)
    margin = float((normalised_cone(contact) @ wrench).max())
    if abs(margin) > 1e-6:
        assert decomposes(contact, wrench) == (margin < 0)


@given(contacts, seeds)
def test_the_boundary_of_the_cone_is_the_boundary_of_what_corners_can_do(contact: SoleContact, seed: int) -> None:
    """Along a random line out of the cone: just inside decomposes, just outside does not."""
    wrench = random_wrench(np.random.default_rng(seed), contact)
    push = np.eye(6)[2]
    rows = wrench_cone(contact)
    speed = rows @ (wrench - push)
    exits = -(rows @ push)[speed > 1e-9] / speed[speed > 1e-9]
    if exits.size:
        for factor, inside in ((1.0 - 1e-4, True), (1.0 + 1e-4, False)):
            assert decomposes(contact, push + factor * exits.min() * (wrench - push)) == inside


@given(contacts)
def test_every_generator_of_the_corner_cone_is_an_extreme_ray(contact: SoleContact) -> None:
    """The 16 edges of the corner pyramids lie on at least five independent faces each: no row is too loose there."""
    mu = contact.friction
    rows = normalised_cone(contact)
    for corner, a, b in product(range(4), (1.0, -1.0), (1.0, -1.0)):
        forces = np.zeros(12)
        forces[3 * corner : 3 * corner + 3] = a * mu, b * mu, 1.0
        wrench = corner_matrix(contact) @ forces
        value = rows @ wrench
        assert value.max() < 1e-12
        assert np.linalg.matrix_rank(rows[value > -1e-10], tol=1e-9) == 5


def extreme_rays(rows: Array, rng: np.random.Generator, count: int) -> list[Array]:
    """Extreme rays of rows @ F <= 0 with f_z = 1, as the vertices that random linear costs end in."""
    rays = []
    for _ in range(count):
        fixed = np.eye(6)[2:3]
        answer = linprog(rng.normal(size=6), A_ub=rows, b_ub=np.zeros(16), A_eq=fixed, b_eq=[1.0], bounds=(None, None))
        assert answer.status == 0
        rays.append(answer.x)
    return rays


def test_every_extreme_ray_of_the_cone_is_a_sum_of_corner_forces() -> None:
    rng = np.random.default_rng(0)
    for _ in range(5):
        contact = SoleContact("sole", rng.uniform(0.05, 0.15), rng.uniform(0.02, 0.1), rng.uniform(0.2, 1.2))
        for ray in extreme_rays(normalised_cone(contact), rng, 40):
            push = np.eye(6)[2]
            assert decomposes(contact, (1.0 - 1e-6) * ray + 1e-6 * push)


@given(contacts)
def test_the_axes_of_the_cone_are_the_textbook_limits(contact: SoleContact) -> None:
    """Under 1 N: friction mu, tilting moments half_width and half_length, yaw mu (half_length + half_width)."""
    x, y, mu = contact.half_length, contact.half_width, contact.friction
    rows = wrench_cone(contact)
    for axis, limit in ((0, mu), (1, mu), (3, y), (4, x), (5, mu * (x + y))):
        for sign in (1.0, -1.0):
            wrench = np.eye(6)[2].copy()
            wrench[axis] = sign * limit * (1.0 - 1e-9)
            assert (rows @ wrench).max() <= 0.0
            wrench[axis] = sign * limit * (1.0 + 1e-9)
            assert (rows @ wrench).max() > 0.0


def test_a_foot_cannot_pull_nor_twist_without_load() -> None:
    rows = wrench_cone(SoleContact("sole", 0.1, 0.05, 0.8))
    for axis in range(6):
        for sign in (1.0, -1.0):
            if (axis, sign) != (2, 1.0):
                assert (rows @ (sign * np.eye(6)[axis])).max() > 0.0


def test_corners_go_round_the_sole_anticlockwise(robot: RobotDescription) -> None:
    for sole in robot.soles:
        corners = sole_corners(sole.half_length, sole.half_width)
        assert corners.shape == (4, 3)
        assert {tuple(p) for p in np.sign(corners)} == {(a, b, 0.0) for a, b in product((1.0, -1.0), repeat=2)}
        np.testing.assert_array_equal(abs(corners), [[sole.half_length, sole.half_width, 0.0]] * 4)
        following = np.roll(corners, -1, axis=0)
        area = 0.5 * np.cross(corners, following).sum(axis=0)
        np.testing.assert_allclose(area, [0.0, 0.0, 4.0 * sole.half_length * sole.half_width], rtol=0, atol=1e-15)


@pytest.mark.parametrize("name", ["half_length", "half_width", "friction"])
@pytest.mark.parametrize("value", [0.0, -0.1, float("nan"), float("inf")])
def test_bad_sizes_are_refused(name: str, value: float) -> None:
    numbers = {"half_length": 0.1, "half_width": 0.05, "friction": 0.6} | {name: value}
    with pytest.raises(ConfigError, match=name):
        SoleContact("sole", **numbers)
