"""Safety filters: a condition on the input, and a resolution that says which input is taken."""

import math
from dataclasses import replace
from functools import partial

import numpy as np

from robots.checks import all_finite
from robots.errors import ConfigError
from robots.messages import Array, Indices
from safety.barriers.rows import BarrierRows, HalfSpaces
from safety.filters.answers import BUDGET_SPENT, Answers
from safety.filters.conditions import BarrierParameters, RowParameters
from safety.filters.filter_inputs import not_finite, wrong_epsilon, wrong_shape
from safety.filters.filter_kernels import survey
from safety.filters.filter_kind import FilterKind
from safety.filters.metric import Jacobians, Metric
from safety.filters.recovery import Eased, Recovery, RecoverySettings
from safety.filters.registry import FILTERS, KINDS, filter_kind
from safety.filters.results import ACTIVE, RELAXED, FilterResult, FilterStatus, explain
from safety.filters.row_conditions import RowConditions
from safety.filters.second_order import acceleration_bounds
from safety.filters.settings import FilterSettings, MetricWeights, checked_bounds
from safety.filters.working_set import Problem
from safety.geometry.contact_rows import packed

NOT_FINITE = "conditions are not finite"
TOO_LARGE = "conditions are too large: their squares are not finite, or they ask for more than any input"
"""Causes of a failure."""

FAR = 2 * ACTIVE
"""With more room than this [m/s, rad/s] no condition counts as active, however sums are rounded."""

__all__ = [
    "ACTIVE",
    "BUDGET_SPENT",
    "FILTERS",
    "KINDS",
    "RELAXED",
    "FilterKind",
    "FilterResult",
    "FilterSettings",
    "FilterStatus",
    "MetricWeights",
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

    What is set later takes force in the next call of :meth:`apply`, and nothing that was learned is lost: buffers, warm
    starts and the way out of a broken barrier stay. Attributes cannot be set but by these methods.

    Args:
        kind: the filter, or its name as :func:`safety.filters.registry.filter_kind` knows it; ``none`` is no filter: it
            passes the nominal input through as it is, even beyond its bounds.
        n_rows: number of barrier rows.
        parameters: of the conditions and resolutions, by family.
        v_max: shape (nv,) bounds on the size of each input, above 0 [m/s, rad/s; for order 2 m/s^2, rad/s^2].
        weights: of the metric.
        settings: how it is run.

    Raises:
        ConfigError: unknown filter, a filter of another order, parameters of another filter, or a bound that is not
            finite and above 0.
    """

    __slots__ = (
        "_answers",
        "_conditions",
        "_limit",
        "_lower",
        "_metric",
        "_n_rows",
        "_recovery",
        "_resolution",
        "_settings",
    )

    def __init__(
        self,
        kind: str | FilterKind,
        n_rows: int,
        parameters: BarrierParameters,
        v_max: Array,
        weights: MetricWeights | None = None,
        settings: FilterSettings | None = None,
    ) -> None:
        kind = kind if isinstance(kind, FilterKind) else filter_kind(kind)
        self._settings = FilterSettings() if settings is None else settings
        if self._settings.order not in kind.orders:
            other = "another one for velocities (order 1): it acts on accelerations"
            raise ConfigError("filter", kind.name, other if self._settings.order == 1 else "one for accelerations")
        if not (isinstance(n_rows, int | np.integer) and n_rows >= 0):
            raise ConfigError("n_rows", n_rows, "a whole number, 0 or above")
        self._n_rows = n_rows
        self._set_limit(checked_bounds("v_max", v_max))
        nv = self._limit.size
        bound = self._settings.velocity_max
        if bound is not None and bound.shape != self._limit.shape:
            raise ConfigError("velocity_max", bound, f"{nv} numbers, one per input")
        self._metric = Metric(nv, MetricWeights() if weights is None else weights)
        self._conditions = RowConditions(kind, parameters, self._take_over)
        self._resolution = kind.resolution.make(nv, n_rows, self._settings.infeasible)
        self._recovery: Recovery | None = None
        self.set_recovery(self._settings.recovery)

    @property
    def kind(self) -> FilterKind:
        """Condition and resolution."""
        return self._conditions.kind

    @property
    def name(self) -> str:
        """Name of the filter."""
        return self._conditions.kind.name

    @property
    def parameters(self) -> BarrierParameters:
        """Of the conditions and resolutions, by family; see :meth:`set_parameters`."""
        return self._conditions.parameters

    @property
    def weights(self) -> MetricWeights:
        """Of the metric; see :meth:`set_weights`."""
        return self._metric.weights

    @property
    def settings(self) -> FilterSettings:
        """How it is run; see :meth:`set_recovery`."""
        return self._settings

    @property
    def v_max(self) -> Array:
        """Bounds (nv,) on the size of each input, not to be written to; see :meth:`set_bounds`."""
        return self._limit

    def set_parameters(self, parameters: BarrierParameters) -> None:
        """Take other parameters of the conditions and resolutions.

        Raises:
            ConfigError: they are no :class:`BarrierParameters`, or have parameters of another filter; nothing changes.
        """
        self._conditions.set_parameters(parameters)

    def set_weights(self, weights: MetricWeights) -> None:
        """Take other weights of the metric."""
        self._metric.weights = weights

    def set_bounds(self, v_max: Array) -> None:
        """Take other bounds (nv,) on the size of each input, above 0.

        Raises:
            ConfigError: they are not one finite number above 0 per input; nothing changes.
        """
        bounds = checked_bounds("v_max", v_max)
        if bounds.shape != self._limit.shape:
            raise ConfigError("v_max", v_max, f"{self._limit.size} numbers, one per input")
        self._set_limit(bounds)

    def _set_limit(self, bounds: Array) -> None:
        self._limit, self._lower = bounds, -bounds
        self._answers = Answers(self._settings.order, bounds, self._settings.dt)

    def set_recovery(self, recovery: RecoverySettings | None) -> None:
        """Come back from behind a barrier in another way; ``None``: the conditions are strict there."""
        self._settings = replace(self._settings, recovery=recovery)
        order, infeasible = self._settings.order, self._settings.infeasible
        # the papers' baseline has none
        possible = order == 1 and self.kind.joint and infeasible != "unsafe_pass_nominal"
        if recovery is None or not possible:
            self._recovery = None
        elif self._recovery is None:
            self._recovery = Recovery(self._limit.size, self._n_rows, recovery, self._settings.dt)
        else:
            self._recovery.settings = recovery

    def _take_over(self, parameters: RowParameters, others: bool) -> None:
        """Give the resolution its parameters; where the rows are others, what it learned of the last ones is no use."""
        if others:
            self._resolution = self.kind.resolution.make(self._limit.size, self._n_rows, self._settings.infeasible)
        self._resolution.set_parameters(parameters)

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
        jacobians, order = (feet, balance, hands), self._settings.order
        # numbers that overflow are looked for where they matter
        with np.errstate(all="ignore"):
            cause = self._objection(rows, v_des, age, velocity, jacobians) or wrong_epsilon(self._n_rows, epsilon)
            if cause:
                return self._refusal(cause, velocity)
            if self._conditions.kind.condition is None:
                if cause := not_finite(order, rows, v_des, velocity):
                    return self._refusal(cause, velocity)
                return FilterResult(v_des.copy(), FilterStatus.UNCHANGED, 0.0, -1, 0)
            if cause := self._conditions.prepare(rows.family):
                return self._refusal(not_finite(order, rows, v_des, velocity) or cause, velocity)
            own = self._conditions.of_rows
            parameters = own if epsilon is None else replace(own, epsilon=epsilon)
            result = self._filter(rows, v_des, jacobians, velocity, parameters)
        if self._recovery is not None and not (result.status == FilterStatus.FAILED and result.worst_row < 0):
            self._recovery.note(v_des, result.v)
        return result

    def reset(self) -> None:
        """The robot is at rest: no command is left to go on from."""
        if self._recovery is not None:
            self._recovery.reset()

    def resume(self, v_des: Array, v: Array) -> None:
        """Go on from the nominal input and the command (nv,) of a tick that another filter answered."""
        if self._recovery is not None:
            self._recovery.note(v_des, v)

    def _filter(
        self,
        rows: BarrierRows,
        v_des: Array,
        jacobians: Jacobians,
        velocity: Array | None,
        parameters: RowParameters,
    ) -> FilterResult:
        """The result for inputs of the right shapes; ``jacobians``: feet, balance and hands."""
        lower, upper, s, answers = self._lower, self._limit, self._settings, self._answers
        if s.order == 2 and velocity is not None:
            lower, upper = acceleration_bounds(self._limit, velocity, s.velocity_max, s.dt)
        spaces = self._conditions.spaces(rows, velocity if s.order == 2 else None, parameters)
        violated = np.empty(self._n_rows, dtype=bool)
        parts = packed(rows.h, rows.dh_dt, spaces.A, spaces.b, v_des)
        total, room = survey(*parts, lower, upper, violated)
        if not math.isfinite(total) or spaces.A is not rows.jac:
            if cause := not_finite(s.order, rows, v_des, velocity):
                return self._refusal(cause, velocity)
        cause = "" if math.isfinite(total) else TOO_LARGE if all_finite(spaces.b) else NOT_FINITE
        asked, eased = spaces, None if cause else self._ease(rows, spaces, v_des, jacobians, parameters)
        if eased is not None:
            spaces, v_des = eased.spaces, eased.v_des
            parts = packed(rows.h, rows.dh_dt, spaces.A, spaces.b, v_des)
            survey(*parts, lower, upper, violated)
        elif not cause and room >= 0.0 and not self._acts_when_met(spaces):
            if room >= FAR:
                return FilterResult(v_des.copy(), FilterStatus.UNCHANGED, 0.0, -1, 0)
            return answers.found(v_des.copy(), FilterStatus.UNCHANGED, spaces, velocity)
        if cause := cause or self._metric.write(jacobians, parts[4]):
            return answers.failure(cause, spaces, velocity)
        conditions = HalfSpaces(parts[2], parts[3], spaces.active)
        problem = Problem(conditions, parts[4], self._metric.matrix, lower, upper, violated)
        try:
            resolved = self._resolution.resolve(problem, rows)
        except np.linalg.LinAlgError as error:
            return answers.failure(f"linear equations have no answer: {error}", spaces, velocity)
        return answers.conclude(resolved, asked, velocity)

    def _ease(
        self, rows: BarrierRows, spaces: HalfSpaces, v_des: Array, jacobians: Jacobians, parameters: RowParameters
    ) -> Eased | None:
        """What to filter instead where rows are lost."""
        condition = self._conditions.kind.condition
        if self._recovery is None or condition is None:
            return None
        metric = partial(self._metric.at, jacobians, v_des)
        return self._recovery.ease(rows, spaces, condition, parameters, v_des, metric, self._limit)

    def _acts_when_met(self, spaces: HalfSpaces) -> bool:
        """Whether the resolution has something to do although the nominal input satisfies every condition."""
        return self._conditions.kind.resolution.acts_when_met and bool(spaces.active.any())

    def _objection(
        self,
        rows: BarrierRows,
        v_des: Array,
        age: float,
        velocity: Array | None,
        jacobians: Jacobians,
    ) -> str:
        """Why these inputs cannot be used, whatever their numbers are, in words; empty where they can."""
        order, oldest = self._settings.order, self._settings.max_age
        if not -oldest <= age <= oldest:
            return f"input is {age:.2f} s old, allowed are {oldest:.2f} s"
        measured = None if order == 1 else velocity
        if cause := wrong_shape(self._n_rows, self._limit.size, rows, v_des, measured, jacobians):
            return cause
        if order == 1 or (velocity is not None and rows.curvature is not None):
            return ""
        return not_finite(order, rows, v_des, velocity)

    def prepare(self, family: Indices) -> str:
        """Make ready for rows of these families (n_rows,), once as long as they stay the same; why not, in words.

        :meth:`apply` does it where it has not been done; the tick that it happens in takes a little longer.
        """
        return self._conditions.prepare(family)

    def _refusal(self, cause: str, velocity: Array | None) -> FilterResult:
        """For inputs of which no conditions can be made: nothing is left to go on from either."""
        self.reset()
        return self._answers.refusal(cause, velocity)
