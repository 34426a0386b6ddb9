"""Joint-velocity safety filters: a condition on the velocity, and how the nearest one is found."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from robots.checks import all_finite, require_non_negative, require_one_of
from robots.errors import ConfigError
from robots.messages import Array
from safety.conditions import BarrierParameters, cbf, issf_cbf
from safety.rows import BarrierRows, HalfSpaces
from wbc.qp import UNBOUNDED, make_solver

FILTERS = ("none", "cbf", "issf")
CONDITIONS = {"cbf": cbf, "issf": issf_cbf}

SLACK_ROUNDING = 1e-8
"""Room [m/s, rad/s] given to a row on top of its least slack, so that rounding does not make it infeasible again."""

SLACK_PULL = 1e-8
"""Weight of the nominal velocity while the least slack is sought: it makes the velocity unique."""

ACTIVE = 1e-6
"""Conditions with less room than this [m/s, rad/s] count as active."""


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
        active: number of conditions at their limit (to ``ACTIVE``) or beyond it.
    """

    v: Array
    status: FilterStatus
    slack: float
    worst_row: int
    active: int


class SafetyFilter:
    r"""Nearest velocity that satisfies the barrier conditions and the velocity bounds.

    .. math:: \min_v \|v - v^{des}\|^2 + w_f \|J_f (v - v^{des})\|^2 + w_b \|J_b (v - v^{des})\|^2
        + w_h \|J_h (v - v^{des})\|^2
        \quad\text{s.t.}\quad A v \ge b,\; v_{min} \le v \le v_{max}

    The first term is eq. (33) of Lee et al. The second keeps the filter from dragging stance feet when a row moves
    base or legs: J_f stacks the Jacobians of the feet in contact. The third makes it give way with the arms before it
    disturbs balance: J_b stacks the Jacobians of the tasks that keep it (CoM, orientation of base and torso). The
    fourth keeps the hands, J_h, close to where they were going: the nearest joint velocity alone may carry them far off
    along a boundary. They are weights, not equalities, because equalities leave too little freedom where joint limits
    and collisions meet.

    When no v satisfies the rows, the ladder is: the least sum of squared violations, then the velocity nearest to the
    nominal one among those (as in p-SSA); if that fails too, zero velocity. The nominal velocity is never passed on.

    Args:
        name: one of ``FILTERS``; ``none`` passes the nominal velocity through.
        n_rows: number of barrier rows.
        parameters: alpha and epsilon by family.
        v_max: shape (nv,) bounds on the size of each velocity, above 0 [m/s, rad/s].
        foot_weight: w_f, 0 or above.
        balance_weight: w_b, 0 or above.
        hand_weight: w_h, 0 or above.

    Raises:
        ConfigError: unknown filter, a negative weight, or a bound that is not finite and above 0.
    """

    def __init__(
        self,
        name: str,
        n_rows: int,
        parameters: BarrierParameters,
        v_max: Array,
        foot_weight: float = 1e3,
        balance_weight: float = 1e3,
        hand_weight: float = 1e2,
    ) -> None:
        require_one_of("filter", name, FILTERS)
        require_non_negative("foot_weight", foot_weight)
        require_non_negative("balance_weight", balance_weight)
        require_non_negative("hand_weight", hand_weight)
        if not (all_finite(v_max) and (v_max > 0).all()):
            raise ConfigError("v_max", v_max, "finite and above 0 throughout")
        self.name = name
        self.parameters = parameters
        self.foot_weight = foot_weight
        self.balance_weight = balance_weight
        self.hand_weight = hand_weight
        self._nv = v_max.size
        self._v_max = np.array(v_max)
        self._identity = np.eye(self._nv)
        self._n_rows = n_rows
        self._solver = make_solver("daqp", self._nv, n_rows)
        self._lower = np.concatenate([-v_max, np.zeros(n_rows)])
        self._upper = np.concatenate([v_max, np.full(n_rows, UNBOUNDED)])

    def apply(
        self,
        rows: BarrierRows,
        v_des: Array,
        feet: Array | None = None,
        balance: Array | None = None,
        hands: Array | None = None,
    ) -> FilterResult:
        """Filter one velocity.

        Args:
            rows: barrier rows at the measured state.
            v_des: shape (nv,) nominal velocity.
            feet: shape (k, nv) Jacobians of the feet in contact, or ``None``.
            balance: shape (l, nv) Jacobians of the tasks that keep balance, or ``None``.
            hands: shape (m, nv) Jacobians of the hands' tasks, or ``None``.

        Returns:
            The result; its arrays are new, the input is not changed. Never raises on bad numbers: a value that is not
            finite gives status ``FAILED``.
        """
        if not all_finite(v_des, rows.h, rows.jac, rows.drift):
            return FilterResult(np.zeros(self._nv), FilterStatus.FAILED, float("inf"), -1, 0)
        if self.name == "none":
            return FilterResult(v_des.copy(), FilterStatus.UNCHANGED, 0.0, -1, 0)
        conditions = _active_only(CONDITIONS[self.name](rows, self.parameters))
        if (np.abs(v_des) <= self._v_max).all():
            result = self._result(v_des.copy(), FilterStatus.UNCHANGED, conditions)
            if result.slack == 0.0:
                return result
        hessian = self._identity
        weighted = ((self.foot_weight, feet), (self.balance_weight, balance), (self.hand_weight, hands))
        for weight, jacobian in weighted:
            if jacobian is not None and weight > 0:
                hessian = hessian + weight * (jacobian.T @ jacobian)
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
        hessian = np.diag(np.concatenate([np.full(n, SLACK_PULL), np.ones(m)]))
        gradient = np.concatenate([-SLACK_PULL * v_des, np.zeros(m)])
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
        return FilterResult(v, status, slack, worst if slack > 0 else -1, int(np.count_nonzero(gap < ACTIVE)))


def _active_only(conditions: HalfSpaces) -> HalfSpaces:
    """The same conditions, those that are not active out of reach of any velocity."""
    if conditions.active.all():
        return conditions
    return HalfSpaces(conditions.A, np.where(conditions.active, conditions.b, -UNBOUNDED), conditions.active)
