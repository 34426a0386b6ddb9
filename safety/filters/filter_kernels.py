"""Compiled passes of a filter over all its rows: numbers and room at the nominal input, the metric, the verdict."""

import math

import numpy as np
from numba import types

from robots.kernel_types import FLAGS, MATRIX, ORDER_FREE, OUT, TYPES, VECTOR, njit
from robots.messages import Array, Mask
from wbc.qp import UNBOUNDED


@njit(
    TYPES.UniTuple(types.float64, 2)(VECTOR, VECTOR, MATRIX, VECTOR, VECTOR, VECTOR, VECTOR, types.boolean[::1]),
    cache=True,
    error_model="numpy",
    fastmath=ORDER_FREE,
)
def survey(
    h: Array, dh_dt: Array, A: Array, b: Array, v: Array, lower: Array, upper: Array, violated: Mask
) -> tuple[float, float]:
    """One pass over conditions A v >= b and what they were made of, at the nominal input.

    Args:
        h: shape (n,) values of the rows.
        dh_dt: shape (n,) their rate from what moves by itself.
        A: shape (n, nv).
        b: shape (n,).
        v: shape (nv,) nominal input.
        lower: shape (nv,) its bounds.
        upper: shape (nv,) likewise.
        violated: shape (n,), written: which conditions v violates.

    Returns:
        A sum of all numbers, those of the conditions squared: not finite where one is not, or where a condition is too
        large for its length to be told or asks for ``UNBOUNDED``; and the least room of a condition at v, ``-inf``
        where v is beyond a bound, NaN where a condition has no number.
    """
    nv, total, least, numbers = v.size, 0.0, math.inf, True
    for k in range(nv):
        total += v[k]
        if not lower[k] <= v[k] <= upper[k]:
            least = -math.inf
    for i in range(h.size):
        value, size = 0.0, 0.0
        for k in range(nv):
            value += A[i, k] * v[k]
            size += A[i, k] * A[i, k]
        total += size + h[i] + dh_dt[i] + b[i] * b[i]
        if b[i] >= UNBOUNDED:
            total = math.inf
        value -= b[i]
        violated[i] = value < 0.0
        numbers &= not math.isnan(value)
        least = min(least, value)
    return total, least if numbers else math.nan


@njit(
    types.boolean(
        VECTOR, VECTOR, FLAGS, MATRIX, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, types.float64, OUT, OUT
    ),
    cache=True,
    error_model="numpy",
    fastmath=ORDER_FREE,
)
def ease(
    h: Array,
    dh_dt: Array,
    lost: Mask,
    A: Array,
    b: Array,
    at_zero: Array,
    last: Array,
    depth: Array,
    speed: Array,
    acceleration: Array,
    dt: float,
    theta: Array,
    out: Array,
) -> bool:
    """What conditions A v >= b may ask for at most while rows are lost, see :mod:`safety.filters.recovery`: D'' there.

    Args:
        h: shape (n,) values of the rows.
        dh_dt: shape (n,) their rate from what moves by itself.
        lost: shape (n,) which are lost.
        A: shape (n, nv).
        b: shape (n,).
        at_zero: shape (n,) what lost rows would ask for at h = 0.
        last: shape (nv,) last command.
        depth: shape (n,) recovery depth.
        speed: shape (n,) recovery speed.
        acceleration: shape (n,) recovery acceleration.
        dt: of a tick [s].
        theta: shape (n,), written: fraction of its recovery depth that a row is below 0.
        out: shape (n,), written: the right-hand sides.

    Returns:
        Whether a row that is not lost asks for less than its condition does.
    """
    held_back = False
    for i in range(h.size):
        reached = acceleration[i] * dt
        for k in range(last.size):
            reached += A[i, k] * last[k]
        resting = max(reached, -dh_dt[i])
        if lost[i]:
            theta[i] = min(1.0, -h[i] / depth[i])
            bounded = min(max(b[i], theta[i] * speed[i] - dh_dt[i]), at_zero[i] + speed[i])
            out[i] = (1.0 - theta[i]) * min(bounded, resting) + theta[i] * min(bounded, reached)
        else:
            theta[i] = 0.0
            out[i] = min(b[i], resting)
            held_back |= out[i] < b[i]
    return held_back


@njit(
    types.float64(MATRIX, MATRIX, MATRIX, types.float64, types.float64, types.float64, VECTOR, types.float64[:, ::1]),
    cache=True,
    error_model="numpy",
    fastmath=ORDER_FREE,
)
def metric(
    feet: Array, balance: Array, hands: Array, w_f: float, w_b: float, w_h: float, v: Array, hessian: Array
) -> float:
    """Writes H = I + sum of w J^T J, (nv, nv), for Jacobians (any, nv).

    Returns a sum of all entries of H and of those of H v times v (nv,): not finite where one of them is not.
    """
    nv, k, total = hessian.shape[0], feet.shape[0], 0.0
    m = k + balance.shape[0]
    rows = np.zeros((m + hands.shape[0], nv))
    # what weighs nothing need not be numbers
    if w_f > 0.0:
        rows[:k] = math.sqrt(w_f) * feet
    if w_b > 0.0:
        rows[k:m] = math.sqrt(w_b) * balance
    if w_h > 0.0:
        rows[m:] = math.sqrt(w_h) * hands
    squares = np.dot(rows.T, rows)
    for i in range(nv):
        for j in range(i, nv):
            hessian[i, j] = hessian[j, i] = squares[i, j]
        hessian[i, i] += 1.0
    for i in range(nv):
        pull = 0.0
        for j in range(nv):
            total += hessian[i, j]
            pull += hessian[i, j] * v[j]
        total += pull * v[i]
    return total


@njit(
    TYPES.Tuple((types.int64, types.float64, types.int64))(VECTOR, types.float64),
    cache=True,
    error_model="numpy",
    fastmath=ORDER_FREE,
)
def tally(room: Array, close: float) -> tuple[int, float, int]:
    """The row with the least of ``room`` (n,), that room, and how many have less than ``close``.

    NaN is the least and counts; of equals it is the first. -1 and infinity where there are no rows.
    """
    worst, least, count = -1, math.inf, 0
    for i in range(room.size):
        count += not room[i] >= close
        if worst < 0 or (not room[i] >= least and not math.isnan(least)):
            worst, least = i, room[i]
    return worst, least, count
