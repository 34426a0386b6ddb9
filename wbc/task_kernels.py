"""Compiled evaluation of tasks: Jacobians and commanded velocities of frames, and clipped corrections."""

import math

import numpy as np
from numba import types

from robots.kernel_types import COLUMNS, MATRIX, OUT, OUT_ROWS, TABLE, VECTOR, njit
from robots.messages import Array, Indices

POSITION, ORIENTATION, POSE = 1, 2, 3
"""What of a frame a task is about; the bits of ``POSE`` are the other two."""

POSITION_AT, ROTATION_AT, VELOCITY_AT, ACCELERATION_AT, ANGULAR = 0, 3, 12, 18, 3
"""Where the parts of a frame's references begin: see :func:`evaluate_frames`. The angular part of velocity and
acceleration begins ``ANGULAR`` further."""

NO_TURN = 1e-6
"""Sine of an angle below which its rotation matrix is symmetric to rounding."""


@njit(types.void(OUT, types.float64), cache=True, error_model="numpy")
def _clip(vector: Array, most: float) -> None:
    """Shorten ``vector`` to the norm ``most``, in place."""
    squared = 0.0
    for k in range(vector.size):
        squared += vector[k] * vector[k]
    if squared > most * most:
        scale = most / math.sqrt(squared)
        for k in range(vector.size):
            vector[k] *= scale


@njit(types.void(VECTOR, VECTOR, types.float64, types.float64, OUT), cache=True, error_model="numpy")
def correct(wanted: Array, actual: Array, gain: float, most: float, out: Array) -> None:
    """Write the correction velocity of an error: gain (wanted - actual), its norm clipped to ``most``; (m,) each."""
    for k in range(out.size):
        out[k] = gain * (wanted[k] - actual[k])
    _clip(out, most)


@njit(types.void(MATRIX, types.float64, types.float64, OUT), cache=True, error_model="numpy")
def _beyond_a_quarter_turn(e: Array, angle: float, cosine: float, out: Array) -> None:
    r"""Write the rotation vector of a rotation ``e`` (3, 3) by ``angle`` [rad] of negative cosine.

    The antisymmetric part fades towards half a turn; there the axis a stands in the symmetric part:

    .. math:: \tfrac12 (E + E^T) - \cos\theta\, I = (1 - \cos\theta)\, a a^T
    """
    k = 0
    for i in range(1, 3):
        if e[i, i] > e[k, k]:
            k = i
    squared, along = 0.0, 0.0
    for i in range(3):
        out[i] = 0.5 * (e[i, k] + e[k, i]) + (-cosine if i == k else 0.0)
        squared += out[i] * out[i]
    along = out[0] * (e[2, 1] - e[1, 2]) + out[1] * (e[0, 2] - e[2, 0]) + out[2] * (e[1, 0] - e[0, 1])
    scale = math.copysign(angle, along) / math.sqrt(squared)
    for i in range(3):
        out[i] *= scale


@njit(types.void(MATRIX, OUT), cache=True, error_model="numpy")
def rotation_vector(e: Array, out: Array) -> None:
    """Write the rotation vector (3,) [rad] of a rotation matrix ``e`` (3, 3), its angle in [0, pi].

    Inside the compiled tick; elsewhere :func:`pinocchio.log3` serves, which gives the same to rounding.
    """
    out[0], out[1], out[2] = e[2, 1] - e[1, 2], e[0, 2] - e[2, 0], e[1, 0] - e[0, 1]
    sine = 0.5 * math.sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2])
    cosine = 0.5 * (e[0, 0] + e[1, 1] + e[2, 2] - 1.0)
    if cosine < 0.0:
        _beyond_a_quarter_turn(e, math.atan2(sine, cosine), cosine, out)
        return
    scale = 0.5 * math.atan2(sine, cosine) / sine if sine > NO_TURN else 0.5
    for k in range(3):
        out[k] *= scale


@njit(types.void(VECTOR, VECTOR, COLUMNS, OUT_ROWS), cache=True, error_model="numpy")
def _point_rows(placement: Array, carried: Array, world: Array, out: Array) -> None:
    """Write the Jacobian (3, nv) of a placement's origin."""
    x, y, z = placement[9], placement[10], placement[11]
    for j in range(out.shape[1]):
        a, b, c, s = world[3, j], world[4, j], world[5, j], carried[j]
        out[0, j] = s * (world[0, j] + b * z - c * y)
        out[1, j] = s * (world[1, j] + c * x - a * z)
        out[2, j] = s * (world[2, j] + a * y - b * x)


@njit(types.void(VECTOR, COLUMNS, OUT_ROWS), cache=True, error_model="numpy")
def _turn_rows(carried: Array, world: Array, out: Array) -> None:
    """Write the angular Jacobian (3, nv) of what a joint carries."""
    for k in range(3):
        for j in range(out.shape[1]):
            out[k, j] = carried[j] * world[3 + k, j]


@njit(types.void(OUT, OUT, types.float64), cache=True, error_model="numpy")
def _follow(wanted: Array, last: Array, most: float) -> None:
    """Move ``last`` (3,) towards ``wanted`` by at most ``most``, and ``wanted`` there; not where it is no number."""
    if not most < math.inf:
        return
    step, total = np.empty(3), 0.0
    for k in range(3):
        step[k] = wanted[k] - last[k]
        total += step[k]
    if not math.isfinite(total):
        return
    _clip(step, most)
    for k in range(3):
        last[k] += step[k]
        wanted[k] = last[k]


@njit(
    types.void(TABLE, MATRIX, MATRIX, MATRIX, MATRIX, COLUMNS, MATRIX, OUT_ROWS, OUT_ROWS, OUT),
    cache=True,
    error_model="numpy",
)
def evaluate_frames(
    table: Indices,
    gains: Array,
    references: Array,
    bias: Array,
    transforms: Array,
    world: Array,
    support: Array,
    corrections: Array,
    jacobian: Array,
    command: Array,
) -> None:
    """Write the rows of n tasks about frames into a block of rows.

    Args:
        table: shape (n, 4): first row in the block, frame, joint that carries it, and ``POSITION``, ``ORIENTATION`` or
            ``POSE``.
        gains: shape (n, 6): gain and largest correction of the position, the same of the orientation, acceleration
            gain, and by how much the position's correction may change from one evaluation to the next; infinite: by
            anything.
        references: shape (n, 24): position, rotation (row by row), velocity, acceleration (linear, then angular).
        bias: shape (n, 6) taken off the acceleration.
        transforms: shape (nframes, 12) placements of all frames: see :class:`robots.kinematics.Kinematics`.
        world: shape (6, nv) its ``world_jacobian``.
        support: shape (njoints, nv) its ``support``.
        corrections: shape (n, 3) the positions' corrections of the last evaluation; overwritten by these.
        jacobian: shape (m, nv), the tasks' rows are written.
        command: shape (m,) likewise.
    """
    turn, wanted = np.empty((3, 3)), np.empty(3)
    for i in range(table.shape[0]):
        row, placement, carried, kind = table[i, 0], transforms[table[i, 1]], support[table[i, 2]], table[i, 3]
        gain, reference = gains[i], references[i]
        if kind & POSITION:
            _point_rows(placement, carried, world, jacobian[row : row + 3])
            correct(reference[:3], placement[9:], gain[0], gain[1], wanted)
            _follow(wanted, corrections[i], gain[5])
            for k in range(3):
                command[row + k] = (
                    wanted[k] + reference[VELOCITY_AT + k] + (reference[ACCELERATION_AT + k] - bias[i, k]) / gain[4]
                )
            row += 3
        if kind & ORIENTATION:
            _turn_rows(carried, world, jacobian[row : row + 3])
            for r in range(3):
                for c in range(3):
                    turn[r, c] = 0.0
                    for k in range(3):
                        turn[r, c] += reference[3 + 3 * r + k] * placement[3 * k + c]
            rotation_vector(turn, wanted)
            for k in range(3):
                wanted[k] *= gain[2]
            _clip(wanted, gain[3])
            for k in range(3):
                command[row + k] = wanted[k] + reference[15 + k] + (reference[21 + k] - bias[i, 3 + k]) / gain[4]
