"""DAQP, a dual active-set method. The only place that names it."""

import math
from dataclasses import replace

import daqp
import numpy as np
from numba import types

from robots.kernel_types import MATRIX, VECTOR, njit
from robots.messages import Array
from wbc.active_set import CONTRADICTION, OPTIMAL, ActiveSet
from wbc.qp.problem import FEASIBILITY_TOLERANCE, UNBOUNDED, QpSolution, QpStatus, unsolved

SINGULAR = 1e-13
"""Squared sine of the angle to those it has below which daqp takes a row for dependent on them.

Its own 3.7e-11 takes rows for dependent that are not, and then proves infeasible what is not."""

ITERATIONS = 300
"""Budget of daqp; on 350 rows they take a millisecond, and problems that it solves at all have taken half of that."""

SHORT, NOTHING = 1e-8, 1e-30
"""Rows with a squared length between these are given to daqp at unit length: it has those below 1e-11 for zero."""

SOUND, BROKEN, CROSSED, WITH_SHORT_ROWS = 0, 1, 2, 3
"""What a look at a problem finds."""

SOFT = 8
"""How daqp is told that a row may be violated."""

SOLVED = (1, 2)
"""What daqp says of a solved problem; 2 where a soft row is violated."""


class DaqpSolver:
    """DAQP behind :class:`QpSolver`, asked only where :class:`wbc.active_set.ActiveSet` proves neither answer.

    Both start from the active set of the last problem. What DAQP cannot solve from there is tried once more without it.
    At most ``ROUNDS`` changes of the active set and twice ``iterations`` of DAQP are made; then it has failed.

    Rows with a finite slack weight are its own soft constraints: no slack variables, as fast as hard rows. Their
    multipliers are weight times violation.
    """

    def __init__(self, n: int, m: int, slack_weights: Array | None = None, iterations: int = ITERATIONS) -> None:
        """Prepare for ``n`` variables and ``m`` rows, of which those with a finite weight may be violated.

        ``iterations``: budget of DAQP, each time that it tries.
        """
        self._settings = {"primal_tol": FEASIBILITY_TOLERANCE, "sing_tol": SINGULAR, "iter_limit": iterations}
        self.n = n
        self.m = m
        self._model: daqp.Model | None = None
        self._no_rows = np.zeros((0, n))
        self._softness: Array | None = None
        if slack_weights is not None:
            self._softness = np.concatenate([np.zeros(n), 1.0 / slack_weights])
            self._sense = np.where(self._softness > 0, SOFT, 0).astype(np.int32)
        self._factors: Array | float = 1.0
        self._active = ActiveSet(n, m, self._softness)

    def solve(self, hessian: Array, gradient: Array, rows: Array, lower: Array, upper: Array) -> QpSolution:
        """Solve one problem; see :meth:`QpSolver.solve`."""
        if not self.m:
            rows = self._no_rows
        hessian, gradient, rows, lower, upper = map(np.ascontiguousarray, (hessian, gradient, rows, lower, upper))
        multipliers = np.empty(self.n + self.m)
        outcome, x = self._active.solve(hessian, gradient, rows, lower, upper, multipliers)
        if outcome == OPTIMAL:
            return QpSolution(x, multipliers, "optimal", self._active.changes)
        if outcome == CONTRADICTION:
            return unsolved(self.n, self.m, "infeasible")
        solution = self.search(hessian, gradient, rows, lower, upper)
        if solution.status == "optimal":
            self._active.adopt(solution.multipliers)
        return solution

    def search(self, hessian: Array, gradient: Array, rows: Array, lower: Array, upper: Array) -> QpSolution:
        """Ask DAQP at once; arrays as in :meth:`QpSolver.solve`, each with its entries one after the other."""
        kind = _inspect(hessian, gradient, rows, lower, upper)
        if kind == BROKEN:
            return unsolved(self.n, self.m, "failed")
        if kind == CROSSED:
            return unsolved(self.n, self.m, "infeasible")
        if kind == WITH_SHORT_ROWS:
            squared = np.vecdot(rows, rows)
            squared[(squared >= SHORT) | (squared <= NOTHING)] = 1.0
            return self._solve_stretched(hessian, gradient, rows, lower, upper, squared**-0.5)
        if not isinstance(self._factors, float):
            self._set_factors(1.0)
        return self._solve(hessian, gradient, rows, lower, upper)

    def _solve_stretched(
        self, hessian: Array, gradient: Array, rows: Array, lower: Array, upper: Array, factor: Array
    ) -> QpSolution:
        """The same problem with each row times its ``factor`` (m,), undone in the answer."""
        factors = np.concatenate([np.ones(self.n), factor])
        self._set_factors(factors)
        lower = np.where(lower > -UNBOUNDED, lower * factors, lower)
        upper = np.where(upper < UNBOUNDED, upper * factors, upper)
        solution = self._solve(hessian, gradient, rows * factor[:, None], lower, upper)
        return replace(solution, multipliers=solution.multipliers * factors)

    def _set_factors(self, factors: Array | float) -> None:
        """Say by what the rows are multiplied: violation has to cost the same however long they are."""
        self._factors = factors
        if self._model is not None and self._softness is not None:
            softness = self._softness * factors**2
            self._model.soft_weights(rho_l=softness, rho_u=softness)

    def _solve(self, hessian: Array, gradient: Array, rows: Array, lower: Array, upper: Array) -> QpSolution:
        warm = self._model is not None
        flag = self._load(hessian, gradient, rows, lower, upper)
        if flag < 0:
            self._model = None
            return unsolved(self.n, self.m, "infeasible" if flag == -1 else "failed")
        assert self._model is not None
        x, _, flag, info = self._model.solve()
        if flag not in SOLVED:
            # the active set of an unsolved problem is no good start; from a bad one rounding can make this one unsolved
            self._model = None
            if warm:
                return self._solve(hessian, gradient, rows, lower, upper)
        status: QpStatus = "optimal" if flag in SOLVED else "infeasible" if flag == -1 else "failed"
        return QpSolution(np.array(x), np.array(info["lam"]), status, int(info["iterations"]))

    def _load(self, hessian: Array, gradient: Array, rows: Array, lower: Array, upper: Array) -> int:
        if self._model is not None:
            return int(self._model.update(H=hessian, f=gradient, A=rows, bupper=upper, blower=lower))
        self._model = daqp.Model()
        self._model.settings = self._settings
        if self._softness is None:
            return int(self._model.setup(hessian, gradient, rows, upper, lower)[0])
        flag, _ = self._model.setup(hessian, gradient, rows, upper, lower, self._sense)
        self._set_factors(self._factors)
        return int(flag)


@njit(types.int64(MATRIX, VECTOR, MATRIX, VECTOR, VECTOR), cache=True, error_model="numpy")
def _inspect(hessian: Array, gradient: Array, rows: Array, lower: Array, upper: Array) -> int:
    """What is the matter with a problem: numbers that are not finite, else limits that cross, else short rows."""
    total, crossed, short = 0.0, False, False
    for x in hessian.flat:
        total += x
    for i in range(gradient.size):
        total += gradient[i]
    for i in range(lower.size):
        total += lower[i] + upper[i]
        crossed |= lower[i] > upper[i]
    for i in range(rows.shape[0]):
        squared = 0.0
        for k in range(rows.shape[1]):
            squared += rows[i, k] * rows[i, k]
        total += squared
        short |= NOTHING < squared < SHORT
    if not math.isfinite(total):
        return BROKEN
    return CROSSED if crossed else WITH_SHORT_ROWS if short else SOUND
