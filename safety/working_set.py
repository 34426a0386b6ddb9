"""The input nearest to the nominal one that satisfies many conditions, by solvers that see only those that matter."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from robots.messages import Array, Indices, Mask
from safety.condition_kernels import add_violated, seat
from safety.rows import HalfSpaces
from wbc.qp import UNBOUNDED, QpSolver, make_solver

CAPACITIES = (16, 32, 64, 128)
"""Sizes of the small solvers, in rows; above them one for all rows."""

BEYOND = 1e-9
"""A row violated by more than this [m/s, rad/s] has to be seen by the solver."""


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
