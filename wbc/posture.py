"""The posture below all levels of :mod:`wbc.damped_priorities`, in the coordinates that these leave; compiled."""

import numpy as np
from numba import types

from robots.kernel_types import ORDER_FREE, OUT, OUT_ROWS, njit
from robots.messages import Array
from wbc.triangular import backward, factorise, forward

RIDGE = 1e-9
"""rho, on directions that move no joint: the posture leaves them alone."""


@njit(types.void(OUT_ROWS, OUT, types.int64, OUT), cache=True, error_model="numpy", fastmath=ORDER_FREE)
def project(directions: Array, fractions: Array, count: int, row: Array) -> None:
    """Row times Z, in place: takes off the fraction of each of the ``count`` directions, the first first."""
    for d in range(count):
        direction, along = directions[d], 0.0
        for j in range(row.size):
            along += direction[j] * row[j]
        along *= fractions[d]
        for j in range(row.size):
            row[j] -= along * direction[j]


@njit(types.void(OUT_ROWS, OUT, types.int64, OUT), cache=True, error_model="numpy", fastmath=ORDER_FREE)
def move(directions: Array, fractions: Array, count: int, step: Array) -> None:
    """Z times a step, in place: takes off the fraction of each of the ``count`` directions, the last first."""
    for d in range(count - 1, -1, -1):
        direction, along = directions[d], 0.0
        for j in range(step.size):
            along += direction[j] * step[j]
        along *= fractions[d]
        for j in range(step.size):
            step[j] -= along * direction[j]


@njit(types.void(OUT_ROWS, OUT, types.int64, OUT, OUT), cache=True, error_model="numpy")
def add_posture(directions: Array, fractions: Array, count: int, residual: Array, velocity: Array) -> None:
    """The posture's step where no direction is damped.

    Its normal equations (S N)^T S N + rho with N = I - Q^T Q are solved through the base's few columns B of Q:
    x = N (S^T r + b) / (1 + rho), (B^T B + rho) b = base of N S^T r.
    """
    nv = velocity.size
    base = nv - residual.size
    step, push = np.zeros(nv), np.zeros(nv)
    step[base:] = residual
    project(directions, fractions, count, step)
    used, factor = np.zeros((base, base)), np.empty((base, base))
    for d in range(count):
        for i in range(base):
            for j in range(base):
                used[i, j] += directions[d, i] * directions[d, j]
    for i in range(base):
        used[i, i] += RIDGE
        push[i] = step[i]
    if factorise(used, factor):
        forward(factor, push[:base])
        backward(factor, push[:base])
        project(directions, fractions, count, push)
        for j in range(nv):
            step[j] += push[j]
    for j in range(nv):
        velocity[j] += step[j] / (1.0 + RIDGE)


@njit(types.void(OUT_ROWS, OUT, types.int64, OUT, OUT), cache=True, error_model="numpy", fastmath=ORDER_FREE)
def add_damped_posture(directions: Array, fractions: Array, count: int, residual: Array, velocity: Array) -> None:
    """The posture's step where some directions are damped: the normal equations of this module's last formula."""
    nv, nj = velocity.size, residual.size
    rows, wanted = np.zeros((nj + count, nv)), np.zeros(nj + count)
    wanted[:nj] = residual
    for i in range(nj):
        rows[i, nv - nj + i] = 1.0
        project(directions, fractions, count, rows[i])
    for d in range(count):
        for j in range(nv):
            rows[nj + d, j] = fractions[d] * directions[d, j]
    normal, step, factor = np.dot(rows.T, rows), np.dot(rows.T, wanted), np.empty((nv, nv))
    for i in range(nv):
        normal[i, i] += RIDGE
    if factorise(normal, factor):
        forward(factor, step)
        backward(factor, step)
        # and with it goes what rounding left along directions that are used as a whole
        move(directions, fractions, count, step)
        for j in range(nv):
            velocity[j] += step[j]
