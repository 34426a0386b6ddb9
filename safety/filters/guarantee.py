r"""What the conditions guarantee of h when the robot does not follow the filtered velocity exactly.

With :math:`\dot q = \dot q^{safe} + d`, a row whose condition holds satisfies

.. math:: \dot h \ge -\alpha h + \|J\|^2/\varepsilon + J d \ge -\alpha h - \varepsilon \|d\|^2 / 4

for the ISSf-CBF (the second step completes the square: :math:`\|J\|^2/\varepsilon - \|J\|\|d\|` is least at
:math:`\|J\| = \varepsilon \|d\|/2`), and :math:`\dot h \ge -\alpha h - \|J\|\|d\|` for the CBF. By the comparison lemma
h stays above the solution b of the same equation with equality. Source: eqs. (7)-(12), (26)-(32) of Lee et al., with
gamma of eq. (8) worked out.

All of this holds for exact measurement, conditions that are met (no relaxed tick), and a filter that answers at every
instant; one that holds its velocity for a control period adds an error of the order of that period.
"""

import math
from dataclasses import dataclass

import numpy as np

from robots.checks import require_non_negative, require_positive
from robots.errors import ConfigError
from robots.messages import Array
from safety.barriers.rows import FAMILIES
from safety.filters.conditions import BarrierParameters, FamilyParameters

CONDITIONS = ("cbf", "issf")
"""Conditions that guarantee a bound."""


@dataclass(frozen=True, slots=True)
class SafetyBound:
    """What one condition guarantees for one constraint family.

    Where the family has a margin d_min, everything holds for h - d_min in place of h.

    Attributes:
        condition: one of ``CONDITIONS``.
        parameters: of the family; alpha, margin and, for ``issf``, epsilon are read.
    """

    condition: str
    parameters: FamilyParameters

    def __post_init__(self) -> None:
        if self.condition not in CONDITIONS:
            raise ConfigError("condition", self.condition, "one of " + ", ".join(CONDITIONS))

    @property
    def margin(self) -> float:
        """d_min of the family; without one of its own, the barrier as it is."""
        return self.parameters.margin or 0.0

    def bound(self, disturbance: float, gradient: float) -> float:
        """Least h that a disturbance of at most this size can bring about, for rows of at most this ``gradient``."""
        alpha, epsilon = self.parameters.alpha, self.parameters.epsilon
        if self.condition == "issf":
            return self.margin + issf_bound(alpha, epsilon, disturbance)
        return self.margin + cbf_bound(alpha, gradient, disturbance)

    def running_bound(self, h: float, disturbance: Array, gradient: Array, dt: float) -> Array:
        """The same over time.

        Args:
            h: smallest barrier of the family at the beginning.
            disturbance: shape (n,) sizes of d in each step [m/s, rad/s].
            gradient: shape (n,) longest Jacobian row of the family in each step.
            dt: length of a step [s], above 0.

        Returns:
            Shape (n,), bound on h at the end of each step.
        """
        alpha, epsilon, start = self.parameters.alpha, self.parameters.epsilon, min(h - self.margin, 0.0)
        if self.condition == "issf":
            return self.margin + issf_running_bound(alpha, epsilon, disturbance, dt, start)
        return self.margin + cbf_running_bound(alpha, gradient, disturbance, dt, start)

    def row_forcing(self, jac: Array, disturbance: Array) -> Array:
        r"""What holds rows up and pushes them down, :math:`\alpha d_{min} + \|J_i\|^2/\varepsilon + J_i d`.

        The CBF lacks the square.

        Args:
            jac: shape (n, nv) gradients.
            disturbance: shape (nv,) d [m/s, rad/s].

        Returns:
            Shape (n,), the unit of the rate of h; for :func:`settle`.
        """
        forcing: Array = self.parameters.alpha * self.margin + jac @ disturbance
        if self.condition == "issf":
            forcing += np.vecdot(jac, jac) / self.parameters.epsilon
        return forcing


def settle(b: Array, alpha: float, forcing: Array, dt: float) -> Array:
    r"""One step of :math:`\dot b = -\alpha b + f` with f constant over it, exactly.

    .. math:: b(t + \Delta t) = e^{-\alpha \Delta t} b(t) + \frac{1 - e^{-\alpha \Delta t}}{\alpha} f

    Args:
        b: shape (n,) values at the beginning of the step.
        alpha: slope [1/s], above 0.
        forcing: shape (n,) f, the unit of b per second.
        dt: length of the step [s], 0 or above.

    Returns:
        Shape (n,) values at its end; a new array.
    """
    require_non_negative("dt", dt)
    keep, gain = _weights(alpha, dt)
    return keep * b + gain * forcing


def _weights(alpha: float, dt: float) -> tuple[float, float]:
    """Factors on b and on f in :func:`settle`."""
    require_positive("alpha", alpha)
    return math.exp(-alpha * dt), -math.expm1(-alpha * dt) / alpha


def issf_bound(alpha: float, epsilon: float, disturbance: float) -> float:
    r"""Least h under the ISSf-CBF condition and a disturbance that never exceeds a size.

    .. math:: h \ge -\gamma(\delta), \quad \gamma(\delta) = \frac{\varepsilon \delta^2}{4 \alpha},
        \quad \delta = \sup_t \|d(t)\|

    where h begins there or above. Source: eq. (8) of Lee et al.

    Args:
        alpha: slope of the class-K function [1/s], above 0.
        epsilon: ISSf parameter, above 0.
        disturbance: delta, 0 or above [m/s, rad/s].

    Returns:
        -gamma, 0 or below, the unit of h.

    Raises:
        ConfigError: a value is not allowed.
    """
    require_positive("alpha", alpha)
    require_positive("epsilon", epsilon)
    require_non_negative("disturbance", disturbance)
    return 0.0 - epsilon * disturbance**2 / (4.0 * alpha)


def cbf_bound(alpha: float, gradient: float, disturbance: float) -> float:
    r"""Least h under the CBF condition, a disturbance and a gradient that never exceed a size.

    .. math:: h \ge -\frac{\sup_t \|J\| \, \delta}{\alpha}, \quad \delta = \sup_t \|d(t)\|

    Args:
        alpha: slope of the class-K function [1/s], above 0.
        gradient: largest size of a row of the Jacobian, 0 or above.
        disturbance: delta, 0 or above [m/s, rad/s].

    Returns:
        The bound, 0 or below, the unit of h.

    Raises:
        ConfigError: a value is not allowed.
    """
    require_positive("alpha", alpha)
    require_non_negative("gradient", gradient)
    require_non_negative("disturbance", disturbance)
    return 0.0 - gradient * disturbance / alpha


def issf_running_bound(alpha: float, epsilon: float, disturbance: Array, dt: float, start: float = 0.0) -> Array:
    r"""Bound on h over time under the ISSf-CBF condition, for a disturbance that is known.

    .. math:: \dot b = -\alpha b - \varepsilon \|d(t)\|^2 / 4, \quad b(0) = \min(h(0), 0)

    Exact for a disturbance that is constant over each step.

    Args:
        alpha: slope of the class-K function [1/s], above 0.
        epsilon: ISSf parameter, above 0.
        disturbance: shape (n,) sizes of d in each step, 0 or above [m/s, rad/s]; NaN where there is none: the bound
            is NaN from there on.
        dt: length of a step [s], above 0.
        start: b(0), 0 or below.

    Returns:
        Shape (n,), b at the end of each step, 0 or below.

    Raises:
        ConfigError: a value is not allowed.
    """
    require_positive("epsilon", epsilon)
    return _run(alpha, -0.25 * epsilon * _sizes("disturbance", disturbance) ** 2, dt, start)


def cbf_running_bound(alpha: float, gradient: Array, disturbance: Array, dt: float, start: float = 0.0) -> Array:
    r"""Bound on h over time under the CBF condition, for a disturbance that is known.

    .. math:: \dot b = -\alpha b - \|J(t)\| \|d(t)\|, \quad b(0) = \min(h(0), 0)

    Exact where both are constant over each step.

    Args:
        alpha: slope of the class-K function [1/s], above 0.
        gradient: shape (n,) sizes of the row (the largest, for several) in each step, 0 or above.
        disturbance: shape (n,) as in :func:`issf_running_bound`.
        dt: length of a step [s], above 0.
        start: b(0), 0 or below.

    Returns:
        Shape (n,), b at the end of each step, 0 or below.

    Raises:
        ConfigError: a value is not allowed.
    """
    sizes = _sizes("gradient", gradient) * _sizes("disturbance", disturbance)
    return _run(alpha, -sizes, dt, start)


def _sizes(name: str, values: Array) -> Array:
    if values.ndim != 1 or (values < 0).any() or np.isinf(values).any():
        raise ConfigError(name, values, "a vector of sizes, 0 or above")
    return values


def _run(alpha: float, forcing: Array, dt: float, start: float) -> Array:
    """Solution at the end of each step, from ``start``; never above zero."""
    require_positive("dt", dt)
    if not (math.isfinite(start) and start <= 0):
        raise ConfigError("start", start, "a finite number, 0 or below")
    keep, gain = _weights(alpha, dt)
    gained = gain * forcing
    out = np.empty(forcing.size)
    b = start
    for i, forced in enumerate(gained.tolist()):
        b = keep * b + forced
        out[i] = b
    return out


class RowBound:
    r"""Bound on h of every row of one family by its own gradient, kept up to date step by step.

    .. math:: \dot b_i = -\alpha b_i + \|J_i\|^2/\varepsilon + J_i d, \quad b_i(0) = h_i(0)

    (as in :meth:`SafetyBound.row_forcing`). It says how much of the margin that the condition keeps the disturbance
    takes. What separates h from it is that the condition was not active. Unlike the other bounds it gives nothing away,
    so the period for which the filter holds its velocity shows: h may lie below it by what that amounts to.

    Args:
        guarantee: of the family.
        dt: length of a step [s], above 0.

    Raises:
        ConfigError: a value is not allowed.
    """

    def __init__(self, guarantee: SafetyBound, dt: float) -> None:
        require_positive("dt", dt)
        self._guarantee = guarantee
        self._keep, self._gain = _weights(guarantee.parameters.alpha, dt)
        self._b: Array | None = None

    def advance(self, h: Array, jac: Array, disturbance: Array) -> float:
        """Take in one step; the first only gives the values from which the bounds start.

        Args:
            h: shape (n,) at the end of the step.
            jac: shape (n, nv) gradients there.
            disturbance: shape (nv,) d during the step; NaN where the filter does not run: the bound is NaN from there.

        Returns:
            b of the row with the smallest h, the unit of h; NaN without rows.
        """
        if self._b is None:
            self._b = h.copy()
        else:
            self._b *= self._keep
            self._b += self._gain * self._guarantee.row_forcing(jac, disturbance)
        return float(self._b[h.argmin()]) if h.size else math.nan


def safety_bounds(condition: str, parameters: BarrierParameters) -> dict[str, SafetyBound]:
    """What a filter guarantees, by constraint family; empty for a condition that guarantees no bound."""
    if condition not in CONDITIONS:
        return {}
    return {family: SafetyBound(condition, getattr(parameters, family)) for family in FAMILIES}
