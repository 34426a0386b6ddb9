"""Safety filters: a condition on the input, and a resolution that says which input is taken."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from robots.checks import all_finite, require_non_negative, require_one_of, require_positive
from robots.errors import ConfigError
from robots.messages import Array, Indices
from safety.barriers.rows import FAMILIES, BarrierRows, HalfSpaces
from safety.filters.conditions import BarrierParameters, RowParameters
from safety.filters.conflict import Candidates
from safety.filters.filter_inputs import not_finite, wrong_epsilon, wrong_shape
from safety.filters.filter_kernels import metric, survey
from safety.filters.recovery import Eased, Recovery, RecoverySettings
from safety.filters.registry import CONDITIONS, FILTERS, KINDS
from safety.filters.resolutions import (
    INFEASIBLE,
    CartesianPush,
    JointPush,
    NearestQp,
    Resolution,
    Resolved,
    SlackQp,
)
from safety.filters.results import ACTIVE, RELAXED, FilterResult, FilterStatus, explain, report
from safety.filters.second_order import acceleration_bounds, ecbf_rows, index_rows, without_margin
from safety.filters.working_set import Problem
from safety.geometry.contact_rows import packed
from wbc.qp import UNBOUNDED

BUDGET_SPENT = "budget spent: the answer is the best found so far"
"""Cause in a result whose search was cut short; see :attr:`safety.filters.results.FilterResult.spent`."""

NOT_FINITE = "conditions are not finite"
TOO_LARGE = "conditions are too large: their squares are not finite, or they ask for more than any input"
"""Causes of a failure."""

FAR = 2 * ACTIVE
"""With more room than this [m/s, rad/s] no condition counts as active, however sums are rounded."""

QPS = ("qp", "two_phase", "slack_qp")
"""Resolutions that solve a QP."""

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

    Every search has a budget. Where one is spent, v is the one of least slack found so far, between its bounds, and the
    result says so (``spent`` and the cause): see :class:`safety.filters.resolutions.NearestQp`.

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
        dt: that step [s], above 0; order 2, and recovery.
        recovery: how to come back from behind a barrier, see :mod:`safety.filters.recovery`; only for order 1 and
            filters that solve a QP. ``None``: the conditions are as strict there as anywhere.

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
        recovery: RecoverySettings | None = None,
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
        self._lower, self._upper = -self._limit, self._limit
        self._hessian, self._none = np.zeros((self._nv, self._nv)), np.zeros((0, self._nv))
        self._pushes = self.kind.resolution.startswith("push")
        self._family: bytes | None = None
        self._recovery: Recovery | None = None
        # the papers' baseline has none
        eased = order == 1 and self.kind.resolution in QPS and infeasible != "unsafe_pass_nominal"
        if recovery is not None and eased:
            self._recovery = Recovery(self._nv, n_rows, recovery, dt)

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
                :class:`safety.filters.adaptation.EpsilonAdapter`); ``None``: that of its family.

        Returns:
            The result; its arrays are new, the input is not changed. Never raises on bad numbers: a value that is not
            finite or too large to reckon with, an array of another shape, or input that is too old gives status
            ``FAILED`` with the cause.
        """
        jacobians = (feet, balance, hands)
        # numbers that overflow are looked for where they matter
        with np.errstate(all="ignore"):
            cause = self._objection(rows, v_des, age, velocity, jacobians) or wrong_epsilon(self._n_rows, epsilon)
            if cause:
                return self._refusal(cause, velocity)
            if self.kind.condition is None:
                if cause := not_finite(self.order, rows, v_des, velocity):
                    return self._refusal(cause, velocity)
                return FilterResult(v_des.copy(), FilterStatus.UNCHANGED, 0.0, -1, 0)
            if cause := self.prepare(rows.family):
                return self._refusal(not_finite(self.order, rows, v_des, velocity) or cause, velocity)
            own = self._row_parameters
            parameters = own if epsilon is None else replace(own, epsilon=epsilon)
            result = self._filter(rows, v_des, jacobians, velocity, parameters)
        if self._recovery is not None and not (result.status == FilterStatus.FAILED and result.worst_row < 0):
            self._recovery.note(v_des, result.v)
        return result

    def reset(self) -> None:
        """The robot is at rest: no command is left to go on from."""
        if self._recovery is not None:
            self._recovery.reset()

    def _filter(
        self,
        rows: BarrierRows,
        v_des: Array,
        jacobians: tuple[Array | None, ...],
        velocity: Array | None,
        parameters: RowParameters,
    ) -> FilterResult:
        """The result for inputs of the right shapes; ``jacobians``: feet, balance and hands."""
        lower, upper = self._lower, self._upper
        if self.order == 2 and velocity is not None:
            lower, upper = acceleration_bounds(self._limit, velocity, self._velocity_max, self._dt)
        spaces, violated = self._spaces(rows, velocity, parameters), np.empty(self._n_rows, dtype=bool)
        parts = packed(rows.h, rows.drift, spaces.A, spaces.b, v_des)
        total, room = survey(*parts, lower, upper, violated)
        if not math.isfinite(total) or spaces.A is not rows.jac:
            if cause := not_finite(self.order, rows, v_des, velocity):
                return self._refusal(cause, velocity)
        cause = "" if math.isfinite(total) else TOO_LARGE if all_finite(spaces.b) else NOT_FINITE
        asked, eased = spaces, None if cause else self._ease(rows, spaces, v_des, jacobians, parameters)
        if eased is not None:
            spaces, v_des = eased.spaces, eased.v_des
            parts = packed(rows.h, rows.drift, spaces.A, spaces.b, v_des)
            survey(*parts, lower, upper, violated)
        elif not cause and room >= 0.0 and not (self._pushes and spaces.active.any()):
            if room >= FAR:
                return FilterResult(v_des.copy(), FilterStatus.UNCHANGED, 0.0, -1, 0)
            return self._report(v_des.copy(), FilterStatus.UNCHANGED, velocity, spaces)
        if cause := cause or self._write_metric(jacobians, parts[4]):
            return self._failure(cause, velocity, spaces)
        conditions = HalfSpaces(parts[2], parts[3], spaces.active)
        problem = Problem(conditions, parts[4], self._hessian, lower, upper, violated)
        try:
            resolved = self._resolution.resolve(problem, rows)
        except np.linalg.LinAlgError as error:
            return self._failure(f"linear equations have no answer: {error}", velocity, spaces)
        return self._conclude(resolved, velocity, asked)

    def _ease(
        self,
        rows: BarrierRows,
        spaces: HalfSpaces,
        v_des: Array,
        jacobians: tuple[Array | None, ...],
        parameters: RowParameters,
    ) -> Eased | None:
        """What to filter instead where rows are lost."""
        if self._recovery is None:
            return None
        metric = partial(self._metric, jacobians, v_des)
        return self._recovery.ease(rows, spaces, CONDITIONS[self.name], parameters, v_des, metric, self._limit)

    def _metric(self, jacobians: tuple[Array | None, ...], v_des: Array) -> Array:
        """The metric (nv, nv), valid until the next one."""
        self._write_metric(jacobians, v_des)
        return self._hessian

    def _objection(
        self,
        rows: BarrierRows,
        v_des: Array,
        age: float,
        velocity: Array | None,
        jacobians: tuple[Array | None, ...],
    ) -> str:
        """Why these inputs cannot be used, whatever their numbers are, in words; empty where they can."""
        if not -self.max_age <= age <= self.max_age:
            return f"input is {age:.2f} s old, allowed are {self.max_age:.2f} s"
        measured = None if self.order == 1 else velocity
        if cause := wrong_shape(self._n_rows, self._nv, rows, v_des, measured, jacobians):
            return cause
        if self.order == 1 or (velocity is not None and rows.curvature is not None):
            return ""
        return not_finite(self.order, rows, v_des, velocity)

    def prepare(self, family: Indices) -> str:
        """Make ready for rows of these families (n_rows,), once as long as they stay the same; why not, in words.

        :meth:`apply` does it where it has not been done; the tick that it happens in takes a little longer.
        """
        if self.kind.condition is None:
            return ""
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

    def _write_metric(self, jacobians: tuple[Array | None, ...], v_des: Array) -> str:
        """Bring ``_hessian``, the metric (nv, nv), up to date; why it cannot be used, in words."""
        feet, balance, hands = (self._none if j is None else np.ascontiguousarray(j, dtype=float) for j in jacobians)
        weights = self.foot_weight, self.balance_weight, self.hand_weight
        if math.isfinite(metric(feet, balance, hands, *weights, v_des, self._hessian)):
            return ""
        return "nominal input is too large" if all_finite(self._hessian) else "weighted Jacobians are not finite"

    def _conclude(self, resolved: Resolved, velocity: Array | None, spaces: HalfSpaces) -> FilterResult:
        if resolved.v is None:
            return self._failure(resolved.cause or "no solver has an answer", velocity, spaces, resolved.candidates)
        if not all_finite(resolved.v):
            return self._failure("the answer is not finite", velocity, spaces)
        if resolved.unsafe:
            cause = "no solution found: the nominal input is passed on"
            return self._report(resolved.v, FilterStatus.UNSAFE, velocity, spaces, cause, resolved.candidates)
        cause = BUDGET_SPENT if resolved.spent else ""
        return self._report(
            resolved.v, FilterStatus.FILTERED, velocity, spaces, cause, resolved.candidates, resolved.spent
        )

    def _report(
        self,
        v: Array,
        status: FilterStatus,
        velocity: Array | None,
        spaces: HalfSpaces,
        cause: str = "",
        candidates: Candidates | None = None,
        spent: bool = False,
    ) -> FilterResult:
        """What an input does to the conditions; the stop action where that cannot be told."""
        result = report(v, status, spaces, cause, candidates, spent)
        return replace(result, v=self._stop(velocity)) if result.status == FilterStatus.FAILED else result

    def _refusal(self, cause: str, velocity: Array | None) -> FilterResult:
        """For inputs of which no conditions can be made."""
        self.reset()
        return FilterResult(self._stop(velocity), FilterStatus.FAILED, math.inf, -1, 0, cause=cause)

    def _failure(
        self, cause: str, velocity: Array | None, spaces: HalfSpaces, candidates: Candidates | None = None
    ) -> FilterResult:
        return report(self._stop(velocity), FilterStatus.FAILED, spaces, cause, candidates)

    def _stop(self, velocity: Array | None) -> Array:
        """The stop action: zero velocity, or the acceleration that brakes to it; zero where it is not known."""
        if self.order == 1 or velocity is None or velocity.shape != (self._nv,) or not all_finite(velocity):
            return np.zeros(self._nv)
        return np.clip(-velocity / self._dt, -self._limit, self._limit)
