"""Of all inputs of least slack, the one nearest to the nominal input."""

import math

import numpy as np
from numba import types

from robots.kernel_types import MATRIX, ORDER_FREE, OUT_ROWS, TYPES, VECTOR, njit
from robots.messages import Array, Indices, Mask
from safety.filters.working_set import NOT_WANTED, Problem
from wbc.active_set import OPTIMAL, search
from wbc.qp import UNBOUNDED

ROUNDS = 100
"""Budget of the search, in changes of its active set: it starts from the limits that were active one tick before."""

ROUNDING = 1e-8
"""Room [m/s, rad/s] given to a row on top of its least slack, so that rounding does not make it infeasible again."""

SLACK_PULL = 1e-8
"""Weight of the nominal velocity while the least slack is sought: it makes the velocity unique.

It costs slack of about this times the change of velocity over the row's length: below 1e-6 m/s."""

VIOLATED, CLEARLY = 1e-5, 100.0
"""A row short of more than this [m/s, rad/s] is violated for certain where it pulls so many times as hard as the
nominal velocity does in the first phase: it is not that pull which it is short by."""

SAMPLE = 4
"""So many violated rows for each variable, evenly among them, tell which directions they fix,"""

FIXED = 1e-10
"""those along which the sum of their squares grows by more than this fraction of the most,"""

PULLED = 1e-4
"""and a variable at a bound whose pulls that way are left with more than this fraction of the sum of their sizes."""


@njit(
    TYPES.Tuple((types.boolean[::1], types.int64))(MATRIX, VECTOR, VECTOR, VECTOR, VECTOR, types.float64, OUT_ROWS),
    cache=True,
    error_model="numpy",
    fastmath=ORDER_FREE,
)
def fixed_by(
    A: Array, short: Array, v: Array, lower: Array, upper: Array, least: float, curvature: Array
) -> tuple[Mask, int]:
    """Variables (nv,) that violated rows, weighted by what they are short of, hold at a bound; how many rows these are.

    Rows and bounds that pull with less than ``least`` do not count. Writes the sum of A_i^T A_i over (a sample of)
    these rows, the upper triangle of (nv, nv).
    """
    nv = v.size
    pull, size, held = np.zeros(nv), np.zeros(nv), np.zeros(nv, np.bool_)
    curvature[:] = 0.0
    counts = np.zeros(short.size, np.bool_)
    for i in range(short.size):
        if short[i] > VIOLATED:
            squared = 0.0
            for k in range(nv):
                squared += A[i, k] * A[i, k]
            counts[i] = short[i] * math.sqrt(squared) > least
    stride, seen = 1 + counts.sum() // (SAMPLE * nv), 0
    for i in range(short.size):
        if not counts[i]:
            continue
        seen += 1
        row = A[i]
        for k in range(nv):
            fraction = short[i] * row[k]
            pull[k] += fraction
            size[k] += abs(fraction)
        if seen % stride == 0:
            for k in range(nv):
                fraction, out = row[k], curvature[k]
                for j in range(k, nv):
                    out[j] += fraction * row[j]
    for k in range(nv):
        enough = max(PULLED * size[k], least)
        up, down = pull[k] > enough, -pull[k] > enough
        held[k] = (up and v[k] >= upper[k]) or (down and v[k] <= lower[k])
    return held, counts.sum()


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _pivot(factor: Array, left: Indices) -> int:
    """Cholesky factor of the first variables that have curvature of their own, in place; how many these are.

    The variable with the most curvature left comes next: rows, columns and ``left`` (m,) are exchanged.
    """
    m, largest = left.size, 0.0
    for a in range(m):
        largest = max(largest, factor[a, a])
    for k in range(m):
        pivot = k
        for a in range(k + 1, m):
            if factor[a, a] > factor[pivot, pivot]:
                pivot = a
        if not factor[pivot, pivot] > FIXED * largest:
            return k
        left[k], left[pivot] = left[pivot], left[k]
        for a in range(m):
            factor[a, k], factor[a, pivot] = factor[a, pivot], factor[a, k]
        for a in range(m):
            factor[k, a], factor[pivot, a] = factor[pivot, a], factor[k, a]
        scale = 1.0 / math.sqrt(factor[k, k])
        for a in range(k, m):
            factor[k, a] *= scale
        for a in range(k + 1, m):
            fraction, row, source = factor[k, a], factor[a], factor[k]
            for b in range(k + 1, m):
                row[b] -= fraction * source[b]
    return m


@njit(types.float64[:, ::1](MATRIX, types.boolean[::1]), cache=True, error_model="numpy", fastmath=ORDER_FREE)
def directions_left(curvature: Array, held: Mask) -> Array:
    """A basis (n, r) of the moves that nothing fixes: ``curvature`` (n, n), semidefinite, is next to zero along them.

    Variables that are ``held`` (n,) do not move. The first variables of a Cholesky factorisation with pivots, as many
    as have curvature of their own, follow from the others. Of ``curvature`` the upper triangle is read.
    """
    left = np.flatnonzero(~held)
    m = left.size
    factor = np.empty((m, m))
    for a in range(m):
        for b in range(a, m):
            factor[a, b] = factor[b, a] = curvature[left[a], left[b]]
    rank = _pivot(factor, left)
    basis = np.zeros((held.size, m - rank))
    for c in range(m - rank):
        basis[left[rank + c], c] = 1.0
        for a in range(rank - 1, -1, -1):
            value = -factor[a, rank + c]
            for b in range(a + 1, rank):
                value -= factor[a, b] * basis[left[b], c]
            basis[left[a], c] = value / factor[a, a]
    return basis


@njit(OUT_ROWS(MATRIX, MATRIX), cache=True, error_model="numpy", fastmath=ORDER_FREE)
def along(basis: Array, A: Array) -> Array:
    """The basis (nv, r) with the rows A (n, nv) along it below, (nv + n, r)."""
    nv, r = basis.shape
    out = np.zeros((nv + A.shape[0], r))
    out[:nv] = basis
    for i in range(A.shape[0]):
        row = out[nv + i]
        for k in range(nv):
            fraction, move = A[i, k], basis[k]
            for c in range(r):
                row[c] += fraction * move[c]
    return out


class SecondPhase:
    r"""The input nearest to the nominal one that violates no row by more than a first phase has it.

    .. math:: v = \arg\min_v \|v - v^{des}\|_H^2 \quad\text{s.t.}\quad A v \ge b - s^*,\; v_{min} \le v \le v_{max}

    Source: eq. (13) of the p-SSA paper. What the first phase found, :math:`v^*`, meets all of this. At the least sum of
    squares :math:`\sum_i s^*_i A_i` is zero but for bounds that v is pulled against, so no violated row and none of
    these bounds has room on either side: every allowed v differs from :math:`v^*` by a move along which all of them
    stay where they are. Such moves have a basis N (:func:`directions_left`). Where it has at most half as many columns
    as v has entries, it is often empty, the search is for z with :math:`v = v^* + N z`; otherwise for v itself. All
    conditions stay in it, so whatever rounding made of N none is violated by more than ``ROUNDING`` beyond the first
    phase's; a direction taken for fixed that is not costs distance to the nominal input alone.
    """

    def __init__(self, nv: int, n_rows: int, rounds: int = ROUNDS) -> None:
        """For ``nv`` variables and ``n_rows`` rows; ``rounds``: budget of the search."""
        self._rounds = rounds
        self._softness = np.zeros(2 * nv + n_rows)
        self._low, self._high = np.full(2 * nv + n_rows, -UNBOUNDED), np.full(2 * nv + n_rows, UNBOUNDED)
        self._last, self._curvature = np.zeros(0, dtype=np.int64), np.zeros((nv, nv))

    def solve(self, problem: Problem, A: Array, short: Array, v: Array) -> Array | None:
        """The input (nv,), new; ``None`` where none was found that is proved to be nearest.

        Args:
            problem: nominal input, metric and bounds are read.
            A: shape (n_rows, nv) of the conditions.
            short: shape (n_rows,) by how much v violates them, below 0 where it does not.
            v: shape (nv,) what the first phase found, between the bounds.
        """
        lower, upper = problem.lower, problem.upper
        least = CLEARLY * SLACK_PULL * float(np.abs(v - problem.clipped()).max(initial=0.0))
        nv = v.size
        # before these there are unbounded variables, as many as a basis has columns at most
        np.subtract(lower, v, out=self._low[nv : 2 * nv])
        np.subtract(upper, v, out=self._high[nv : 2 * nv])
        self._low[2 * nv :] = np.where(short > 0.0, -ROUNDING, short)
        held, count = fixed_by(A, short, v, lower, upper, least, self._curvature)
        if 2 * (count + np.count_nonzero(held)) > v.size:
            basis = directions_left(self._curvature, held)
            if 2 * basis.shape[1] <= v.size:
                return self._along(problem, A, v, basis)
        gradient = problem.hessian @ (v - problem.v_des)
        move = self._search(problem.hessian, gradient, A, 0)
        return None if move is None else np.minimum(np.maximum(v + move, lower), upper)

    def _along(self, problem: Problem, A: Array, v: Array, basis: Array) -> Array | None:
        """The same, moving along a basis (nv, r) only."""
        r = basis.shape[1]
        if r == 0:
            return v.copy()
        pulled = problem.hessian @ basis
        hessian, gradient = basis.T @ pulled, pulled.T @ (v - problem.v_des)
        z = self._search(hessian, gradient, along(basis, A), r)
        return None if z is None else np.minimum(np.maximum(v + basis @ z, problem.lower), problem.upper)

    def _search(self, hessian: Array, gradient: Array, rows: Array, added: int) -> Array | None:
        """The optimum, from the limits that were active last time; ``added`` variables come before these in number."""
        n = gradient.size
        guess, x = np.zeros(n + 1, dtype=np.int64), np.empty(n)
        last = self._last[:n]
        guess[: last.size] = last + added * np.sign(last)
        first = self._low.size - n - rows.shape[0]
        low, high, softness = self._low[first:], self._high[first:], self._softness[first:]
        outcome, _ = search(hessian, gradient, rows, low, high, softness, guess, self._rounds, x, NOT_WANTED)
        found = guess[np.abs(guess) > added]
        self._last = found - added * np.sign(found)
        return x if outcome == OPTIMAL else None
