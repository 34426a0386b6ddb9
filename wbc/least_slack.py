"""Conditions that may be violated: the least sum of squares, by Newton steps that never increase it."""

import math

import numpy as np
from numba import njit, types

from robots.messages import Array, Indices, Mask
from wbc.active_set import MATRIX, OPTIMAL, ORDER_FREE, OUT, SPENT, VECTOR, search

STEPS = 30
"""Budget: Newton steps of one search for the least slack."""

DIRECT = 2
"""Steps after which a search that has not ended starts anew with the cost in the foreground,"""

STAGES = (1e6, 1e4, 1e2, 1.0)
"""times these factors one after the other: each answer is a good start for the next, and all together take fewer steps."""

ROUNDS = 300
"""Budget: changes of the active set in all of them together."""

TRIALS = 20
"""Step lengths tried along one of them."""

DEFINITE = 1e-14
"""Share of the largest curvature that every direction has at least, about the point where a step starts."""

FLAT = 1e-9
"""Share of its value at a step's start to which the slope of the cost has to fall at its end."""

STILL = 1e-10
"""A step shorter than this, over 1 + the size of the point, is the last."""


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _shortfall(rows: Array, demand: Array, x: Array, out: Array) -> None:
    """Writes demand - rows x."""
    for i in range(demand.size):
        value = 0.0
        for j in range(x.size):
            value += rows[i, j] * x[j]
        out[i] = demand[i] - value


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _count_in(
    rows: Array, demand: Array, weights: Array, short: Array, seen: Mask, matrix: Array, vector: Array
) -> int:
    """Bring the cost of the violated rows up to date: adds w a a^T and -w b a of each that has become one.

    What those no longer violated had added is taken away. ``seen`` tells which are in the cost, and is written.
    Returns how many have changed.
    """
    changed, n = 0, vector.size
    for i in range(demand.size):
        if (short[i] > 0.0) == seen[i]:
            continue
        changed += 1
        seen[i] = not seen[i]
        weight = weights[i] if seen[i] else -weights[i]
        for j in range(n):
            share = weight * rows[i, j]
            vector[j] -= share * demand[i]
            for k in range(n):
                matrix[j, k] += share * rows[i, k]
    return changed


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _slope(short: Array, rate: Array, weights: Array, t: float) -> tuple[float, float]:
    """First and second derivative of half the weighted sum of squared violations after a share t of a step."""
    first, second = 0.0, 0.0
    for i in range(short.size):
        left = short[i] - t * rate[i]
        share = weights[i] * rate[i] if left > 0.0 else 0.0
        first -= share * left
        second += share * rate[i]
    return first, second


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _length(first: float, second: float, short: Array, rate: Array, weights: Array) -> float:
    """The share, 1 at most, of a step at which the cost is least.

    ``first`` and ``second`` are the derivatives of the rest of the cost at the start. The slope of the whole never falls
    along the step and is piecewise straight: its zero is enclosed, and found by Newton's method from either side. The
    share returned is one where the cost still falls, or is flat: it is not above that at the start.
    """
    slope, _ = _slope(short, rate, weights, 0.0)
    slope += first
    low, high, slope_low, slope_high, t = 0.0, 1.0, slope, math.inf, 1.0
    flat = FLAT * abs(slope)
    if slope >= 0.0:
        return 0.0
    for _ in range(TRIALS):
        slope, curvature = _slope(short, rate, weights, t)
        slope += first + t * second
        if slope <= flat:
            low, slope_low = t, slope
        else:
            high, slope_high = t, slope
        if slope >= -flat and slope <= flat or low == 1.0 or high - low <= STILL:
            break
        t -= slope / (curvature + second)
        if not low < t < high:
            t = (low * slope_high - high * slope_low) / (slope_high - slope_low)
        if not low < t < high:
            t = 0.5 * (low + high)
    return low


@njit(
    types.UniTuple(types.int64, 3)(
        MATRIX,
        VECTOR,
        MATRIX,
        VECTOR,
        VECTOR,
        MATRIX,
        VECTOR,
        VECTOR,
        types.int64[::1],
        types.int64,
        types.int64,
        OUT,
        OUT,
    ),
    cache=True,
    error_model="numpy",
    fastmath=ORDER_FREE,
)
def descend(
    hessian: Array,
    gradient: Array,
    soft: Array,
    demand: Array,
    weights: Array,
    rows: Array,
    lower: Array,
    upper: Array,
    guess: Array,
    steps: int,
    rounds: int,
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
        hessian: H, shape (n, n), positive definite.
        gradient: g, shape (n,).
        soft: c, shape (k, n).
        demand: d, shape (k,).
        weights: w, shape (k,), 0 or above.
        rows: A, shape (m, n).
        lower: shape (n + m,).
        upper: shape (n + m,).
        guess: of the active limits, see :func:`wbc.active_set.search`; that of the last point is written.
        steps: budget.
        rounds: budget of changes of the active set, all steps together.
        x: shape (n,) a point that meets the limits, written.
        short: shape (k,), written: demand - soft x.

    Returns:
        ``OPTIMAL``, ``SPENT``, or what ``search`` made of a step that it has no answer to; the number of steps, and that
        of changes of the active set in them.
    """
    n = x.size
    seen = np.zeros(demand.size, np.bool_)
    matrix, vector, plain = hessian.copy(), gradient.copy(), np.empty((n, n))
    pull, target, end, move = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    rate, hard, nowhere = np.empty(demand.size), np.zeros(lower.size), np.empty(0)
    _shortfall(soft, demand, x, short)
    length, changes = 0.0, 0
    for step in range(steps):
        changed = _count_in(soft, demand, weights, short, seen, matrix, vector)
        if changed == 0 and length == 1.0:
            return OPTIMAL, step, changes
        least = 0.0
        for j in range(n):
            least = max(least, DEFINITE * matrix[j, j])
        for j in range(n):
            for k in range(n):
                plain[j, k] = matrix[j, k]
            plain[j, j] += least
            target[j] = vector[j] - least * x[j]
        outcome, made = search(plain, target, rows, lower, upper, hard, guess, rounds - changes, end, nowhere)
        changes += made
        if outcome != OPTIMAL:
            return outcome, step, changes
        size, first, second, largest = 0.0, 0.0, 0.0, 0.0
        for j in range(n):
            move[j] = end[j] - x[j]
            size, largest = max(size, abs(move[j])), max(largest, abs(x[j]))
        for j in range(n):
            pull[j] = 0.0
            value = gradient[j]
            for k in range(n):
                value += hessian[j, k] * x[k]
                pull[j] += hessian[j, k] * move[k]
            first += value * move[j]
            second += pull[j] * move[j]
        for i in range(demand.size):
            value = 0.0
            for j in range(n):
                value += soft[i, j] * move[j]
            rate[i] = value
        length = _length(first, second, short, rate, weights)
        if length == 0.0:
            return OPTIMAL, step, changes
        for j in range(n):
            x[j] = end[j] if length == 1.0 else x[j] + length * move[j]
        _shortfall(soft, demand, x, short)
        if size * length <= STILL * (1.0 + largest):
            return OPTIMAL, step + 1, changes
    return SPENT, steps, changes


class LeastSlack:
    """Solves problems of one size, each from the last one's point and active set; see :func:`descend`.

    Attributes:
        short: shape (k,) by how much each row falls short at the last answer; below 0 where it does not.
        steps: made for it.
        rounds: changes of the active set in these.
    """

    def __init__(self, n: int, k: int, m: int = 0, steps: int = STEPS, rounds: int = ROUNDS) -> None:
        """For ``n`` variables, ``k`` rows that may be violated and ``m`` that must hold."""
        self.short = np.zeros(k)
        self.steps = self.rounds = 0
        self._guess = np.zeros(n + 1, dtype=np.int64)
        self._steps, self._rounds = steps, rounds

    def solve(
        self,
        hessian: Array,
        gradient: Array,
        soft: tuple[Array, Array, Array],
        rows: Array,
        lower: Array,
        upper: Array,
        start: Array,
        guess: Indices | None = None,
    ) -> tuple[int, Array]:
        """Outcome and x (n,), new.

        Args:
            hessian: shape (n, n).
            gradient: shape (n,).
            soft: the rows (k, n) that may be violated, their demands (k,) and weights (k,).
            rows: shape (m, n) that must hold.
            lower: shape (n + m,).
            upper: shape (n + m,).
            start: shape (n,) a point that meets the limits.
            guess: limits active there, as :func:`wbc.active_set.search` has them; ``None`` for those of last time.
        """
        if guess is not None:
            self._guess[:] = guess
        self.steps = self.rounds = 0
        problem = soft, rows, lower, upper
        outcome, best, cost = self._descend(hessian, gradient, 1.0, problem, start, DIRECT)
        if outcome == OPTIMAL:
            return outcome, best
        best_short, x = self.short.copy(), best
        for stage in STAGES:
            outcome, x, reached = self._descend(hessian, gradient, stage, problem, x, self._steps - self.steps)
            if reached < cost or (outcome == OPTIMAL and stage == 1.0):
                best, best_short, cost = x, self.short.copy(), reached
            if outcome != OPTIMAL:
                break
        self.short[:] = best_short
        return outcome, best

    def _descend(
        self,
        hessian: Array,
        gradient: Array,
        stage: float,
        problem: tuple[tuple[Array, Array, Array], Array, Array, Array],
        start: Array,
        steps: int,
    ) -> tuple[int, Array, float]:
        """Outcome, x (n,) and cost, with ``stage`` times the cost of x itself on the way, without that in the end."""
        (soft, demand, weights), rows, lower, upper = problem
        x, budget = start.copy(), max(0, self._rounds - self.rounds)
        outcome, made, rounds = descend(
            stage * hessian,
            stage * gradient,
            soft,
            demand,
            weights,
            rows,
            lower,
            upper,
            self._guess,
            steps,
            budget,
            x,
            self.short,
        )
        self.steps += made
        self.rounds += rounds
        violation = np.maximum(self.short, 0.0)
        cost = x @ (0.5 * (hessian @ x) + gradient) + 0.5 * (weights * violation) @ violation
        return outcome, x, float(cost)
