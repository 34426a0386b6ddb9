"""Safety filters: a condition on the input, and a resolution that says which input is taken."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from robots.checks import all_finite, require_non_negative, require_one_of, require_positive
from robots.errors import ConfigError
from robots.messages import Array, Indices
from safety.conditions import (
    NO_MARGINS,
    SET_MARGINS,
    BarrierParameters,
    RowParameters,
    cbf,
    issf_cbf,
    ssa,
    sss,
    worst_row,
)
from safety.infeasibility import Candidates
from safety.kernels import all_numbers, room
from safety.resolutions import (
    INFEASIBLE,
    CartesianPush,
    JointPush,
    NearestQp,
    Problem,
    Resolution,
    Resolved,
    SlackQp,
)
from safety.results import ACTIVE, RELAXED, FilterResult, FilterStatus, explain, report
from safety.rows import BarrierRows, HalfSpaces
from safety.second_order import acceleration_bounds, ecbf_rows, index_rows, without_margin
from wbc.qp import UNBOUNDED

__all__ = [
    "ACTIVE",
    "CONDITIONS",
    "FILTERS",
    "KINDS",
    "RELAXED",
    "FilterKind",
    "FilterResult",
    "FilterStatus",
    "SafetyFilter",
    "explain",
]

Condition = Callable[[BarrierRows, RowParameters], HalfSpaces]


@dataclass(frozen=True, slots=True)
class FilterKind:
    """What makes one filter differ from another.

    Attributes:
        name: in configurations.
        title: in texts and figures.
        condition: half-spaces of the rows; ``None``: no condition.
        resolution: ``qp``, ``slack_qp``, ``two_phase``, ``push_cartesian`` or ``push_joint``; ``none``: pass through.
        source: paper and equations.
        margins: margin by family where the parameters give none.
        orders: relative degrees it is defined for: 1, input velocity; 2, input acceleration.
    """

    name: str
    title: str
    condition: Condition | None
    resolution: str
    source: str
    margins: Mapping[str, float]
    orders: tuple[int, ...] = (1, 2)


LEE = "Lee et al., Safety-Critical Whole-Body Control for Humanoid Robots via ISSf-CBFs"
PSSA = "p-SSA paper"
SPARK = "SPARK"

KINDS: dict[str, FilterKind] = {
    kind.name: kind
    for kind in (
        FilterKind("none", "no filter", None, "none", f"baseline w/o-CBF of {LEE}", NO_MARGINS),
        FilterKind("cbf", "CBF", cbf, "qp", f"{LEE}, eqs. (5), (31), (33); {SPARK}, eq. (6)", NO_MARGINS),
        FilterKind("issf", "ISSf-CBF", issf_cbf, "qp", f"{LEE}, eqs. (32), (33)", NO_MARGINS),
        FilterKind("ecbf", "eCBF", cbf, "qp", f"{LEE}, eqs. (54), (55)", NO_MARGINS, (2,)),
        FilterKind("ssa", "SSA", ssa, "qp", f"{PSSA}, eq. (9); {SPARK}, eq. (5)", SET_MARGINS),
        FilterKind("rssa", "r-SSA", ssa, "slack_qp", f"{PSSA}, eq. (10)", SET_MARGINS),
        FilterKind("pssa", "p-SSA", ssa, "two_phase", f"{PSSA}, eqs. (12), (13)", SET_MARGINS),
        FilterKind("sss", "SSS", sss, "qp", f"{SPARK}, eq. (7)", SET_MARGINS),
        FilterKind("pfm", "PFM", worst_row, "push_cartesian", f"{SPARK}, eqs. (8)-(10)", SET_MARGINS),
        FilterKind("sma", "SMA", worst_row, "push_joint", f"{SPARK}, eqs. (12), (13)", SET_MARGINS),
    )
}
"""All filters by name."""

FILTERS = tuple(KINDS)

CONDITIONS: dict[str, Condition] = {kind.name: kind.condition for kind in KINDS.values() if kind.condition}


class SafetyFilter:
    r"""Makes an input satisfy the barrier conditions, one of ``FILTERS``: see :data:`KINDS` for what each does.

    Distance to the nominal input is measured in the metric

    .. math:: \|v - v^{des}\|_H^2 = \|v - v^{des}\|^2 + w_f \|J_f (v - v^{des})\|^2
        + w_b \|J_b (v - v^{des})\|^2 + w_h \|J_h (v - v^{des})\|^2

    The first term is eq. (33) of Lee et al. The second keeps the filter from dragging stance feet when a row moves
    base or legs: J_f stacks the Jacobians of the feet in contact. The third makes it give way with the arms before it
    disturbs balance: J_b stacks the Jacobians of the tasks that keep it (CoM, orientation of base and torso). The
    fourth keeps the hands, J_h, close to where they were going: the nearest joint velocity alone may carry them far off
    along a boundary. They are weights, not equalities, because equalities leave too little freedom where joint limits
    and collisions meet.

    When no v satisfies the rows, the QP filters go down a ladder: the least sum of squared violations and the v nearest
    to the nominal one among those (as in p-SSA); if that fails too, the stop action ("zero_velocity"): zero velocity,
    for order 2 the acceleration that brakes to it. The nominal input is passed on only with ``unsafe_pass_nominal``,
    which is for comparison with the papers' baselines, and the status says so.

    Args:
        name: one of ``FILTERS``; ``none`` passes the nominal input through.
        n_rows: number of barrier rows.
        parameters: of the conditions and resolutions, by family.
        v_max: shape (nv,) bounds on the size of each input, above 0 [m/s, rad/s; for order 2 m/s^2, rad/s^2].
        foot_weight: w_f, 0 or above.
        balance_weight: w_b, 0 or above.
        hand_weight: w_h, 0 or above.
        infeasible: one of ``INFEASIBLE``, for ``cbf``, ``issf``, ``ecbf``, ``ssa`` and ``sss``.
        max_age: inputs older than this are refused [s], above 0.
        order: 1, the input is a velocity; 2, it is an acceleration.
        velocity_max: shape (nv,) bounds on the velocity after a step, order 2 only; ``None`` for none.
        dt: that step [s], above 0; order 2 only.

    Raises:
        ConfigError: unknown filter or option, a filter of another order, a negative weight, or a bound that is not
            finite and above 0.
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
        infeasible: str = "least_slack",
        max_age: float = 0.1,
        order: int = 1,
        velocity_max: Array | None = None,
        dt: float = 0.002,
    ) -> None:
        require_one_of("filter", name, FILTERS)
        self.kind = KINDS[name]
        if order not in {1, 2}:
            raise ConfigError("order", order, "1 (velocity) or 2 (acceleration)")
        if order not in self.kind.orders:
            raise ConfigError("filter", name, "another one for velocities (order 1): it acts on accelerations")
        require_one_of("infeasible", infeasible, INFEASIBLE)
        weights = {"foot_weight": foot_weight, "balance_weight": balance_weight, "hand_weight": hand_weight}
        for key, weight in weights.items():
            require_non_negative(key, weight)
        for key, bound in (("v_max", v_max), ("velocity_max", velocity_max)):
            if bound is not None and not (bound.shape == v_max.shape and all_finite(bound) and (bound > 0).all()):
                raise ConfigError(key, bound, "finite and above 0 throughout, one number per input")
        for key, time in (("max_age", max_age), ("dt", dt)):
            require_positive(key, time)
        self.name, self.parameters, self.infeasible, self.max_age = name, parameters, infeasible, max_age
        self.foot_weight, self.balance_weight, self.hand_weight = foot_weight, balance_weight, hand_weight
        self.order, self._dt = order, dt
        self._nv, self._n_rows = v_max.size, n_rows
        self._limit = np.array(v_max)
        self._velocity_max = None if velocity_max is None else np.array(velocity_max)
        self._identity = np.eye(self._nv)
        self._family: bytes | None = None

    def apply(
        self,
        rows: BarrierRows,
        v_des: Array,
        feet: Array | None = None,
        balance: Array | None = None,
        hands: Array | None = None,
        *,
        age: float = 0.0,
        velocity: Array | None = None,
    ) -> FilterResult:
        """Filter one input.

        Args:
            rows: barrier rows at the measured state; for order 2 with their curvature.
            v_des: shape (nv,) nominal velocity, or acceleration.
            feet: shape (k, nv) Jacobians of the feet in contact, or ``None``.
            balance: shape (l, nv) Jacobians of the tasks that keep balance, or ``None``.
            hands: shape (m, nv) Jacobians of the hands' tasks, or ``None``.
            age: of the oldest of these inputs [s].
            velocity: shape (nv,) measured velocity, for order 2.

        Returns:
            The result; its arrays are new, the input is not changed. Never raises on bad numbers: a value that is not
            finite, or too old, gives status ``FAILED``.
        """
        if cause := self._objection(rows, v_des, age, velocity):
            return FilterResult(self._stop(velocity), FilterStatus.FAILED, float("inf"), -1, 0, cause=cause)
        if self.kind.condition is None:
            return FilterResult(v_des.copy(), FilterStatus.UNCHANGED, 0.0, -1, 0)
        self._prepare(rows.family)
        spaces = self._spaces(rows, velocity)
        if not all_finite(spaces.b):
            return self._failure("conditions are not finite", velocity, spaces)
        lower, upper = -self._limit, self._limit
        if self.order == 2 and velocity is not None:
            lower, upper = acceleration_bounds(self._limit, velocity, self._velocity_max, self._dt)
        violated = room(spaces.A, v_des, spaces.b) < 0
        pushes = self.kind.resolution.startswith("push") and spaces.active.any()
        if not (pushes or violated.any() or (v_des < lower).any() or (v_des > upper).any()):
            return report(v_des.copy(), FilterStatus.UNCHANGED, spaces)
        hessian = self._metric(((self.foot_weight, feet), (self.balance_weight, balance), (self.hand_weight, hands)))
        if hessian is not self._identity and not all_finite(hessian):
            return self._failure("weighted Jacobians are not finite", velocity, spaces)
        resolved = self._resolution.resolve(Problem(spaces, v_des, hessian, lower, upper, violated), rows)
        return self._conclude(resolved, velocity, spaces)

    def _objection(self, rows: BarrierRows, v_des: Array, age: float, velocity: Array | None) -> str:
        """Why these inputs cannot be used, in words; empty where they can."""
        if not -self.max_age <= age <= self.max_age:
            return f"input is {age:.2f} s old, allowed are {self.max_age:.2f} s"
        if rows.jac.shape != (self._n_rows, self._nv) or v_des.shape != (self._nv,):
            size, expected = (*rows.jac.shape, v_des.size), (self._n_rows, self._nv, self._nv)
            return f"rows, their columns and the nominal input are {size}, expected {expected}"
        if not all_finite(v_des):
            return f"nominal {'velocity' if self.order == 1 else 'acceleration'} is not finite"
        if not all_numbers(rows.h, rows.drift, rows.jac):
            return "barrier rows are not finite"
        return "" if self.order == 1 else self._objection_to_second_order(rows, velocity)

    def _objection_to_second_order(self, rows: BarrierRows, velocity: Array | None) -> str:
        if velocity is None or velocity.shape != (self._nv,) or not all_finite(velocity):
            return "measured velocity is missing or not finite"
        if rows.curvature is None or not all_finite(rows.curvature):
            return "curvature of the barrier rows is missing or not finite"
        return ""

    def _prepare(self, family: Indices) -> None:
        """Parameters of each row, made once as long as the rows are of the same families."""
        # a fraction of the time of numpy's comparison
        if (key := family.tobytes()) == self._family:
            return
        self._family = key
        self._row_parameters = self.parameters.of_rows(family, self.kind.margins)
        self._bare_parameters = without_margin(self._row_parameters)
        self._resolution = self._make_resolution(self._row_parameters)

    def _make_resolution(self, p: RowParameters) -> Resolution:
        makers: dict[str, Callable[[], Resolution]] = {
            "qp": lambda: NearestQp(self._nv, self._n_rows, self.infeasible),
            "two_phase": lambda: NearestQp(self._nv, self._n_rows),
            "slack_qp": lambda: SlackQp(self._nv, self._n_rows, p.slack_weight),
            "push_cartesian": lambda: CartesianPush(p.push_cartesian),
            "push_joint": lambda: JointPush(p.push_joint),
        }
        return makers[self.kind.resolution]()

    def _spaces(self, rows: BarrierRows, velocity: Array | None) -> HalfSpaces:
        """The conditions on the input, those that are not active out of reach of any."""
        p = self._row_parameters
        if self.order == 2 and velocity is not None:
            rows = (ecbf_rows if self.name == "ecbf" else index_rows)(rows, velocity, p)
            p = self._bare_parameters
        spaces = CONDITIONS[self.name](rows, p)
        if spaces.active.all():
            return spaces
        return HalfSpaces(spaces.A, np.where(spaces.active, spaces.b, -UNBOUNDED), spaces.active)

    def _metric(self, weighted: tuple[tuple[float, Array | None], ...]) -> Array:
        hessian = self._identity
        for weight, jacobian in weighted:
            if jacobian is not None and weight > 0:
                hessian = hessian + weight * (jacobian.T @ jacobian)
        return hessian

    def _conclude(self, resolved: Resolved, velocity: Array | None, spaces: HalfSpaces) -> FilterResult:
        if resolved.v is None:
            return self._failure("no solver has an answer", velocity, spaces, resolved.candidates)
        if resolved.unsafe:
            cause = "no input satisfies all conditions: the nominal one is passed on"
            return report(resolved.v, FilterStatus.UNSAFE, spaces, cause, resolved.candidates)
        return report(resolved.v, FilterStatus.FILTERED, spaces, "", resolved.candidates)

    def _failure(
        self, cause: str, velocity: Array | None, spaces: HalfSpaces, candidates: Candidates | None = None
    ) -> FilterResult:
        return report(self._stop(velocity), FilterStatus.FAILED, spaces, cause, candidates)

    def _stop(self, velocity: Array | None) -> Array:
        """The stop action: zero velocity, or the acceleration that brakes to it."""
        if self.order == 1 or velocity is None or velocity.shape != (self._nv,) or not all_finite(velocity):
            return np.zeros(self._nv)
        return np.clip(-velocity / self._dt, -self._limit, self._limit)
