"""Active limits and the point that they hold, compiled, for :mod:`wbc.active_set`."""

import math
from typing import NamedTuple

import numpy as np

from robots.kernel_types import ORDER_FREE, njit
from robots.messages import Array, Indices, Mask
from wbc.limits import NOTHING, Limits
from wbc.triangular import backward, forward, product

WRONG_SIGN = 1e-12
"""Fraction of the largest multiplier by which one may have the wrong sign."""

CONTRADICTION_TOLERANCE = 1e-7
"""A contradiction is proved where every point within the bounds breaks an average of limits by more than this."""

REACH = 1e9
"""No point with a larger variable is looked for when limits are proved to contradict each other."""


class Active(NamedTuple):
    """Active limits of a search in order of entry, as push . y >= target in coordinates in which H is the identity.

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
def describe(active: Active, k: int, limits: Limits, metric: Array, free: Array, i: int, sign: float) -> None:
    """Write limit i with its side to place k; ``metric`` is the factor U of H, ``free`` the optimum without limits."""
    n, push = metric.shape[0], active.pushes[k]
    if i < n:
        push[:] = 0.0
        push[i] = sign
    else:
        row = limits.rows[i - n]
        for j in range(n):
            push[j] = sign * row[j]
    forward(metric, push)
    squared = product(push, push)
    scale = 1.0 / math.sqrt(squared) if squared > NOTHING else 1.0
    for j in range(n):
        push[j] *= scale
    active.limits[k], active.signs[k], active.scales[k], active.forces[k] = i, sign, scale, 0.0
    active.targets[k] = scale * (limits.lower[i] if sign > 0.0 else -limits.upper[i])
    active.wanted[k] = active.targets[k] - product(push, free)
    for j in range(k):
        active.products[j] = product(push, active.pushes[j])
    active.products[k] = product(push, push) + scale * scale * limits.softness[i]


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def factor_row(active: Active, k: int) -> float:
    """Row k of the Cholesky factor, of the limit described there; returns what is left of it beside those before."""
    row = active.factor[k]
    for j in range(k):
        row[j] = (active.products[j] - product(row[:j], active.factor[j, :j])) / active.factor[j, j]
    left = active.products[k] - product(row[:k], row[:k])
    row[k] = math.sqrt(max(left, 0.0))
    return left


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def drop(active: Active, gone: int, count: int) -> int:
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
def substitute(active: Active, count: int, x: Array) -> None:
    """Solve the second half, L^T x = x, in place, for the first ``count`` active limits."""
    for a in range(count - 1, -1, -1):
        x[a] /= active.factor[a, a]
        for b in range(a):
            x[b] -= active.factor[a, b] * x[a]


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def forces(active: Active, count: int) -> int:
    """The multipliers that hold all active limits; returns the place of the most wrong sign, -1 for none."""
    force, largest = active.forces, 0.0
    for a in range(count):
        force[a] = (active.wanted[a] - product(active.factor[a, :a], force[:a])) / active.factor[a, a]
    substitute(active, count, force)
    for a in range(count):
        largest = max(largest, abs(force[a]))
    wrong, least = -1, -WRONG_SIGN * largest
    for a in range(count):
        if not force[a] >= least:
            wrong, least = a, force[a]
    return wrong


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def moved(active: Active, count: int, free: Array, y: Array) -> None:
    """Where the active limits push the free optimum to: writes ``y``."""
    for j in range(y.size):
        y[j] = free[j]
    for a in range(count):
        force, push = active.forces[a], active.pushes[a]
        for j in range(y.size):
            y[j] += force * push[j]


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def refine(active: Active, count: int, limits: Limits, metric: Array, y: Array, x: Array) -> None:
    """One step of refinement of the point x = U^-1 y: what rounding left of the active limits is taken away.

    U may be as badly conditioned as the root of H; limits that meet in one point, as the sides of a cone do, would come
    and go by what it leaves.
    """
    n, rates, left = x.size, active.rates, 0.0
    for a in range(count):
        i = active.limits[a]
        value = x[i] if i < n else product(limits.rows[i - n], x)
        scale = active.scales[a]
        short = active.targets[a] - active.signs[a] * scale * value
        short -= scale * scale * limits.softness[i] * active.forces[a]
        left = max(left, abs(short))
        rates[a] = (short - product(active.factor[a, :a], rates[:a])) / active.factor[a, a]
    if left == 0.0:
        return
    substitute(active, count, rates)
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
def contradicts(active: Active, count: int, limits: Limits) -> bool:
    """Whether the limit at place ``count`` and the active ones that do not give way to it cannot hold together.

    Weighted by their rates they add up to one condition on x; no x within the bounds, or ``REACH`` where there are
    none, meets that one (Farkas).
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
    return demand > CONTRADICTION_TOLERANCE * weights and weights > 0.0
