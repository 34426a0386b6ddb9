r"""Acceleration as the input: rows of second order, whose rate is affine in the acceleration.

With :math:`\dot h = J v + \partial_t h` and :math:`\ddot h = J u + c` (c is ``rows.curvature``), an index that contains
:math:`\dot h` gives rows on u, to which every condition applies as it does to first-order rows and v.
"""

import numpy as np

from robots.messages import Array
from safety.barriers.rows import BarrierRows, HalfSpaces
from safety.filters.conditions import RowParameters, cbf
from safety.geometry.contact_rows import room


def index_rows(rows: BarrierRows, v: Array, parameters: RowParameters) -> BarrierRows:
    r"""Rows of the second-order safety index.

    .. math:: h_2 = \mathrm{sgn}(h)|h|^n - d_{min}^n + k \dot h,\qquad
        \dot h_2 = n |h|^{n-1} \dot h + k (J u + c)

    SPARK prints :math:`\phi_2 = d^n - d_{min}^n - k \dot d`. There :math:`\phi > 0` is unsafe, so the first two terms
    have to have the other sign: a large distance is safe. With that put right :math:`h_2 = -\phi_2`; the sign function
    continues it into penetration. For n = 1 and :math:`k = 1/\alpha` it is :math:`h_e/\alpha` of :func:`ecbf_rows`.

    Source: section on the safe set algorithm of SPARK, second-order index; eq. (3) of the p-SSA paper for n = 1.

    Args:
        rows: n barrier rows with their curvature.
        v: shape (nv,) velocity now [m/s, rad/s].
        parameters: margin, index_gain and index_power are read.

    Returns:
        Rows on the acceleration; ``h`` [m for n = 1] has the margin in it already.

    Raises:
        ValueError: the rows have no curvature.
    """
    curvature = _curvature(rows)
    rate = room(rows.jac, v, -rows.dh_dt)
    k, n = parameters.index_gain, parameters.index_power
    size = np.abs(rows.h)
    h = np.sign(rows.h) * size**n - parameters.margin**n + k * rate
    dh_dt = n * size ** (n - 1) * rate + k * curvature
    return BarrierRows(h, k[:, None] * rows.jac, dh_dt, rows.family, None, rows.cartesian)


def ecbf_rows(rows: BarrierRows, v: Array, parameters: RowParameters) -> BarrierRows:
    r"""Rows of the exponential control barrier function.

    .. math:: h_e = \dot h + \alpha (h - d_{min}),\qquad \dot h_e = J u + c + \alpha \dot h

    Source: eq. (54) of Lee et al.; the margin is zero there.

    Args:
        rows: n barrier rows with their curvature.
        v: shape (nv,) velocity now [m/s, rad/s].
        parameters: alpha and margin are read.

    Returns:
        Rows on the acceleration, ``h`` [m/s or rad/s] with the margin in it.

    Raises:
        ValueError: the rows have no curvature.
    """
    curvature = _curvature(rows)
    rate = room(rows.jac, v, -rows.dh_dt)
    h = rate + parameters.alpha * (rows.h - parameters.margin)
    return BarrierRows(h, rows.jac, curvature + parameters.alpha * rate, rows.family, None, rows.cartesian)


def ecbf(rows: BarrierRows, v: Array, parameters: RowParameters) -> HalfSpaces:
    r"""Half-spaces of the exponential control barrier condition on the acceleration, for DynWBC's QP for example.

    .. math:: J u + c + \alpha \dot h \ge -\alpha_e h_e,\qquad \alpha_e = \alpha

    Source: eq. (55) of Lee et al. with their choice of alpha_e.

    Args:
        rows: n barrier rows with their curvature.
        v: shape (nv,) velocity now [m/s, rad/s].
        parameters: alpha and margin are read.

    Returns:
        A (n, nv) is the rows' own ``jac``, b (n,) [m/s^2 or rad/s^2] is new; every row active.

    Raises:
        ValueError: the rows have no curvature.
    """
    return cbf(ecbf_rows(rows, v, parameters), without_margin(parameters))


def without_margin(parameters: RowParameters) -> RowParameters:
    """The same parameters for rows that have the margin in their value already."""
    values = {name: getattr(parameters, name) for name in RowParameters.__slots__}
    return RowParameters(**(values | {"margin": np.zeros_like(parameters.margin)}))


def acceleration_bounds(limit: Array, v: Array, v_max: Array | None, dt: float) -> tuple[Array, Array]:
    r"""Bounds of the acceleration that keep the velocity within its own after a step.

    .. math:: -u_{max} \le u \le u_{max},\qquad |v + u\,dt| \le v_{max}

    Where the velocity is too high for both, the acceleration's bound holds: it brakes as hard as that allows.

    Args:
        limit: shape (nv,) u_max [m/s^2, rad/s^2].
        v: shape (nv,) velocity now.
        v_max: shape (nv,), ``None`` for no bound on the velocity.
        dt: step [s].

    Returns:
        Lower and upper bound, shape (nv,) each.
    """
    if v_max is None:
        return -limit, limit
    return np.clip((-v_max - v) / dt, -limit, limit), np.clip((v_max - v) / dt, -limit, limit)


def _curvature(rows: BarrierRows) -> Array:
    if rows.curvature is None:
        raise ValueError("second-order rows need the curvature of the barriers")
    return rows.curvature
