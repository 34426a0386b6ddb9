"""Which conditions cannot hold together, found out only when somebody asks."""

from dataclasses import dataclass

import numpy as np

from robots.messages import Array, Indices
from wbc.qp import UNBOUNDED, make_solver

PULL = 1e-8
"""Weight of the velocity's own size while the least violation is sought: it makes the velocity unique."""

SUPPORT = 1e-6
"""Fraction of the largest least violation above which a row's own counts as more than rounding."""


@dataclass(frozen=True, slots=True)
class Candidates:
    """Rows among which a conflict is to be found: A v >= b within bounds; arrays of its own.

    Attributes:
        rows: shape (m,) their places among the barrier rows, in any order.
        A: shape (m, nv).
        b: shape (m,).
        lower: shape (nv,) bound of v.
        upper: shape (nv,) likewise.
    """

    rows: Indices
    A: Array
    b: Array
    lower: Array
    upper: Array


def minimal_conflict(candidates: Candidates) -> tuple[int, ...]:
    """A set of rows that cannot hold together within the bounds, but could if any one of them were dropped.

    The rows with a violation in the least-squares compromise cannot hold together: weighted by these violations they
    sum up to a condition that no velocity within the bounds meets (Farkas). From these, one after the other is dropped
    where the rest stays in conflict without it.

    Args:
        candidates: the rows to look at.

    Returns:
        Their places among the barrier rows, ascending; empty where all candidates can hold together.
    """
    violation = _least_violation(candidates)
    if violation is None or not violation.size:
        return ()
    kept = [int(i) for i in np.flatnonzero(violation > SUPPORT * violation.max())]
    if _can_hold(candidates, kept):
        kept = list(range(candidates.b.size))
        if _can_hold(candidates, kept):
            return ()
    # ties in the order of the rows, whatever that of the candidates is
    for i in sorted(kept, key=lambda k: (violation[k], candidates.rows[k])):
        rest = [k for k in kept if k != i]
        if not _can_hold(candidates, rest):
            kept = rest
    return tuple(sorted(int(candidates.rows[k]) for k in kept))


def _can_hold(candidates: Candidates, chosen: list[int]) -> bool:
    """Whether some velocity within the bounds satisfies the chosen rows."""
    A, b = candidates.A[chosen], candidates.b[chosen]
    n = A.shape[1]
    lower = np.concatenate([candidates.lower, b])
    upper = np.concatenate([candidates.upper, np.full(b.size, UNBOUNDED)])
    return make_solver("daqp", n, b.size).solve(np.eye(n), np.zeros(n), A, lower, upper).status == "optimal"


def _least_violation(candidates: Candidates) -> Array | None:
    """Violations (m,) of least sum of squares."""
    A, b = candidates.A, candidates.b
    m, n = A.shape
    solver = make_solver("daqp", n, m, np.full(m, 1 / PULL))
    lower = np.concatenate([candidates.lower, b])
    upper = np.concatenate([candidates.upper, np.full(m, UNBOUNDED)])
    solution = solver.solve(np.eye(n), np.zeros(n), A, lower, upper)
    return np.maximum(0.0, b - A @ solution.x) if solution.status == "optimal" else None
