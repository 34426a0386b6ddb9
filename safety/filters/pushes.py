"""Resolutions that solve nothing: pushes of the worst row, and none at all."""

import numpy as np

from robots.checks import all_finite
from robots.messages import Array
from safety.barriers.rows import BarrierRows
from safety.filters.conditions import RowParameters
from safety.filters.resolution import ResolutionKind, Resolved
from safety.filters.working_set import Problem

RANK = 1e-9
"""Fraction of the largest singular value below which a direction of a point's motion counts as out of reach."""


class CartesianPush:
    r"""Potential field: the point of the worst row is pushed along its normal.

    .. math:: v = v^{des} + J_c^{+} c\,\hat n

    :math:`J_c^+` is the pseudo-inverse of least change in the metric H (for H = I that of Moore and Penrose). SPARK
    takes :math:`J_c^+ (J_c v^{des} + c\,\hat n)` instead, which also discards whatever the nominal motion does without
    moving the point: all of the posture. Source: eqs. (8)-(10) of SPARK.
    """

    def __init__(self) -> None:
        """Without a push until the parameters are set."""
        self._push = np.zeros(0)

    def set_parameters(self, parameters: RowParameters) -> None:
        """``push_cartesian`` is c of each row [m/s]."""
        self._push = parameters.push_cartesian

    def resolve(self, problem: Problem, rows: BarrierRows) -> Resolved:
        """See :meth:`safety.filters.resolution.Resolution.resolve`."""
        if (i := _pushed_row(problem)) is None:
            return Resolved(problem.clipped())
        jac, direction = (rows.jac[i : i + 1], np.ones(1)) if rows.cartesian is None else rows.cartesian(i)
        if jac.ndim != 2 or jac.shape[1] != problem.v_des.size or direction.shape != jac.shape[:1]:
            shapes = f"shapes {jac.shape} and {direction.shape}, expected (k, {problem.v_des.size}) and (k,)"
            return Resolved(None, cause=f"Jacobian and direction of row {i}'s point have {shapes}")
        towards = np.linalg.solve(problem.hessian, jac.T)
        moved = jac @ towards
        if not all_finite(moved, direction):
            return Resolved(None, cause=f"Jacobian or direction of row {i}'s point is not finite or too large")
        strength = np.linalg.pinv(moved, rcond=RANK, hermitian=True) @ (self._push[i] * direction)
        return _pushed(problem, towards @ strength)


class JointPush:
    r"""Sliding mode: the worst row's gradient is added.

    .. math:: v = v^{des} + c\, H^{-1} J_i^T

    Source: eq. (12) of SPARK, H = I there.
    """

    def __init__(self) -> None:
        """Without a push until the parameters are set."""
        self._push = np.zeros(0)

    def set_parameters(self, parameters: RowParameters) -> None:
        """``push_joint`` is c of each row [rad/s per m/rad]."""
        self._push = parameters.push_joint

    def resolve(self, problem: Problem, rows: BarrierRows) -> Resolved:
        """See :meth:`safety.filters.resolution.Resolution.resolve`."""
        if (i := _pushed_row(problem)) is None:
            return Resolved(problem.clipped())
        return _pushed(problem, self._push[i] * np.linalg.solve(problem.hessian, problem.spaces.A[i]))


class PassThrough:
    """The nominal input whatever the conditions say: these are only looked at."""

    def set_parameters(self, parameters: RowParameters) -> None:
        """None are read."""

    def resolve(self, problem: Problem, rows: BarrierRows) -> Resolved:
        """See :meth:`safety.filters.resolution.Resolution.resolve`."""
        return Resolved(problem.v_des.copy())


PASS_THROUGH = ResolutionKind("none", lambda nv, n_rows, infeasible: PassThrough(), False)
CARTESIAN_PUSH = ResolutionKind("push_cartesian", lambda nv, n_rows, infeasible: CartesianPush(), False, True)
JOINT_PUSH = ResolutionKind("push_joint", lambda nv, n_rows, infeasible: JointPush(), False, True)


def _pushed_row(problem: Problem) -> int | None:
    """The row that is active, if there is one."""
    active = np.flatnonzero(problem.spaces.active)
    return int(active[0]) if active.size else None


def _pushed(problem: Problem, push: Array) -> Resolved:
    """The nominal input and a push, between the bounds."""
    v = problem.v_des + push
    if not all_finite(v):
        # clipped, an infinite push would look like an ordinary one
        return Resolved(None, cause="the push is not finite")
    return Resolved(np.minimum(np.maximum(v, problem.lower), problem.upper))
