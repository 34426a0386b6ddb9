"""A dual active-set search that starts from the active set of the last problem and proves what it answers."""

import math

import numpy as np
from numba import types

from robots.kernel_types import MATRIX, ORDER_FREE, OUT, TYPES, VECTOR, njit
from robots.messages import Array, Indices
from wbc.active_limits import (
    WRONG_SIGN,
    Active,
    contradicts,
    describe,
    drop,
    factor_row,
    forces,
    moved,
    refine,
    substitute,
)
from wbc.limits import Limits, worst_of, worst_of_all
from wbc.triangular import backward, factorise, forward, product

DEPENDENT = 1e-11
"""Fraction of its squared length that has to be left of a limit beside the active ones, for it to join them."""

ROUNDS = 220
"""Budget: changes of the active set in one search."""

LISTED = 256
"""Broken limits that are kept for the next rounds, which then need not look at all of them."""

OPTIMAL, CONTRADICTION, UNKNOWN, SPENT = 0, 1, 2, 3
"""Outcomes: proved optimum; proof that no point meets all limits; neither could be proved; budget spent."""


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _enter(active: Active, count: int, limits: Limits, free: Array, y: Array, budget: int) -> tuple[int, int, int]:
    """Bring in the limit described at place ``count``, the active ones giving way as their multipliers get to zero.

    Multipliers and ``y`` go along. Returns the outcome (``OPTIMAL``: it is in), the number of active limits and the
    changes made.
    """
    changes, short = 0, active.targets[count] - product(active.pushes[count], y)
    while changes < budget:
        changes += 1
        left = factor_row(active, count)
        rates = active.rates
        rates[:count] = active.factor[count, :count]
        substitute(active, count, rates)
        blocking, longest = -1, math.inf
        for a in range(count):
            if rates[a] > WRONG_SIGN and active.forces[a] < longest * rates[a]:
                blocking, longest = a, max(0.0, active.forces[a] / rates[a])
        room, independent = count + 1 < active.limits.size, left > DEPENDENT * active.products[count]
        if independent and not room and active.limits.size > y.size + 1:
            return UNKNOWN, count, changes
        # n limits that hold leave nothing beside them, whatever rounding says
        enters = independent and room and not short / left > longest
        if blocking < 0 and not enters:
            return CONTRADICTION if contradicts(active, count, limits) else UNKNOWN, count, changes
        step = short / left if enters else longest
        for a in range(count):
            active.forces[a] -= step * rates[a]
        active.forces[count] += step
        if enters:
            active.held[active.limits[count]] = True
            moved(active, count + 1, free, y)
            return OPTIMAL, count + 1, changes
        short -= step * left
        count = drop(active, blocking, count)
    moved(active, count + 1, free, y)
    return SPENT, count, changes


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _take_up(active: Active, guess: Indices, limits: Limits, metric: Array, free: Array) -> int:
    """Make the limits of a guess active, those left out that depend on others before; how many there are."""
    count = 0
    for code in guess:
        i = abs(code) - 1
        if code == 0 or count + 1 >= active.limits.size:
            break
        if active.held[i]:
            continue
        describe(active, count, limits, metric, free, i, 1.0 if code > 0 else -1.0)
        if factor_row(active, count) > DEPENDENT * active.products[count] and math.isfinite(active.targets[count]):
            active.held[i] = True
            count += 1
    return count


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _hand_out(active: Active, count: int, guess: Indices, multipliers: Array) -> None:
    """Write the active limits to ``guess`` (a zero after the last) and, where they are wanted, their multipliers."""
    guess[:] = 0
    for a in range(count):
        i, sign = active.limits[a], active.signs[a]
        guess[a] = i + 1 if sign > 0.0 else -i - 1
        if multipliers.size:
            multipliers[i] = -sign * active.scales[a] * active.forces[a]


@njit(
    TYPES.UniTuple(types.int64, 2)(
        MATRIX, VECTOR, MATRIX, VECTOR, VECTOR, VECTOR, types.int64[::1], types.int64, OUT, OUT
    ),
    cache=True,
    error_model="numpy",
    fastmath=ORDER_FREE,
)
def search(
    hessian: Array,
    gradient: Array,
    rows: Array,
    lower: Array,
    upper: Array,
    softness: Array,
    guess: Indices,
    budget: int,
    x: Array,
    multipliers: Array,
) -> tuple[int, int]:
    r"""Solve the problem of :class:`wbc.qp.QpSolver` from a guess of its active set.

    The limits guessed are held as equalities; those whose multipliers have the wrong sign are let go. From there it is
    the dual method of Goldfarb and Idnani, "A numerically stable dual method for solving strictly convex quadratic
    programs", Mathematical Programming 27 (1983), sec. 3: the limit broken most comes in, and active ones whose
    multipliers get to zero on the way go. An answer counts as the optimum only where all limits were checked at a point
    solved for anew from its active set, and no multiplier has the wrong sign.

    Args:
        hessian: shape (n, n).
        gradient: shape (n,).
        rows: shape (m, n).
        lower: shape (n + m,).
        upper: shape (n + m,).
        softness: shape (n + m,), 0 for what must hold; else one over the weight of half the squared violation.
        guess: shape (k,), k - 1 the most limits that may be active; 1 + number of a limit for its lower side, minus
            that for its upper one, a zero after the last. That of the last point of the search is written.
        budget: changes of the active set that may be made.
        x: shape (n,), written; the optimum where the outcome is ``OPTIMAL``.
        multipliers: shape (n + m,) as in :class:`wbc.qp.QpSolution`, written where the outcome is ``OPTIMAL``; or
            empty, if they are not wanted.

    Returns:
        The outcome, one of ``OPTIMAL``, ``CONTRADICTION``, ``UNKNOWN`` and ``SPENT``, and the number of changes.
    """
    n, k = gradient.size, guess.size
    multipliers[:] = 0.0
    metric, free, y, values = np.empty((n, n)), np.empty(n), np.empty(n), np.empty(lower.size)
    if not factorise(hessian, metric):
        return UNKNOWN, 0
    for j in range(n):
        free[j] = -gradient[j]
    forward(metric, free)
    limits = Limits(rows, lower, upper, softness)
    active = Active(
        np.empty(k, np.int64),
        np.empty(k),
        np.empty(k),
        np.empty((k, n)),
        np.empty(k),
        np.empty(k),
        np.empty(k),
        np.empty((k, k)),
        np.empty(k),
        np.empty(k),
        np.zeros(lower.size, np.bool_),
    )
    listed, waiting, changes = np.empty(LISTED, np.int64), 0, 0
    count, anew = _take_up(active, guess, limits, metric, free), True
    while changes <= budget:
        if anew:
            wrong = forces(active, count)
            if wrong >= 0:
                count = drop(active, wrong, count)
                changes += 1
                continue
            moved(active, count, free, y)
        x[:] = y
        backward(metric, x)
        worst, most, side, waiting = worst_of(limits, active.held, x, listed[:waiting])
        if worst < 0 and not anew:
            # multipliers that went along with every change since are no proof
            anew = True
            continue
        if worst < 0:
            refine(active, count, limits, metric, y, x)
            worst, most, side, waiting = worst_of_all(limits, active.held, x, values, listed)
            if worst < 0:
                _hand_out(active, count, guess, multipliers)
                return OPTIMAL, changes
        if not math.isfinite(most) or active.held[worst]:
            return UNKNOWN, changes
        describe(active, count, limits, metric, free, worst, side)
        outcome, count, made = _enter(active, count, limits, free, y, budget - changes)
        changes, anew = changes + made, False
        if outcome != OPTIMAL:
            _hand_out(active, count + 1, guess, multipliers[:0])
            return outcome, changes
    _hand_out(active, count, guess, multipliers[:0])
    return SPENT, changes


class ActiveSet:
    """Solves problems of one size from the active set of the last one; see :func:`search`.

    Attributes:
        guess: shape (k,) the active set to start from, as :func:`search` has it.
        changes: of the active set, in the last search.
    """

    def __init__(
        self,
        n: int,
        m: int,
        softness: Array | None = None,
        budget: int = ROUNDS,
        soft_room: int | None = None,
    ) -> None:
        """For ``n`` variables and ``m`` rows.

        Args:
            n: variables.
            m: rows.
            softness: shape (n + m,), read by every search anew; ``None`` where all limits must hold.
            budget: changes of the active set in one search.
            soft_room: how many soft limits may be active beside n others; if not given, as many as there are now, 2 n
                at most.
        """
        self._softness = np.zeros(n + m) if softness is None else softness
        room = min(2 * n, int(np.count_nonzero(self._softness))) if soft_room is None else soft_room
        self.guess = np.zeros(n + 1 + room, dtype=np.int64)
        self.changes = 0
        self._n, self._m, self._budget = n, m, budget

    def solve(
        self,
        hessian: Array,
        gradient: Array,
        rows: Array,
        lower: Array,
        upper: Array,
        multipliers: Array,
        budget: int | None = None,
    ) -> tuple[int, Array]:
        """Outcome and x (n,), new; arrays as in :func:`search`, each with its entries one after the other.

        ``budget`` is for this search, where it is not to be the usual one.
        """
        x, budget = np.empty(self._n), self._budget if budget is None else budget
        outcome, self.changes = search(
            hessian, gradient, rows, lower, upper, self._softness, self.guess, budget, x, multipliers
        )
        return outcome, x

    def adopt(self, multipliers: Array) -> None:
        """Start next from the active set of multipliers (n + m,) that another solver found."""
        self.guess[:] = active_limits(multipliers, self.guess.size)


def active_limits(multipliers: Array, size: int) -> Indices:
    """Limits with a multiplier, as a guess of ``size`` entries for :func:`search`; those beyond its room left out."""
    found = np.flatnonzero(multipliers)[: size - 1]
    out = np.zeros(size, dtype=np.int64)
    out[: found.size] = np.where(multipliers[found] < 0, found + 1, -found - 1)
    return out
