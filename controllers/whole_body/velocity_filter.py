"""Barriers kept before DynWBC: KinWBC's velocity is filtered."""

import math

from controllers.whole_body.config import ControllerConfig, FilterTuning
from controllers.whole_body.strategy import AccelerationConditions, MetricJacobians
from robots.messages import Array, Indices, Mask
from safety.barriers.rows import BarrierRows
from safety.filters.adaptation import EpsilonAdapter
from safety.filters.results import FilterResult
from safety.filters.safety_filter import SafetyFilter
from safety.filters.settings import FilterSettings
from wbc.dynwbc import DynWbcResult


class VelocityFilter:
    """The strategy of every filter that is defined for velocities; see :class:`SafetyStrategy`.

    Args:
        config: filter, settings and parameters are read.
        n_rows: number of barrier rows.
        joint_limits: shape (nj,) velocity limits of the joints [rad/s].

    Raises:
        ConfigError: unknown filter, or parameters of another one.
    """

    second_order, condition_count = False, 0

    def __init__(self, config: ControllerConfig, n_rows: int, joint_limits: Array) -> None:
        safety, self._joint_limits = config.safety, joint_limits
        self._filter = SafetyFilter(
            config.filter,
            n_rows,
            safety.parameters(),
            safety.velocity_bounds(joint_limits),
            safety.weights(),
            FilterSettings(config.infeasible, dt=config.dt, recovery=safety.recovery()),
        )
        self._adapter: EpsilonAdapter | None = None
        if config.adaptive:
            self._adapter = EpsilonAdapter(safety.parameters(), config.adaptation, config.dt)
        self._swing_fraction = _swing_fraction(safety)

    @property
    def filter(self) -> SafetyFilter:
        """Condition and resolution at work."""
        return self._filter

    def prepare(self, family: Indices) -> None:
        """See :meth:`SafetyStrategy.prepare`."""
        self._filter.prepare(family)

    def reset(self) -> None:
        """See :meth:`SafetyStrategy.reset`."""
        self._filter.reset()
        if self._adapter is not None:
            self._adapter.reset()

    def resume(self, v_des: Array, v: Array) -> None:
        """See :meth:`SafetyStrategy.resume`."""
        self._filter.resume(v_des, v)
        if self._adapter is not None:
            self._adapter.told(v)

    def set_safety(self, safety: FilterTuning) -> None:
        """See :meth:`SafetyStrategy.set_safety`."""
        self._filter.set_parameters(safety.parameters())
        self._filter.set_weights(safety.weights())
        self._filter.set_bounds(safety.velocity_bounds(self._joint_limits))
        self._filter.set_recovery(safety.recovery())
        if self._adapter is not None:
            self._adapter.set_parameters(safety.parameters())
        self._swing_fraction = _swing_fraction(safety)

    def filter_velocity(
        self, rows: BarrierRows, v_des: Array, tasks: MetricJacobians, in_contact: Mask, v: Array
    ) -> FilterResult:
        """See :meth:`SafetyStrategy.filter_velocity`."""
        feet = self._kept(tasks.feet, in_contact)
        if self._adapter is None:
            return self._filter.apply(rows, v_des, feet, tasks.balance, tasks.hands)
        epsilon = self._adapter.epsilon(rows, v)
        result = self._filter.apply(rows, v_des, feet, tasks.balance, tasks.hands, epsilon=epsilon)
        self._adapter.told(result.v)
        return result

    def conditions(self, rows: BarrierRows, v: Array) -> AccelerationConditions | None:
        """None: the velocity that DynWBC follows satisfies them."""
        return None

    def conclude(
        self, filtered: FilterResult, conditions: AccelerationConditions | None, dynamic: DynWbcResult, v: Array
    ) -> FilterResult:
        """The filtered velocity as it is."""
        return filtered

    def _kept(self, feet: Array, in_contact: Mask) -> Array:
        """Rows of the feet's Jacobians (12, nv) that the filter is to leave alone.

        All of a foot on the ground. Of a foot in the air its orientation: turned by its ankle out of another leg's way,
        it would come down on its edge. Its position by a weight of its own.
        """
        left, right = in_contact.tolist()
        if left and right:
            return feet
        kept = feet.copy()
        for foot, standing in enumerate(in_contact):
            if not standing:
                kept[6 * foot : 6 * foot + 3] *= self._swing_fraction
        return kept


def _swing_fraction(safety: FilterTuning) -> float:
    """Factor on the rows of a foot in the air: its weight goes with the square of its rows."""
    return math.sqrt(safety.swing_weight / safety.foot_weight) if safety.foot_weight > 0 else 0.0
