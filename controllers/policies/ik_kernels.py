"""Compiled inverse kinematics: points of a tree of revolute joints to their goals, within the joints' limits."""

import math

import numpy as np
from numba import types

from robots.kernel_types import MATRIX, OUT, PLACES, TYPES, VECTOR, njit
from robots.messages import Array, Indices

OUT_MATRIX = types.float64[:, ::1]
OUT_TENSOR = types.float64[:, :, ::1]
TENSOR = TYPES.Array(types.float64, 3, "C", readonly=True)


@njit(types.void(VECTOR, PLACES, TENSOR, MATRIX, MATRIX, OUT_TENSOR, OUT_MATRIX), cache=True, error_model="numpy")
def place_joints(
    q: Array, parents: Indices, turns: Array, shifts: Array, axes: Array, rotations: Array, origins: Array
) -> None:
    """Write rotations (n, 3, 3) and origins (n, 3) of the joints' frames.

    Args:
        q: shape (n,) angles [rad].
        parents: shape (n,) joint that carries each, an earlier one; -1 for none.
        turns: shape (n, 3, 3) of each frame in its parent's, at angle zero.
        shifts: shape (n, 3) of its origin there [m].
        axes: shape (n, 3), of unit length, in its own frame.
        rotations: written.
        origins: written [m].
    """
    own, turned = np.empty((3, 3)), np.empty((3, 3))
    for i in range(q.size):
        c, s = math.cos(q[i]), math.sin(q[i])
        x, y, z = axes[i, 0], axes[i, 1], axes[i, 2]
        u = 1.0 - c
        own[0, 0], own[0, 1], own[0, 2] = c + u * x * x, u * x * y - s * z, u * x * z + s * y
        own[1, 0], own[1, 1], own[1, 2] = u * x * y + s * z, c + u * y * y, u * y * z - s * x
        own[2, 0], own[2, 1], own[2, 2] = u * x * z - s * y, u * y * z + s * x, c + u * z * z
        for a in range(3):
            for b in range(3):
                turned[a, b] = turns[i, a, 0] * own[0, b] + turns[i, a, 1] * own[1, b] + turns[i, a, 2] * own[2, b]
        p = parents[i]
        if p < 0:
            rotations[i], origins[i] = turned, shifts[i]
            continue
        for a in range(3):
            origins[i, a] = origins[p, a]
            for k in range(3):
                origins[i, a] += rotations[p, a, k] * shifts[i, k]
            for b in range(3):
                rotations[i, a, b] = (
                    rotations[p, a, 0] * turned[0, b]
                    + rotations[p, a, 1] * turned[1, b]
                    + rotations[p, a, 2] * turned[2, b]
                )


@njit(types.float64(TENSOR, MATRIX, PLACES, MATRIX, MATRIX, OUT), cache=True, error_model="numpy")
def point_errors(
    rotations: Array, origins: Array, carriers: Indices, offsets: Array, goals: Array, errors: Array
) -> float:
    """Write goals less places (3 m,) of m points; returns the sum of squares [m^2]."""
    total = 0.0
    for k in range(carriers.size):
        j = carriers[k]
        for a in range(3):
            place = origins[j, a]
            for b in range(3):
                place += rotations[j, a, b] * offsets[k, b]
            errors[3 * k + a] = goals[k, a] - place
            total += errors[3 * k + a] ** 2
    return total


@njit(
    types.void(PLACES, MATRIX, TENSOR, MATRIX, PLACES, MATRIX, OUT, OUT_MATRIX),
    cache=True,
    error_model="numpy",
)
def point_jacobian(
    parents: Indices,
    axes: Array,
    rotations: Array,
    origins: Array,
    carriers: Indices,
    places: Array,
    axis: Array,
    jacobian: Array,
) -> None:
    """Write the Jacobian (3 m, n) of m points at ``places`` (m, 3), carried by joints; ``axis`` (3,) is scratch."""
    jacobian[:] = 0.0
    for k in range(carriers.size):
        j = carriers[k]
        while j >= 0:
            for a in range(3):
                axis[a] = (
                    rotations[j, a, 0] * axes[j, 0] + rotations[j, a, 1] * axes[j, 1] + rotations[j, a, 2] * axes[j, 2]
                )
            rx, ry, rz = places[k, 0] - origins[j, 0], places[k, 1] - origins[j, 1], places[k, 2] - origins[j, 2]
            jacobian[3 * k, j] = axis[1] * rz - axis[2] * ry
            jacobian[3 * k + 1, j] = axis[2] * rx - axis[0] * rz
            jacobian[3 * k + 2, j] = axis[0] * ry - axis[1] * rx
            j = parents[j]


@njit(
    types.int64(
        OUT, VECTOR, VECTOR, PLACES, TENSOR, MATRIX, MATRIX, PLACES, MATRIX, MATRIX, types.float64, types.int64
    ),
    cache=True,
    error_model="numpy",
)
def reach(
    q: Array,
    lower: Array,
    upper: Array,
    parents: Indices,
    turns: Array,
    shifts: Array,
    axes: Array,
    carriers: Indices,
    offsets: Array,
    goals: Array,
    tolerance: float,
    most: int,
) -> int:
    """Move ``q`` (n,) in place so that points come to their goals, within limits; returns the steps that were tried.

    Levenberg-Marquardt on the joints that are not held by a limit; ends where every error is below ``tolerance`` [m],
    where nothing gets better, or after ``most`` steps.
    """
    n, m = q.size, 3 * carriers.size
    rotations, origins = np.empty((n, 3, 3)), np.empty((n, 3))
    errors, trial_errors, jacobian = np.empty(m), np.empty(m), np.empty((m, n))
    places, axis, trial = np.empty((carriers.size, 3)), np.empty(3), np.empty(n)
    normal = np.empty((m, m))
    place_joints(q, parents, turns, shifts, axes, rotations, origins)
    cost = point_errors(rotations, origins, carriers, offsets, goals, errors)
    damping = 1e-6
    for step in range(most):
        if np.abs(errors).max() < tolerance:
            return step
        for k in range(carriers.size):
            for a in range(3):
                places[k, a] = goals[k, a] - errors[3 * k + a]
        point_jacobian(parents, axes, rotations, origins, carriers, places, axis, jacobian)
        for j in range(n):
            gradient = 0.0
            for i in range(m):
                gradient += jacobian[i, j] * errors[i]
            if (q[j] <= lower[j] and gradient < 0.0) or (q[j] >= upper[j] and gradient > 0.0):
                jacobian[:, j] = 0.0
        better = False
        while damping < 1e3:
            normal[:] = jacobian @ jacobian.T
            for i in range(m):
                normal[i, i] += damping
            move = jacobian.T @ np.linalg.solve(normal, errors)
            for j in range(n):
                trial[j] = min(max(q[j] + min(max(move[j], -1.0), 1.0), lower[j]), upper[j])
            place_joints(trial, parents, turns, shifts, axes, rotations, origins)
            found = point_errors(rotations, origins, carriers, offsets, goals, trial_errors)
            if found < cost * (1.0 - 1e-9):
                better = True
                break
            damping *= 10.0
        if not better:
            return step + 1
        damping = max(1e-6, 0.1 * damping)
        cost = found
        q[:], errors[:] = trial, trial_errors
    return most
