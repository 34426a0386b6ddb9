"""Newton steps towards the least sum of squared violations, compiled, for :mod:`wbc.least_slack`."""

import math
from typing import NamedTuple

import numpy as np
from numba import types

from robots.kernel_types import MATRIX, ORDER_FREE, OUT, TYPES, VECTOR, njit
from robots.messages import Array, Indices, Mask
from wbc.active_set import OPTIMAL, SPENT, UNKNOWN, search

TRIALS = 30
"""Step lengths tried along one of them."""

DEFINITE = 1e-14
"""Fraction of the largest curvature that is added in every direction where rounding leaves the cost indefinite."""

FLAT = 1e-9
"""Fraction of its value at a step's start to which the slope of the cost has to fall at its end."""

STILL = 1e-10
"""A step shorter than this, over 1 + the size of the point, is the last."""


class Violated(NamedTuple):
    """The cost of the rows that are violated, half of x^T matrix x + 2 vector^T x; which they are: seen, (k,)."""

    matrix: Array
    vector: Array
    seen: Mask


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _violation(rows: Array, demand: Array, x: Array, out: Array) -> None:
    """Writes demand - rows x."""
    for i in range(demand.size):
        value = 0.0
        for j in range(x.size):
            value += rows[i, j] * x[j]
        out[i] = demand[i] - value


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _find_changed(short: Array, weights: Array, seen: Mask, changed: Indices, signed: Array) -> int:
    """Write which rows have become violated or no longer are, with their weight or minus it; how many there are.

    ``seen`` tells which were violated before, and is brought up to date.
    """
    count = 0
    for i in range(short.size):
        if (short[i] > 0.0) != seen[i]:
            seen[i] = not seen[i]
            changed[count], signed[count] = i, weights[i] if seen[i] else -weights[i]
            count += 1
    return count


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _count_in(rows: Array, demand: Array, changed: Indices, signed: Array, matrix: Array, vector: Array) -> None:
    """Add w a a^T and -w b a of rows a x >= b that have changed to the cost of the violated rows.

    Four at a time: the matrix is read and written less often.
    """
    n, count = vector.size, changed.size
    for first in range(0, count, 4):
        i0, w0 = changed[first], signed[first]
        i1, w1 = (changed[first + 1], signed[first + 1]) if first + 1 < count else (i0, 0.0)
        i2, w2 = (changed[first + 2], signed[first + 2]) if first + 2 < count else (i0, 0.0)
        i3, w3 = (changed[first + 3], signed[first + 3]) if first + 3 < count else (i0, 0.0)
        for j in range(n):
            s0, s1, s2, s3 = w0 * rows[i0, j], w1 * rows[i1, j], w2 * rows[i2, j], w3 * rows[i3, j]
            vector[j] -= s0 * demand[i0] + s1 * demand[i1] + s2 * demand[i2] + s3 * demand[i3]
            for k in range(n):
                matrix[j, k] += s0 * rows[i0, k] + s1 * rows[i1, k] + s2 * rows[i2, k] + s3 * rows[i3, k]


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _slope(short: Array, rate: Array, weights: Array, t: float) -> tuple[float, float]:
    """First and second derivative of half the weighted sum of squared violations after a fraction t of a step."""
    first, second = 0.0, 0.0
    for i in range(short.size):
        left = short[i] - t * rate[i]
        fraction = weights[i] * rate[i] if left > 0.0 else 0.0
        first -= fraction * left
        second += fraction * rate[i]
    return first, second


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _length(first: float, second: float, short: Array, rate: Array, weights: Array) -> float:
    """The fraction, 1 at most, of a step at which the cost is least.

    ``first`` and ``second`` are the derivatives of the rest of the cost at the start. The slope of the whole never
    falls along the step and is piecewise straight: its zero is enclosed, and found by Newton's method from either side.
    The fraction returned is one where the cost still falls, or is flat: it is not above that at the start. It is
    negative where the cost does not fall along the step at all: rounding is all that is left of it.
    """
    slope, _ = _slope(short, rate, weights, 0.0)
    slope += first
    low, high, slope_low, slope_high, t = 0.0, 1.0, slope, math.inf, 1.0
    flat = FLAT * abs(slope)
    if slope >= 0.0:
        return -1.0
    for _ in range(TRIALS):
        slope, curvature = _slope(short, rate, weights, t)
        slope += first + t * second
        if slope <= flat:
            low, slope_low = t, slope
        else:
            high, slope_high = t, slope
        if abs(slope) <= flat or low == 1.0 or high - low <= STILL:
            break
        t -= slope / (curvature + second)
        if not low < t < high:
            t = (low * slope_high - high * slope_low) / (slope_high - slope_low)
        if not low < t < high:
            t = 0.5 * (low + high)
    return low


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _write_piece(
    cost: tuple[Array, Array], violated: Violated, x: Array, fraction: float, hessian: Array, gradient: Array
) -> None:
    """Hessian and gradient of the piece that x is in, with ``fraction`` of the largest curvature about x on top."""
    n, least = x.size, 0.0
    for j in range(n):
        for k in range(n):
            hessian[j, k] = cost[0][j, k] + violated.matrix[j, k]
        least = max(least, fraction * hessian[j, j])
    for j in range(n):
        hessian[j, j] += least
        gradient[j] = cost[1][j] + violated.vector[j] - least * x[j]


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _derivatives(hessian: Array, gradient: Array, x: Array, move: Array) -> tuple[float, float]:
    """Of the cost of x itself, along ``move``: the first and the second one."""
    first, second = 0.0, 0.0
    for j in range(x.size):
        value, change = gradient[j], 0.0
        for k in range(x.size):
            value += hessian[j, k] * x[k]
            change += hessian[j, k] * move[k]
        first += value * move[j]
        second += change * move[j]
    return first, second


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _walk(x: Array, end: Array, length: float, move: Array, short: Array, rate: Array) -> bool:
    """Go a fraction ``length`` of the way to ``end``; whether that was far enough away to go on."""
    size, largest = 0.0, 0.0
    for j in range(x.size):
        size, largest = max(size, abs(move[j])), max(largest, abs(x[j]))
        x[j] = end[j] if length == 1.0 else x[j] + length * move[j]
    for i in range(short.size):
        short[i] -= length * rate[i]
    return size > STILL * (1.0 + largest)


@njit(
    TYPES.UniTuple(types.int64, 3)(
        TYPES.Tuple((MATRIX, VECTOR)),
        TYPES.Tuple((MATRIX, VECTOR, VECTOR)),
        TYPES.Tuple((MATRIX, VECTOR, VECTOR)),
        types.int64[::1],
        TYPES.UniTuple(types.int64, 2),
        TYPES.NamedTuple((types.float64[:, ::1], OUT, types.boolean[::1]), Violated),
        OUT,
        OUT,
    ),
    cache=True,
    error_model="numpy",
    fastmath=ORDER_FREE,
)
def descend(
    cost: tuple[Array, Array],
    soft: tuple[Array, Array, Array],
    limits: tuple[Array, Array, Array],
    guess: Indices,
    budget: tuple[int, int],
    violated: Violated,
    x: Array,
    short: Array,
) -> tuple[int, int, int]:
    r"""Newton's method on a cost that is quadratic piece by piece, under limits that hold at every point of it.

    .. math:: \min_x \tfrac12 x^T H x + g^T x + \tfrac12 \sum_i w_i \max(0, d_i - c_i^T x)^2 \quad\text{s.t.}\quad
        l_x \le x \le u_x,\; l \le A x \le u

    A step goes to the optimum of the piece that the point is in, as far as the cost falls; the last one ends where its
    own piece has it. The limits make a convex set and the length is the best one, so that every point is allowed and
    costs no more than the one before: where the budget ends, the best so far is there.

    Args:
        cost: H, shape (n, n), positive definite, and g, shape (n,).
        soft: c, shape (k, n), d, shape (k,), and w, shape (k,), 0 or above.
        limits: A, shape (m, n), lower and upper sides, shape (n + m,).
        guess: of the active limits, see :func:`wbc.active_set.search`; that of the last point is written.
        budget: Newton steps, and changes of the active set in all of them.
        violated: of any point, or none (zeros); that of the last point is written.
        x: shape (n,) a point that meets the limits, written.
        short: shape (k,), written: d - c x.

    Returns:
        ``OPTIMAL``, ``SPENT``, or what ``search`` made of a step that it has no answer to; the number of steps, and
        that of changes of the active set in them.
    """
    hessian, gradient = cost
    rows, demand, weights = soft
    n, k = x.size, demand.size
    changed, signed = np.empty(k, np.int64), np.empty(k)
    piece, slope, end, move, rate = np.empty((n, n)), np.empty(n), np.empty(n), np.empty(n), np.empty(k)
    hard, nowhere = np.zeros(limits[1].size), np.empty(0)
    _violation(rows, demand, x, short)
    outcome, length, steps, changes, exact = SPENT, 0.0, 0, 0, True
    while steps < budget[0]:
        count = _find_changed(short, weights, violated.seen, changed, signed)
        if count == 0 and length == 1.0 and exact:
            outcome = OPTIMAL
            break
        _count_in(rows, demand, changed[:count], signed[:count], violated.matrix, violated.vector)
        _write_piece(cost, violated, x, 0.0, piece, slope)
        found, made = search(piece, slope, *limits, hard, guess, budget[1] - changes, end, nowhere)
        steps, changes, exact = steps + 1, changes + made, found != UNKNOWN
        if not exact:
            _write_piece(cost, violated, x, DEFINITE, piece, slope)
            found, made = search(piece, slope, *limits, hard, guess, budget[1] - changes, end, nowhere)
            changes += made
        if found != OPTIMAL:
            outcome = found
            break
        for j in range(n):
            move[j] = end[j] - x[j]
        _violation(rows, np.zeros(k), move, rate)
        for i in range(k):
            rate[i] = -rate[i]
        length = _length(*_derivatives(hessian, gradient, x, move), short, rate, weights)
        if length < 0.0 or not _walk(x, end, length, move, short, rate):
            outcome = OPTIMAL
            break
    _violation(rows, demand, x, short)
    return outcome, steps, changes
