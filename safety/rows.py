"""Barrier rows: the one form in which every safety constraint reaches a filter."""

from dataclasses import dataclass

from robots.messages import Array, Indices, Mask

FAMILIES = ("joint_limit", "self_collision", "leg_collision", "obstacle", "workspace")
"""Constraint families, eqs. (34)-(37) of Lee et al., self-collision split in two; parameters are given per family."""


@dataclass(frozen=True, slots=True)
class BarrierRows:
    r"""n barriers at one state: :math:`h \ge 0` is safe and :math:`\dot h = J v + \partial_t h`.

    Attributes:
        h: shape (n,) values [m or rad].
        jac: shape (n, nv) gradients [m/m, m/rad or rad/rad].
        drift: shape (n,) rate of h from what moves by itself, :math:`-\hat n^T v_{obstacle}` [m/s].
        family: shape (n,) index into ``FAMILIES``.
    """

    h: Array
    jac: Array
    drift: Array
    family: Indices


@dataclass(frozen=True, slots=True)
class HalfSpaces:
    """Linear conditions A v >= b on a velocity.

    Attributes:
        A: shape (n, nv).
        b: shape (n,).
        active: shape (n,) bool; rows that are not active need not hold.
    """

    A: Array
    b: Array
    active: Mask
