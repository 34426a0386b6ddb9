"""Resolutions that solve a QP with all conditions: the nearest input, or the best one where violation has a price."""

import numpy as np

from robots.checks import all_finite
from robots.messages import Array
from safety.barriers.rows import BarrierRows
from safety.filters.condition_kernels import least_violation, near_zero_rows
from safety.filters.conditions import RowParameters
from safety.filters.resolution import ResolutionKind, Resolved, candidates
from safety.filters.second_phase import SLACK_PULL, SecondPhase
from safety.filters.working_set import BEYOND, Optimum, Problem, WorkingSetQp
from wbc.active_set import OPTIMAL
from wbc.least_slack import LeastSlack
from wbc.qp import UNBOUNDED

NEAR_ZERO_REACH = 1e-4
"""A row that changes over all inputs between the bounds by at most this fraction of the widest bound's range [m/rad] is
next to immovable,"""

NEAR_ZERO_GAIN = 1e-3
"""and given up where that change is also at most this fraction of what the row is short of at its best."""

CONFLICT_TOLERANCE = 1e-7
"""Conditions certainly cannot hold where every input violates one by more than this [m/s, rad/s]."""


class NearestQp:
    r"""The nearest input that satisfies the conditions; where there is none, what ``infeasible`` says.

    ``least_slack`` takes two phases, as p-SSA does:

    .. math:: s^* = \arg\min_s \tfrac12 \|s\|^2 \;\text{s.t.}\; A v \ge b - s,\; v_{min} \le v \le v_{max};
        \qquad v = \arg\min_v \|v - v^{des}\|_H^2 \;\text{s.t.}\; A v \ge b - s^*,\; v_{min} \le v \le v_{max}

    Where the conditions can hold s* is zero, so the first phase is done only where they cannot. Source: eqs. (12),
    (13) of the p-SSA paper with p = 2 and unit weights; eq. (33) of Lee et al. where the conditions can hold.

    A row that cannot hold and that nothing moves to speak of (``NEAR_ZERO_REACH``, ``NEAR_ZERO_GAIN``) is left out of
    both phases and stays violated: its compromise with the others would be full speed, in a direction that rounding
    decides, for next to nothing. So the slack is the least to within

    .. math:: \|s\| \le (1 + \gamma) \|s^*\|, \qquad \gamma = \mathrm{NEAR\_ZERO\_GAIN}

    and each row left out is short of at most ``NEAR_ZERO_REACH`` times the widest bound's range more than at its best.
    Without such rows it is the least, to rounding (``SLACK_PULL`` and ``ROUNDING`` of
    :mod:`safety.filters.second_phase`). Should rounding leave the second phase without an answer, that of the first is
    taken.

    After a conflict the next tick starts with the first phase and asks whether all conditions can hold only where its
    slack does not prove that they cannot: the answer is the same, only sooner.

    Everything has a budget (``ROUNDS`` of :mod:`wbc.active_set`, ``STEPS`` of :mod:`wbc.least_slack`, ``PASSES`` of
    :mod:`safety.filters.working_set`). The first phase is at every step at an input between the bounds, with less slack
    than before; so where a budget is spent that one is taken, and ``spent`` of the answer says so.

    ``unsafe_pass_nominal`` returns the nominal input, clipped to its bounds: the naive baseline of sec. V-C there.
    """

    def __init__(self, nv: int, n_rows: int, infeasible: str = "least_slack") -> None:
        """For ``nv`` variables and ``n_rows`` rows; ``infeasible``: one of ``safety.filters.settings.INFEASIBLE``."""
        self._pass_nominal = infeasible == "unsafe_pass_nominal"
        self._pull, self._weights = SLACK_PULL * np.eye(nv), np.ones(n_rows)
        self._hard = WorkingSetQp(nv, n_rows)
        self._soft = Compromise(nv, n_rows)
        self._second = SecondPhase(nv, n_rows)
        self._conflict = False

    def set_parameters(self, parameters: RowParameters) -> None:
        """None are read: all that the conditions ask for is in the problem."""

    def resolve(self, problem: Problem, rows: BarrierRows) -> Resolved:
        """See :meth:`safety.filters.resolution.Resolution.resolve`."""
        if self._conflict:
            return self._compromise(problem, None)
        hard = self._hard.solve(problem, problem.spaces.b)
        if hard.v is not None:
            return Resolved(hard.v)
        if self._pass_nominal:
            return Resolved(problem.clipped(), True, candidates(problem, hard.working))
        return self._compromise(problem, hard)

    def _compromise(self, problem: Problem, hard: Optimum | None) -> Resolved:
        """Both phases; ``hard``: what became of the hard conditions, ``None`` where that was not tried."""
        A, b, bounds = np.ascontiguousarray(problem.spaces.A), problem.spaces.b, (problem.lower, problem.upper)
        near_zero = near_zero_rows(A, b, *bounds, NEAR_ZERO_REACH, NEAR_ZERO_GAIN)
        if near_zero.size:
            b = b.copy()
            b[near_zero] = -UNBOUNDED
        soft = A, b, self._weights
        proved, v = self._soft.solve(problem, self._pull, problem.clipped(), soft, direct=True)
        short = self._soft.short
        certain = least_violation(A, b, *bounds, short) > CONFLICT_TOLERANCE
        if not certain and (near_zero.size or hard is None):
            hard = self._hard.solve(problem, b)
            if hard.v is not None:
                self._conflict = near_zero.size > 0
                return Resolved(
                    hard.v, False, candidates(problem, self._hard.working(), near_zero) if near_zero.size else None
                )
        if not proved:
            proved, v = self._soft.go_on()
            certain = certain or least_violation(A, b, *bounds, short) > CONFLICT_TOLERANCE
        self._conflict = True
        seen = candidates(problem, np.flatnonzero(short > -BEYOND), near_zero)
        nearest = self._second.solve(problem, A, short, v)
        unknown = not certain and hard is not None and hard.spent
        spent = not proved or nearest is None or unknown
        return Resolved(v if nearest is None else nearest, False, seen, spent=spent)


class Compromise:
    """The input of least cost between its bounds where violation costs; searched from that of the last tick.

    Attributes:
        short: shape (n_rows,) by how much the conditions were violated at the last answer, below 0 where they held.
    """

    def __init__(self, nv: int, n_rows: int) -> None:
        """For ``nv`` variables and ``n_rows`` rows."""
        self._search = LeastSlack(nv, n_rows)
        self._no_rows, self._last = np.zeros((0, nv)), np.full(nv, np.nan)
        self._bounds = self._last, self._last
        self.short = self._search.short

    def solve(
        self,
        problem: Problem,
        hessian: Array,
        centre: Array,
        soft: tuple[Array, Array, Array],
        *,
        direct: bool = False,
    ) -> tuple[bool, Array]:
        """Whether the optimum was proved, and the input (nv,), new.

        Args:
            problem: its bounds are read.
            hessian: shape (nv, nv), metric of half the squared distance to ``centre``.
            centre: shape (nv,).
            soft: rows (n_rows, nv), their right-hand sides and the weights of half their squared violation.
            direct: whether to make a few steps only; where they prove no optimum, :meth:`go_on` looks further.
        """
        lower, upper = self._bounds = problem.lower, problem.upper
        start = np.minimum(np.maximum(self._last, lower), upper)
        if not all_finite(start):
            start = problem.clipped()
        gradient = -(hessian @ centre)
        return self._kept(
            *self._search.solve(hessian, gradient, soft, self._no_rows, lower, upper, start, direct=direct)
        )

    def go_on(self) -> tuple[bool, Array]:
        """The rest of :meth:`solve`, for the problem that it was given last."""
        return self._kept(*self._search.go_on())

    def _kept(self, outcome: int, v: Array) -> tuple[bool, Array]:
        lower, upper = self._bounds
        self._last = np.minimum(np.maximum(v, lower), upper)
        return outcome == OPTIMAL, self._last


class SlackQp:
    r"""The input that trades distance to the nominal one against violation.

    .. math:: \min_{v, s} \|v - v^{des}\|_H^2 + \tfrac12 \sum_i Q_i s_i^2
        \quad\text{s.t.}\quad A v \ge b - s,\; v_{min} \le v \le v_{max}

    There is always an answer, and it may violate conditions that could be held. Source: eq. (10) of the p-SSA paper
    with p = 2.
    """

    def __init__(self, nv: int, n_rows: int) -> None:
        """For ``nv`` variables and ``n_rows`` rows."""
        self._weights = np.zeros(n_rows)
        self._search = Compromise(nv, n_rows)

    def set_parameters(self, parameters: RowParameters) -> None:
        """``slack_weight`` is Q, shape (n_rows,)."""
        # the search's objective is half of both terms: 1/2 |v - v_des|^2 + 1/2 (Q/2) s^2
        self._weights = 0.5 * parameters.slack_weight

    def resolve(self, problem: Problem, rows: BarrierRows) -> Resolved:
        """See :meth:`safety.filters.resolution.Resolution.resolve`."""
        soft = np.ascontiguousarray(problem.spaces.A), problem.spaces.b, self._weights
        proved, v = self._search.solve(problem, problem.hessian, problem.v_des, soft)
        working = np.flatnonzero((self._search.short > -BEYOND) | problem.violated)
        return Resolved(v, False, candidates(problem, working), spent=not proved)


NEAREST = ResolutionKind("qp", NearestQp)
TWO_PHASE = ResolutionKind("two_phase", lambda nv, n_rows, infeasible: NearestQp(nv, n_rows))
SLACK = ResolutionKind("slack_qp", lambda nv, n_rows, infeasible: SlackQp(nv, n_rows))
