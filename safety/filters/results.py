"""What a filter answers, and how to read it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from robots.messages import Array, Indices
from safety.barriers.rows import HalfSpaces
from safety.filters.conflict import Candidates, minimal_conflict
from safety.filters.filter_kernels import tally

ACTIVE = 1e-6
"""Conditions with less room than this [m/s, rad/s] count as active."""

RELAXED = 1e-7
"""Conditions violated by more than this [m/s, rad/s] count as relaxed; less is a solver's rounding."""


SINGLE_THREADED = 9216
"""Numbers in a matrix up to which BLAS multiplies it alone; for more it starts threads, and waits for them."""

NO_ROWS, NOTHING = np.zeros(0, dtype=np.intp), np.zeros(0)
"""Where no condition is violated; nobody may write to them, and there is nothing to write."""


class FilterStatus(IntEnum):
    """What became of the nominal input."""

    UNCHANGED = 0
    """It satisfied every condition and is returned as it came."""
    FILTERED = 1
    """Another input, which satisfies every condition."""
    RELAXED = 2
    """An input that violates some conditions, by as much as the filter's resolution has it."""
    FAILED = 3
    """No answer: the stop action, never the nominal input. ``cause`` says why."""
    UNSAFE = 4
    """The nominal input, clipped, because no solution was found: only where that was asked for."""


@dataclass(frozen=True, slots=True)
class FilterResult:
    """A filtered input.

    Attributes:
        v: shape (nv,) the input to use: a velocity, or an acceleration for order 2.
        status: what was done.
        slack: largest violation of an active condition by ``v`` [m/s or rad/s], recomputed from ``v``; 0 for none,
            infinite where it cannot be told.
        worst_row: index of that condition; -1 for none.
        active: number of conditions at their limit (to ``ACTIVE``) or beyond it.
        relaxed: indices of the conditions that ``v`` violates by more than ``RELAXED``, ascending.
        violation: by how much each of these is violated.
        cause: why the status is ``FAILED`` or ``UNSAFE``, or that a budget was spent; empty otherwise.
        candidates: rows among which to look for a conflict; ``None`` where all conditions hold.
        spent: whether ``v`` is the best that was found before a budget was spent, see
            :class:`safety.filters.resolutions.NearestQp`; its bounds, status and slack are as true as ever.
    """

    v: Array
    status: FilterStatus
    slack: float
    worst_row: int
    active: int
    relaxed: Indices = field(default_factory=lambda: NO_ROWS)
    violation: Array = field(default_factory=lambda: NOTHING)
    cause: str = ""
    candidates: Candidates | None = None
    spent: bool = False

    def conflict(self) -> tuple[int, ...]:
        """A minimal set of rows that cannot hold together within the bounds; computed when asked, some ms.

        Empty where they can: for r-SSA, which relaxes also what could be held, it is looked for among the rows that
        its solver saw; PFM and SMA do not look at rows together and have none.
        """
        return () if self.candidates is None else minimal_conflict(self.candidates)


def report(
    v: Array,
    status: FilterStatus,
    spaces: HalfSpaces,
    cause: str = "",
    candidates: Candidates | None = None,
    spent: bool = False,
) -> FilterResult:
    """What an input does to the conditions, whatever a solver said.

    Args:
        v: shape (nv,) the input that is returned; kept, not copied.
        status: what was done; ``FILTERED`` becomes ``RELAXED`` where ``v`` violates a condition, and any becomes
            ``FAILED`` where a condition has no number at ``v`` or violates it without bound.
        spaces: the conditions.
        cause: see :class:`FilterResult`.
        candidates: likewise; kept only where ``v`` violates a condition.
        spent: likewise.
    """
    gap = _room(spaces.A, v, spaces.b)
    worst, least, active = tally(gap, ACTIVE)
    if worst < 0:
        return FilterResult(v, status, 0.0, -1, 0, cause=cause, spent=spent)
    if not math.isfinite(least):
        cause = f"condition {worst} is not finite at the answer" if spent or not cause else cause
        return FilterResult(v, FilterStatus.FAILED, math.inf, worst, active, cause=cause)
    slack = max(0.0, -least)
    if slack <= RELAXED:
        return FilterResult(v, status, slack, worst if slack > 0 else -1, active, cause=cause, spent=spent)
    relaxed = np.flatnonzero(gap < -RELAXED)
    if status == FilterStatus.FILTERED:
        status = FilterStatus.RELAXED
    return FilterResult(v, status, slack, worst, active, relaxed, -gap[relaxed], cause, candidates, spent)


def _room(A: Array, v: Array, b: Array) -> Array:
    """A v - b, by numpy, as anybody would check it; in blocks that are too small for BLAS to start threads."""
    out = np.empty(b.size)
    # a multiple of what BLAS takes at a time, so that the rounding does not depend on the blocks
    block = max(16, SINGLE_THREADED // max(1, v.size) // 16 * 16)
    for i in range(0, b.size, block):
        A[i : i + block].dot(v, out=out[i : i + block])
    out -= b
    return out


def explain(result: FilterResult, labels: Sequence[str]) -> str:
    """What a filter did, for humans: which rows were given up, by how much, and which cannot hold together.

    Args:
        result: of :meth:`safety.filters.safety_filter.SafetyFilter.apply`.
        labels: name of every barrier row.

    Returns:
        One line or several; amounts in m/s or rad/s, for accelerations m/s^2 or rad/s^2.
    """
    lines = [result.status.name.lower() + (f": {result.cause}" if result.cause else "")]
    order = np.argsort(-result.violation, kind="stable")
    lines += [f"  short by {result.violation[k]:.3g}: {labels[result.relaxed[k]]}" for k in order]
    if conflict := result.conflict():
        words = "cannot hold together" if len(conflict) > 1 else "cannot hold"
        lines.append(f"  {words} within the bounds: " + "; ".join(labels[i] for i in conflict))
    return "\n".join(lines)
