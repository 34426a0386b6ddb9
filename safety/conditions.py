"""Conditions: what a filter demands of the velocity, as half-spaces."""

from dataclasses import dataclass

import numpy as np

from robots.checks import require_positive
from robots.messages import Array
from safety.rows import FAMILIES, BarrierRows, HalfSpaces


@dataclass(frozen=True, slots=True)
class FamilyParameters:
    """Parameters of one constraint family.

    Attributes:
        alpha: slope of the class-K function [1/s], above 0.
        epsilon: ISSf parameter, above 0; smaller is more cautious. At rest a row keeps the margin
            ``|jac|^2 / (alpha epsilon)``. Unit: that of |jac|^2 over that of the rate of h, e.g. [m s/rad^2].
    """

    alpha: float
    epsilon: float

    def __post_init__(self) -> None:
        require_positive("alpha", self.alpha)
        require_positive("epsilon", self.epsilon)


@dataclass(frozen=True, slots=True)
class BarrierParameters:
    """Parameters of all families."""

    joint_limit: FamilyParameters
    self_collision: FamilyParameters
    leg_collision: FamilyParameters
    obstacle: FamilyParameters
    workspace: FamilyParameters

    def alphas(self) -> Array:
        """Shape (len(FAMILIES),), in the order of ``FAMILIES``."""
        return np.array([getattr(self, f).alpha for f in FAMILIES])

    def epsilons(self) -> Array:
        """Shape (len(FAMILIES),), in the order of ``FAMILIES``."""
        return np.array([getattr(self, f).epsilon for f in FAMILIES])


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
    alpha = parameters.alphas()[rows.family]
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
    return HalfSpaces(base.A, base.b + squared / parameters.epsilons()[rows.family], base.active)
