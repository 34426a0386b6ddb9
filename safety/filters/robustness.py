r"""How large epsilon may be for the disturbance that reaches a row: the ISSf-CBF condition as a design equation.

Along one row the condition, held for a control period dt, leaves

.. math:: h_{k+1} = (1 - \alpha\,dt)\,h_k + dt\,(\|J_k\|^2/\varepsilon + e_k)

with equality where it binds; :math:`e_k` is what the robot does beyond what was asked of it along this row, in the
mean over the period: the row of :math:`\dot q = \dot q^{safe} + d`, :math:`J d`, and what is left of holding the
velocity. The bound of eq. (8) of Lee et al. replaces it by the size of all of d; most of d does not touch a row, so
that bound is loose by an order of magnitude (see :class:`safety.filters.guarantee.RowBound`). Here e_k is taken as
measured.

The recursion is linear in 1/epsilon. With :math:`h_0` at the beginning and a for :math:`1 - \alpha\,dt`

.. math:: h_n = F_n + S_n/\varepsilon - D_n,\quad F_n = a^n h_0,\quad
    S_n = dt \sum_{k<n} a^{n-1-k} \|J_k\|^2,\quad D_n = -dt \sum_{k<n} a^{n-1-k} e_k

and :math:`h_n \ge m` for all n holds for every epsilon up to

.. math:: \varepsilon^* = \min_n \frac{S_n}{m + D_n - F_n} \quad\text{over n with } m + D_n > F_n.

For a steady e along a steady row this is :math:`\|J\|^2/(\alpha m - e)`.
"""

import math

import numpy as np
from scipy.signal import lfilter

from robots.checks import require_finite, require_non_negative, require_positive
from robots.errors import ConfigError
from robots.messages import Array, Mask


def largest_epsilon(
    alpha: float, squared: Array, disturbance: Array, dt: float, margin: float = 0.0, start: float = 0.0
) -> float:
    """Largest epsilon for which h of a row stays at its margin or above, under a disturbance that is known.

    Args:
        alpha: slope of the class-K function [1/s], above 0; alpha dt at most 1.
        squared: shape (n,) squared lengths of the row in each period, 0 or above.
        disturbance: shape (n,) e in each period, the unit of the rate of h.
        dt: length of a period [s], above 0.
        margin: h to keep, 0 or above.
        start: h at the beginning, ``margin`` or above.

    Returns:
        epsilon*, above 0; infinite where the CBF condition alone keeps the margin, 0 where no epsilon does.

    Raises:
        ConfigError: a value is not allowed.
    """
    require_positive("alpha", alpha)
    require_positive("dt", dt)
    require_non_negative("margin", margin)
    require_finite("start", start)
    if alpha * dt > 1.0:
        raise ConfigError("alpha", alpha, f"at most 1/dt = {1.0 / dt:g}")
    if start < margin:
        raise ConfigError("start", start, f"at the margin {margin:g} or above")
    keep = 1.0 - alpha * dt
    held, pushed = (dt * lfilter([1.0], [1.0, -keep], values) for values in (squared, disturbance))
    free = start * keep ** np.arange(1, squared.size + 1)
    lacking = margin - pushed - free
    # rounding of what cancels where the CBF alone keeps exactly the margin
    needs = lacking > 1e-12 * (1.0 + abs(start))
    return float(np.min(held[needs] / lacking[needs])) if needs.any() else math.inf


def row_disturbance(h: Array, squared: Array, alpha: float, epsilon: float, dt: float) -> Array:
    r"""What rows did beyond what the condition asked of them.

    .. math:: e_k = (h_{k+1} - h_k)/dt + \alpha h_k - \|J_k\|^2/\varepsilon

    Where the condition binds this is the disturbance; where it does not, the room that is left is in it too.

    Args:
        h: shape (n, rows) at each control tick.
        squared: shape (n, rows) squared lengths of the rows there.
        alpha: of the condition that was in force [1/s].
        epsilon: of the condition that was in force.
        dt: control period [s], above 0.

    Returns:
        Shape (n - 1, rows), the unit of the rate of h.
    """
    require_positive("dt", dt)
    require_positive("epsilon", epsilon)
    disturbance: Array = np.diff(h, axis=0) / dt + alpha * h[:-1] - squared[:-1] / epsilon
    return disturbance


def episodes(binding: Mask, gap: int) -> list[slice]:
    """Stretches in which a condition binds, shape (n,); interruptions of at most ``gap`` samples do not end one."""
    ticks = np.flatnonzero(binding)
    if not ticks.size:
        return []
    breaks = np.flatnonzero(np.diff(ticks) > gap + 1)
    firsts, lasts = np.r_[ticks[0], ticks[breaks + 1]], np.r_[ticks[breaks], ticks[-1]]
    return [slice(int(a), int(b) + 1) for a, b in zip(firsts, lasts, strict=True)]
