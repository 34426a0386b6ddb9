"""What a filter returns: the input that was found, or the stop action and why."""

import math
from dataclasses import replace

import numpy as np

from robots.checks import all_finite
from robots.messages import Array
from safety.barriers.rows import HalfSpaces
from safety.filters.conflict import Candidates
from safety.filters.resolution import Resolved
from safety.filters.results import FilterResult, FilterStatus, report

BUDGET_SPENT = "budget spent: the answer is the best found so far"
"""Cause in a result whose search was cut short; see :attr:`safety.filters.results.FilterResult.spent`."""


class Answers:
    """Makes results; knows the stop action.

    The measured velocity (nv,), for order 2, is ``None`` where it is not known.

    Args:
        order: 1, the input is a velocity; 2, it is an acceleration.
        limit: shape (nv,) bounds on the size of each input.
        dt: step over which an acceleration is held [s].
    """

    __slots__ = ("_dt", "_limit", "_order")

    def __init__(self, order: int, limit: Array, dt: float) -> None:
        self._order, self._limit, self._dt = order, limit, dt

    def conclude(self, resolved: Resolved, spaces: HalfSpaces, velocity: Array | None) -> FilterResult:
        """For what a resolution found, and the conditions that the nominal input was asked to satisfy."""
        if resolved.v is None:
            return self.failure(resolved.cause or "no solver has an answer", spaces, velocity, resolved.candidates)
        if not all_finite(resolved.v):
            return self.failure("the answer is not finite", spaces, velocity)
        if resolved.unsafe:
            cause = "no solution found: the nominal input is passed on"
            return self.found(resolved.v, FilterStatus.UNSAFE, spaces, velocity, cause, resolved.candidates)
        cause, spent = BUDGET_SPENT if resolved.spent else "", resolved.spent
        return self.found(resolved.v, FilterStatus.FILTERED, spaces, velocity, cause, resolved.candidates, spent)

    def found(
        self,
        v: Array,
        status: FilterStatus,
        spaces: HalfSpaces,
        velocity: Array | None,
        cause: str = "",
        candidates: Candidates | None = None,
        spent: bool = False,
    ) -> FilterResult:
        """What an input does to the conditions; the stop action where that cannot be told."""
        result = report(v, status, spaces, cause, candidates, spent)
        return replace(result, v=self.stop(velocity)) if result.status == FilterStatus.FAILED else result

    def failure(
        self, cause: str, spaces: HalfSpaces, velocity: Array | None, candidates: Candidates | None = None
    ) -> FilterResult:
        """For conditions that no input was found for."""
        return report(self.stop(velocity), FilterStatus.FAILED, spaces, cause, candidates)

    def refusal(self, cause: str, velocity: Array | None) -> FilterResult:
        """For inputs of which no conditions can be made."""
        return FilterResult(self.stop(velocity), FilterStatus.FAILED, math.inf, -1, 0, cause=cause)

    def stop(self, velocity: Array | None) -> Array:
        """The stop action: zero velocity, or the acceleration that brakes to it; zero where it is not known."""
        nv = self._limit.size
        if self._order == 1 or velocity is None or velocity.shape != (nv,) or not all_finite(velocity):
            return np.zeros(nv)
        return np.clip(-velocity / self._dt, -self._limit, self._limit)
