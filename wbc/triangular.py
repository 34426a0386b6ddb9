"""Triangular factors and products, compiled."""

import math

from numba import njit

from robots.kernel_types import ORDER_FREE
from robots.messages import Array


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def factorise(matrix: Array, factor: Array) -> bool:
    """Cholesky: ``matrix`` = U^T U, both (n, n). False where it is not positive definite or has a NaN."""
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
            share, out, source = row[i], factor[i, i:], row[i:]
            for j in range(out.size):
                out[j] -= share * source[j]
    return True


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def forward(factor: Array, x: Array) -> None:
    """U^-T x, in place."""
    for i in range(x.size):
        x[i] /= factor[i, i]
        share, row, rest = x[i], factor[i, i + 1 :], x[i + 1 :]
        for j in range(rest.size):
            rest[j] -= share * row[j]


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def backward(factor: Array, x: Array) -> None:
    """U^-1 x, in place."""
    for i in range(x.size - 1, -1, -1):
        row, rest, total = factor[i, i + 1 :], x[i + 1 :], 0.0
        for j in range(rest.size):
            total += row[j] * rest[j]
        x[i] = (x[i] - total) / factor[i, i]


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def product(a: Array, b: Array) -> float:
    """Sum of products of two vectors."""
    total = 0.0
    for j in range(a.size):
        total += a[j] * b[j]
    return total
