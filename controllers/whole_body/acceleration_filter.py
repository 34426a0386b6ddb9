"""The exponential CBF: no velocity is filtered, its conditions are rows of DynWBC on the acceleration."""

import numpy as np

from robots.checks import all_finite
from robots.messages import Array
from safety.barriers.rows import BarrierRows, HalfSpaces
from safety.filters.conditions import BarrierParameters
from safety.filters.results import FilterResult, FilterStatus, report
from safety.filters.second_order import ecbf
from wbc.dynwbc import DynWbc, DynWbcResult

ROUNDING = 1e-9
"""A velocity command this close to its bound [m/s, rad/s] counts as within it."""


class AccelerationFilter:
    """Conditions of the eCBF for DynWBC, and what came of them.

    Source: eqs. (54), (55) of Lee et al., their baseline *eCBF*.

    Args:
        parameters: alpha and margin of each family are read.
        v_max: shape (nv,) bounds on the size of each velocity command, above 0 [m/s, rad/s].
    """

    def __init__(self, parameters: BarrierParameters, v_max: Array) -> None:
        self._parameters = parameters
        self._v_max = np.array(v_max)

    def velocity(self, v: Array) -> Array:
        """A velocity (nv,) within its bounds."""
        return np.clip(v, -self._v_max, self._v_max)

    def joint_bounds(self, dynwbc: DynWbc, v: Array, dt: float) -> tuple[Array, Array]:
        """Joint accelerations (nj,) at which the motors' velocity command reaches its bounds, at velocity ``v``."""
        low, high = (dynwbc.acceleration_reference(bound, v, dt) for bound in (-self._v_max, self._v_max))
        return low[6:], high[6:]

    def conditions(self, rows: BarrierRows, v: Array) -> HalfSpaces:
        """Conditions on the acceleration at rows with curvature and measured velocity ``v`` (nv,)."""
        return ecbf(rows, v, self._parameters.of_rows(rows.family))

    def result(
        self, dynwbc: DynWbc, conditions: HalfSpaces, dynamic: DynWbcResult, v: Array, dt: float
    ) -> FilterResult:
        """The velocity command that belongs to DynWBC's acceleration, and what it means for the conditions.

        Args:
            dynwbc: knows how velocity command and acceleration belong together.
            conditions: of this tick.
            dynamic: DynWBC's result.
            v: shape (nv,) measured velocity.
            dt: control period [s].

        Returns:
            The velocity command, joints within their bounds (the base's part follows from the acceleration: no motor is
            told), with slack, active and relaxed conditions of the acceleration that it asks for [m/s^2, rad/s^2];
            ``UNCHANGED`` where no condition is active. ``FAILED`` where a number is not finite or DynWBC has no
            solution.
        """
        command = dynwbc.velocity_command(dynamic.acceleration, v, dt)
        if dynamic.status != "optimal" or not all_finite(command, conditions.b):
            return _failure(v.size, "no acceleration satisfies the contacts and the torque limits")
        bounded = np.concatenate([command[:6], self.velocity(command)[6:]])
        asked = dynamic.acceleration
        if not np.allclose(bounded, command, rtol=0.0, atol=ROUNDING):
            asked = dynwbc.acceleration_reference(bounded, v, dt)
        found = report(asked, FilterStatus.FILTERED, conditions)
        if found.status == FilterStatus.FAILED:
            return _failure(v.size, "conditions on the acceleration are not numbers")
        status = found.status if found.active else FilterStatus.UNCHANGED
        return FilterResult(bounded, status, found.slack, found.worst_row, found.active, found.relaxed, found.shortfall)


def _failure(nv: int, cause: str) -> FilterResult:
    return FilterResult(np.zeros(nv), FilterStatus.FAILED, float("inf"), -1, 0, cause=cause)
