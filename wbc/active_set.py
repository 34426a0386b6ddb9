"""A dual active-set search that starts from the active set of the last problem and proves what it answers."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit, types

from robots.messages import Array, Indices, Mask

ORDER_FREE = {"reassoc", "contract"}
"""Sums may be taken in any order; NaN and infinity are not lost."""

TOLERANCE = 1e-9
"""Largest violation of a limit at an optimum; of a row shorter than 1 at unit length."""

ROUNDING = 1e-13
"""Violation at unit length, over 1 + the largest variable, that no answer can be asked to stay below."""

NOTHING = 1e-30
"""Squared length up to which a row counts as zero: nothing moves it."""

DEPENDENT = 1e-11
"""Share of its squared length that has to be left of a limit beside the active ones, for it to join them."""

WRONG_SIGN = 1e-12
"""Share of the largest multiplier by which one may have the wrong sign."""

CERTAIN = 1e-7
"""A contradiction is proved where every point within the bounds breaks an average of limits by more than this."""

REACH = 1e9
"""No point with a larger variable is looked for when limits are proved to contradict each other."""

ROUNDS = 220
"""Budget: changes of the active set in one search."""

LISTED = 256
"""Broken limits that are kept for the next rounds, which then need not look at all of them."""

CLEARLY = 1e-6
"""Listed limits come in only where they are broken by more than this at unit length: more than rounding can be."""

OPTIMAL, CONTRADICTION, UNKNOWN, SPENT = 0, 1, 2, 3
"""Outcomes: proved optimum; proof that no point meets all limits; neither could be proved; budget spent."""

VECTOR = types.Array(types.float64, 1, "C", readonly=True)
MATRIX = types.Array(types.float64, 2, "C", readonly=True)
OUT = types.float64[::1]


class Limits(NamedTuple):
    """What is to hold: lower <= [x; rows x] <= upper, (n + m,), softened by ``softness`` (n + m,); rows (m, n)."""

    rows: Array
    lower: Array
    upper: Array
    softness: Array


class Active(NamedTuple):
    """Active limits of a search in order of entry, each as push . y >= target in coordinates in which H is the identity.

    Attributes:
        limits: their numbers, bounds first, then rows.
        signs: +1 where the lower side is active, -1 where the upper one is.
        scales: what each is multiplied by, so that its push has unit length.
        pushes: their gradients.
        targets: their bounds.
        wanted: what they want beyond where the optimum without limits is.
        products: of the gradient described last with those before it and itself, softness added to the last.
        factor: lower Cholesky factor of all such products.
        forces: their multipliers, 0 or above.
        rates: how these give way to a limit that enters.
        held: shape (n + m,) which limits are active.
    """

    limits: Indices
    signs: Array
    scales: Array
    pushes: Array
    targets: Array
    wanted: Array
    products: Array
    factor: Array
    forces: Array
    rates: Array
    held: Mask


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
def _product(a: Array, b: Array) -> float:
    total = 0.0
    for j in range(a.size):
        total += a[j] * b[j]
    return total


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _excess(limits: Limits, i: int, value: float, floor: float) -> tuple[float, float]:
    """By how much limit i is broken beyond what is tolerated, at unit length, and +1 (below) or -1 (above).

    0 or less where it holds; NaN where it has no number or its lower side is above its upper one.
    """
    n, lower, upper = limits.rows.shape[1], limits.lower[i], limits.upper[i]
    if not lower <= upper:
        return math.nan, 1.0
    squared = _product(limits.rows[i - n], limits.rows[i - n]) if i >= n else 1.0
    length = 1.0 if squared <= NOTHING else math.sqrt(squared)
    tolerated = max(TOLERANCE * min(1.0, 1.0 / length), floor)
    if lower > value:
        return (lower - value) / length - tolerated, 1.0
    return (value - upper) / length - tolerated, -1.0


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _floor(x: Array) -> float:
    largest = 0.0
    for j in range(x.size):
        largest = max(largest, abs(x[j]))
    return ROUNDING * (1.0 + largest)


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _values(limits: Limits, x: Array, values: Array) -> float:
    """Writes [x; rows x] (n + m,); returns the sum of all sides of all limits: NaN or infinite where one is."""
    rows, n, total = limits.rows, x.size, 0.0
    for i in range(n):
        values[i] = x[i]
    for i in range(rows.shape[0]):
        value = 0.0
        for j in range(n):
            value += rows[i, j] * x[j]
        values[n + i] = value
    for i in range(values.size):
        total += limits.lower[i] + limits.upper[i]
    return total


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _worst_of_all(
    limits: Limits, held: Mask, x: Array, values: Array, listed: Indices
) -> tuple[int, float, float, int]:
    """The limit broken most, by how much, its side, and how many broken ones were written to ``listed``.

    -1 where all hold. The amount is NaN where a number is not finite or a lower side is above its upper one. An active
    limit that is soft is met by its own multiplier and not looked at. ``values`` (n + m,) is written.
    """
    worst, most, side, count, floor = -1, 0.0, 1.0, 0, _floor(x)
    if not math.isfinite(_values(limits, x, values)):
        return 0, math.nan, 1.0, 0
    lower, upper = limits.lower, limits.upper
    for i in range(values.size):
        if lower[i] <= values[i] <= upper[i] or (held[i] and limits.softness[i] > 0.0):
            continue
        excess, sign = _excess(limits, i, values[i], floor)
        if excess <= 0.0:
            continue
        if count < listed.size:
            listed[count] = i
            count += 1
        if not excess <= most:
            worst, most, side = i, excess, sign
            if math.isnan(most):
                break
    return worst, most, side, count


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _worst_of(limits: Limits, held: Mask, x: Array, listed: Indices) -> tuple[int, float, float, int]:
    """The same among those ``listed``, of which those clearly broken are kept, at the front."""
    worst, most, side, count = -1, 0.0, 1.0, 0
    for i in listed:
        if held[i]:
            continue
        value = x[i] if i < x.size else _product(limits.rows[i - x.size], x)
        if limits.lower[i] <= value <= limits.upper[i]:
            continue
        excess, sign = _excess(limits, i, value, CLEARLY)
        if excess > 0.0:
            listed[count] = i
            count += 1
            if excess > most:
                worst, most, side = i, excess, sign
    return worst, most, side, count


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _describe(active: Active, k: int, limits: Limits, metric: Array, free: Array, i: int, sign: float) -> None:
    """Write limit i with its side to place k; ``metric`` is the Cholesky factor U of H, ``free`` the optimum without."""
    n, push = metric.shape[0], active.pushes[k]
    if i < n:
        push[:] = 0.0
        push[i] = sign
    else:
        row = limits.rows[i - n]
        for j in range(n):
            push[j] = sign * row[j]
    forward(metric, push)
    squared = _product(push, push)
    scale = 1.0 / math.sqrt(squared) if squared > NOTHING else 1.0
    for j in range(n):
        push[j] *= scale
    active.limits[k], active.signs[k], active.scales[k], active.forces[k] = i, sign, scale, 0.0
    active.targets[k] = scale * (limits.lower[i] if sign > 0.0 else -limits.upper[i])
    active.wanted[k] = active.targets[k] - _product(push, free)
    for j in range(k):
        active.products[j] = _product(push, active.pushes[j])
    active.products[k] = _product(push, push) + scale * scale * limits.softness[i]


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _factor_row(active: Active, k: int) -> float:
    """Row k of the Cholesky factor, of the limit described there; returns what is left of it beside those before."""
    row = active.factor[k]
    for j in range(k):
        row[j] = (active.products[j] - _product(row[:j], active.factor[j, :j])) / active.factor[j, j]
    left = active.products[k] - _product(row[:k], row[:k])
    row[k] = math.sqrt(max(left, 0.0))
    return left


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _drop(active: Active, gone: int, count: int) -> int:
    """Let an active limit go; returns how many are left. What is described at place ``count`` moves with the others.

    Rotations of neighbouring columns make the factor without its row triangular again.
    """
    factor = active.factor
    active.held[active.limits[gone]] = False
    for k in range(gone + 1, count + 1):
        to = k - 1
        active.limits[to], active.signs[to], active.scales[to] = active.limits[k], active.signs[k], active.scales[k]
        active.targets[to], active.wanted[to] = active.targets[k], active.wanted[k]
        active.forces[to], active.products[to] = active.forces[k], active.products[k]
        for j in range(active.pushes.shape[1]):
            active.pushes[to, j] = active.pushes[k, j]
        if k < count:
            for j in range(k + 1):
                factor[to, j] = factor[k, j]
    for c in range(gone, count - 1):
        size = math.hypot(factor[c, c], factor[c, c + 1])
        cosine, sine = factor[c, c] / size, factor[c, c + 1] / size
        for k in range(c, count - 1):
            one, two = factor[k, c], factor[k, c + 1]
            factor[k, c] = cosine * one + sine * two
            factor[k, c + 1] = cosine * two - sine * one
    return count - 1


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _substitute(active: Active, count: int, x: Array) -> None:
    """Solve the second half, L^T x = x, in place, for the first ``count`` active limits."""
    for a in range(count - 1, -1, -1):
        x[a] /= active.factor[a, a]
        for b in range(a):
            x[b] -= active.factor[a, b] * x[a]


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _forces(active: Active, count: int) -> int:
    """The multipliers that hold all active limits; returns the place of the most wrong sign, -1 for none."""
    force, largest = active.forces, 0.0
    for a in range(count):
        force[a] = (active.wanted[a] - _product(active.factor[a, :a], force[:a])) / active.factor[a, a]
    _substitute(active, count, force)
    for a in range(count):
        largest = max(largest, abs(force[a]))
    wrong, least = -1, -WRONG_SIGN * largest
    for a in range(count):
        if not force[a] >= least:
            wrong, least = a, force[a]
    return wrong


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _moved(active: Active, count: int, free: Array, y: Array) -> None:
    """Where the active limits push the free optimum to: writes ``y``."""
    for j in range(y.size):
        y[j] = free[j]
    for a in range(count):
        force, push = active.forces[a], active.pushes[a]
        for j in range(y.size):
            y[j] += force * push[j]


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _refine(active: Active, count: int, limits: Limits, metric: Array, y: Array, x: Array) -> None:
    """One step of refinement of the point x = U^-1 y: what rounding left of the active limits is taken away.

    U may be as badly conditioned as the root of H; limits that meet in one point, as the sides of a cone do, would come
    and go by what it leaves.
    """
    n, rates, left = x.size, active.rates, 0.0
    for a in range(count):
        i = active.limits[a]
        value = x[i] if i < n else _product(limits.rows[i - n], x)
        scale = active.scales[a]
        short = active.targets[a] - active.signs[a] * scale * value
        short -= scale * scale * limits.softness[i] * active.forces[a]
        left = max(left, abs(short))
        rates[a] = (short - _product(active.factor[a, :a], rates[:a])) / active.factor[a, a]
    if left == 0.0:
        return
    _substitute(active, count, rates)
    step = np.zeros(n)
    for a in range(count):
        active.forces[a] += rates[a]
        push = active.pushes[a]
        for j in range(n):
            step[j] += rates[a] * push[j]
    for j in range(n):
        y[j] += step[j]
    backward(metric, step)
    for j in range(n):
        x[j] += step[j]


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _contradicts(active: Active, count: int, limits: Limits) -> bool:
    """Whether the limit at place ``count`` and the active ones that do not give way to it cannot hold together.

    Weighted by their rates they add up to one condition on x; no x within the bounds, or ``REACH`` where there are none,
    meets that one (Farkas).
    """
    n, demand, weights = limits.rows.shape[1], 0.0, 0.0
    total = np.zeros(n)
    for a in range(count + 1):
        weight = active.scales[a] * (1.0 if a == count else max(0.0, -active.rates[a]))
        if active.limits[a] >= n and weight > 0.0:
            demand += weight * active.targets[a] / active.scales[a]
            weights += weight
            row = limits.rows[active.limits[a] - n]
            for j in range(n):
                total[j] += weight * active.signs[a] * row[j]
    for j in range(n):
        demand -= max(total[j] * max(limits.lower[j], -REACH), total[j] * min(limits.upper[j], REACH))
    return demand > CERTAIN * weights and weights > 0.0


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _enter(active: Active, count: int, limits: Limits, free: Array, y: Array, budget: int) -> tuple[int, int, int]:
    """Bring in the limit described at place ``count``, the active ones giving way as their multipliers get to zero.

    Returns the outcome (``OPTIMAL``: it is in), the number of active limits and the changes made.
    """
    changes = 0
    while changes < budget:
        changes += 1
        left = _factor_row(active, count)
        rates = active.rates
        rates[:count] = active.factor[count, :count]
        _substitute(active, count, rates)
        blocking, longest = -1, math.inf
        for a in range(count):
            if rates[a] > WRONG_SIGN and active.forces[a] < longest * rates[a]:
                blocking, longest = a, max(0.0, active.forces[a] / rates[a])
        if left > DEPENDENT * active.products[count] and count + 1 < active.limits.size:
            held = active.products[count] - _product(active.pushes[count], active.pushes[count])
            short = active.targets[count] - _product(active.pushes[count], y) - held * active.forces[count]
            if not short / left > longest:
                active.held[active.limits[count]] = True
                return OPTIMAL, count + 1, changes
        if blocking < 0:
            return CONTRADICTION if _contradicts(active, count, limits) else UNKNOWN, count, changes
        for a in range(count):
            active.forces[a] -= longest * rates[a]
        active.forces[count] += longest
        count = _drop(active, blocking, count)
        _moved(active, count + 1, free, y)
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
        _describe(active, count, limits, metric, free, i, 1.0 if code > 0 else -1.0)
        if _factor_row(active, count) > DEPENDENT * active.products[count] and math.isfinite(active.targets[count]):
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
    types.UniTuple(types.int64, 2)(
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
        guess: shape (k,), k - 1 the most limits that may be active; 1 + number of a limit for its lower side, minus that
            for its upper one, a zero after the last. That of the last point of the search is written.
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
    count = _take_up(active, guess, limits, metric, free)
    while changes <= budget:
        wrong = _forces(active, count)
        if wrong >= 0:
            count = _drop(active, wrong, count)
            changes += 1
            continue
        _moved(active, count, free, y)
        x[:] = y
        backward(metric, x)
        worst, most, side, waiting = _worst_of(limits, active.held, x, listed[:waiting])
        if worst < 0:
            _refine(active, count, limits, metric, y, x)
            worst, most, side, waiting = _worst_of_all(limits, active.held, x, values, listed)
            if worst < 0:
                _hand_out(active, count, guess, multipliers)
                return OPTIMAL, changes
        if not math.isfinite(most) or active.held[worst]:
            return UNKNOWN, changes
        _describe(active, count, limits, metric, free, worst, side)
        outcome, count, made = _enter(active, count, limits, free, y, budget - changes)
        changes += made
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

    def __init__(self, n: int, m: int, softness: Array | None = None, budget: int = ROUNDS) -> None:
        """For ``n`` variables and ``m`` rows; ``softness``: shape (n + m,), ``None`` where all limits must hold."""
        self._softness = np.zeros(n + m) if softness is None else softness
        self.guess = np.zeros(n + 1 + min(n, int(np.count_nonzero(self._softness))), dtype=np.int64)
        self.changes = 0
        self._n, self._m, self._budget = n, m, budget

    def solve(
        self, hessian: Array, gradient: Array, rows: Array, lower: Array, upper: Array, multipliers: Array
    ) -> tuple[int, Array]:
        """Outcome and x (n,), new; arrays as in :func:`search`, each with its entries one after the other."""
        x = np.empty(self._n)
        outcome, self.changes = search(
            hessian, gradient, rows, lower, upper, self._softness, self.guess, self._budget, x, multipliers
        )
        return outcome, x

    def start_from(self, limits: Indices) -> None:
        """Start next from the lower sides of these limits, as many as there is room for."""
        limits = limits[: self.guess.size - 1]
        self.guess[: limits.size], self.guess[limits.size :] = limits + 1, 0

    def adopt(self, multipliers: Array) -> None:
        """Start next from the active set of multipliers (n + m,) that another solver found."""
        self.guess[:] = active_limits(multipliers, self.guess.size)


def active_limits(multipliers: Array, size: int) -> Indices:
    """Limits with a multiplier, as a guess of ``size`` entries for :func:`search`; those beyond its room are left out."""
    found = np.flatnonzero(multipliers)[: size - 1]
    out = np.zeros(size, dtype=np.int64)
    out[: found.size] = np.where(multipliers[found] < 0, found + 1, -found - 1)
    return out
