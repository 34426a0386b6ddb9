r"""Epsilon of the ISSf-CBF row by row while the robot runs, from the disturbance that is seen to reach each row.

What the robot did beyond what it was told last, :math:`\hat d = v_k - v^{safe}_{k-1}`, pushes row i in by
:math:`-J_i \hat d`. A first-order filter of time constant T gives :math:`p_i`, of which only what is above zero counts:

.. math:: \varepsilon_i = \frac{\|J_i\|^2}{\|J_i\|^2/\varepsilon_{max} + p_i},
    \quad\text{at least } \varepsilon_{min}

so that the term of eq. (32) of Lee et al. becomes :math:`\|J_i\|^2/\varepsilon_{max} + p_i`: what it always was, and
the push besides.

Guaranteed: :math:`\varepsilon_{min} \le \varepsilon_i \le \varepsilon_{max}` whatever is measured, so that the bound of
eq. (8) holds with :math:`\varepsilon_{max}`, as it would without adaptation; and where the push is as estimated and
epsilon is not at its lower end, h sinks no lower than with no disturbance. Not guaranteed: anything about a push that
changes within T, or one that the lower end cuts off.

A higher velocity that is asked for is followed late, by the motors' time constant :math:`T_m`, which is seen as a
push. From the term to the estimate this is

.. math:: G(s) = \frac{T_m s}{(T_m s + 1)(T s + 1)},\quad |G(i\omega)| \le \frac{T_m}{T_m + T} < 1,
    \qquad S = \frac{1}{1 - G} = 1 + \frac{T_m s}{T_m T s^2 + T s + 1}

so that by the small-gain theorem, cuts at zero and at the lower end included, the loop cannot run away: of the push
after its filter it makes an estimate of at most :math:`1 + T_m/T` times that in the mean square (a sine of frequency
:math:`1/\sqrt{T_m T}` is raised by as much). This is no bound of the peak: where nothing is cut, a push that changes
can raise it by the integral of \|S\|'s impulse response, :math:`1 + c\,T_m/T` with c from :math:`4/\pi` for small
:math:`T/T_m` to 2 for large. What bounds the peak in any case is the lower end. A steady push is not raised,
:math:`S(0) = 1`. A joint that dry friction holds still does not follow, and the term grows until it moves or epsilon is
at its lower end.
"""

from dataclasses import dataclass

import numpy as np

from robots.checks import require_between, require_positive
from robots.messages import Array
from safety.barriers.rows import BarrierRows
from safety.filters.conditions import BarrierParameters


@dataclass(frozen=True, slots=True)
class AdaptationTuning:
    """How epsilon is adapted.

    Attributes:
        time: constant T of the filter, above 0 [s].
        least: epsilon_min as a fraction of the family's epsilon, in (0, 1].
    """

    time: float = 0.05
    least: float = 0.05

    def __post_init__(self) -> None:
        require_positive("adaptation time", self.time)
        require_positive("adaptation least", self.least)
        require_between("adaptation least", self.least, 0.0, 1.0)


class EpsilonAdapter:
    """Adapts epsilon of every row; the family's own epsilon is its upper end.

    To be asked before the filter and told afterwards what the filter has made of it, once a tick.

    Args:
        parameters: of the conditions.
        tuning: of the adaptation.
        dt: control period [s], above 0.
    """

    def __init__(self, parameters: BarrierParameters, tuning: AdaptationTuning, dt: float) -> None:
        require_positive("dt", dt)
        self._most = parameters.values("epsilon")
        self._least = tuning.least
        self._fraction = -float(np.expm1(-dt / tuning.time))
        self.reset()

    def set_parameters(self, parameters: BarrierParameters) -> None:
        """Take other parameters of the conditions; what was seen and told stays."""
        self._most = parameters.values("epsilon")

    def reset(self) -> None:
        """Forget what was seen and told."""
        self._told: Array | None = None
        self._push: Array | None = None

    def told(self, v_safe: Array) -> None:
        """The velocity (nv,) that the robot is told to take on until the next tick."""
        self._told = v_safe.copy()

    def epsilon(self, rows: BarrierRows, velocity: Array) -> Array:
        """The epsilon of every row.

        Args:
            rows: at the measured state, the same rows in every tick.
            velocity: shape (nv,) measured.

        Returns:
            Shape (n,), between the ends of each row's family; the upper one until there is something to go by.
        """
        most = self._most[rows.family]
        if self._push is None or self._push.shape != rows.h.shape:
            self._push = np.zeros(rows.h.size)
        if self._told is not None:
            seen = rows.jac @ (self._told - velocity)
            self._push += self._fraction * (seen - self._push)
            # a row that was not finite for a tick is not lost for good; the filter has refused that tick
            np.nan_to_num(self._push, copy=False, nan=0.0, posinf=0.0, neginf=0.0)
        squared = np.vecdot(rows.jac, rows.jac)
        push = np.maximum(self._push, 0.0)
        # without a gradient epsilon has no effect
        fraction = np.divide(push, squared, out=np.zeros_like(push), where=squared > 0)
        return np.clip(most / (1.0 + most * fraction), self._least * most, most)
