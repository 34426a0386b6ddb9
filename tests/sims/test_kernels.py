"""The plant's kernels against the same sums in plain numpy."""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robots.messages import Array, Indices
from sims.kernels import LEAST_FORCE, ground_loads, read_state

SEEDS = st.integers(0, 2**32 - 1)
SOLES = np.array([4, 8])
GROUND, OTHER = 0, 6


@dataclass
class Contacts:
    """What MuJoCo lists: fields of contacts lie apart in its memory, and constraints of other kinds come first."""

    addresses: Indices
    frames: Array
    points: Array
    geoms: Indices
    forces: Array

    def arrays(self) -> tuple[Indices, Array, Array, Indices, Array]:
        n = self.addresses.size
        apart = np.zeros((n, 73))
        frames, points = apart[:, 4:13], apart[:, 1:4]
        frames[:], points[:] = self.frames, self.points
        numbers = np.zeros((n, 146), dtype=np.int32)
        addresses, geoms = numbers[:, 141], numbers[:, 130:132]
        addresses[:], geoms[:] = self.addresses, self.geoms
        return addresses, frames, points, geoms, self.forces


def rotations(rng: np.random.Generator, n: int) -> Array:
    quaternions = rng.standard_normal((n, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    return np.array([pin.Quaternion(q).matrix() for q in quaternions]).reshape(n, 3, 3)


def some_contacts(rng: np.random.Generator, n: int) -> Contacts:
    """Soles on the ground and on each other's side of the pair, bodies that are no soles, contacts without rows."""
    geoms = np.array([GROUND, OTHER, *SOLES])
    pairs = [rng.choice(geoms, 2, replace=False) for _ in range(n)]
    carried = rng.random(n) < 0.7
    addresses = np.where(carried, 5 + 3 * np.cumsum(carried) - 3, -1)
    forces = 100.0 * rng.standard_normal(5 + 3 * int(carried.sum()))
    return Contacts(
        addresses, rotations(rng, n).reshape(n, 9), rng.uniform(-1, 1, (n, 3)), np.reshape(pairs, (n, 2)), forces
    )


def sole_poses(rng: np.random.Generator) -> Array:
    return np.concatenate([rotations(rng, 2), rng.uniform(-1, 1, (2, 1, 3))], axis=1)


def measured(contacts: Contacts, poses: Array) -> tuple[Array, Array, Array]:
    loads, wrenches, zmp = np.full((2, 6), 7.0), np.full((2, 6), 7.0), np.full(2, 7.0)
    ground_loads(*contacts.arrays(), SOLES, poses, loads, wrenches, zmp)
    return loads, wrenches, zmp


def expected(contacts: Contacts, poses: Array) -> tuple[Array, Array, Array]:
    """The oracle: contact by contact, in numpy."""
    loads = np.zeros((2, 6))
    for i in np.flatnonzero(contacts.addresses >= 0):
        along = contacts.forces[contacts.addresses[i] : contacts.addresses[i] + 3]
        # the rows of the frame are its axes; it points from the first geom to the second
        force = contacts.frames[i].reshape(3, 3).T @ along
        wrench = np.concatenate([force, np.cross(contacts.points[i], force)])
        for s, sole in enumerate(SOLES):
            loads[s] += wrench * (float(contacts.geoms[i, 1] == sole) - float(contacts.geoms[i, 0] == sole))
    wrenches = np.zeros((2, 6))
    for s in range(2):
        rotation, position = poses[s, :3], poses[s, 3]
        wrenches[s, :3] = rotation.T @ loads[s, :3]
        wrenches[s, 3:] = rotation.T @ (loads[s, 3:] - np.cross(position, loads[s, :3]))
    net = loads.sum(axis=0)
    zmp = np.array([-net[4], net[3]]) / net[2] if net[2] >= LEAST_FORCE else np.full(2, np.nan)
    return loads, wrenches, zmp


@given(seed=SEEDS, n=st.integers(0, 12))
def test_loads_wrenches_and_zmp_are_the_sums_over_the_contacts(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    contacts, poses = some_contacts(rng, n), sole_poses(rng)
    for found, right in zip(measured(contacts, poses), expected(contacts, poses), strict=True):
        np.testing.assert_allclose(found, right, rtol=1e-12, atol=1e-10)


@given(seed=SEEDS)
def test_two_soles_in_contact_put_opposite_loads_on_each_other(seed: int) -> None:
    rng = np.random.default_rng(seed)
    contacts = some_contacts(rng, 6)
    contacts.geoms = np.array([rng.permutation(SOLES) for _ in range(6)])
    loads, _, zmp = measured(contacts, sole_poses(rng))
    np.testing.assert_array_equal(loads[0], -loads[1])
    assert np.isnan(zmp).all()


@pytest.mark.parametrize(("force", "carried"), [(LEAST_FORCE, True), (0.999 * LEAST_FORCE, False), (-50.0, False)])
def test_there_is_a_zmp_from_the_least_force_on(force: float, carried: bool) -> None:
    """Upward force at one point: the ZMP is below that point."""
    frame = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]).reshape(1, 9)
    point = np.array([[0.3, -0.2, 0.0]])
    contacts = Contacts(np.array([0]), frame, point, np.array([[GROUND, SOLES[0]]]), np.array([force, 0.0, 0.0]))
    zmp = measured(contacts, sole_poses(np.random.default_rng(0)))[2]
    np.testing.assert_allclose(zmp, point[0, :2] if carried else np.nan, rtol=1e-12)


@given(seed=SEEDS)
def test_a_state_is_read_in_pinocchio_s_order_and_axes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    qpos, qvel = rng.standard_normal(12), rng.standard_normal(11)
    qpos[3:7] /= np.linalg.norm(qpos[3:7])
    q, v = np.empty(12), np.empty(11)
    read_state(qpos, qvel, q, v)
    np.testing.assert_array_equal(q, qpos[[0, 1, 2, 4, 5, 6, 3, *range(7, 12)]])
    np.testing.assert_allclose(v[:3], pin.Quaternion(q[3:7]).matrix().T @ qvel[:3], rtol=1e-12, atol=1e-15)
    np.testing.assert_array_equal(v[3:], qvel[3:])
