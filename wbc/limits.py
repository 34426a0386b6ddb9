"""What is to hold in a quadratic program, and which of it a point breaks, compiled, for :mod:`wbc.active_set`."""

import math
from typing import NamedTuple

from robots.kernel_types import ORDER_FREE, njit
from robots.messages import Array, Indices, Mask
from wbc.triangular import product

TOLERANCE = 1e-9
"""Largest violation of a limit at an optimum; of a row shorter than 1 at unit length."""

ROUNDING = 1e-13
"""Violation at unit length, over 1 + the largest variable, that no answer can be asked to stay below."""

NOTHING = 1e-30
"""Squared length up to which a row counts as zero: nothing moves it."""

CLEARLY = 1e-6
"""Listed limits come in only where they are broken by more than this at unit length: more than rounding can be."""


class Limits(NamedTuple):
    """What is to hold: lower <= [x; rows x] <= upper, (n + m,), softened by ``softness`` (n + m,); rows (m, n)."""

    rows: Array
    lower: Array
    upper: Array
    softness: Array


@njit(cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _excess(limits: Limits, i: int, value: float, floor: float) -> tuple[float, float]:
    """By how much limit i is broken beyond what is tolerated, at unit length, and +1 (below) or -1 (above).

    0 or less where it holds; NaN where it has no number or its lower side is above its upper one.
    """
    n, lower, upper = limits.rows.shape[1], limits.lower[i], limits.upper[i]
    if not lower <= upper:
        return math.nan, 1.0
    squared = product(limits.rows[i - n], limits.rows[i - n]) if i >= n else 1.0
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
def worst_of_all(limits: Limits, held: Mask, x: Array, values: Array, listed: Indices) -> tuple[int, float, float, int]:
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
def worst_of(limits: Limits, held: Mask, x: Array, listed: Indices) -> tuple[int, float, float, int]:
    """The same among those ``listed``, of which those clearly broken are kept, at the front."""
    worst, most, side, count = -1, 0.0, 1.0, 0
    for i in listed:
        if held[i]:
            continue
        value = x[i] if i < x.size else product(limits.rows[i - x.size], x)
        if limits.lower[i] <= value <= limits.upper[i]:
            continue
        excess, sign = _excess(limits, i, value, CLEARLY)
        if excess > 0.0:
            listed[count] = i
            count += 1
            if excess > most:
                worst, most, side = i, excess, sign
    return worst, most, side, count
