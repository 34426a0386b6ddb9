"""Quadratic programs: one problem form, persistent solvers behind it. The only place that names a solver."""

import math
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import daqp
import numpy as np
import proxsuite
from numba import types

from robots.checks import require_one_of
from robots.errors import ConfigError
from robots.kernel_types import MATRIX, VECTOR, njit
from robots.messages import Array
from wbc.active_set import CONTRADICTION, OPTIMAL, ActiveSet
from wbc.limits import TOLERANCE

QpStatus = Literal["optimal", "infeasible", "failed"]
UNBOUNDED = 1e30
"""Bounds of this size or more count as absent."""

FEASIBILITY_TOLERANCE = TOLERANCE
"""Largest violation of a row that a solution may show (rows are in m/s, rad/s, N or N m)."""

SINGULAR = 1e-13
"""Squared sine of the angle to those it has below which daqp takes a row for dependent on them.

Its own 3.7e-11 takes rows for dependent that are not, and then proves infeasible what is not."""

ITERATIONS = 300
"""Budget of daqp; on 350 rows they take a millisecond, and problems that it solves at all have taken half of that."""

PROXQP_BUDGET = 200
"""Of proxqp's outer iterations, and of the inner ones in each."""

SHORT, NOTHING = 1e-8, 1e-30
"""Rows with a squared length between these are given to daqp at unit length: it has those below 1e-11 for zero."""

SOUND, BROKEN, CROSSED, WITH_SHORT_ROWS = 0, 1, 2, 3
"""What a look at a problem finds."""

SOFT = 8
"""How daqp is told that a row may be violated."""

SOLVED = (1, 2)
"""What daqp says of a solved problem; 2 where a soft row is violated."""


@dataclass(frozen=True, slots=True)
class QpSolution:
    """Answer of a solver.

    Attributes:
        x: shape (n,) minimiser; the solver's last iterate unless ``status`` is ``optimal``.
        multipliers: shape (n + m,) of the bounds, then the rows; positive where an upper side is active.
        status: ``optimal``, ``infeasible`` (proved so) or ``failed`` (no answer: iteration limit, bad data).
        iterations: of the solver.
        spent: whether ``x`` only meets the limits, because a budget was spent before the optimum was found.
    """

    x: Array
    multipliers: Array
    status: QpStatus
    iterations: int
    spent: bool = False


class QpSolver(Protocol):
    r"""A solver for problems of one size, warm-started from its last answer.

    .. math:: \min_x \tfrac12 x^T H x + g^T x \quad \text{s.t.}\quad
        l_x \le x \le u_x,\; l \le A x \le u
    """

    def solve(self, hessian: Array, gradient: Array, rows: Array, lower: Array, upper: Array) -> QpSolution:
        """Solve one problem.

        Args:
            hessian: H, shape (n, n), symmetric positive definite.
            gradient: g, shape (n,).
            rows: A, shape (m, n).
            lower: shape (n + m,), bounds of x, then of A x; ``-UNBOUNDED`` for none (infinity is refused).
            upper: shape (n + m,), likewise.

        Returns:
            The solution; never raises for a problem without solution.
        """
        ...


def make_solver(name: str, n: int, m: int, slack_weights: Array | None = None) -> QpSolver:
    r"""A persistent solver for ``n`` variables and ``m`` rows.

    Args:
        name: ``daqp`` (dual active set) or ``proxqp`` (augmented Lagrangian).
        n: number of variables.
        m: number of rows.
        slack_weights: shape (m,), above 0: row i may be violated by :math:`s_i` at the cost
            :math:`\tfrac12 w_i s_i^2`; infinite for a row that must hold. Only ``daqp`` has them.

    Raises:
        ConfigError: unknown name, a weight that is not above 0, or weights for a solver that has none.
    """
    require_one_of("qp solver", name, ("daqp", "proxqp"))
    if slack_weights is None:
        return DaqpSolver(n, m) if name == "daqp" else ProxqpSolver(n, m)
    if name != "daqp":
        raise ConfigError("qp solver", name, "daqp where rows may be violated")
    if slack_weights.shape != (m,) or not (slack_weights > 0).all():
        raise ConfigError("slack_weights", slack_weights, f"{m} numbers above 0")
    return DaqpSolver(n, m, slack_weights)


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
            return self._unsolved("infeasible")
        solution = self.search(hessian, gradient, rows, lower, upper)
        if solution.status == "optimal":
            self._active.adopt(solution.multipliers)
        return solution

    def search(self, hessian: Array, gradient: Array, rows: Array, lower: Array, upper: Array) -> QpSolution:
        """Ask DAQP at once; arrays as in :meth:`QpSolver.solve`, each with its entries one after the other."""
        kind = _inspect(hessian, gradient, rows, lower, upper)
        if kind == BROKEN:
            return self._unsolved("failed")
        if kind == CROSSED:
            return self._unsolved("infeasible")
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
            return self._unsolved("infeasible" if flag == -1 else "failed")
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

    def _unsolved(self, status: QpStatus) -> QpSolution:
        return QpSolution(np.zeros(self.n), np.zeros(self.n + self.m), status, 0)


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
            return self._unsolved("failed")
        if (lower > upper).any():
            return self._unsolved("infeasible")
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

    def _unsolved(self, status: QpStatus) -> QpSolution:
        return QpSolution(np.zeros(self.n), np.zeros(self.n + self.m), status, 0)


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


def _finite(*arrays: Array) -> bool:
    """No NaN or infinity anywhere; bounds may be huge."""
    # without the wrapper of the method: most of the time on arrays of this size
    return all(math.isfinite(np.add.reduce(a, axis=None)) for a in arrays)


def kkt_residual(
    hessian: Array,
    gradient: Array,
    rows: Array,
    lower: Array,
    upper: Array,
    solution: QpSolution,
    slack_weights: Array | None = None,
) -> float:
    """Largest violation of the optimality conditions of a solution: stationarity, feasibility, complementarity.

    Args:
        hessian: shape (n, n).
        gradient: shape (n,).
        rows: shape (m, n).
        lower: shape (n + m,).
        upper: shape (n + m,).
        solution: what a solver returned for it.
        slack_weights: shape (m,) as for :func:`make_solver`: a row may then be violated by its multiplier over its
            weight.

    Returns:
        The largest absolute residual; sides at ``UNBOUNDED`` must have no multiplier.
    """
    full = np.vstack([np.eye(gradient.size), rows])
    value = full @ solution.x
    up, down = np.maximum(solution.multipliers, 0), np.maximum(-solution.multipliers, 0)
    stationarity = hessian @ solution.x + gradient + full.T @ solution.multipliers
    if slack_weights is not None:
        # a violated row counts as moved to where its multiplier pays for it
        value = value - np.concatenate([np.zeros(gradient.size), solution.multipliers[gradient.size :] / slack_weights])
    primal = np.maximum(0, np.maximum(lower - value, value - upper))
    gap_up = np.where(upper < UNBOUNDED, np.abs(upper - value), UNBOUNDED) * up
    gap_down = np.where(lower > -UNBOUNDED, np.abs(value - lower), UNBOUNDED) * down
    return float(max(np.abs(r).max(initial=0.0) for r in (stationarity, primal, gap_up, gap_down)))
