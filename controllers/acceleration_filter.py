"""The exponential CBF: no velocity is filtered, its conditions are rows of DynWBC on the acceleration."""

import numpy as np

from robots.checks import all_finite
from robots.messages import Array
from safety.conditions import BarrierParameters
from safety.results import FilterResult, FilterStatus, report
from safety.rows import BarrierRows, HalfSpaces
from safety.second_order import ecbf
from wbc.dynwbc import DynWbcResult


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

    def conditions(self, rows: BarrierRows, v: Array) -> HalfSpaces:
        """Conditions on the acceleration at rows with curvature and measured velocity ``v`` (nv,)."""
        return ecbf(rows, v, self._parameters.of_rows(rows.family))

    def result(self, v: Array, conditions: HalfSpaces, dynamic: DynWbcResult) -> FilterResult:
        """What became of the conditions.

        Args:
            v: shape (nv,) the velocity command that goes to the motors.
            conditions: of this tick.
            dynamic: DynWBC's result.

        Returns:
            The velocity command, with slack, active and relaxed conditions of the acceleration [m/s^2, rad/s^2];
            ``UNCHANGED`` where no condition is active. ``FAILED`` where a number is not finite or DynWBC has no
            solution.
        """
        if dynamic.status != "optimal" or not all_finite(v, conditions.b):
            cause = "no acceleration satisfies the contacts and the torque limits"
            return FilterResult(np.zeros(v.size), FilterStatus.FAILED, float("inf"), -1, 0, cause=cause)
        found = report(dynamic.acceleration, FilterStatus.FILTERED, conditions)
        status = found.status if found.active else FilterStatus.UNCHANGED
        return FilterResult(v, status, found.slack, found.worst_row, found.active, found.relaxed, found.shortfall)
