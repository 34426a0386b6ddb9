"""Compiled reading of MuJoCo's arrays: the loads on the soles and the state, once a physics step each."""

import numpy as np
from numba import types

from robots.kernel_types import njit
from robots.messages import Array, Indices

LEAST_FORCE = 1.0
"""Vertical force of the ground [N] below which there is no ZMP."""

NUMBERS = types.Array(types.float64, 1, "C", readonly=True)
CONTACT_ADDRESSES = types.Array(types.int32, 1, "A", readonly=True)
CONTACT_GEOMS = types.Array(types.int32, 2, "A", readonly=True)
CONTACT_NUMBERS = types.Array(types.float64, 2, "A", readonly=True)
"""Types given in advance: compiled at import. Fields of contacts lie a contact's size apart in MuJoCo's memory."""


@njit(cache=True, error_model="numpy")
def _add_contacts(
    addresses: Indices, frames: Array, points: Array, geoms: Indices, forces: Array, soles: Indices, loads: Array
) -> None:
    """Writes ``loads``; the arguments are those of :func:`ground_loads`."""
    loads[:] = 0.0
    force = np.empty(3)
    for i in range(addresses.size):
        if addresses[i] < 0:
            continue
        for k in range(3):
            force[k] = 0.0
            for axis in range(3):
                force[k] += frames[i, 3 * axis + k] * forces[addresses[i] + axis]
        for s in range(2):
            if soles[s] in (geoms[i, 0], geoms[i, 1]):
                # MuJoCo's contact frame points from the first geom to the second
                sign = 1.0 if geoms[i, 1] == soles[s] else -1.0
                for k in range(3):
                    x, y = (k + 1) % 3, (k + 2) % 3
                    loads[s, k] += sign * force[k]
                    loads[s, 3 + k] += sign * (points[i, x] * force[y] - points[i, y] * force[x])


@njit(cache=True, error_model="numpy")
def _in_sole_axes(load: Array, pose: Array, wrench: Array) -> None:
    """Writes ``wrench`` (6,), ``load`` (6,) about the centre of a sole in its axes; ``pose`` (4, 3)."""
    moment = np.empty(3)
    R, p = pose[:3], pose[3]
    for k in range(3):
        x, y = (k + 1) % 3, (k + 2) % 3
        moment[k] = load[3 + k] - (p[x] * load[y] - p[y] * load[x])
    for k in range(3):
        wrench[k] = R[0, k] * load[0] + R[1, k] * load[1] + R[2, k] * load[2]
        wrench[3 + k] = R[0, k] * moment[0] + R[1, k] * moment[1] + R[2, k] * moment[2]


@njit(
    types.void(
        CONTACT_ADDRESSES,
        CONTACT_NUMBERS,
        CONTACT_NUMBERS,
        CONTACT_GEOMS,
        NUMBERS,
        types.Array(types.intp, 1, "C", readonly=True),
        types.Array(types.float64, 3, "C", readonly=True),
        types.float64[:, ::1],
        types.float64[:, ::1],
        types.float64[::1],
    ),
    cache=True,
    error_model="numpy",
)
def ground_loads(
    addresses: Indices,
    frames: Array,
    points: Array,
    geoms: Indices,
    forces: Array,
    soles: Indices,
    poses: Array,
    loads: Array,
    wrenches: Array,
    zmp: Array,
) -> None:
    """What the contacts of one physics step put on each sole, and the ZMP on the ground plane.

    Args:
        addresses: shape (n,) where the rows of each contact begin in ``forces``; below 0 for a contact that only grazes
            and has none.
        frames: shape (n, 9) axes of each contact in the rows, the normal first.
        points: shape (n, 3) of the contacts in the world [m].
        geoms: shape (n, 2) the two of each contact.
        forces: shape (n_rows,) of all constraints; three for a contact, along its axes [N].
        soles: shape (2,) geom of each sole.
        poses: shape (2, 4, 3) of each sole: rotation, then position [m].
        loads: shape (2, 6) force, then moment about the world's origin, world axes [N, N m]; written.
        wrenches: shape (2, 6) force, then moment about the sole's centre, sole axes [N, N m]; written.
        zmp: shape (2,) [m], NaN where the vertical force is below ``LEAST_FORCE``; written.
    """
    _add_contacts(addresses, frames, points, geoms, forces, soles, loads)
    for s in range(2):
        _in_sole_axes(loads[s], poses[s], wrenches[s])
    vertical = loads[0, 2] + loads[1, 2]
    carried = vertical >= LEAST_FORCE
    zmp[0] = -(loads[0, 4] + loads[1, 4]) / vertical if carried else np.nan
    zmp[1] = (loads[0, 3] + loads[1, 3]) / vertical if carried else np.nan


@njit(
    types.void(NUMBERS, NUMBERS, types.float64[::1], types.float64[::1]),
    cache=True,
    error_model="numpy",
)
def read_state(qpos: Array, qvel: Array, q: Array, v: Array) -> None:
    """MuJoCo's state in pinocchio's conventions: quaternion x, y, z, w; base velocity in the base's axes.

    Args:
        qpos: shape (nq,) base position, quaternion w, x, y, z, joints.
        qvel: shape (nv,) linear velocity of the base in the world, angular velocity in its axes, joints.
        q: shape (nq,), written.
        v: shape (nv,), written.
    """
    q[:] = qpos
    q[3], q[4], q[5], q[6] = qpos[4], qpos[5], qpos[6], qpos[3]
    v[:] = qvel
    x, y, z, w = q[3], q[4], q[5], q[6]
    a, b, c = qvel[0], qvel[1], qvel[2]
    v[0] = (1 - 2 * (y * y + z * z)) * a + 2 * (x * y + w * z) * b + 2 * (x * z - w * y) * c
    v[1] = 2 * (x * y - w * z) * a + (1 - 2 * (x * x + z * z)) * b + 2 * (y * z + w * x) * c
    v[2] = 2 * (x * z + w * y) * a + 2 * (y * z - w * x) * b + (1 - 2 * (x * x + y * y)) * c
