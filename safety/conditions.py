"""Conditions: what a filter demands of the velocity, as half-spaces."""

from dataclasses import dataclass

import numpy as np

from robots.checks import require_positive
from robots.messages import Array
from safety.rows import FAMILIES, BarrierRows, HalfSpaces


@dataclass(frozen=True, slots=True)
class FamilyParameters:
    """Parameters of one constraint family; each filter reads those that its condition has.

    Attributes:
        alpha: slope of the class-K function of CBF, ISSf-CBF and eCBF [1/s], above 0.
        epsilon: ISSf parameter, above 0; smaller is more cautious. At rest a row keeps the margin
            ``|jac|^2 / (alpha epsilon)``. Unit: that of |jac|^2 over that of the rate of h, e.g. [m s/rad^2].
    """

    alpha: float = 5.0
    epsilon: float = 5.0

    def __post_init__(self) -> None:
        for name in self.__slots__:
            require_positive(name, getattr(self, name))


@dataclass(frozen=True, slots=True)
class BarrierParameters:
    """Parameters of all families; those not given have the defaults of :class:`FamilyParameters`."""

    joint_limit: FamilyParameters = FamilyParameters()
    self_collision: FamilyParameters = FamilyParameters()
    leg_collision: FamilyParameters = FamilyParameters()
    obstacle: FamilyParameters = FamilyParameters()
    workspace: FamilyParameters = FamilyParameters()
    custom: FamilyParameters = FamilyParameters()

    def values(self, name: str) -> Array:
        """The parameter ``name`` of every family, shape (len(FAMILIES),), in the order of ``FAMILIES``."""
        return np.array([getattr(getattr(self, f), name) for f in FAMILIES])


def cbf(rows: BarrierRows, parameters: BarrierParameters) -> HalfSpaces:
    r"""Half-spaces of the control barrier condition.

    .. math:: J_i v + \partial_t h_i \ge -\alpha_i h_i

    Source: eq. (5) of Lee et al. with linear class-K function, the ``CBF`` baseline of their section 5.2.

    Args:
        rows: n barrier rows.
        parameters: alpha by family.

    Returns:
        A (n, nv) is the rows' own ``jac``, b (n,) is new; every row active.
    """
    alpha = parameters.values("alpha")[rows.family]
    return HalfSpaces(rows.jac, -alpha * rows.h - rows.drift, np.ones(rows.h.size, dtype=bool))


def issf_cbf(rows: BarrierRows, parameters: BarrierParameters) -> HalfSpaces:
    r"""Half-spaces of the input-to-state safe control barrier condition.

    .. math:: J_i v + \partial_t h_i \ge -\alpha_i h_i + \|J_i\|^2 / \varepsilon_i

    Source: eqs. (32), (39), (40), (45), (49), (53) of Lee et al.

    Args:
        rows: n barrier rows.
        parameters: alpha and epsilon by family.

    Returns:
        A (n, nv) is the rows' own ``jac``, b (n,) is new; every row active.
    """
    base = cbf(rows, parameters)
    squared = np.vecdot(rows.jac, rows.jac)
    return HalfSpaces(base.A, base.b + squared / parameters.values("epsilon")[rows.family], base.active)
