"""ProxQP, an augmented Lagrangian method. The only place that names it."""

import math

import numpy as np
import proxsuite

from robots.messages import Array
from wbc.qp.problem import FEASIBILITY_TOLERANCE, UNBOUNDED, QpSolution, QpStatus, unsolved

PROXQP_BUDGET = 200
"""Of proxqp's outer iterations, and of the inner ones in each."""


class ProxqpSolver:
    """ProxQP (dense, with box constraints) behind :class:`QpSolver`, iterations capped."""

    def __init__(self, n: int, m: int) -> None:
        """Prepare for ``n`` variables and ``m`` rows."""
        self.n = n
        self.m = m
        self._qp = proxsuite.proxqp.dense.QP(n, 0, m, True)
        settings = self._qp.settings
        settings.eps_abs = 0.1 * FEASIBILITY_TOLERANCE
        settings.eps_rel = 0.0
        settings.check_duality_gap = True
        settings.eps_duality_gap_abs = 10 * FEASIBILITY_TOLERANCE
        settings.eps_duality_gap_rel = 0.0
        settings.eps_primal_inf = settings.eps_dual_inf = 1e-10
        settings.max_iter = PROXQP_BUDGET
        settings.max_iter_in = PROXQP_BUDGET
        settings.initial_guess = proxsuite.proxqp.InitialGuess.COLD_START_WITH_PREVIOUS_RESULT
        self._loaded = False

    def solve(self, hessian: Array, gradient: Array, rows: Array, lower: Array, upper: Array) -> QpSolution:
        """Solve one problem; see :meth:`QpSolver.solve`."""
        if not _finite(hessian, gradient, rows, lower, upper):
            return unsolved(self.n, self.m, "failed")
        if (lower > upper).any():
            return unsolved(self.n, self.m, "infeasible")
        n = self.n
        load = self._qp.update if self._loaded else self._qp.init
        load(H=hessian, g=gradient, C=rows, l=lower[n:], u=upper[n:], l_box=lower[:n], u_box=upper[:n])
        self._loaded = True
        self._qp.solve()
        results = self._qp.results
        solved = results.info.status == proxsuite.proxqp.QPSolverOutput.PROXQP_SOLVED
        infeasible = results.info.status == proxsuite.proxqp.QPSolverOutput.PROXQP_PRIMAL_INFEASIBLE
        status: QpStatus = "optimal" if solved else "infeasible" if infeasible else "failed"
        # ProxQP stacks the multipliers of the rows before those of the box
        multipliers = np.concatenate([results.z[self.m :], results.z[: self.m]])
        multipliers[(multipliers > 0) & (upper >= UNBOUNDED) | (multipliers < 0) & (lower <= -UNBOUNDED)] = 0.0
        return QpSolution(np.array(results.x), multipliers, status, int(results.info.iter))


def _finite(*arrays: Array) -> bool:
    """No NaN or infinity anywhere; bounds may be huge."""
    # without the wrapper of the method: most of the time on arrays of this size
    return all(math.isfinite(np.add.reduce(a, axis=None)) for a in arrays)
