"""Compiled arithmetic of the base's filter: its matrices are nearly empty, which numpy cannot know."""

import numpy as np
from numba import types

from robots.kernel_types import MATRIX, OUT, OUT_ROWS, VECTOR, njit
from robots.messages import Array


@njit(cache=True, error_model="numpy")
def _put_cross(out: Array, row: int, column: int, v: Array, right: Array, scale: float) -> None:
    """Adds ``scale`` times skew(v) right to the (3, 3) block of ``out`` at ``row``, ``column``."""
    for j in range(3):
        x, y, z = right[0, j], right[1, j], right[2, j]
        out[row, column + j] += scale * (v[1] * z - v[2] * y)
        out[row + 1, column + j] += scale * (v[2] * x - v[0] * z)
        out[row + 2, column + j] += scale * (v[0] * y - v[1] * x)


@njit(cache=True, error_model="numpy")
def _times(left: Array, right: Array, out: Array) -> None:
    """Writes left right, a product of square matrices, of which ``left`` is nearly empty."""
    n = left.shape[0]
    out[:] = 0.0
    for i in range(n):
        for k in range(n):
            factor = left[i, k]
            if factor != 0.0:
                for j in range(n):
                    out[i, j] += factor * right[k, j]


@njit(
    types.void(OUT_ROWS, MATRIX, VECTOR, VECTOR, MATRIX, VECTOR, types.float64, types.float64, types.float64),
    cache=True,
    error_model="numpy",
)
def predict_covariance(
    covariance: Array,
    rotation: Array,
    velocity: Array,
    position: Array,
    soles: Array,
    densities: Array,
    gyro: float,
    gravity: float,
    dt: float,
) -> None:
    """Carry the covariance of the error over a step, in place.

    Args:
        covariance: shape (27, 27).
        rotation: shape (3, 3) of the IMU.
        velocity: shape (3,) of the IMU.
        position: shape (3,) of the IMU.
        soles: shape (2, 3) positions.
        densities: shape (27,) of the noise of each entry of the error, squared, but for the gyro's.
        gyro: density of the gyro's noise, squared.
        gravity: above 0 [m/s^2].
        dt: of the step [s].
    """
    n = covariance.shape[0]
    step, transition = np.zeros((n, n)), np.empty((n, n))
    # F dt, and the gyro's noise, which comes in where its bias does
    for i in range(3):
        for j in range(3):
            step[i, 9 + j] = step[3 + i, 12 + j] = -dt * rotation[i, j]
        step[6 + i, 3 + i] = dt
    step[3, 1], step[4, 0] = dt * gravity, -dt * gravity
    _put_cross(step, 3, 9, velocity, rotation, -dt)
    _put_cross(step, 6, 9, position, rotation, -dt)
    for foot in range(2):
        _put_cross(step, 15 + 6 * foot, 9, soles[foot], rotation, -dt)
    _times(step, step, transition)
    for i in range(n):
        for j in range(n):
            transition[i, j] = step[i, j] + 0.5 * transition[i, j]
        transition[i, i] += 1.0
    half, turned = np.empty((n, n)), np.empty((n, n))
    _times(transition, covariance, half)
    for i in range(n):
        for j in range(n):
            turned[j, i] = half[i, j]
    # (Phi P Phi^T)^T = Phi (Phi P)^T, and it is symmetric
    _times(transition, turned, covariance)
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(3):
                total += step[i, 9 + k] * step[j, 9 + k]
            covariance[i, j] += gyro / dt * total
        covariance[i, i] += dt * densities[i]


@njit(types.void(OUT_ROWS, MATRIX, VECTOR, VECTOR, OUT), cache=True, error_model="numpy")
def correct_covariance(covariance: Array, rows: Array, residuals: Array, variances: Array, error: Array) -> None:
    """Kalman's correction by measurements with independent noise, one after the other.

    Args:
        covariance: shape (n, n), corrected in place.
        rows: shape (m, n), H.
        residuals: shape (m,) innovations.
        variances: shape (m,) of their noise.
        error: shape (n,), written: the error that is to be taken off the estimate.
    """
    n = covariance.shape[0]
    error[:] = 0.0
    cross = np.empty(n)
    for i in range(residuals.size):
        cross[:] = 0.0
        left = residuals[i]
        for k in range(n):
            factor = rows[i, k]
            if factor != 0.0:
                left -= factor * error[k]
                for j in range(n):
                    cross[j] += factor * covariance[k, j]
        spread = variances[i]
        for k in range(n):
            spread += rows[i, k] * cross[k]
        for j in range(n):
            gain = cross[j] / spread
            error[j] += gain * left
            for k in range(n):
                covariance[j, k] -= gain * cross[k]
