"""Safety filters: a condition on the input, and a resolution that says which input is taken."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from robots.checks import all_finite, require_non_negative, require_one_of, require_positive
from robots.errors import ConfigError
from robots.messages import Array, Indices
from safety.conditions import BarrierParameters, RowParameters
from safety.filter_inputs import wrong_shape
from safety.filter_kinds import CONDITIONS, FILTERS, KINDS
from safety.infeasibility import Candidates
from safety.kernels import all_numbers, room
from safety.resolutions import (
    INFEASIBLE,
    CartesianPush,
    JointPush,
    NearestQp,
    Resolution,
    Resolved,
    SlackQp,
)
from safety.results import ACTIVE, RELAXED, FilterResult, FilterStatus, explain, report
from safety.rows import FAMILIES, BarrierRows, HalfSpaces
from safety.second_order import acceleration_bounds, ecbf_rows, index_rows, without_margin
from safety.working_set import Problem
from wbc.qp import UNBOUNDED

__all__ = [
    "ACTIVE",
    "CONDITIONS",
    "FILTERS",
    "KINDS",
    "RELAXED",
    "FilterResult",
    "FilterStatus",
    "SafetyFilter",
    "explain",
]


class SafetyFilter:
    r"""Makes an input satisfy the barrier conditions, one of ``FILTERS``: see :data:`KINDS` for what each does.

    Distance to the nominal input is measured in the metric

    .. math:: \|v - v^{des}\|_H^2 = \|v - v^{des}\|^2 + w_f \|J_f (v - v^{des})\|^2
        + w_b \|J_b (v - v^{des})\|^2 + w_h \|J_h (v - v^{des})\|^2

    The first term is eq. (33) of Lee et al. The second keeps the filter from dragging stance feet when a row moves
    base or legs: J_f stacks the Jacobians of the feet in contact, and of what else of the feet is to be left alone. The
    third makes it give way with the arms before it disturbs balance: J_b stacks the Jacobians of the tasks that keep it
    (CoM, orientation of base and torso). The fourth keeps the hands, J_h, close to where they were going: the nearest
    joint velocity alone may carry them far off along a boundary. They are weights, not equalities, because equalities
    leave too little freedom where joint limits and collisions meet.

    When no v satisfies the rows, the QP filters go down a ladder: the least sum of squared violations and the v nearest
    to the nominal one among those (as in p-SSA); if that fails too, the stop action ("zero_velocity"): zero velocity,
    for order 2 the acceleration that brakes to it as hard as the bounds allow. Where the velocity is not known there is
    nothing to brake against: the acceleration is zero then, and the robot coasts at the speed it has; whoever drives it
    has to stop it by other means. The nominal input is passed on only with ``unsafe_pass_nominal``, which is for
    comparison with the papers' baselines, and the status says so.

    Args:
        name: one of ``FILTERS``; ``none`` is no filter: it passes the nominal input through as it is, even beyond its
            bounds.
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
        if not (isinstance(n_rows, int | np.integer) and n_rows >= 0):
            raise ConfigError("n_rows", n_rows, "a whole number, 0 or above")
        if not isinstance(parameters, BarrierParameters):
            raise ConfigError("parameters", parameters, "a BarrierParameters")
        v_max = np.asarray(v_max, dtype=float)
        velocity_max = None if velocity_max is None else np.asarray(velocity_max, dtype=float)
        if v_max.ndim != 1:
            raise ConfigError("v_max", v_max, "of shape (nv,), one number per input")
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
        epsilon: Array | None = None,
    ) -> FilterResult:
        """Filter one input.

        Args:
            rows: barrier rows at the measured state; for order 2 with their curvature.
            v_des: shape (nv,) nominal velocity, or acceleration.
            feet: shape (k, nv) Jacobians of the feet that are to be left alone, or ``None``.
            balance: shape (l, nv) Jacobians of the tasks that keep balance, or ``None``.
            hands: shape (m, nv) Jacobians of the hands' tasks, or ``None``.
            age: of the oldest of these inputs [s].
            velocity: shape (nv,) measured velocity, for order 2.
            epsilon: shape (n,) ISSf parameter of each row in this tick, above 0 (see
                :class:`safety.adaptation.EpsilonAdapter`); ``None``: that of its family.

        Returns:
            The result; its arrays are new, the input is not changed. Never raises on bad numbers: a value that is not
            finite or too large to reckon with, an array of another shape, or input that is too old gives status
            ``FAILED`` with the cause.
        """
        jacobians = (("feet", feet), ("balance", balance), ("hands", hands))
        # numbers that overflow are looked for where they matter
        with np.errstate(all="ignore"):
            cause = self._objection(rows, v_des, age, velocity, jacobians) or self._objection_to_epsilon(epsilon)
            if not cause and self.kind.condition is None:
                return FilterResult(v_des.copy(), FilterStatus.UNCHANGED, 0.0, -1, 0)
            if cause := cause or self._prepare(rows.family):
                return FilterResult(self._stop(velocity), FilterStatus.FAILED, float("inf"), -1, 0, cause=cause)
            own = self._row_parameters
            parameters = own if epsilon is None else replace(own, epsilon=epsilon)
            return self._filter(rows, v_des, (feet, balance, hands), velocity, parameters)

    def _filter(
        self,
        rows: BarrierRows,
        v_des: Array,
        jacobians: tuple[Array | None, ...],
        velocity: Array | None,
        parameters: RowParameters,
    ) -> FilterResult:
        """The result for inputs of the right shapes; ``jacobians``: feet, balance and hands."""
        spaces = self._spaces(rows, velocity, parameters)
        if not all_finite(spaces.b):
            return self._failure("conditions are not finite", velocity, spaces)
        lower, upper = -self._limit, self._limit
        if self.order == 2 and velocity is not None:
            lower, upper = acceleration_bounds(self._limit, velocity, self._velocity_max, self._dt)
        violated = room(spaces.A, v_des, spaces.b) < 0
        pushes = self.kind.resolution.startswith("push") and spaces.active.any()
        if not (pushes or violated.any() or (v_des < lower).any() or (v_des > upper).any()):
            return self._report(v_des.copy(), FilterStatus.UNCHANGED, velocity, spaces)
        hessian = self._metric(jacobians)
        if hessian is not self._identity and not all_finite(hessian):
            return self._failure("weighted Jacobians are not finite", velocity, spaces)
        try:
            resolved = self._resolution.resolve(Problem(spaces, v_des, hessian, lower, upper, violated), rows)
        except np.linalg.LinAlgError as error:
            return self._failure(f"linear equations have no answer: {error}", velocity, spaces)
        return self._conclude(resolved, velocity, spaces)

    def _objection(
        self,
        rows: BarrierRows,
        v_des: Array,
        age: float,
        velocity: Array | None,
        jacobians: tuple[tuple[str, Array | None], ...],
    ) -> str:
        """Why these inputs cannot be used, in words; empty where they can."""
        if not -self.max_age <= age <= self.max_age:
            return f"input is {age:.2f} s old, allowed are {self.max_age:.2f} s"
        vectors = (("nominal input", v_des), ("measured velocity", None if self.order == 1 else velocity))
        if cause := wrong_shape(self._n_rows, self._nv, rows, vectors, jacobians):
            return cause
        if not all_finite(v_des):
            return f"nominal {'velocity' if self.order == 1 else 'acceleration'} is not finite"
        if not all_numbers(rows.h, rows.drift, rows.jac):
            return "barrier rows are not finite"
        return "" if self.order == 1 else self._objection_to_second_order(rows, velocity)

    def _objection_to_second_order(self, rows: BarrierRows, velocity: Array | None) -> str:
        if velocity is None or not all_finite(velocity):
            return "measured velocity is missing or not finite"
        if rows.curvature is None or not all_finite(rows.curvature):
            return "curvature of the barrier rows is missing or not finite"
        return ""

    def _objection_to_epsilon(self, epsilon: Array | None) -> str:
        if epsilon is None:
            return ""
        if epsilon.shape != (self._n_rows,):
            return f"epsilon has shape {epsilon.shape}, expected {(self._n_rows,)}"
        return "" if all_finite(epsilon) and (epsilon > 0).all() else "epsilon is not finite and above 0 throughout"

    def _prepare(self, family: Indices) -> str:
        """Parameters of each row, made once as long as the rows are of the same families; why not, in words."""
        # a fraction of the time of numpy's comparison
        if (key := family.tobytes()) == self._family:
            return ""
        if family.dtype.kind not in "iu" or not ((family >= 0) & (family < len(FAMILIES))).all():
            return f"family of the barrier rows has to be integers from 0 to {len(FAMILIES) - 1}"
        self._family = key
        self._row_parameters = self.parameters.of_rows(family, self.kind.margins)
        self._bare_parameters = without_margin(self._row_parameters)
        self._resolution = self._make_resolution(self._row_parameters)
        return ""

    def _make_resolution(self, p: RowParameters) -> Resolution:
        makers: dict[str, Callable[[], Resolution]] = {
            "qp": lambda: NearestQp(self._nv, self._n_rows, self.infeasible),
            "two_phase": lambda: NearestQp(self._nv, self._n_rows),
            "slack_qp": lambda: SlackQp(self._nv, self._n_rows, p.slack_weight),
            "push_cartesian": lambda: CartesianPush(p.push_cartesian),
            "push_joint": lambda: JointPush(p.push_joint),
        }
        return makers[self.kind.resolution]()

    def _spaces(self, rows: BarrierRows, velocity: Array | None, p: RowParameters) -> HalfSpaces:
        """The conditions on the input, those that are not active out of reach of any."""
        if self.order == 2 and velocity is not None:
            rows = (ecbf_rows if self.name == "ecbf" else index_rows)(rows, velocity, p)
            p = self._bare_parameters
        spaces = CONDITIONS[self.name](rows, p)
        if spaces.active.all():
            return spaces
        return HalfSpaces(spaces.A, np.where(spaces.active, spaces.b, -UNBOUNDED), spaces.active)

    def _metric(self, jacobians: tuple[Array | None, ...]) -> Array:
        hessian, weights = self._identity, (self.foot_weight, self.balance_weight, self.hand_weight)
        for weight, jacobian in zip(weights, jacobians, strict=True):
            if jacobian is not None and weight > 0:
                hessian = hessian + weight * (jacobian.T @ jacobian)
        return hessian

    def _conclude(self, resolved: Resolved, velocity: Array | None, spaces: HalfSpaces) -> FilterResult:
        if resolved.v is None:
            return self._failure(resolved.cause or "no solver has an answer", velocity, spaces, resolved.candidates)
        if not all_finite(resolved.v):
            return self._failure("the answer is not finite", velocity, spaces)
        if resolved.unsafe:
            cause = "no solution found: the nominal input is passed on"
            return self._report(resolved.v, FilterStatus.UNSAFE, velocity, spaces, cause, resolved.candidates)
        return self._report(resolved.v, FilterStatus.FILTERED, velocity, spaces, "", resolved.candidates)

    def _report(
        self,
        v: Array,
        status: FilterStatus,
        velocity: Array | None,
        spaces: HalfSpaces,
        cause: str = "",
        candidates: Candidates | None = None,
    ) -> FilterResult:
        """What an input does to the conditions; the stop action where that cannot be told."""
        result = report(v, status, spaces, cause, candidates)
        return replace(result, v=self._stop(velocity)) if result.status == FilterStatus.FAILED else result

    def _failure(
        self, cause: str, velocity: Array | None, spaces: HalfSpaces, candidates: Candidates | None = None
    ) -> FilterResult:
        return report(self._stop(velocity), FilterStatus.FAILED, spaces, cause, candidates)

    def _stop(self, velocity: Array | None) -> Array:
        """The stop action: zero velocity, or the acceleration that brakes to it; zero where it is not known."""
        if self.order == 1 or velocity is None or velocity.shape != (self._nv,) or not all_finite(velocity):
            return np.zeros(self._nv)
        return np.clip(-velocity / self._dt, -self._limit, self._limit)
