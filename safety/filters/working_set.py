"""The input nearest to the nominal one that satisfies many conditions."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from robots.messages import Array, Indices, Mask
from safety.barriers.rows import HalfSpaces
from safety.filters.condition_kernels import add_violated
from wbc.active_set import CONTRADICTION, OPTIMAL, ROUNDS, SPENT, ActiveSet
from wbc.qp import UNBOUNDED, DaqpSolver

CAPACITY = 64
"""Rows that the second solver sees at most."""

PASSES, ITERATIONS = 2, 60
"""Budget: problems that it is given, each with the rows added that the answer before violated, and its own in each."""

BEYOND = 1e-9
"""A row violated by more than this [m/s, rad/s] has to be seen by it."""

NOT_WANTED, NO_ROWS = np.zeros(0), np.zeros(0, dtype=np.int64)


@dataclass(frozen=True, slots=True)
class Problem:
    """One tick's problem.

    Attributes:
        spaces: the conditions; b of those that are not active is out of reach.
        v_des: shape (nv,) nominal input.
        hessian: shape (nv, nv) metric H in which distance to it is measured.
        lower: shape (nv,) bound of the input.
        upper: shape (nv,) likewise.
        violated: shape (n,) conditions that the nominal input violates.
    """

    spaces: HalfSpaces
    v_des: Array
    hessian: Array
    lower: Array
    upper: Array
    violated: Mask

    def clipped(self) -> Array:
        """The nominal input between its bounds, shape (nv,), new."""
        return np.minimum(np.maximum(self.v_des, self.lower), self.upper)


class Optimum(NamedTuple):
    """What was found.

    Attributes:
        v: shape (nv,) the optimum; ``None`` where there is none, or none was found.
        working: rows that the search had active at its end where there is no optimum, among them those in conflict.
        spent: whether neither an optimum nor a conflict was proved: a budget was spent, or rounding stood in the way.
    """

    v: Array | None
    working: Indices = NO_ROWS
    spent: bool = False


class WorkingSetQp:
    r"""The input nearest to the nominal one under conditions that hold.

    .. math:: \min_v (v - v^{des})^T H (v - v^{des}) \quad\text{s.t.}\quad A v \ge b,\; v_{min} \le v \le v_{max}

    :class:`wbc.active_set.ActiveSet` searches from the rows that were at their limit last time, until its budget is
    spent. Where rounding keeps it from a proof of either an optimum or a conflict, DAQP is asked, which sees only rows
    that matter: those that the nominal input violates and those that the search had, and then what its answer violates,
    until that is nothing: then the optimum for these rows is that for all. It is asked ``PASSES`` times at most, for
    ``CAPACITY`` rows at most.
    """

    def __init__(self, nv: int, n_rows: int, rounds: int = ROUNDS) -> None:
        """For ``nv`` variables and ``n_rows`` rows; ``rounds``: budget of the search."""
        self._nv = nv
        self._active = ActiveSet(nv, n_rows, budget=rounds)
        self._lower, self._upper = np.zeros(nv + n_rows), np.full(nv + n_rows, UNBOUNDED)
        self._second = SecondSolver(nv)

    def solve(self, problem: Problem, b: Array) -> Optimum:
        """Solve one problem.

        Args:
            problem: all but the conditions' right-hand sides.
            b: shape (n_rows,) right-hand sides.
        """
        nv, A = self._nv, np.ascontiguousarray(problem.spaces.A)
        self._lower[:nv], self._lower[nv:], self._upper[:nv] = problem.lower, b, problem.upper
        gradient = -(problem.hessian @ problem.v_des)
        outcome, v = self._active.solve(problem.hessian, gradient, A, self._lower, self._upper, NOT_WANTED)
        if outcome == OPTIMAL:
            return Optimum(np.minimum(np.maximum(v, problem.lower), problem.upper))
        if outcome in {CONTRADICTION, SPENT}:
            return Optimum(None, self.working(), outcome == SPENT)
        return self._ask_again(problem, A, b)

    def working(self) -> Indices:
        """Rows among the active limits of the search."""
        limits = np.abs(self._active.guess) - 1
        return np.sort(limits[limits >= self._nv]) - self._nv

    def _ask_again(self, problem: Problem, A: Array, b: Array) -> Optimum:
        chosen, room = problem.violated & (b > -UNBOUNDED), np.empty(b.size)
        chosen[self.working()] = True
        for _ in range(PASSES):
            working = np.flatnonzero(chosen)
            if working.size > CAPACITY:
                break
            v = self._second.solve(problem, A[working], b[working])
            if v is None:
                return Optimum(None, working, True)
            if not add_violated(A, v, b, BEYOND, chosen, room):
                return Optimum(v)
        return Optimum(None, self.working(), True)


class SecondSolver:
    """DAQP with its buffers, for up to ``CAPACITY`` rows."""

    def __init__(self, nv: int) -> None:
        self._qp, self._nv = DaqpSolver(nv, CAPACITY, iterations=ITERATIONS), nv
        # a row that is not in use is a bounded variable, out of reach
        self._idle = np.eye(1, nv)
        self._rows = np.tile(self._idle, (CAPACITY, 1))
        self._lower, self._upper = np.full(nv + CAPACITY, -UNBOUNDED), np.full(nv + CAPACITY, UNBOUNDED)

    def solve(self, problem: Problem, A: Array, b: Array) -> Array | None:
        """The optimum for these rows alone; ``None`` where none is found."""
        n, m = self._nv, b.size
        self._rows[:m], self._rows[m:] = A, self._idle
        self._lower[:n], self._upper[:n] = problem.lower, problem.upper
        self._lower[n : n + m], self._lower[n + m :] = b, -UNBOUNDED
        gradient = -(problem.hessian @ problem.v_des)
        solution = self._qp.search(problem.hessian, gradient, self._rows, self._lower, self._upper)
        if solution.status != "optimal":
            return None
        return np.minimum(np.maximum(solution.x, problem.lower), problem.upper)
