"""The form of a quadratic program, its solution, and what makes one a solution."""

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from robots.messages import Array
from wbc.limits import TOLERANCE

QpStatus = Literal["optimal", "infeasible", "failed"]
UNBOUNDED = 1e30
"""Bounds of this size or more count as absent."""

FEASIBILITY_TOLERANCE = TOLERANCE
"""Largest violation of a row that a solution may show (rows are in m/s, rad/s, N or N m)."""


@dataclass(frozen=True, slots=True)
class QpSolution:
    """Answer of a solver.

    Attributes:
        x: shape (n,) minimiser; the solver's last iterate unless ``status`` is ``optimal``.
        multipliers: shape (n + m,) of the bounds, then the rows; positive where an upper side is active.
        status: ``optimal``, ``infeasible`` (proved so) or ``failed`` (no answer: iteration limit, bad data).
        iterations: of the solver.
        spent: whether ``x`` only meets the limits, because a budget was spent before the optimum was found.
    """

    x: Array
    multipliers: Array
    status: QpStatus
    iterations: int
    spent: bool = False


class QpSolver(Protocol):
    r"""A solver for problems of one size, warm-started from its last answer.

    .. math:: \min_x \tfrac12 x^T H x + g^T x \quad \text{s.t.}\quad
        l_x \le x \le u_x,\; l \le A x \le u
    """

    def solve(self, hessian: Array, gradient: Array, rows: Array, lower: Array, upper: Array) -> QpSolution:
        """Solve one problem.

        Args:
            hessian: H, shape (n, n), symmetric positive definite.
            gradient: g, shape (n,).
            rows: A, shape (m, n).
            lower: shape (n + m,), bounds of x, then of A x; ``-UNBOUNDED`` for none (infinity is refused).
            upper: shape (n + m,), likewise.

        Returns:
            The solution; never raises for a problem without solution.
        """
        ...


def unsolved(n: int, m: int, status: QpStatus) -> QpSolution:
    """What there is to say of a problem of ``n`` variables and ``m`` rows that nothing was found for."""
    return QpSolution(np.zeros(n), np.zeros(n + m), status, 0)


def kkt_residual(
    hessian: Array,
    gradient: Array,
    rows: Array,
    lower: Array,
    upper: Array,
    solution: QpSolution,
    slack_weights: Array | None = None,
) -> float:
    """Largest violation of the optimality conditions of a solution: stationarity, feasibility, complementarity.

    Args:
        hessian: shape (n, n).
        gradient: shape (n,).
        rows: shape (m, n).
        lower: shape (n + m,).
        upper: shape (n + m,).
        solution: what a solver returned for it.
        slack_weights: shape (m,) as for :func:`make_solver`: a row may then be violated by its multiplier over its
            weight.

    Returns:
        The largest absolute residual; sides at ``UNBOUNDED`` must have no multiplier.
    """
    full = np.vstack([np.eye(gradient.size), rows])
    value = full @ solution.x
    up, down = np.maximum(solution.multipliers, 0), np.maximum(-solution.multipliers, 0)
    stationarity = hessian @ solution.x + gradient + full.T @ solution.multipliers
    if slack_weights is not None:
        # a violated row counts as moved to where its multiplier pays for it
        value = value - np.concatenate([np.zeros(gradient.size), solution.multipliers[gradient.size :] / slack_weights])
    primal = np.maximum(0, np.maximum(lower - value, value - upper))
    gap_up = np.where(upper < UNBOUNDED, np.abs(upper - value), UNBOUNDED) * up
    gap_down = np.where(lower > -UNBOUNDED, np.abs(value - lower), UNBOUNDED) * down
    return float(max(np.abs(r).max(initial=0.0) for r in (stationarity, primal, gap_up, gap_down)))
