"""Joint-velocity safety filters: a condition on the velocity, and how the nearest one is found."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from robots.checks import all_finite, require_non_negative, require_one_of
from robots.messages import Array
from safety.conditions import BarrierParameters, cbf, issf_cbf
from safety.rows import BarrierRows, HalfSpaces
from wbc.qp import UNBOUNDED, make_solver

FILTERS = ("none", "cbf", "issf")
CONDITIONS = {"cbf": cbf, "issf": issf_cbf}

SLACK_ROUNDING = 1e-8
"""Room [m/s, rad/s] given to a row on top of its least slack, so that rounding does not make it infeasible again."""


class FilterStatus(IntEnum):
    """What became of the nominal velocity."""

    UNCHANGED = 0
    """It satisfied every condition and is returned as it came."""
    FILTERED = 1
    """The nearest velocity that satisfies every condition."""
    RELAXED = 2
    """No velocity satisfies every condition: the one with least violation."""
    FAILED = 3
    """No answer: zero velocity, never the nominal one."""


@dataclass(frozen=True, slots=True)
class FilterResult:
    """A filtered velocity.

    Attributes:
        v: shape (nv,) the velocity to use.
        status: what was done.
        slack: largest violation of an active condition by ``v`` [m/s or rad/s], recomputed from ``v``; 0 for none.
        worst_row: index of that condition; -1 for none.
        active: number of conditions that hold with equality (to 1e-6).
    """

    v: Array
    status: FilterStatus
    slack: float
    worst_row: int
    active: int


class SafetyFilter:
    r"""Nearest velocity that satisfies the barrier conditions and the velocity bounds.

    .. math:: \min_v \|v - v^{des}\|^2 + w_f \|J_f (v - v^{des})\|^2
        \quad\text{s.t.}\quad A v \ge b,\; v_{min} \le v \le v_{max}

    The first term is eq. (33) of Lee et al. The second keeps the filter from dragging stance feet when a row moves
    base or legs: J_f stacks the Jacobians of the feet in contact. It is a weight, not an equality, because an
    equality leaves too little freedom where joint limits and collisions meet in the legs.

    When no v satisfies the rows, the ladder is: the least sum of squared violations, then the velocity nearest to the
    nominal one among those (as in p-SSA); if that fails too, zero velocity. The nominal velocity is never passed on.

    Args:
        name: one of ``FILTERS``; ``none`` passes the nominal velocity through.
        n_rows: number of barrier rows.
        parameters: alpha and epsilon by family.
        v_max: shape (nv,) bounds on the size of each velocity, above 0 [m/s, rad/s].
        foot_weight: w_f, 0 or above.

    Raises:
        ConfigError: unknown filter or a negative weight.
    """

    def __init__(
        self, name: str, n_rows: int, parameters: BarrierParameters, v_max: Array, foot_weight: float = 1e3
    ) -> None:
        require_one_of("filter", name, FILTERS)
        require_non_negative("foot_weight", foot_weight)
        self.name = name
        self.parameters = parameters
        self.foot_weight = foot_weight
        self._nv = v_max.size
        self._v_max = v_max
        self._identity = np.eye(self._nv)
        self._n_rows = n_rows
        self._solver = make_solver("daqp", self._nv, n_rows)
        self._lower = np.concatenate([-v_max, np.zeros(n_rows)])
        self._upper = np.concatenate([v_max, np.full(n_rows, UNBOUNDED)])

    def apply(self, rows: BarrierRows, v_des: Array, feet: Array | None = None) -> FilterResult:
        """Filter one velocity.

        Args:
            rows: barrier rows at the measured state.
            v_des: shape (nv,) nominal velocity.
            feet: shape (k, nv) Jacobians of the feet in contact, or ``None``.

        Returns:
            The result; its arrays are new, the input is not changed. Never raises on bad numbers: a value that is not
            finite gives status ``FAILED``.
        """
        if not all_finite(v_des, rows.h, rows.jac, rows.drift):
            return FilterResult(np.zeros(self._nv), FilterStatus.FAILED, float("inf"), -1, 0)
        if self.name == "none":
            return FilterResult(v_des.copy(), FilterStatus.UNCHANGED, 0.0, -1, 0)
        conditions = CONDITIONS[self.name](rows, self.parameters)
        if (np.abs(v_des) <= self._v_max).all() and (conditions.A @ v_des >= conditions.b).all():
            return self._result(v_des.copy(), FilterStatus.UNCHANGED, conditions)
        hessian = self._identity
        if feet is not None and self.foot_weight > 0:
            hessian = hessian + self.foot_weight * (feet.T @ feet)
        v = self._nearest(hessian, v_des, conditions.A, conditions.b)
        if v is not None:
            return self._result(v, FilterStatus.FILTERED, conditions)
        return self._relaxed(hessian, v_des, conditions)

    def _nearest(self, hessian: Array, v_des: Array, rows: Array, b: Array) -> Array | None:
        self._lower[self._nv :] = b
        solution = self._solver.solve(hessian, -hessian @ v_des, rows, self._lower, self._upper)
        if solution.status != "optimal":
            return None
        return np.clip(solution.x, -self._v_max, self._v_max)

    def _relaxed(self, hessian: Array, v_des: Array, conditions: HalfSpaces) -> FilterResult:
        slack = self._least_slack(v_des, conditions)
        if slack is not None:
            v = self._nearest(hessian, v_des, conditions.A, conditions.b - slack - SLACK_ROUNDING)
            if v is not None:
                return self._result(v, FilterStatus.RELAXED, conditions)
        return self._result(np.zeros(self._nv), FilterStatus.FAILED, conditions)

    def _least_slack(self, v_des: Array, conditions: HalfSpaces) -> Array | None:
        """Slack (n,) of least sum of squares; a faint pull to ``v_des`` makes the velocity unique."""
        n, m = self._nv, self._n_rows
        pull = 1e-8
        hessian = np.diag(np.concatenate([np.full(n, pull), np.ones(m)]))
        gradient = np.concatenate([-pull * v_des, np.zeros(m)])
        lower = np.concatenate([-self._v_max, np.zeros(m), conditions.b])
        upper = np.concatenate([self._v_max, np.full(2 * m, UNBOUNDED)])
        rows = np.hstack([conditions.A, np.eye(m)])
        solution = make_solver("daqp", n + m, m).solve(hessian, gradient, rows, lower, upper)
        if solution.status != "optimal":
            return None
        return np.maximum(0.0, conditions.b - conditions.A @ solution.x[:n])

    def _result(self, v: Array, status: FilterStatus, conditions: HalfSpaces) -> FilterResult:
        gap = conditions.A @ v - conditions.b
        if gap.size == 0:
            return FilterResult(v, status, 0.0, -1, 0)
        worst = int(np.argmin(gap))
        slack = max(0.0, -float(gap[worst]))
        return FilterResult(v, status, slack, worst if slack > 0 else -1, int((gap < 1e-6).sum()))
