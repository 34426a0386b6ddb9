"""Compiled loops of a tick: the arithmetic that numpy would spread over many small calls."""

import math

import numpy as np
from numba import njit

from robots.messages import Array, Indices


@njit(cache=True)
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


@njit(cache=True)
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


@njit(cache=True)
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


@njit(cache=True)
def torque_cost(
    base: Array,
    torque: Array,
    jacobian: Array,
    bias: Array,
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
    ``previous`` (nj,) are the references of acceleration, wrench and torque. The energy term uses
    M q_dd = [J_cb^T F - h_b; torque + J_cj^T F - h_j], so the mass matrix is not needed again.
    """
    nj, nf = torque.shape[0], jacobian.shape[0]
    nx = nj + nf
    hessian[:] = 0.0
    gradient[:] = 0.0
    for a in range(nj):
        offset = torque[a, nx] - previous[a]
        for i in range(nx):
            t = w_rate * torque[a, i]
            gradient[i] += t * offset
            for j in range(i, nx):
                hessian[i, j] += t * torque[a, j]
        for j in range(a, nj):
            hessian[a, j] += w_energy * torque[a, j]
        for f in range(nf):
            hessian[a, nj + f] += w_energy * (torque[a, nj + f] + jacobian[f, 6 + a])
        gradient[a] += w_energy * (torque[a, nx] - bias[6 + a]) - w_acceleration * acceleration[6 + a]
        hessian[a, a] += w_acceleration
    _add_base_cost(base, jacobian, bias, acceleration, w_acceleration, w_energy, hessian, gradient)
    for f in range(nf):
        hessian[nj + f, nj + f] += wrench_weight[f]
        gradient[nj + f] -= wrench_weight[f] * wrench[f]
    for i in range(nx):
        for j in range(i):
            hessian[i, j] = hessian[j, i]


@njit(cache=True)
def _add_base_cost(
    base: Array,
    jacobian: Array,
    bias: Array,
    acceleration: Array,
    w_acceleration: float,
    w_energy: float,
    hessian: Array,
    gradient: Array,
) -> None:
    """The base's share of the acceleration and energy terms, into the upper triangle of ``hessian``."""
    nf = jacobian.shape[0]
    nx = base.shape[1] - 1
    nj = nx - nf
    for k in range(6):
        offset = w_acceleration * (base[k, nx] - acceleration[k]) - w_energy * bias[k]
        for i in range(nx):
            b = base[k, i]
            gradient[i] += b * offset
            for j in range(i, nx):
                hessian[i, j] += w_acceleration * b * base[k, j]
            for f in range(max(0, i - nj), nf):
                hessian[i, nj + f] += w_energy * b * jacobian[f, k]
