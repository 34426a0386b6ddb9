"""Resolutions: which input is taken, given the conditions."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from robots.messages import Array, Indices, Mask
from safety.infeasibility import Candidates
from safety.rows import BarrierRows, HalfSpaces
from wbc.qp import UNBOUNDED, QpSolver, make_solver

CAPACITIES = (32, 128)
"""Sizes of the small solvers, in rows; above them one for all rows."""

BEYOND = 1e-9
"""A row violated by more than this [m/s, rad/s] has to be seen by the solver."""

SLACK_ROUNDING = 1e-8
"""Room [m/s, rad/s] given to a row on top of its least slack, so that rounding does not make it infeasible again."""

SLACK_PULL = 1e-8
"""Weight of the nominal velocity while the least slack is sought: it makes the velocity unique.

It costs slack of about this times the change of velocity over the row's length: below 1e-6 m/s."""

RANK = 1e-9
"""Share of the largest singular value below which a direction of a point's motion counts as out of reach."""

INFEASIBLE = ("least_slack", "unsafe_pass_nominal")
"""What is done where no velocity satisfies the conditions; the second is the papers' naive baseline."""


@dataclass(frozen=True, slots=True)
class Problem:
    """One tick's problem.

    Attributes:
        spaces: the conditions; b of those that are not active is out of reach.
        v_des: shape (nv,) nominal input.
        hessian: shape (nv, nv) metric H in which distance to it is measured.
        lower: shape (nv,) bound of the input.
        upper: shape (nv,) likewise.
        violated: shape (n,) conditions that the nominal input violates: where the search for rows that matter starts.
    """

    spaces: HalfSpaces
    v_des: Array
    hessian: Array
    lower: Array
    upper: Array
    violated: Mask

    def clipped(self) -> Array:
        """The nominal input between its bounds, shape (nv,), new."""
        return np.clip(self.v_des, self.lower, self.upper)


@dataclass(frozen=True, slots=True)
class Resolved:
    """What a resolution found.

    Attributes:
        v: shape (nv,) input between its bounds; ``None`` where no solver had an answer.
        unsafe: whether it is the nominal input although no input satisfies the conditions.
        candidates: rows among which the conflict is; ``None`` where there is none.
    """

    v: Array | None
    unsafe: bool = False
    candidates: Candidates | None = None


class Resolution(Protocol):
    """Finds an input for one tick's problem."""

    def resolve(self, problem: Problem, rows: BarrierRows) -> Resolved:
        """Find it; ``rows`` are those that the conditions were made of."""
        ...


class WorkingSetQp:
    r"""The input nearest to the nominal one, by a solver that sees only the rows that matter.

    .. math:: \min_v (v - v^{des})^T H (v - v^{des}) + w \sum_i s_i^2
        \quad\text{s.t.}\quad A v \ge b - s,\; v_{min} \le v \le v_{max}

    (without s where no weight is given). It starts from the rows that the nominal input violates and those that were
    at their limit last time, solves, checks all rows, adds the violated ones and repeats until there is none: then the
    optimum for these rows is that for all, exactly. The solver is the smallest of a few persistent ones that fits.
    """

    def __init__(self, nv: int, n_rows: int, slack_weight: float | None = None) -> None:
        """For ``nv`` variables and ``n_rows`` rows; ``slack_weight``: w of each row, ``None`` for rows that hold."""
        self._nv = nv
        self._weight = slack_weight
        self._sizes = [c for c in CAPACITIES if c < n_rows] + [n_rows]
        self._solvers: dict[int, _SizedSolver] = {}
        self._last: Indices = np.zeros(0, dtype=np.intp)

    def solve(self, problem: Problem, b: Array, scale: Array | None = None) -> tuple[Array | None, Indices]:
        """Solve one problem.

        Args:
            problem: all but the conditions' right-hand sides.
            b: shape (n_rows,) right-hand sides.
            scale: shape (n_rows,) factor on each row, so that its weight is ``w scale^2``; ``None`` for 1.

        Returns:
            The optimum (nv,), ``None`` where there is none, and the rows that the solver saw last.
        """
        A = problem.spaces.A
        chosen = problem.violated.copy()
        chosen[self._last] = problem.spaces.active[self._last]
        while True:
            working = np.flatnonzero(chosen)
            v = self._solve_for(problem, A[working], b[working], None if scale is None else scale[working])
            if v is None:
                return None, working
            gap = A @ v - b
            new = (gap < -BEYOND) & ~chosen
            if not new.any():
                self._last = working[gap[working] < BEYOND]
                return v, working
            chosen |= new

    def _solve_for(self, problem: Problem, A: Array, b: Array, scale: Array | None) -> Array | None:
        """The optimum for these rows alone."""
        if scale is not None:
            A, b = A * scale[:, None], b * scale
        size = next(s for s in self._sizes if s >= b.size)
        if size not in self._solvers:
            self._solvers[size] = _SizedSolver(self._nv, size, self._weight)
        return self._solvers[size].solve(problem, A, b)


class _SizedSolver:
    """A persistent solver with its buffers, for up to ``size`` rows."""

    def __init__(self, nv: int, size: int, slack_weight: float | None) -> None:
        weights = None if slack_weight is None else np.full(size, slack_weight)
        self._qp: QpSolver = make_solver("daqp", nv, size, weights)
        self._nv = nv
        self._rows = np.zeros((size, nv))
        self._lower, self._upper = np.full(nv + size, -UNBOUNDED), np.full(nv + size, UNBOUNDED)

    def solve(self, problem: Problem, A: Array, b: Array) -> Array | None:
        n, m = self._nv, b.size
        self._rows[:m] = A
        # a row that is not in use is a bounded variable, out of reach
        self._rows[m:] = 0.0
        self._rows[m:, 0] = 1.0
        self._lower[:n], self._upper[:n] = problem.lower, problem.upper
        self._lower[n : n + m], self._lower[n + m :] = b, -UNBOUNDED
        data = (problem.hessian, -problem.hessian @ problem.v_des, self._rows, self._lower, self._upper)
        solution = self._qp.solve(*data)
        if solution.status == "failed":
            # once more, without the active set of the last time
            solution = self._qp.solve(*data)
        if solution.status != "optimal":
            return None
        return np.minimum(np.maximum(solution.x, problem.lower), problem.upper)


class NearestQp:
    r"""The nearest input that satisfies the conditions; where there is none, what ``infeasible`` says.

    ``least_slack`` takes two phases, as p-SSA does:

    .. math:: s^* = \arg\min_s \tfrac12 \|s\|^2 \;\text{s.t.}\; A v \ge b - s,\; v_{min} \le v \le v_{max};
        \qquad v = \arg\min_v \|v - v^{des}\|_H^2 \;\text{s.t.}\; A v \ge b - s^*,\; v_{min} \le v \le v_{max}

    Where the conditions can hold s* is zero, so the first phase is done only where they cannot. Source: eqs. (12),
    (13) of the p-SSA paper with p = 2 and unit weights; eq. (33) of Lee et al. where the conditions can hold.

    ``unsafe_pass_nominal`` returns the nominal input, clipped to its bounds: the naive baseline of sec. V-C there.
    """

    def __init__(self, nv: int, n_rows: int, infeasible: str = "least_slack") -> None:
        """For ``nv`` variables and ``n_rows`` rows; ``infeasible``: one of ``INFEASIBLE``."""
        self._pass_nominal = infeasible == "unsafe_pass_nominal"
        self._identity = np.eye(nv)
        self._hard = WorkingSetQp(nv, n_rows)
        self._soft = WorkingSetQp(nv, n_rows, 1 / SLACK_PULL)
        self._relaxed = WorkingSetQp(nv, n_rows)

    def resolve(self, problem: Problem, rows: BarrierRows) -> Resolved:
        """See :meth:`Resolution.resolve`."""
        spaces = problem.spaces
        v, working = self._hard.solve(problem, spaces.b)
        if v is not None:
            return Resolved(v)
        candidates = _copy(problem, working)
        if self._pass_nominal:
            return Resolved(problem.clipped(), True, candidates)
        plain = replace(problem, v_des=problem.clipped(), hessian=self._identity)
        least, _ = self._soft.solve(plain, spaces.b)
        if least is None:
            return Resolved(None, False, candidates)
        slack = np.maximum(0.0, spaces.b - spaces.A @ least)
        v, _ = self._relaxed.solve(problem, spaces.b - slack - SLACK_ROUNDING * (slack > 0))
        return Resolved(v, False, candidates)


class SlackQp:
    r"""The input that trades distance to the nominal one against violation.

    .. math:: \min_{v, s} \|v - v^{des}\|_H^2 + \tfrac12 \sum_i Q_i s_i^2
        \quad\text{s.t.}\quad A v \ge b - s,\; v_{min} \le v \le v_{max}

    There is always an answer, and it may violate conditions that could be held. Source: eq. (10) of the p-SSA paper
    with p = 2.
    """

    def __init__(self, nv: int, n_rows: int, slack_weight: Array) -> None:
        """For ``nv`` variables and ``n_rows`` rows; ``slack_weight``: Q, shape (n_rows,)."""
        # the solver's objective is half of both terms: 1/2 |v - v_des|^2 + 1/2 (Q/2) s^2
        self._scale = np.sqrt(0.5 * slack_weight)
        self._qp = WorkingSetQp(nv, n_rows, 1.0)

    def resolve(self, problem: Problem, rows: BarrierRows) -> Resolved:
        """See :meth:`Resolution.resolve`."""
        v, working = self._qp.solve(problem, problem.spaces.b, self._scale)
        return Resolved(v, False, _copy(problem, working))


class CartesianPush:
    r"""Potential field: the point of the worst row is pushed along its normal.

    .. math:: v = v^{des} + J_c^{+} c\,\hat n

    :math:`J_c^+` is the pseudo-inverse of least change in the metric H (for H = I that of Moore and Penrose). SPARK
    takes :math:`J_c^+ (J_c v^{des} + c\,\hat n)` instead, which also discards whatever the nominal motion does without
    moving the point: all of the posture. Source: eqs. (8)-(10) of SPARK.
    """

    def __init__(self, push: Array) -> None:
        """``push``: c of each row [m/s], shape (n_rows,)."""
        self._push = push

    def resolve(self, problem: Problem, rows: BarrierRows) -> Resolved:
        """See :meth:`Resolution.resolve`."""

        def push(i: int) -> Array:
            jac, direction = (rows.jac[i : i + 1], np.ones(1)) if rows.cartesian is None else rows.cartesian(i)
            towards = np.linalg.solve(problem.hessian, jac.T)
            return towards @ (np.linalg.pinv(jac @ towards, rcond=RANK, hermitian=True) @ (self._push[i] * direction))

        return _pushed(problem, push)


class JointPush:
    r"""Sliding mode: the worst row's gradient is added.

    .. math:: v = v^{des} + c\, H^{-1} J_i^T

    Source: eq. (12) of SPARK, H = I there.
    """

    def __init__(self, push: Array) -> None:
        """``push``: c of each row [rad/s per m/rad], shape (n_rows,)."""
        self._push = push

    def resolve(self, problem: Problem, rows: BarrierRows) -> Resolved:
        """See :meth:`Resolution.resolve`."""
        return _pushed(problem, lambda i: self._push[i] * np.linalg.solve(problem.hessian, problem.spaces.A[i]))


def _pushed(problem: Problem, push: Callable[[int], Array]) -> Resolved:
    """The nominal input and the push of the row that is active, if there is one, between the bounds."""
    active = np.flatnonzero(problem.spaces.active)
    v = problem.v_des if not active.size else problem.v_des + push(int(active[0]))
    return Resolved(np.clip(v, problem.lower, problem.upper))


def _copy(problem: Problem, working: Indices) -> Candidates:
    """The rows that a solver saw, kept for later."""
    A, b = problem.spaces.A[working], problem.spaces.b[working]
    return Candidates(working, A, b, problem.lower, problem.upper)
