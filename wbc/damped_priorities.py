r"""Prioritised velocities that are continuous at singularities.

Each level's projected Jacobian :math:`J_i Z_{i-1} = U \Sigma V^T` is inverted with its small singular values damped,
and leaves to the levels below what it does not use itself:

.. math:: \dot q_i = \dot q_{i-1} + Z_{i-1} V g(\Sigma) U^T (\dot x_i - J_i \dot q_{i-1}),\quad
    g(\sigma) = \frac{\sigma}{\max(\sigma, \sigma_d)^2},\quad
    Z_i = Z_{i-1} \left(I - V s(\Sigma) V^T\right),\quad s(\sigma) = \min\left(1, (\sigma/\sigma_d)^2\right)

:math:`g` is the damped inverse :math:`\sigma / (\sigma^2 + \lambda^2)`, taken singular value by singular value as by
Maciejewski and Klein (J. Robotic Systems 5, 1988), with the damping that fades in below a threshold of Chiaverini,
Siciliano and Egeland (IEEE Trans. Control Systems Technology 2, 1994),
:math:`\lambda^2 = (1 - (\sigma / \sigma_d)^2) \lambda_{max}^2`, for :math:`\lambda_{max} = \sigma_d`. Both g and s
are continuous and vanish at 0, so the velocity is a continuous function of Jacobians and commands, whatever their rank;
with a cut (eq. (13) of Lee et al. as :func:`wbc.kinwbc.prioritised_velocity` has it) it jumps wherever a singular value
passes the cut.

Where all singular values are at least :math:`\sigma_d` this is eq. (13) of Lee et al. exactly. Elsewhere

- no direction gets more than its residual over :math:`\sigma_d`: :math:`g(\sigma) \le 1/\sigma_d`;
- a level moves by the fraction s of its residual along a damped direction, and the levels below move it along there by
  at most :math:`\sigma (1 - s) \le \tfrac{2}{3\sqrt 3} \sigma_d` times the norm of their own step in the coordinates of
  Z.

The posture, where it is the last level, asks for joint velocities, one each. It is met in the least squares sense,

.. math:: \min_y \|S Z y - r\|^2 + \sum_j s_j^2 (v_j^T y)^2 + \rho \|y\|^2

with S the choice of the joints and r what is left to do. The sum goes over all directions :math:`v_j` that the levels
above use: it changes nothing where they use them as a whole, and keeps the velocity continuous where one becomes free.
"""

import math
from collections.abc import Sequence

import numpy as np
from numba import types

from robots.kernel_types import MATRIX, ORDER_FREE, OUT, OUT_ROWS, PLACES, VECTOR, njit
from robots.messages import Array, Indices
from wbc.posture import add_damped_posture, add_posture, move, project

SWEEPS = 10
"""Passes over all pairs of rows while they are made orthogonal; convergence is quadratic, 5 or 6 are usual."""

ORTHOGONAL = 1e-15
"""Cosine of the angle at which two rows count as orthogonal."""

UNUSED = 1e-16
"""Fraction of a direction below which it counts as left to the levels below as a whole."""


def damped_velocity(
    levels: Sequence[tuple[Array, Array]], nv: int, damped_below: Sequence[float] | Array, posture: Array | None = None
) -> Array:
    """Generalised velocity (nv,) of prioritised levels: see this module.

    Args:
        levels: highest priority first; Jacobians (m_i, nv) and commanded velocities (m_i,).
        nv: size of the velocity.
        damped_below: threshold of each level's singular values [m or 1, as its rows], above 0.
        posture: shape (nj,) commanded velocities of the last nj entries, below all levels; ``None``: none.
    """
    sizes = np.array([command.size for _, command in levels], dtype=np.int64)
    jacobian = np.concatenate([np.zeros((0, nv)), *(jacobian for jacobian, _ in levels)])
    command = np.concatenate([np.zeros(0), *(command for _, command in levels)])
    thresholds = np.asarray(damped_below, dtype=float)
    return solve_levels(jacobian, command, sizes, thresholds, np.zeros(0) if posture is None else posture)


@njit(types.boolean(VECTOR, types.int64), cache=True, error_model="numpy")
def _any_damped(fractions: Array, count: int) -> bool:
    """Whether one of the ``count`` directions is not used as a whole."""
    for d in range(count):
        if fractions[d] < 1.0:
            return True
    return False


@njit(types.boolean(OUT_ROWS, types.float64), cache=True, error_model="numpy")
def _certainly_above(low: Array, threshold: float) -> bool:
    """Whether no singular value of a lower triangular matrix (m, m) is below ``threshold``; False proves nothing.

    With G = L L^T the smallest is at least 1 / sqrt(||G^-1||_F).
    """
    m = low.shape[0]
    inverse, trace = np.zeros((m, m)), 0.0
    for c in range(m):
        for i in range(c, m):
            value = 1.0 if i == c else 0.0
            for k in range(c, i):
                value -= low[i, k] * inverse[k, c]
            inverse[i, c] = value / low[i, i]
            trace += inverse[i, c] * inverse[i, c]
    limit = 1.0 / (threshold * threshold)
    if trace < limit:
        return True
    total = 0.0
    for a in range(m):
        for b in range(m):
            value = 0.0
            for k in range(max(a, b), m):
                value += inverse[k, a] * inverse[k, b]
            total += value * value
    return total < limit * limit


@njit(types.boolean(OUT_ROWS, OUT, types.float64, OUT_ROWS), cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _solve_regular(rows: Array, residual: Array, threshold: float, basis: Array) -> bool:
    """Try a level whose singular values are all above the threshold: Gram and Schmidt, then forward substitution.

    Writes an orthonormal basis (m, nv) of the ``rows`` (m, nv) and, in place of ``residual`` (m,), the step's
    coordinates in it. False, with ``residual`` as it was, where it is not certain that all are above.
    """
    m, nv = rows.shape
    low = np.zeros((m, m))
    for i in range(m):
        row = basis[i]
        for j in range(nv):
            row[j] = rows[i, j]
        for k in range(i):
            other, along = basis[k], 0.0
            for j in range(nv):
                along += other[j] * row[j]
            for j in range(nv):
                row[j] -= along * other[j]
            low[i, k] = along
        squared = 0.0
        for j in range(nv):
            squared += row[j] * row[j]
        low[i, i] = math.sqrt(squared)
        # no singular value is above the smallest pivot
        if not low[i, i] > threshold:
            return False
        for j in range(nv):
            row[j] /= low[i, i]
    if not _certainly_above(low, threshold):
        return False
    for i in range(m):
        for k in range(i):
            residual[i] -= low[i, k] * residual[k]
        residual[i] /= low[i, i]
    return True


@njit(types.void(OUT_ROWS, OUT), cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _orthogonalise(rows: Array, residual: Array) -> None:
    """Turn rows (m, nv) and what they ask for (m,) so that the rows are orthogonal: U^T J and U^T r of an SVD.

    One-sided Jacobi rotations after Hestenes (SIAM J. 6, 1958); small rows come out with all their digits.
    """
    m, nv = rows.shape
    for _ in range(SWEEPS):
        turned = False
        for a in range(m - 1):
            for b in range(a + 1, m):
                p, q = rows[a], rows[b]
                pp, qq, pq = 0.0, 0.0, 0.0
                for j in range(nv):
                    pp += p[j] * p[j]
                    qq += q[j] * q[j]
                    pq += p[j] * q[j]
                if not abs(pq) > ORTHOGONAL * math.sqrt(pp) * math.sqrt(qq):
                    continue
                turned = True
                half = (qq - pp) / (2.0 * pq)
                tangent = math.copysign(1.0, half) / (abs(half) + math.hypot(1.0, half))
                cosine = 1.0 / math.hypot(1.0, tangent)
                sine = cosine * tangent
                for j in range(nv):
                    x, y = p[j], q[j]
                    p[j], q[j] = cosine * x - sine * y, sine * x + cosine * y
                x, y = residual[a], residual[b]
                residual[a], residual[b] = cosine * x - sine * y, sine * x + cosine * y
        if not turned:
            return


@njit(
    types.int64(OUT_ROWS, OUT, types.float64, OUT_ROWS, OUT, types.int64, OUT),
    cache=True,
    error_model="numpy",
    fastmath=ORDER_FREE,
)
def _solve_damped(
    rows: Array, residual: Array, threshold: float, directions: Array, fractions: Array, count: int, step: Array
) -> int:
    """A level any of whose singular values may be small: adds to ``step`` (nv,), and the directions that it uses.

    ``rows`` (m, nv) and ``residual`` (m,) are overwritten. Returns how many directions there are then.
    """
    _orthogonalise(rows, residual)
    for i in range(rows.shape[0]):
        row, squared = rows[i], 0.0
        for j in range(row.size):
            squared += row[j] * row[j]
        # g(sigma) r v with v = row / sigma: nothing is divided by sigma
        along = residual[i] / max(squared, threshold * threshold)
        for j in range(row.size):
            step[j] += along * row[j]
        fraction = min(1.0, squared / (threshold * threshold))
        if fraction > UNUSED:
            sigma = math.sqrt(squared)
            for j in range(row.size):
                directions[count, j] = row[j] / sigma
            fractions[count] = fraction
            count += 1
    return count


@njit(
    types.int64(MATRIX, VECTOR, types.float64, OUT_ROWS, OUT, types.int64, OUT),
    cache=True,
    error_model="numpy",
    fastmath=ORDER_FREE,
)
def _add_level(
    jacobian: Array, command: Array, threshold: float, directions: Array, fractions: Array, count: int, velocity: Array
) -> int:
    """Add one level's step to ``velocity`` (nv,), and the directions that it uses; returns how many there are then."""
    size, nv = jacobian.shape
    rows, residual, step = np.empty((size, nv)), np.empty(size), np.zeros(nv)
    for i in range(size):
        source, row, moved = jacobian[i], rows[i], 0.0
        for j in range(nv):
            row[j] = source[j]
            moved += source[j] * velocity[j]
        residual[i] = command[i] - moved
        project(directions, fractions, count, row)
    used = count
    if _solve_regular(rows, residual, threshold, directions[count : count + size]):
        for i in range(size):
            fractions[count + i] = 1.0
            row = directions[count + i]
            for j in range(nv):
                step[j] += residual[i] * row[j]
        used += size
    else:
        used = _solve_damped(rows, residual, threshold, directions, fractions, count, step)
    # a step has no part along directions that are used as a whole
    if _any_damped(fractions, count):
        move(directions, fractions, count, step)
    for j in range(nv):
        velocity[j] += step[j]
    return used


@njit(types.float64[::1](MATRIX, VECTOR, PLACES, VECTOR, VECTOR), cache=True, error_model="numpy", fastmath=ORDER_FREE)
def solve_levels(jacobian: Array, command: Array, sizes: Indices, thresholds: Array, posture: Array) -> Array:
    """Velocity (nv,), new, of stacked levels: see this module.

    Args:
        jacobian: shape (m, nv) rows of all levels, highest priority first.
        command: shape (m,) commanded velocities.
        sizes: shape (l,) rows of each level.
        thresholds: shape (l,) singular values below are damped, above 0.
        posture: shape (nj,) commanded velocities of the last nj entries; none: there is no posture.
    """
    m, nv = jacobian.shape
    velocity, directions, fractions = np.zeros(nv), np.empty((m, nv)), np.empty(m)
    count, start = 0, 0
    for level in range(sizes.size):
        rows = slice(start, start + sizes[level])
        count = _add_level(jacobian[rows], command[rows], thresholds[level], directions, fractions, count, velocity)
        start += sizes[level]
    if posture.size:
        left = posture - velocity[nv - posture.size :]
        if _any_damped(fractions, count):
            add_damped_posture(directions, fractions, count, left, velocity)
        else:
            add_posture(directions, fractions, count, left, velocity)
    return velocity
