"""Triangular factors and products, compiled."""

import math

import numpy as np
from numba import types

from robots.kernel_types import MATRIX, ORDER_FREE, OUT, PLACES, njit
from robots.messages import Array, Indices


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def factorise(matrix: Array, factor: Array) -> bool:
    """Cholesky: ``matrix`` = U^T U, both (n, n). False where it is not positive definite or has a NaN.

    ``factor`` has U above its diagonal and U^T below it, so that rows of either are read from one end to the other.
    """
    n, total = matrix.shape[0], 0.0
    for i in range(n):
        for j in range(n):
            factor[i, j] = matrix[i, j]
            total += matrix[i, j]
    if not math.isfinite(total):
        return False
    for k in range(n):
        row = factor[k]
        if not row[k] > 0.0:
            return False
        scale = 1.0 / math.sqrt(row[k])
        for j in range(k, n):
            row[j] *= scale
        for i in range(k + 1, n):
            fraction, out, source = row[i], factor[i, i:], row[i:]
            for j in range(out.size):
                out[j] -= fraction * source[j]
    for i in range(n):
        for j in range(i):
            factor[i, j] = factor[j, i]
    return True


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def forward(factor: Array, x: Array) -> None:
    """U^-T x, in place."""
    for i in range(x.size):
        x[i] /= factor[i, i]
        fraction, row, rest = x[i], factor[i, i + 1 :], x[i + 1 :]
        for j in range(rest.size):
            rest[j] -= fraction * row[j]


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def backward(factor: Array, x: Array) -> None:
    """U^-1 x, in place."""
    for i in range(x.size - 1, -1, -1):
        x[i] /= factor[i, i]
        fraction, column, rest = x[i], factor[i, :i], x[:i]
        for j in range(rest.size):
            rest[j] -= fraction * column[j]


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def product(a: Array, b: Array) -> float:
    """Sum of products of two vectors."""
    total = 0.0
    for j in range(a.size):
        total += a[j] * b[j]
    return total


@njit(types.boolean(MATRIX, MATRIX, PLACES, OUT), cache=True, error_model="numpy", fastmath=ORDER_FREE)
def squared_lengths(hessian: Array, rows: Array, which: Indices, out: Array) -> bool:
    """Writes a^T H^-1 a, (k,), for the rows a that ``which`` (k,) picks from (m, n); H is (n, n).

    False where H is not positive definite.
    """
    n, k = hessian.shape[0], which.size
    factor, turned = np.empty((n, n)), np.empty((n, k))
    out[:] = 0.0
    if not factorise(hessian, factor):
        return False
    for c in range(k):
        for i in range(n):
            turned[i, c] = rows[which[c], i]
    for i in range(n):
        scale, done = 1.0 / factor[i, i], turned[i]
        for c in range(k):
            done[c] *= scale
            out[c] += done[c] * done[c]
        for j in range(i + 1, n):
            fraction, rest = factor[i, j], turned[j]
            for c in range(k):
                rest[c] -= fraction * done[c]
    return True
