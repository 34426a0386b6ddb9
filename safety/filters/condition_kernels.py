"""Compiled passes over conditions A v >= b, for the working set and the resolutions of a filter."""

import numpy as np
from numba import types

from robots.kernel_types import MATRIX, ORDER_FREE, VECTOR, njit
from robots.messages import Array, Indices, Mask


@njit(
    types.boolean(MATRIX, VECTOR, VECTOR, types.float64, types.boolean[::1], types.float64[::1]),
    cache=True,
    error_model="numpy",
    fastmath=ORDER_FREE,
)
def add_violated(A: Array, v: Array, b: Array, beyond: float, chosen: Mask, out: Array) -> bool:
    """Writes :func:`room` to ``out`` (n,), and adds to ``chosen`` (n,) the rows violated by more than ``beyond``.

    Returns:
        Whether there were any that had not been chosen before.
    """
    added = False
    for i in range(b.size):
        value = 0.0
        for k in range(v.size):
            value += A[i, k] * v[k]
        out[i] = value - b[i]
        if out[i] < -beyond and not chosen[i]:
            chosen[i] = added = True
    return added


@njit(types.int64[::1](MATRIX, VECTOR, VECTOR, VECTOR, types.float64, types.float64), cache=True, error_model="numpy")
def near_zero_rows(A: Array, b: Array, lower: Array, upper: Array, reach: float, gain: float) -> Indices:
    """Conditions A (n, nv), b (n,) that no input between its bounds (nv,) meets, nor eases to speak of; ascending.

    Between the bounds a row's value spans at most ``reach`` times the range of the widest of them, and at most ``gain``
    times what it is short of at its best. Where such rows are left out, the root of the sum of squared violations is
    therefore at most 1 + ``gain`` times the least: each is short of at most that times its best, and the others' least
    is not larger without them.
    """
    out, count, widest = np.empty(b.size, np.int64), 0, 0.0
    for k in range(lower.size):
        widest = max(widest, upper[k] - lower[k])
    for i in range(b.size):
        span, best = 0.0, 0.0
        for k in range(lower.size):
            low, high = A[i, k] * lower[k], A[i, k] * upper[k]
            span += abs(high - low)
            best += max(low, high)
            if span > reach * widest:
                break
        if span <= reach * widest and span <= gain * (b[i] - best):
            out[count] = i
            count += 1
    return out[:count]


@njit(types.float64(MATRIX, VECTOR, VECTOR, VECTOR, VECTOR), cache=True, error_model="numpy")
def least_violation(A: Array, b: Array, lower: Array, upper: Array, short: Array) -> float:
    """A bound from below on the largest violation by any input between its bounds (nv,); above 0 only for a conflict.

    Weighted by the violations that a compromise has, ``short`` (n,) where it is above 0, the conditions A (n, nv),
    b (n,) add up to one; what that one is short of at best is an average of theirs (Farkas).
    """
    row, demand, weights = np.zeros(lower.size), 0.0, 0.0
    for i in range(b.size):
        if short[i] > 0.0:
            weights += short[i]
            demand += short[i] * b[i]
            for k in range(lower.size):
                row[k] += short[i] * A[i, k]
    for k in range(lower.size):
        demand -= max(row[k] * lower[k], row[k] * upper[k])
    return demand / weights if weights > 0.0 else 0.0


@njit(
    types.float64[::1](VECTOR, VECTOR, MATRIX, VECTOR, VECTOR, VECTOR),
    cache=True,
    error_model="numpy",
    fastmath=ORDER_FREE,
)
def issf_demand(h: Array, dh_dt: Array, jac: Array, alpha: Array, margin: Array, epsilon: Array) -> Array:
    """What the ISSf condition asks of J_i v: alpha (margin - h) - dh_dt + |J|^2 / epsilon, (n,), new; jac (n, nv)."""
    out = np.empty(h.size)
    for i in range(h.size):
        squared = 0.0
        for k in range(jac.shape[1]):
            squared += jac[i, k] * jac[i, k]
        out[i] = alpha[i] * (margin[i] - h[i]) - dh_dt[i] + squared / epsilon[i]
    return out
