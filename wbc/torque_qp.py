"""The reduced QP of DynWBC: its fixed parts for one set of feet on the ground, and its solution."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from robots.messages import Array
from wbc.active_set import OPTIMAL, active_limits
from wbc.contact import SoleContact, wrench_cone
from wbc.kernels import limit_torques
from wbc.least_slack import LeastSlack
from wbc.qp import UNBOUNDED, QpSolution, make_solver

SLACK_PULL = 1e-6
"""Weight of the usual cost while the least violation of the conditions is sought: it makes the answer unique."""

SLACK_ROUNDING = 1e-6
"""Room [m/s^2, rad/s^2] given to a condition on top of its least violation, so that rounding does not undo it."""

RELAXED_ROUNDS = 450
"""Budget of changes of the active set, among cones and torques, while the least violation is sought."""


@dataclass(frozen=True, slots=True)
class DynWbcProblem:
    """The reduced QP over x = [joint accelerations (nj); wrenches (6 c)] and the maps back from it.

    c feet are on the ground; k conditions are put on the acceleration.

    Attributes:
        feet: which feet are on the ground, of all that may be, in their order.
        hessian: shape (nx, nx), nx = nj + 6 c.
        gradient: shape (nx,).
        rows: shape (16 c + nj + k, nx): wrench cones, torques, conditions on the acceleration; the controller's own,
            until the next problem with the same feet.
        lower: shape (nx + 16 c + nj + k,).
        upper: shape (nx + 16 c + nj + k,).
        base: shape (6, nx + 1) map from x to the base's acceleration, in the last column its offset.
        torque: shape (nj, nx + 1) likewise to the joint torques.
    """

    feet: tuple[int, ...]
    hessian: Array
    gradient: Array
    rows: Array
    lower: Array
    upper: Array
    base: Array
    torque: Array


class TorqueQp:
    """Rows, bounds and warm-started solver of all problems with the same feet on the ground.

    A foot in the air has no variables and no cone: on one foot the problem is smaller than on two.

    Attributes:
        feet: which feet are on the ground, of all that may be.
        nx: number of variables.
        wrenches: of these feet within the wrenches of all, shape (6 c,) indices.
        rows: shape (16 c + nj + k, nx): the cones stand, torques and conditions are written by each problem.
    """

    def __init__(
        self, feet: Sequence[int], contacts: Sequence[SoleContact], effort: Array, solver: str, condition_count: int
    ) -> None:
        """Prepare the problems of one set of feet.

        Args:
            feet: which of ``contacts`` are on the ground.
            contacts: all soles that may be.
            effort: shape (nj,) torque limits [N m].
            solver: name of the QP solver.
            condition_count: k, number of conditions on the acceleration.

        Raises:
            ConfigError: unknown solver.
        """
        self.feet = tuple(feet)
        nj, cones = effort.size, 16 * len(self.feet)
        self.nx = nx = nj + 6 * len(self.feet)
        self.wrenches = np.array([6 * foot + i for foot in self.feet for i in range(6)], dtype=int)
        self._nj, self._hard, self._count = nj, cones + nj, condition_count
        m = self._hard + condition_count
        self._solver = make_solver(solver, nx, m)
        if condition_count:
            self._without, self._nearest = make_solver("daqp", nx, self._hard), make_solver("daqp", nx, m)
            self._least_slack = LeastSlack(nx, condition_count, self._hard, rounds=RELAXED_ROUNDS)
            self._weights = np.ones(condition_count)
        self._compromise: Array | None = None
        self.rows = np.zeros((m, nx))
        for i, foot in enumerate(self.feet):
            self.rows[16 * i : 16 * i + 16, nj + 6 * i : nj + 6 * i + 6] = wrench_cone(contacts[foot])
        free, absent = np.full(nx, UNBOUNDED), np.full(condition_count, UNBOUNDED)
        self._lower = np.concatenate([-free, np.full(cones, -UNBOUNDED), -effort, -absent])
        self._upper = np.concatenate([free, np.zeros(cones), effort, absent])

    def limits(self, torque: Array) -> tuple[Array, Array]:
        """New lower and upper bounds of the problem with torques ``torque`` (nj, nx + 1), whose rows are written."""
        lower, upper = np.empty(self._lower.size), np.empty(self._lower.size)
        limit_torques(torque, self._hard - self._nj, self._lower, self._upper, self.rows, lower, upper)
        return lower, upper

    def write_conditions(self, matrix: Array, bound: Array, base: Array, lower: Array) -> None:
        """Put conditions ``matrix`` q_dd >= ``bound``, (k, nv) and (k,), into the rows and into ``lower``."""
        rows = self.rows[self._hard :]
        np.matmul(matrix[:, :6], base[:, :-1], out=rows)
        rows[:, : self._nj] += matrix[:, 6:]
        lower[-self._count :] = bound - matrix[:, :6] @ base[:, -1]

    def solve(self, problem: DynWbcProblem) -> tuple[QpSolution, bool]:
        """The optimum, and whether conditions had to be violated for it (by the least sum of squares)."""
        solution = self._solver.solve(problem.hessian, problem.gradient, problem.rows, problem.lower, problem.upper)
        if solution.status == "optimal" or not self._count:
            self._compromise = None
            return solution, False
        return self._relaxed(problem), True

    def _relaxed(self, problem: DynWbcProblem) -> QpSolution:
        """The optimum with the conditions lowered by their least sum of squared violations.

        That is sought from the point within cones and torques nearest to the last tick's, and never leaves them: where
        rounding or a budget leaves no answer later on, the best point so far is one.
        """
        limits, hard = problem.rows[: self._hard], self.nx + self._hard
        start, lower, upper = self._within(problem)
        if start.status != "optimal":
            return start
        soft = problem.rows[self._hard :], lower[hard:], self._weights
        cost = SLACK_PULL * problem.hessian, SLACK_PULL * problem.gradient
        guess = active_limits(start.multipliers, self.nx + 1)
        outcome, x = self._least_slack.solve(*cost, soft, limits, lower[:hard], upper[:hard], start.x, guess)
        self._compromise = x
        lower[hard:] -= np.maximum(self._least_slack.short, 0.0) + SLACK_ROUNDING
        nearest = self._nearest.solve(problem.hessian, problem.gradient, problem.rows, lower, upper)
        if nearest.status == "optimal":
            return replace(nearest, spent=outcome != OPTIMAL)
        return QpSolution(x, np.zeros(lower.size), "optimal", self._least_slack.steps, True)

    def _within(self, problem: DynWbcProblem) -> tuple[QpSolution, Array, Array]:
        """A point within cones and torques, and the bounds of the problem, new; joints' are given up if they must be.

        It is nearest to the last compromise, in the metric of the cost; without one, the optimum without conditions.
        """
        limits, hard = problem.rows[: self._hard], self.nx + self._hard
        gradient = problem.gradient if self._compromise is None else -(problem.hessian @ self._compromise)
        lower, upper = problem.lower.copy(), problem.upper.copy()
        start = self._without.solve(problem.hessian, gradient, limits, lower[:hard], upper[:hard])
        if start.status != "optimal":
            lower[: self._nj], upper[: self._nj] = -UNBOUNDED, UNBOUNDED
            start = self._without.solve(problem.hessian, gradient, limits, lower[:hard], upper[:hard])
        return start, lower, upper
