"""Barrier rows: the one form in which every safety constraint reaches a filter."""

from collections.abc import Callable
from dataclasses import dataclass

from robots.messages import Array, Indices, Mask

FAMILIES = ("joint_limit", "self_collision", "leg_collision", "obstacle", "workspace", "custom")
"""Constraint families: eqs. (34)-(37) of Lee et al., self-collision split in two, and one for barriers of one's own.

Parameters are given per family."""


@dataclass(frozen=True, slots=True)
class BarrierRows:
    r"""n barriers at one state: :math:`h \ge 0` is safe, :math:`\dot h = J v + \partial_t h`.

    With the second order evaluated, :math:`\ddot h = J \dot v + c`. A pair of bodies may have several rows: its signed
    distance first, then distances between features of the two that are never less (see
    :class:`safety.barriers.self_collision.SelfCollisionBarrier`);
    :attr:`safety.barriers.barrier_set.BarrierSet.representative` tells which are which.

    Attributes:
        h: shape (n,) values [m or rad].
        jac: shape (n, nv) gradients [m/m, m/rad or rad/rad].
        dh_dt: shape (n,) rate of h from what moves by itself, :math:`-\hat n^T v_{obstacle}` of the obstacle's
            material point in contact [m/s].
        family: shape (n,) index into ``FAMILIES``.
        curvature: shape (n,) second derivative c of h at zero acceleration of the joints and of what moves by itself
            [m/s^2 or rad/s^2]; ``None`` where not evaluated. Where closest features slide fast, at lines that cross
            nearly parallel, it is large.
        cartesian: gives, for a row's index, the Jacobian (k, nv) of the point that the row is about and the unit
            direction (k,) in which moving it raises h fastest; ``None``: use the row of ``jac`` itself.
    """

    h: Array
    jac: Array
    dh_dt: Array
    family: Indices
    curvature: Array | None = None
    cartesian: Callable[[int], tuple[Array, Array]] | None = None


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
