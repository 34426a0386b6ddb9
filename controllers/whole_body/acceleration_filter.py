"""Barriers kept within DynWBC: no velocity is filtered, the conditions are rows on the acceleration."""

import numpy as np

from controllers.whole_body.config import FilterTuning
from controllers.whole_body.strategy import AccelerationConditions, MetricJacobians
from robots.checks import all_finite
from robots.messages import Array, Indices, Mask
from safety.barriers.rows import BarrierRows
from safety.filters.filter_kind import FilterKind
from safety.filters.results import FilterResult, FilterStatus, report
from safety.filters.row_conditions import RowConditions
from wbc.dynwbc import DynWbc, DynWbcResult

ROUNDING = 1e-9
"""A velocity command this close to its bound [m/s, rad/s] counts as within it."""


class AccelerationFilter:
    """The strategy of filters that are defined for accelerations only; see :class:`SafetyStrategy`.

    Source: eqs. (54), (55) of Lee et al., their baseline *eCBF*, for which this was made.

    Args:
        kind: the filter; its resolution is DynWBC's QP.
        safety: parameters and velocity bounds are read.
        n_rows: number of barrier rows.
        joint_limits: shape (nj,) velocity limits of the joints [rad/s].
        dynwbc: knows how velocity command and acceleration belong together.
        dt: control period [s].

    Raises:
        ConfigError: parameters of another filter.
    """

    second_order = True

    def __init__(
        self, kind: FilterKind, safety: FilterTuning, n_rows: int, joint_limits: Array, dynwbc: DynWbc, dt: float
    ) -> None:
        self._joint_limits, self._dynwbc, self._dt = joint_limits, dynwbc, dt
        self._conditions = RowConditions(kind, safety.parameters(), lambda *_: None)
        self._v_max = safety.velocity_bounds(joint_limits)
        self._count = n_rows

    @property
    def condition_count(self) -> int:
        """One for each barrier row."""
        return self._count

    def prepare(self, family: Indices) -> None:
        """See :meth:`SafetyStrategy.prepare`."""
        self._conditions.prepare(family)

    def reset(self) -> None:
        """Nothing is kept from one tick to the next."""

    def resume(self, v_des: Array, v: Array) -> None:
        """Nothing is needed of them."""

    def set_safety(self, safety: FilterTuning) -> None:
        """See :meth:`SafetyStrategy.set_safety`."""
        self._conditions.set_parameters(safety.parameters())
        self._v_max = safety.velocity_bounds(self._joint_limits)

    def filter_velocity(
        self, rows: BarrierRows, v_des: Array, tasks: MetricJacobians, in_contact: Mask, v: Array
    ) -> FilterResult:
        """The nominal velocity within its bounds: DynWBC looks after the barriers."""
        return FilterResult(self._bounded(v_des), FilterStatus.UNCHANGED, 0.0, -1, 0)

    def conditions(self, rows: BarrierRows, v: Array) -> AccelerationConditions:
        """Conditions at rows with curvature, and the accelerations at which velocity commands reach their bounds."""
        self._conditions.prepare(rows.family)
        spaces = self._conditions.spaces(rows, v, self._conditions.of_rows)
        low, high = (self._dynwbc.acceleration_reference(bound, v, self._dt) for bound in (-self._v_max, self._v_max))
        return AccelerationConditions(spaces, (low[6:], high[6:]))

    def conclude(
        self, filtered: FilterResult, conditions: AccelerationConditions | None, dynamic: DynWbcResult, v: Array
    ) -> FilterResult:
        """The velocity command that belongs to DynWBC's acceleration, and what it means for the conditions.

        Returns:
            The velocity command, joints within their bounds (the base's part follows from the acceleration: no motor is
            told), with slack, active and relaxed conditions of the acceleration that it asks for [m/s^2, rad/s^2];
            ``UNCHANGED`` where no condition is active. ``FAILED`` where a number is not finite or DynWBC has no
            solution.
        """
        assert conditions is not None
        spaces, dynwbc = conditions.spaces, self._dynwbc
        command = dynwbc.velocity_command(dynamic.acceleration, v, self._dt)
        if dynamic.status != "optimal" or not all_finite(command, spaces.b):
            return _failure(v.size, "no acceleration satisfies the contacts and the torque limits")
        bounded = np.concatenate([command[:6], self._bounded(command)[6:]])
        asked = dynamic.acceleration
        if not np.allclose(bounded, command, rtol=0.0, atol=ROUNDING):
            asked = dynwbc.acceleration_reference(bounded, v, self._dt)
        found = report(asked, FilterStatus.FILTERED, spaces)
        if found.status == FilterStatus.FAILED:
            return _failure(v.size, "conditions on the acceleration are not numbers")
        status = found.status if found.active else FilterStatus.UNCHANGED
        return FilterResult(bounded, status, found.slack, found.worst_row, found.active, found.relaxed, found.violation)

    def _bounded(self, v: Array) -> Array:
        """A velocity (nv,) within its bounds."""
        return np.clip(v, -self._v_max, self._v_max)


def _failure(nv: int, cause: str) -> FilterResult:
    return FilterResult(np.zeros(nv), FilterStatus.FAILED, float("inf"), -1, 0, cause=cause)
