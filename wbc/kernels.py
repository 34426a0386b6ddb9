"""Compiled arithmetic of DynWBC: what numpy would spread over many small calls."""

import math

import numpy as np
from numba import types

from robots.kernel_types import COLUMNS, MATRIX, ORDER_FREE, OUT, OUT_ROWS, PLACES, VECTOR, njit
from robots.messages import Array, Indices


@njit(types.float64(types.Array(types.float64, 2, "A", readonly=True), PLACES), cache=True)
def smallest_block_bound(inverse: Array, sizes: Indices) -> float:
    """Lower bound of the singular values of the diagonal blocks of a triangular matrix, from its inverse (m, m).

    A block R has no singular value below 1 / ||R^-1||_F; the smallest of these bounds over the blocks of ``sizes`` is
    returned. Only the upper triangle is read: LAPACK keeps other things below.
    """
    start, worst = 0, math.inf
    for size in sizes:
        total = 0.0
        for i in range(start, start + size):
            for j in range(i, start + size):
                total += inverse[i, j] * inverse[i, j]
        if size > 0:
            # not a number where the inverse overflowed: then nothing is certain
            worst = min(worst, 1.0 / math.sqrt(total)) if total > 0.0 else 0.0
        start += size
    return worst


@njit(types.void(COLUMNS, OUT_ROWS), cache=True)
def solve_six(matrix: Array, right: Array) -> None:
    """Solve A X = B in place of B (6, n) for the leading 6 x 6 block A of ``matrix``, by Cholesky."""
    factor = np.empty((6, 6))
    for i in range(6):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            factor[i, j] = math.sqrt(total) if i == j else total / factor[j, j]
    columns = right.shape[1]
    for i in range(6):
        for k in range(i):
            for j in range(columns):
                right[i, j] -= factor[i, k] * right[k, j]
        for j in range(columns):
            right[i, j] /= factor[i, i]
    for i in range(5, -1, -1):
        for k in range(i + 1, 6):
            for j in range(columns):
                right[i, j] -= factor[k, i] * right[k, j]
        for j in range(columns):
            right[i, j] /= factor[i, i]


@njit(types.void(COLUMNS, VECTOR, MATRIX, OUT_ROWS, OUT_ROWS), cache=True)
def eliminate_base(mass: Array, bias: Array, jacobian: Array, base: Array, torque: Array) -> None:
    """Base acceleration and joint torques as affine functions of x = [joint accelerations; contact wrenches].

    With the last column the constant part, writes ``base`` (6, nx + 1) and ``torque`` (nj, nx + 1):
    base = M_bb^-1 ([-M_bj, J_cb^T] x - h_b), torque = M_jb base + [M_jj, -J_cj^T] x + h_j. ``mass`` (nv, nv) is
    the mass matrix, ``bias`` (nv,) the bias forces, ``jacobian`` (nf, nv) that of the contacts.
    """
    nf = jacobian.shape[0]
    nj = mass.shape[0] - 6
    for i in range(6):
        base[i, :nj] = -mass[i, 6:]
        base[i, nj : nj + nf] = jacobian[:, i]
        base[i, nj + nf] = -bias[i]
    solve_six(mass, base)
    for a in range(nj):
        torque[a, :nj] = mass[6 + a, 6:]
        torque[a, nj : nj + nf] = -jacobian[:, 6 + a]
        torque[a, nj + nf] = bias[6 + a]
        for k in range(6):
            m = mass[6 + a, k]
            for j in range(base.shape[1]):
                torque[a, j] += m * base[k, j]


@njit(
    types.void(MATRIX, MATRIX, VECTOR, VECTOR, types.float64, OUT_ROWS, OUT),
    cache=True,
    error_model="numpy",
)
def _add_wrench_cost(
    base: Array,
    jacobian: Array,
    wrench: Array,
    wrench_weight: Array,
    w_energy: float,
    hessian: Array,
    gradient: Array,
) -> None:
    """Add the wrenches' own cost and their part of the energy term."""
    nf = jacobian.shape[0]
    nx = base.shape[1] - 1
    nj = nx - nf
    for f in range(nf):
        for k in range(6):
            w = w_energy * jacobian[f, k]
            for g in range(nf):
                hessian[nj + f, nj + g] += w * base[k, nj + g]
            gradient[nj + f] += w * base[k, nx]
        hessian[nj + f, nj + f] += wrench_weight[f]
        gradient[nj + f] -= wrench_weight[f] * wrench[f]


@njit(
    types.void(
        *(MATRIX, MATRIX, MATRIX, VECTOR, VECTOR, VECTOR, VECTOR),
        *(types.float64, types.float64, types.float64),
        *(OUT_ROWS, OUT),
    ),
    cache=True,
    error_model="numpy",
)
def torque_cost(
    base: Array,
    torque: Array,
    jacobian: Array,
    acceleration: Array,
    wrench: Array,
    previous: Array,
    wrench_weight: Array,
    w_acceleration: float,
    w_rate: float,
    w_energy: float,
    hessian: Array,
    gradient: Array,
) -> None:
    """Cost of eq. (16) of Lee et al. over x: writes ``hessian`` (nx, nx) and ``gradient`` (nx,).

    ``base`` and ``torque`` as :func:`eliminate_base` leaves them; ``acceleration`` (nv,), ``wrench`` (nf,) and
    ``previous`` (nj,) are the references of acceleration, wrench and torque. With the base eliminated, the energy term
    splits into one of the joints, whose mass matrix is T, the joints' part of ``torque``, and one of the wrenches:
    q_dd^T M q_dd = q_j^T T q_j + (J_cb^T F - h_b)^T M_bb^-1 (J_cb^T F - h_b).
    """
    nj, nf = torque.shape[0], jacobian.shape[0]
    nx = nj + nf
    residuals = np.empty((nj + 6, nx + 1))
    a, r = math.sqrt(w_acceleration), math.sqrt(w_rate)
    for i in range(nj):
        for j in range(nx + 1):
            residuals[i, j] = r * torque[i, j]
        residuals[i, nx] -= r * previous[i]
    for i in range(6):
        for j in range(nx + 1):
            residuals[nj + i, j] = a * base[i, j]
        residuals[nj + i, nx] -= a * acceleration[i]
    squares = np.dot(residuals.T, residuals)
    for i in range(nx):
        for j in range(nx):
            hessian[i, j] = squares[i, j]
        gradient[i] = squares[nx, i]
    for i in range(nj):
        for j in range(nj):
            hessian[i, j] += w_energy * torque[i, j]
        hessian[i, i] += w_acceleration
        gradient[i] -= w_acceleration * acceleration[6 + i]
    _add_wrench_cost(base, jacobian, wrench, wrench_weight, w_energy, hessian, gradient)
    for i in range(nx):
        for j in range(i):
            hessian[i, j] = hessian[j, i]


@njit(types.void(MATRIX, types.int64, VECTOR, VECTOR, OUT_ROWS, OUT, OUT), cache=True)
def limit_torques(
    torque: Array, first: int, usual_lower: Array, usual_upper: Array, rows: Array, lower: Array, upper: Array
) -> None:
    """Write the torques' rows and all bounds of a problem.

    Args:
        torque: shape (nj, nx + 1) joint torques as :func:`eliminate_base` leaves them.
        first: which of ``rows`` is that of the first torque.
        usual_lower: shape (nx + m,) bounds of x, then of the rows, for torques that are 0 at x = 0.
        usual_upper: likewise.
        rows: shape (m, nx); those of the torques are written.
        lower: shape (nx + m,), written.
        upper: likewise.
    """
    nj, nx = torque.shape[0], rows.shape[1]
    for i in range(lower.size):
        lower[i], upper[i] = usual_lower[i], usual_upper[i]
    for i in range(nj):
        for j in range(nx):
            rows[first + i, j] = torque[i, j]
        lower[nx + first + i] -= torque[i, nx]
        upper[nx + first + i] -= torque[i, nx]


@njit(types.void(MATRIX, MATRIX, VECTOR, OUT, OUT), cache=True, error_model="numpy", fastmath=ORDER_FREE)
def motion_and_torques(base: Array, torque: Array, x: Array, acceleration: Array, torques: Array) -> None:
    """What x (nx,) stands for: writes ``acceleration`` (6 + nj,) and ``torques`` (nj,).

    ``base`` (6, nx + 1) and ``torque`` (nj, nx + 1) as :func:`eliminate_base` leaves them.
    """
    nj, nx = torque.shape[0], x.size
    for i in range(6):
        total = base[i, nx]
        for j in range(nx):
            total += base[i, j] * x[j]
        acceleration[i] = total
    for i in range(nj):
        acceleration[6 + i] = x[i]
        total = torque[i, nx]
        for j in range(nx):
            total += torque[i, j] * x[j]
        torques[i] = total


@njit(types.void(MATRIX, PLACES, PLACES, COLUMNS, MATRIX, PLACES, OUT_ROWS), cache=True, error_model="numpy")
def local_jacobians(
    transforms: Array, frames: Indices, joints: Indices, world: Array, support: Array, feet: Indices, out: Array
) -> None:
    """Write the Jacobians (6 c, nv) of some of n frames in their own axes, one below the other.

    Args:
        transforms: shape (nframes, 12) placements of all frames: see :class:`robots.kinematics.Kinematics`.
        frames: shape (n,) frames.
        joints: shape (n,) the joint that carries each.
        world: shape (6, nv) ``world_jacobian`` of the kinematics.
        support: shape (njoints, nv) ``support`` of the kinematics.
        feet: shape (c,) which of the n frames.
        out: shape (6 c, nv), written.
    """
    nv = out.shape[1]
    for i in range(feet.size):
        foot = feet[i]
        t, carried = transforms[frames[foot]], support[joints[foot]]
        for j in range(nv):
            a, b, c = world[3, j], world[4, j], world[5, j]
            x = world[0, j] + b * t[11] - c * t[10]
            y = world[1, j] + c * t[9] - a * t[11]
            z = world[2, j] + a * t[10] - b * t[9]
            for k in range(3):
                u, v, w = carried[j] * t[3 * k], carried[j] * t[3 * k + 1], carried[j] * t[3 * k + 2]
                out[6 * i + k, j] = u * x + v * y + w * z
                out[6 * i + 3 + k, j] = u * a + v * b + w * c
