r"""Conditions: what a filter demands of the input, as half-spaces, and the parameters that they have.

:math:`h \ge 0` is safe. Papers with energy functions write :math:`\phi = d_{min} - h`, where the margin
:math:`d_{min}` is the family's; :math:`\phi \ge 0` is then the same as :math:`h \le d_{min}`.

What is left of a guarantee in discrete time: with the velocity held for a step dt,
:math:`h_{k+1} \ge h_k + dt\,\dot h_k - \tfrac12 c\,dt^2`, where c bounds the size of :math:`\ddot h` along the step.

- CBF, for :math:`\alpha\,dt \le 1`: :math:`h_{k+1} - d_{min} \ge (1 - \alpha\,dt)(h_k - d_{min}) - \tfrac12 c\,dt^2`.
  From :math:`h_0 \ge d_{min}` on therefore :math:`h_k \ge d_{min} - c\,dt/(2\alpha)`.
- SSA and SSS see a row only once it is inside its margin, so one step may carry it in by :math:`dt\,V`, where V bounds
  the rate at which h falls. SSA then raises it again if :math:`c\,dt \le 2\eta`: :math:`h_k \ge d_{min} - dt\,V`. SSS,
  for :math:`\lambda\,dt \le 1`: :math:`h_k \ge d_{min} - \max(dt\,V,\; c\,dt/(2\lambda))`.
- SSA with a boundary layer of width w sees its rows from afar and is, for :math:`h \ge d_{min} - w`, the CBF with
  :math:`\alpha = \eta/w`. So for :math:`\eta\,dt \le w` and :math:`c\,dt \le 2\eta`, from :math:`h_0 \ge d_{min}` on
  :math:`h_k \ge d_{min} - c\,dt\,w/(2\eta)`, which is inside the layer; V does not enter, and no margin is needed for
  it. From below the layer each step raises h by :math:`\eta\,dt - \tfrac12 c\,dt^2` or more until it is in it. SSS with
  a layer is the CBF with :math:`\alpha = \lambda` and its margin.
- SMA and PFM hold one row at a time and guarantee nothing about the others.

V counts what moves by itself: an obstacle's own speed, along the normal, adds to the robot's.

With accelerations held for a step all of this holds for the index (:math:`h_2` of
:func:`safety.filters.second_order.index_rows`, :math:`h_e` of :func:`safety.filters.second_order.ecbf_rows`) in place
of h: 0 in place of :math:`d_{min}`, V bounds the rate at which the index falls and c the size of its second derivative,
in which the third one of h appears. It holds within steps too, not only at their ends. So where the index of power 1 is
never below :math:`-\delta`, :math:`k \dot h + (h - d_{min}) \ge -\delta`, and h never sinks below :math:`d_{min} -
\delta` from above it (for :math:`h_e`, which is :math:`\alpha` times the index with :math:`k = 1/\alpha`, below
:math:`d_{min} - \delta/\alpha`).

So the margins of SSA, SSS and their kin have to be above :math:`dt\,V`; that is what their defaults are for.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np

from robots.checks import require_non_negative, require_positive
from robots.errors import ConfigError
from robots.messages import Array, Indices, Mask
from safety.barriers.rows import FAMILIES, BarrierRows, HalfSpaces
from safety.filters.condition_kernels import issf_demand
from safety.geometry.contact_rows import packed

NO_MARGINS: Mapping[str, float] = dict.fromkeys(FAMILIES, 0.0)
"""Margins of CBF, ISSf-CBF and eCBF: the barrier as it is, as in Lee et al."""

SET_MARGINS: Mapping[str, float] = {
    "joint_limit": 0.05,
    "self_collision": 0.01,
    "leg_collision": 0.01,
    "obstacle": 0.05,
    "workspace": 0.02,
    "custom": 0.0,
}
"""Margins of the filters that act inside them only: obstacles 0.05 m and self-collision 0.01 m as in sec. V-B of the
p-SSA paper. The others are ours: what a joint at 10 rad/s and a hand at 4 m/s do in 5 ms; none for barriers of
one's own, whose unit and range only their author knows: a margin that h never exceeds would hold for ever."""


@dataclass(frozen=True, slots=True)
class FamilyParameters:
    """Parameters of one constraint family; each filter reads those that its condition and its resolution have.

    The defaults of eta and slack_weight are those of the p-SSA paper (sec. V-C, V-E), those of slope, push_cartesian
    and push_joint those of SPARK's Table 11 for its first case, G1FixedBase_D1_AG_SO_v0. Both papers
    leave the second-order index to the user: power 1 is the linear one of both, its gain of 1 s is ours.

    Attributes:
        alpha: slope of the class-K function of CBF, ISSf-CBF and eCBF [1/s], above 0.
        epsilon: ISSf parameter, above 0; smaller is more cautious. At rest a row keeps the margin
            ``|jac|^2 / (alpha epsilon)``. Unit: that of |jac|^2 over that of the rate of h, e.g. [m s/rad^2].
        margin: d_min, the h to keep [m or rad], 0 or above; ``None`` for the filter's own.
        eta: rate at which SSA, r-SSA and p-SSA leave the margin [m/s or rad/s], above 0.
        layer: w, depth inside the margin over which SSA, r-SSA and p-SSA come to ask for eta [m or rad]; 0 for the
            papers' switch at the margin. Above 0 it makes SSS see its rows outside the margin too.
        slope: lambda of SSS [1/s], above 0.
        slack_weight: weight of squared violation in r-SSA [s/m squared times that of |v|^2], above 0.
        push_cartesian: velocity that PFM adds to the worst row's point [m/s], above 0.
        push_joint: velocity that SMA adds per gradient of the worst row [rad/s per m/rad], above 0.
        index_gain: k of the second-order index [s for power 1], above 0.
        index_power: n of the second-order index, 1 or above: below, its slope at h = 0 is infinite.
        recovery_depth: a row lower than minus this [m or rad] is lost, see :mod:`safety.filters.recovery`; above 0.
        recovery_speed: by how much more than at h = 0 a lost row may ask of the rate of h [m/s or rad/s], above 0.
        recovery_acceleration: at which a lost row may ask for more [m/s^2 or rad/s^2], above 0.
    """

    alpha: float = 5.0
    epsilon: float = 5.0
    margin: float | None = None
    eta: float = 0.5
    layer: float = 0.0
    slope: float = 10.0
    slack_weight: float = 10.0
    push_cartesian: float = 0.1
    push_joint: float = 40.0
    index_gain: float = 1.0
    index_power: float = 1.0
    recovery_depth: float = 0.005
    recovery_speed: float = 0.25
    recovery_acceleration: float = 2.0

    def __post_init__(self) -> None:
        for name in self.__slots__:
            if name not in ("margin", "layer"):
                require_positive(name, getattr(self, name))
        require_non_negative("layer", self.layer)
        if self.margin is not None:
            require_non_negative("margin", self.margin)
        if self.index_power < 1:
            raise ConfigError("index_power", self.index_power, "1 or above")


@dataclass(frozen=True, slots=True)
class RowParameters:
    """The parameters of each row, shape (n,) each; see :class:`FamilyParameters`.

    Attributes:
        own: those that a filter registered from outside has besides, shape (n,) each, by name.
    """

    alpha: Array
    epsilon: Array
    margin: Array
    eta: Array
    layer: Array
    slope: Array
    slack_weight: Array
    push_cartesian: Array
    push_joint: Array
    index_gain: Array
    index_power: Array
    recovery_depth: Array
    recovery_speed: Array
    recovery_acceleration: Array
    own: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class BarrierParameters:
    """Parameters of all families; those not given have the defaults of :class:`FamilyParameters`.

    Attributes:
        own: parameters of a filter that brings its own, see :class:`safety.filters.filter_kind.FilterKind`: one
            instance of its dataclass for all families, or instances by family; ``None``: the filter's defaults.
    """

    joint_limit: FamilyParameters = FamilyParameters()
    self_collision: FamilyParameters = FamilyParameters()
    leg_collision: FamilyParameters = FamilyParameters()
    obstacle: FamilyParameters = FamilyParameters()
    workspace: FamilyParameters = FamilyParameters()
    custom: FamilyParameters = FamilyParameters()
    own: Any = None

    def values(self, name: str) -> Array:
        """The parameter ``name`` of every family, shape (len(FAMILIES),), in the order of ``FAMILIES``."""
        return np.array([getattr(getattr(self, f), name) for f in FAMILIES], dtype=float)

    def margins(self, defaults: Mapping[str, float]) -> Array:
        """The margin of every family, shape (len(FAMILIES),); ``defaults`` by family where it has none of its own."""
        own = {f: getattr(self, f).margin for f in FAMILIES}
        return np.array([defaults[f] if own[f] is None else own[f] for f in FAMILIES], dtype=float)

    def of_rows(
        self, family: Indices, margins: Mapping[str, float] = NO_MARGINS, own: Mapping[str, Array] | None = None
    ) -> RowParameters:
        """The parameters row by row.

        Args:
            family: shape (n,) index into ``FAMILIES``.
            margins: by family, for those that have none of their own.
            own: row by row already.
        """
        names = [name for name in FamilyParameters.__slots__ if name != "margin"]
        values: dict[str, Array] = {name: self.values(name)[family] for name in names}
        return RowParameters(margin=self.margins(margins)[family], own={} if own is None else own, **values)


@cache
def _all_active(n: int) -> Mask:
    """Shape (n,), all true; nobody may write to it."""
    out = np.ones(n, dtype=bool)
    out.flags.writeable = False
    return out


def cbf(rows: BarrierRows, parameters: RowParameters) -> HalfSpaces:
    r"""Half-spaces of the control barrier condition.

    .. math:: J_i v + \partial_t h_i \ge -\alpha_i (h_i - d_{min,i})

    Source: eq. (5) of Lee et al. with linear class-K function, on the system of their eq. (31); eq. (6) of SPARK.

    Args:
        rows: n barrier rows.
        parameters: alpha and margin are read.

    Returns:
        A (n, nv) is the rows' own ``jac``, b (n,) is new; every row active.
    """
    b = parameters.alpha * (parameters.margin - rows.h) - rows.dh_dt
    return HalfSpaces(rows.jac, b, _all_active(rows.h.size))


def issf_cbf(rows: BarrierRows, parameters: RowParameters) -> HalfSpaces:
    r"""Half-spaces of the input-to-state safe control barrier condition.

    .. math:: J_i v + \partial_t h_i \ge -\alpha_i (h_i - d_{min,i}) + \|J_i\|^2 / \varepsilon_i

    Source: eqs. (32), (39), (40), (45), (49), (53) of Lee et al.

    Args:
        rows: n barrier rows.
        parameters: alpha, epsilon and margin are read.

    Returns:
        A (n, nv) is the rows' own ``jac``, b (n,) is new; every row active.
    """
    p = parameters
    b = issf_demand(*packed(rows.h, rows.dh_dt, rows.jac, p.alpha, p.margin, p.epsilon))
    return HalfSpaces(rows.jac, b, _all_active(b.size))


def ssa(rows: BarrierRows, parameters: RowParameters) -> HalfSpaces:
    r"""Half-spaces of the safe set algorithm, of r-SSA and of p-SSA.

    .. math:: J_i v + \partial_t h_i \ge \eta_i \quad\text{where}\quad h_i \le d_{min,i}

    This switches on and off at the margin, and what follows it with torques rattles there. With a boundary layer, as
    sliding mode control has it for the same reason,

    .. math:: J_i v + \partial_t h_i \ge \eta_i \min(1,\; (d_{min,i} - h_i) / w_i)

    everywhere: as much from the depth w inside the margin on, less above, and continuous. Above the margin it lets h
    fall, the slower the closer. What that keeps: where the rate is met to within :math:`\delta \le \eta`,

    .. math:: h(t) \ge d_{min} - w\,\delta/\eta \quad\text{from}\quad h(0) \ge d_{min} - w\,\delta/\eta,

    for there :math:`\dot h \ge \eta (d_{min} - h)/w - \delta`, which is 0 on that boundary. From below the layer h is
    in it after :math:`(d_{min} - w - h(0))/(\eta - \delta)` at the latest. The paper's switch comes back to the margin
    itself in a finite time; with the layer h comes as close as :math:`w\,\delta/\eta` to it, exponentially.

    Source: eqs. (6b), (9b), (10b), (12b) of the p-SSA paper, eq. (5) of SPARK; the layer: Slotine and Li, Applied
    Nonlinear Control, section 7.2.

    Args:
        rows: n barrier rows.
        parameters: eta, layer and margin are read.

    Returns:
        A (n, nv) is the rows' own ``jac``, b (n,) is new; active are the rows inside their margin, and all that have
        a layer.
    """
    depth, width = parameters.margin - rows.h, parameters.layer
    layered = width > 0
    fraction = np.where(layered, np.minimum(depth / np.where(layered, width, 1.0), 1.0), 1.0)
    return HalfSpaces(rows.jac, parameters.eta * fraction - rows.dh_dt, (depth >= 0) | layered)


def sss(rows: BarrierRows, parameters: RowParameters) -> HalfSpaces:
    r"""Half-spaces of the sublevel safe set algorithm.

    .. math:: J_i v + \partial_t h_i \ge -\lambda_i (h_i - d_{min,i}) \quad\text{where}\quad h_i \le d_{min,i}

    What it asks for is zero at the margin, where it lets h fall at any rate a moment before. With a layer (of any
    width) the same is asked for everywhere, which is a CBF with this margin.

    Source: eq. (7) of SPARK.

    Args:
        rows: n barrier rows.
        parameters: slope, layer and margin are read.

    Returns:
        A (n, nv) is the rows' own ``jac``, b (n,) is new; active are the rows inside their margin, and all that have
        a layer.
    """
    depth = parameters.margin - rows.h
    return HalfSpaces(rows.jac, parameters.slope * depth - rows.dh_dt, (depth >= 0) | (parameters.layer > 0))


def worst_row(rows: BarrierRows, parameters: RowParameters) -> HalfSpaces:
    r"""Half-space of the row deepest inside its margin: it must not go deeper.

    .. math:: J_i v + \partial_t h_i \ge 0 \quad\text{for}\quad i = \arg\max_j \, d_{min,j} - h_j,\;
        \text{if}\; h_i \le d_{min,i}

    The depths are compared as they are, radians of joint limits with metres of distances: a joint 0.02 rad beyond its
    margin comes before an obstacle 0.01 m inside its own. SPARK takes one maximum over all its energy functions, which
    are distances all of them; with joint limits among them some exchange rate between the units is needed, and none is
    right for all robots, so it is 1 m/rad. A family's margin shifts its rank.

    Source: what eq. (13) of SPARK guarantees of its sliding mode algorithm.

    Args:
        rows: n barrier rows.
        parameters: margin is read.

    Returns:
        A (n, nv) is the rows' own ``jac``, b (n,) is new; active is that row, or none.
    """
    depth = parameters.margin - rows.h
    active = np.zeros(depth.size, dtype=bool)
    if depth.size:
        worst = int(depth.argmax())
        active[worst] = depth[worst] >= 0
    return HalfSpaces(rows.jac, -rows.dh_dt, active)
