"""Resolutions: which input is taken, given the conditions."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from robots.messages import Array, Indices, Mask
from safety.infeasibility import Candidates
from safety.kernels import add_violated, least_shortfall, next_to_immovable, seat
from safety.rows import BarrierRows, HalfSpaces
from wbc.qp import UNBOUNDED, QpSolver, make_solver

CAPACITIES = (16, 32, 64, 128)
"""Sizes of the small solvers, in rows; above them one for all rows."""

BEYOND = 1e-9
"""A row violated by more than this [m/s, rad/s] has to be seen by the solver."""

SLACK_ROUNDING = 1e-8
"""Room [m/s, rad/s] given to a row on top of its least slack, so that rounding does not make it infeasible again."""

SLACK_PULL = 1e-8
"""Weight of the nominal velocity while the least slack is sought: it makes the velocity unique.

It costs slack of about this times the change of velocity over the row's length: below 1e-6 m/s."""

LEVER = 1e-4
"""A row that changes over the bounds' range by less than this share of it [m/rad] is next to immovable,"""

EASE = 1e-3
"""and given up where the best input would ease it by less than this share of what it would still be short of."""

CERTAIN = 1e-7
"""Conditions certainly cannot hold where every input violates one by more than this [m/s, rad/s]."""

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


class Optimum(NamedTuple):
    """What a working set found.

    Attributes:
        v: shape (nv,) the optimum; ``None`` where there is none.
        working: the rows that the solver saw last.
        room: shape (n_rows,) by how much each row holds at v; empty where there is none.
    """

    v: Array | None
    working: Indices
    room: Array


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
        self._working: Indices = np.zeros(0, dtype=np.intp)

    def solve(self, problem: Problem, b: Array, scale: Array | None = None, start: Indices | tuple[()] = ()) -> Optimum:
        """Solve one problem.

        Args:
            problem: all but the conditions' right-hand sides.
            b: shape (n_rows,) right-hand sides.
            scale: shape (n_rows,) factor on each row, so that its weight is ``w scale^2``; ``None`` for 1.
            start: further rows to start from.
        """
        A, room = np.ascontiguousarray(problem.spaces.A), np.empty(b.size)
        chosen = problem.violated.copy()
        chosen[self._last] = problem.spaces.active[self._last]
        if len(start):
            chosen[start] = True
        while True:
            working = self._working = seat(self._working, chosen)
            v = self._solve_for(problem, A[working], b[working], None if scale is None else scale[working])
            if v is None:
                return Optimum(None, working, np.zeros(0))
            if not add_violated(A, v, b, BEYOND, chosen, room):
                self._last = working[room[working] < BEYOND]
                return Optimum(v, working, room)

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
        # a row that is not in use is a bounded variable, out of reach
        self._idle = np.eye(1, nv)
        self._rows = np.tile(self._idle, (size, 1))
        self._lower, self._upper = np.full(nv + size, -UNBOUNDED), np.full(nv + size, UNBOUNDED)
        self._used = 0

    def solve(self, problem: Problem, A: Array, b: Array) -> Array | None:
        n, m = self._nv, b.size
        self._rows[:m] = A
        if m < self._used:
            self._rows[m : self._used] = self._idle
            self._lower[n + m : n + self._used] = -UNBOUNDED
        self._used = m
        self._lower[:n], self._upper[:n] = problem.lower, problem.upper
        self._lower[n : n + m] = b
        gradient = -(problem.hessian @ problem.v_des)
        solution = self._qp.solve(problem.hessian, gradient, self._rows, self._lower, self._upper)
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

    A row that cannot hold and that nothing moves to speak of (``LEVER``, ``EASE``) is left out and stays violated:
    its compromise with the others would be full speed for next to nothing. Should rounding leave the second phase
    without an answer, that of the first is taken.

    After a conflict the next tick starts with the first phase and asks whether all conditions can hold only where its
    slack does not prove that they cannot: the answer is the same, only sooner.

    ``unsafe_pass_nominal`` returns the nominal input, clipped to its bounds: the naive baseline of sec. V-C there.
    """

    def __init__(self, nv: int, n_rows: int, infeasible: str = "least_slack") -> None:
        """For ``nv`` variables and ``n_rows`` rows; ``infeasible``: one of ``INFEASIBLE``."""
        self._pass_nominal = infeasible == "unsafe_pass_nominal"
        self._identity = np.eye(nv)
        self._hard = WorkingSetQp(nv, n_rows)
        self._soft = WorkingSetQp(nv, n_rows, 1 / SLACK_PULL)
        self._relaxed = WorkingSetQp(nv, n_rows)
        self._conflict = False

    def resolve(self, problem: Problem, rows: BarrierRows) -> Resolved:
        """See :meth:`Resolution.resolve`."""
        if self._conflict:
            return self._compromise(problem, tried=False)
        hard = self._hard.solve(problem, problem.spaces.b)
        if hard.v is not None:
            return Resolved(hard.v)
        if self._pass_nominal:
            return Resolved(problem.clipped(), True, _copy(problem, hard.working))
        return self._compromise(problem, tried=True)

    def _compromise(self, problem: Problem, tried: bool) -> Resolved:
        """Both phases; ``tried``: whether it is known that not all conditions can hold."""
        A, b, bounds = np.ascontiguousarray(problem.spaces.A), problem.spaces.b, (problem.lower, problem.upper)
        lost = next_to_immovable(A, b, *bounds, LEVER, EASE)
        if lost.size:
            b = b.copy()
            b[lost] = -UNBOUNDED
        nearby = Problem(problem.spaces, problem.clipped(), self._identity, *bounds, problem.violated)
        soft = self._soft.solve(nearby, b)
        proven = soft.v is not None and least_shortfall(A, b, *bounds, soft.room) > CERTAIN
        if not proven and (lost.size or not tried):
            hard = self._hard.solve(problem, b)
            if hard.v is not None:
                self._conflict = lost.size > 0
                return Resolved(hard.v, False, _copy(problem, hard.working, lost) if lost.size else None)
        self._conflict = True
        candidates = _copy(problem, soft.working, lost)
        if soft.v is None:
            return Resolved(None, False, candidates)
        short, b = np.flatnonzero(soft.room < 0), b.copy()
        b[short] += soft.room[short] - SLACK_ROUNDING
        nearest = self._relaxed.solve(problem, b, start=short).v
        return Resolved(soft.v if nearest is None else nearest, False, candidates)


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
        found = self._qp.solve(problem, problem.spaces.b, self._scale)
        return Resolved(found.v, False, _copy(problem, found.working))


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


def _copy(problem: Problem, working: Indices, lost: Indices | tuple[()] = ()) -> Candidates:
    """The rows that a solver saw and those it was not shown, kept for later."""
    if len(lost):
        working = np.union1d(working, lost)
    A, b = problem.spaces.A[working], problem.spaces.b[working]
    return Candidates(working, A, b, problem.lower, problem.upper)
