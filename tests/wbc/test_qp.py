"""The QP wrapper against an independent method: least-distance programming over non-negative least squares."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import nnls

from robots.errors import ConfigError
from robots.messages import Array
from wbc.qp import FEASIBILITY_TOLERANCE, UNBOUNDED, QpSolution, kkt_residual, make_solver

Problem = tuple[Array, Array, Array, Array, Array]

SOLVERS = ("daqp", "proxqp")
FORMS = ("free", "bounds", "rows", "both", "equalities", "one_sided", "no_rows", "repeated_rows", "repeated_equalities")
KKT = 1e-8


@pytest.fixture(params=SOLVERS)
def solver_name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def least_distance(problem: Problem) -> Array | None:
    """Minimiser of a strictly convex QP, ``None`` where no point is feasible.

    Lawson and Hanson, "Solving Least Squares Problems", chapter 23: with H = L L^T and y = L^T x + L^-1 g the cost is
    ||y||^2 / 2; the residual of one non-negative least-squares problem gives y, or proves that there is none.
    """
    hessian, gradient, rows, lower, upper = problem
    factor = np.linalg.cholesky(hessian)
    full = np.vstack([np.eye(gradient.size), rows])
    above, below = upper < UNBOUNDED, lower > -UNBOUNDED
    sides = np.linalg.solve(factor, np.vstack([full[above], -full[below]]).T).T
    shift = np.linalg.solve(factor, gradient)
    limits = np.concatenate([upper[above], -lower[below]]) + sides @ shift
    if limits.size == 0:
        return np.linalg.solve(hessian, -gradient)
    matrix = -np.vstack([sides.T, limits])
    target = np.append(np.zeros(gradient.size), 1.0)
    weights, _ = nnls(matrix, target, maxiter=10_000)
    residual = matrix @ weights - target
    if np.linalg.norm(residual) < 1e-9:
        return None
    return np.linalg.solve(factor.T, -residual[:-1] / residual[-1] - shift)


def random_problem(rng: np.random.Generator, form: str, n: int, m: int) -> Problem:
    """A feasible problem: every bound lies around the value of one random point."""
    root = rng.normal(size=(n, n))
    rows = rng.normal(size=(0 if form == "no_rows" else m, n))
    if form.startswith("repeated"):
        rows[1], rows[2], rows[3] = rows[0], 0.0, 2.0 * rows[0]
        rows[4] = rows[0] + rows[5]
    value = np.concatenate([np.eye(n), rows]) @ rng.normal(size=n)
    lower, upper = value - rng.exponential(0.5, value.size), value + rng.exponential(0.5, value.size)
    unbounded = np.zeros((2, value.size), dtype=bool)
    if form == "free":
        unbounded[:] = True
    elif form == "bounds":
        unbounded[:, n:] = True
    elif form == "rows":
        unbounded[:, :n] = True
    elif form == "one_sided":
        unbounded[:] = rng.random(value.size) < np.array([[0.4], [0.7]])
        unbounded[1] &= ~unbounded[0] | (rng.random(value.size) < 0.2)
    equal = np.zeros(value.size, dtype=bool)
    if form == "equalities":
        equal[n : n + min(m, n // 2)] = True
    elif form == "repeated_equalities":
        equal[n : n + 6] = True
    elif form == "repeated_rows":
        lower[n + 1], upper[n + 1] = lower[n], upper[n]
    lower, upper = np.where(equal, value, lower), np.where(equal, value, upper)
    lower[unbounded[0]], upper[unbounded[1]] = -UNBOUNDED, UNBOUNDED
    return root @ root.T + 0.1 * np.eye(n), 3.0 * rng.normal(size=n), rows, lower, upper


def random_size(rng: np.random.Generator) -> tuple[int, int]:
    return int(rng.integers(4, 14)), int(rng.integers(6, 24))


def infeasible_problem(rng: np.random.Generator, kind: str, n: int, m: int) -> Problem:
    hessian, gradient, rows, lower, upper = random_problem(rng, "rows" if kind == "cone" else "both", n, m)
    if kind == "crossed bounds":
        lower[2] = upper[2] + 1e-3
    elif kind == "crossed rows":
        lower[n + 2] = upper[n + 2] + 1e-3
    elif kind == "opposite rows":
        rows[1] = rows[0]
        lower[n], upper[n] = upper[n + 1] + 0.5, UNBOUNDED
    elif kind == "row outside the bounds":
        lower[n] = np.maximum(rows[0] * lower[:n], rows[0] * upper[:n]).sum() + 0.5
        upper[n] = UNBOUNDED
    elif kind == "zero row":
        rows[0], lower[n], upper[n] = 0.0, 0.5, 1.0
    else:  # positive combination of the rows is zero, and each has to be at least 1
        rows[-1] = -rng.uniform(0.5, 1.0, m - 1) @ rows[:-1]
        lower[n:], upper[n:] = 1.0, UNBOUNDED
    return hessian, gradient, rows, lower, upper


CONTRADICTIONS = ("opposite rows", "row outside the bounds", "zero row", "cone")


def solve(name: str, problem: Problem) -> QpSolution:
    return make_solver(name, problem[1].size, problem[2].shape[0]).solve(*problem)


def assert_solved(problem: Problem, solution: QpSolution) -> None:
    expected = least_distance(problem)
    assert expected is not None
    assert solution.status == "optimal"
    assert kkt_residual(*problem, solution) < KKT * max(1.0, abs(solution.multipliers).max())
    np.testing.assert_allclose(solution.x, expected, rtol=0, atol=KKT * max(1.0, abs(expected).max()))


@pytest.mark.parametrize("form", FORMS)
def test_each_form_has_the_minimiser_of_the_independent_method(solver_name: str, form: str) -> None:
    rng = np.random.default_rng(FORMS.index(form))
    for _ in range(60):
        problem = random_problem(rng, form, *random_size(rng))
        assert_solved(problem, solve(solver_name, problem))


def test_rows_and_bounds_hold_to_the_stated_tolerance(solver_name: str) -> None:
    rng = np.random.default_rng(20)
    for _ in range(60):
        problem = random_problem(rng, "both", *random_size(rng))
        solution = solve(solver_name, problem)
        value = np.concatenate([solution.x, problem[2] @ solution.x])
        assert (value >= problem[3] - FEASIBILITY_TOLERANCE).all()
        assert (value <= problem[4] + FEASIBILITY_TOLERANCE).all()


def test_fixed_variables_are_solved_for_the_rest(solver_name: str) -> None:
    rng = np.random.default_rng(21)
    for _ in range(30):
        n, m = random_size(rng)
        problem = random_problem(rng, "both", n, m)
        problem[3][:3] = problem[4][:3] = problem[3][:3]
        lower, upper = problem[3][n:], problem[4][n:]
        lower[:], upper[:] = lower - 3.0, upper + 3.0
        if least_distance(problem) is not None:
            assert_solved(problem, solve(solver_name, problem))


def test_a_row_with_many_copies_counts_once(solver_name: str) -> None:
    rng = np.random.default_rng(22)
    for _ in range(30):
        n, m = random_size(rng)
        hessian, gradient, rows, lower, upper = random_problem(rng, "rows", n, m)
        once = solve(solver_name, (hessian, gradient, rows, lower, upper))
        thrice = (
            hessian,
            gradient,
            np.tile(rows, (3, 1)),
            np.concatenate([lower[:n], *[lower[n:]] * 3]),
            np.concatenate([upper[:n], *[upper[n:]] * 3]),
        )
        assert_solved(thrice, solve(solver_name, thrice))
        np.testing.assert_allclose(solve(solver_name, thrice).x, once.x, rtol=0, atol=KKT)


def test_more_active_rows_than_variables_at_a_vertex(solver_name: str) -> None:
    """All 16 rows pass through one point, and the cost pushes into all of them: the multipliers are not unique."""
    rng = np.random.default_rng(23)
    for _ in range(30):
        n, m = 4, 16
        rows, point = rng.normal(size=(m, n)), rng.normal(size=n)
        gradient = -point - rows.T @ np.ones(m)
        upper = np.concatenate([np.full(n, UNBOUNDED), rows @ point])
        problem = (np.eye(n), gradient, rows, np.full(n + m, -UNBOUNDED), upper)
        solution = solve(solver_name, problem)
        assert_solved(problem, solution)
        np.testing.assert_allclose(solution.x, point, rtol=0, atol=KKT)


@pytest.mark.parametrize("kind", ["crossed bounds", "crossed rows"])
def test_crossed_limits_are_infeasible(solver_name: str, kind: str) -> None:
    rng = np.random.default_rng(30)
    for _ in range(20):
        problem = infeasible_problem(rng, kind, *random_size(rng))
        assert solve(solver_name, problem).status == "infeasible"


@pytest.mark.parametrize("kind", CONTRADICTIONS)
def test_contradictory_rows_are_never_called_optimal(solver_name: str, kind: str) -> None:
    rng = np.random.default_rng(31)
    for _ in range(10):
        problem = infeasible_problem(rng, kind, *random_size(rng))
        assert least_distance(problem) is None
        # ProxQP may run into its iteration cap first: no answer, and it says so
        allowed = {"infeasible"} if solver_name == "daqp" else {"infeasible", "failed"}
        assert solve(solver_name, problem).status in allowed


def test_feasible_problems_are_never_called_infeasible(solver_name: str) -> None:
    rng = np.random.default_rng(32)
    for form in FORMS * 30:
        problem = random_problem(rng, form, *random_size(rng))
        assert solve(solver_name, problem).status == "optimal"


def broken(problem: Problem, slot: int, value: float) -> Problem:
    copies = [part.copy() for part in problem]
    copies[slot].flat[1] = value
    return copies[0], copies[1], copies[2], copies[3], copies[4]


@pytest.mark.parametrize("slot", range(5), ids=["hessian", "gradient", "rows", "lower", "upper"])
def test_nan_fails_and_the_next_problem_is_solved(solver_name: str, slot: int) -> None:
    rng = np.random.default_rng(33)
    n, m = 6, 9
    problems = [random_problem(rng, "both", n, m) for _ in range(3)]
    fresh, used = make_solver(solver_name, n, m), make_solver(solver_name, n, m)
    assert used.solve(*problems[0]).status == "optimal"
    for solver in (fresh, used):
        assert solver.solve(*broken(problems[1], slot, np.nan)).status == "failed"
        assert_solved(problems[2], solver.solve(*problems[2]))


@pytest.mark.parametrize("slot", range(3), ids=["hessian", "gradient", "rows"])
def test_infinite_data_fails_and_the_next_problem_is_solved(solver_name: str, slot: int) -> None:
    rng = np.random.default_rng(34)
    n, m = 6, 9
    problems = [random_problem(rng, "both", n, m) for _ in range(2)]
    solver = make_solver(solver_name, n, m)
    assert solver.solve(*broken(problems[0], slot, np.inf)).status == "failed"
    assert_solved(problems[1], solver.solve(*problems[1]))


def test_daqp_refuses_a_concave_cost_and_recovers() -> None:
    rng = np.random.default_rng(35)
    problem = random_problem(rng, "both", 6, 9)
    solver = make_solver("daqp", 6, 9)
    assert solver.solve(-np.eye(6), *problem[1:]).status == "failed"
    assert_solved(problem, solver.solve(*problem))


@pytest.mark.parametrize("kind", ["crossed bounds", *CONTRADICTIONS])
def test_a_solver_recovers_after_an_infeasible_problem(solver_name: str, kind: str) -> None:
    rng = np.random.default_rng(36)
    n, m = 7, 10
    solver = make_solver(solver_name, n, m)
    for _ in range(4):
        assert solver.solve(*infeasible_problem(rng, kind, n, m)).status != "optimal"
        problem = random_problem(rng, "both", n, m)
        assert_solved(problem, solver.solve(*problem))


def drifting(rng: np.random.Generator, n: int, m: int, count: int) -> list[Problem]:
    """A sequence like that of a control loop: all data move a little from one problem to the next."""
    hessian, gradient, rows, lower, upper = random_problem(rng, "both", n, m)
    out = []
    for k in range(count):
        moved = rows + 0.05 * np.sin(0.3 * k + np.arange(rows.size)).reshape(rows.shape)
        pull = 2.0 * np.sin(0.2 * k + np.arange(n))
        out.append((hessian * (1.0 + 0.01 * k), gradient + pull, moved, lower, upper))
    return out


def assert_same_as_fresh(name: str, problems: Sequence[Problem]) -> None:
    solver = make_solver(name, problems[0][1].size, problems[0][2].shape[0])
    for problem in problems:
        warm, fresh = solver.solve(*problem), solve(name, problem)
        assert warm.status == fresh.status == "optimal"
        np.testing.assert_allclose(warm.x, fresh.x, rtol=0, atol=KKT * max(1.0, abs(fresh.x).max()))
        assert kkt_residual(*problem, warm) < KKT * max(1.0, abs(warm.multipliers).max())


def test_a_warm_start_gives_the_answer_of_a_fresh_solver(solver_name: str) -> None:
    rng = np.random.default_rng(40)
    for _ in range(4):
        problems = drifting(rng, *random_size(rng), 25)
        assert_same_as_fresh(solver_name, [p for p in problems if least_distance(p) is not None])


def test_a_warm_start_survives_unrelated_problems(solver_name: str) -> None:
    rng = np.random.default_rng(41)
    for form in ("both", "one_sided", "rows", "repeated_rows"):
        assert_same_as_fresh(solver_name, [random_problem(rng, form, 8, 12) for _ in range(25)])


def test_a_warm_start_survives_a_change_of_active_sides(solver_name: str) -> None:
    """Bounds come and go, as those of a swing foot's wrench do."""
    rng = np.random.default_rng(42)
    hessian, gradient, rows, lower, upper = random_problem(rng, "both", 10, 16)
    problems = []
    for k in range(30):
        low, high = lower.copy(), upper.copy()
        middle = 0.5 * (lower + upper)
        if k % 3 == 1:
            low[:5] = high[:5] = middle[:5]
            low[10:], high[10:] = -UNBOUNDED, UNBOUNDED
        elif k % 3 == 2:
            low[10:14] = high[10:14] = middle[10:14]
            low[:10], high[:10] = -UNBOUNDED, UNBOUNDED
        problems.append((hessian, gradient, rows, low, high))
    assert_same_as_fresh(solver_name, problems)


def test_answers_are_not_overwritten_by_the_next_solve(solver_name: str) -> None:
    rng = np.random.default_rng(43)
    problems = [random_problem(rng, "both", 8, 12) for _ in range(8)]
    solver = make_solver(solver_name, 8, 12)
    answers = [solver.solve(*p) for p in problems]
    for problem, answer in zip(problems, answers, strict=True):
        assert_solved(problem, answer)
    for a, b in pairwise(answers):
        assert not np.shares_memory(a.x, b.x)
        assert not np.shares_memory(a.multipliers, b.multipliers)


@pytest.mark.parametrize("kind", ["both", "crossed bounds", "zero row"])
def test_the_problem_is_not_written_to(solver_name: str, kind: str) -> None:
    rng = np.random.default_rng(44)
    make = random_problem if kind == "both" else infeasible_problem
    problem = make(rng, kind, 8, 12)
    copies = [part.copy() for part in problem]
    solver = make_solver(solver_name, 8, 12)
    for _ in range(2):
        solver.solve(*problem)
    for part, copy in zip(problem, copies, strict=True):
        assert np.array_equal(part, copy)


def test_reading_a_problem_again_does_not_change_its_answer(solver_name: str) -> None:
    """The arrays of a problem may be reused in place: a solver must not keep hold of them."""
    rng = np.random.default_rng(45)
    first, second = (random_problem(rng, "both", 8, 12) for _ in range(2))
    solver = make_solver(solver_name, 8, 12)
    buffers = [part.copy() for part in first]
    assert_solved(first, solver.solve(buffers[0], buffers[1], buffers[2], buffers[3], buffers[4]))
    for buffer, part in zip(buffers, second, strict=True):
        buffer[...] = part
    assert_solved(second, solver.solve(buffers[0], buffers[1], buffers[2], buffers[3], buffers[4]))


@pytest.mark.parametrize("name", ["", "DAQP", "osqp"])
def test_unknown_solvers_are_refused(name: str) -> None:
    with pytest.raises(ConfigError, match="daqp, proxqp"):
        make_solver(name, 3, 2)


def test_the_sign_of_a_multiplier_tells_the_active_side(solver_name: str) -> None:
    """min 1/2 x^2 - 3 x with x <= 1 has multiplier 2; from below, -2; the same for a row."""
    one, far = np.ones((1, 1)), np.array([UNBOUNDED, UNBOUNDED])
    for place in (0, 1):
        for sign in (1.0, -1.0):
            lower, upper = -far, far.copy()
            (upper if sign > 0 else lower)[place] = sign
            solution = solve(solver_name, (one, np.array([-3.0 * sign]), one, lower, upper))
            expected = np.zeros(2)
            expected[place] = 2.0 * sign
            np.testing.assert_allclose(solution.multipliers, expected, rtol=0, atol=KKT)


def test_kkt_residual_is_the_size_of_each_violation() -> None:
    """min 1/2 x^2 - 3 x, x <= 1, -5 <= x (row): optimum 1 with multipliers 2 and 0; then one condition broken each."""
    one = np.ones((1, 1))
    problem = (one, np.array([-3.0]), one, np.array([-UNBOUNDED, -5.0]), np.array([1.0, UNBOUNDED]))

    def residual(x: float, bound: float, row: float) -> float:
        return kkt_residual(*problem, QpSolution(np.array([x]), np.array([bound, row]), "optimal", 1))

    assert residual(1.0, 2.0, 0.0) == 0.0
    assert residual(1.0, 2.5, 0.0) == pytest.approx(0.5)  # stationarity
    assert residual(1.25, 1.75, 0.0) == pytest.approx(0.4375)  # 0.25 outside, and 0.25 * 1.75 of complementarity
    assert residual(0.5, 2.5, 0.0) == pytest.approx(1.25)  # multiplier on an inactive side
    assert residual(1.0, 2.5, -0.5) == pytest.approx(3.0)  # 6 m inside the lower side of the row, multiplier 0.5
    assert residual(3.0, 0.0, 0.0) == pytest.approx(2.0)  # the free minimiser: 2 outside
    assert residual(1.0, 1.0, 1.0) >= 1e20  # a multiplier on a side that does not exist


def test_kkt_residual_is_large_on_wrong_solutions(solver_name: str) -> None:
    rng = np.random.default_rng(50)
    for form in FORMS * 5:
        problem = random_problem(rng, form, *random_size(rng))
        right = solve(solver_name, problem)
        assert kkt_residual(*problem, right) < KKT * max(1.0, abs(right.multipliers).max())
        step = 1e-3 * rng.normal(size=right.x.size)
        moved = QpSolution(right.x + step, right.multipliers, "optimal", 0)
        # the cost alone has moved by H step, and the multipliers have not
        assert kkt_residual(*problem, moved) >= 0.99 * abs(problem[0] @ step).max()
        if abs(right.multipliers).max() > 0.1:
            flipped = QpSolution(right.x, -right.multipliers, "optimal", 0)
            assert kkt_residual(*problem, flipped) > 1e-2


# --- rows that may be violated


def soft_problem(rng: np.random.Generator, n: int, m: int) -> tuple[Problem, Array]:
    """Bounded variables, rows of which many contradict each other, hard rows among them that do not."""
    root, rows = rng.normal(size=(n, n)), rng.normal(size=(m, n))
    rows[m // 2 : m // 2 + 3] = -rows[:3]
    weights = 10.0 ** rng.uniform(-1, 2, m)
    lower = np.concatenate([np.full(n, -1.0), rng.normal(size=m) + 0.5])
    hard = rng.choice(m, 2, replace=False)
    weights[hard], lower[n + hard] = np.inf, -0.5
    upper = np.concatenate([np.full(n, 1.0), np.full(m, UNBOUNDED)])
    return (root @ root.T + 0.1 * np.eye(n), rng.normal(size=n), rows, lower, upper), weights


def with_slack_variables(problem: Problem, weights: Array) -> Problem:
    """The same problem with a variable of its own for every violation."""
    hessian, gradient, rows, lower, upper = problem
    n, m = gradient.size, len(rows)
    soft = np.isfinite(weights)
    k = int(soft.sum())
    large = np.zeros((n + k, n + k))
    large[:n, :n], large[n:, n:] = hessian, np.diag(weights[soft])
    return (
        large,
        np.concatenate([gradient, np.zeros(k)]),
        np.hstack([rows, np.eye(m)[:, soft]]),
        np.concatenate([lower[:n], np.zeros(k), lower[n:]]),
        np.concatenate([upper[:n], np.full(k, UNBOUNDED), upper[n:]]),
    )


def test_soft_rows_are_those_of_the_problem_with_slack_variables() -> None:
    rng = np.random.default_rng(21)
    n, m = 8, 24
    for _ in range(100):
        problem, weights = soft_problem(rng, n, m)
        expected = make_solver("proxqp", n + int(np.isfinite(weights).sum()), m).solve(
            *with_slack_variables(problem, weights)
        )
        assert expected.status == "optimal"
        solution = make_solver("daqp", n, m, weights).solve(*problem)
        assert solution.status == "optimal"
        np.testing.assert_allclose(solution.x, expected.x[:n], rtol=0, atol=1e-6)
        assert kkt_residual(*problem, solution, weights) < KKT


def test_soft_rows_stay_soft_from_problem_to_problem() -> None:
    rng = np.random.default_rng(22)
    n, m = 8, 24
    _, weights = soft_problem(rng, n, m)
    solver, violated = make_solver("daqp", n, m, weights), 0
    hard = ~np.isfinite(weights)
    for k in range(100):
        problem, _ = soft_problem(rng, n, m)
        problem[3][n:][hard] = -0.5 if k % 7 else 100.0
        solution = solver.solve(*problem)
        if k % 7 == 0:
            assert solution.status == "infeasible"
            continue
        if solution.status == "optimal":
            violated += int((problem[2] @ solution.x < problem[3][n:] - 1e-6).any())
            np.testing.assert_allclose(solution.x, make_solver("daqp", n, m, weights).solve(*problem).x, atol=1e-8)
            assert kkt_residual(*problem, solution, weights) < KKT
    assert violated > 50


@pytest.mark.parametrize("weights", [np.zeros(3), np.array([1.0, -1.0, 1.0]), np.ones(2), np.full(3, np.nan)])
def test_bad_slack_weights_are_refused(weights: Array) -> None:
    with pytest.raises(ConfigError, match="slack_weights"):
        make_solver("daqp", 2, 3, weights)


def test_only_daqp_has_soft_rows() -> None:
    with pytest.raises(ConfigError, match="daqp"):
        make_solver("proxqp", 2, 3, np.ones(3))


@pytest.mark.parametrize("length", [1e-4, 3e-6, 1e-7, 1e-10])
def test_rows_count_however_short_they_are(length: float) -> None:
    rng = np.random.default_rng(40)
    solver = make_solver("daqp", 5, 8)
    for i in range(40):
        hessian, gradient, rows, lower, upper = problem = random_problem(rng, "one_sided", 5, 8)
        expected = least_distance(problem)
        factor = np.where(rng.random(8) < (0.5 if i % 2 else 0.0), length, 1.0)
        lower, upper = lower.copy(), upper.copy()
        for side in (lower, upper):
            side[5:] = np.where(np.abs(side[5:]) < UNBOUNDED, side[5:] * factor, side[5:])
        rows = rows * factor[:, None]
        solution = solver.solve(hessian, gradient, rows, lower, upper)
        assert solution.status == "optimal"
        np.testing.assert_allclose(solution.x, expected, rtol=0, atol=1e-6)
        stationarity = hessian @ solution.x + gradient + solution.multipliers @ np.vstack([np.eye(5), rows])
        np.testing.assert_allclose(stationarity, 0.0, rtol=0, atol=1e-7)


def test_a_short_row_that_cannot_hold_is_infeasible() -> None:
    rows, lower = np.array([[2e-6, 0.0]]), np.array([-10.0, -10.0, 2.1e-5])
    solution = make_solver("daqp", 2, 1).solve(np.eye(2), np.zeros(2), rows, lower, np.array([10.0, 10.0, UNBOUNDED]))
    assert solution.status == "infeasible"


@pytest.mark.parametrize("length", [1.0, 1e-5, 2e-6, 1e-8])
def test_violation_of_a_soft_row_costs_the_same_however_short_it_is(length: float) -> None:
    """One row a: x = x0 + w s a with s = (b - a x0) / (1 + w |a|^2)."""
    rng = np.random.default_rng(41)
    weight = 1e8
    solver = make_solver("daqp", 3, 2, np.full(2, weight))
    for i in range(20):
        # by turns an ordinary row: what was said of the short one must not stay
        a, x0 = rng.normal(size=3) * (length if i % 2 else 1.0), rng.normal(size=3)
        b = a @ x0 + rng.uniform(0.0, 1.0) * np.linalg.norm(a)
        lower, upper = np.array([-50.0, -50, -50, b, -UNBOUNDED]), np.array([50.0, 50, 50, UNBOUNDED, UNBOUNDED])
        solution = solver.solve(np.eye(3), -x0, np.stack([a, np.eye(3)[0]]), lower, upper)
        slack = (b - a @ x0) / (1 + weight * a @ a)
        assert solution.status == "optimal"
        np.testing.assert_allclose(solution.x, x0 + weight * slack * a, rtol=0, atol=1e-8)
        assert solution.multipliers[3] == pytest.approx(-weight * slack, rel=1e-6)


@pytest.mark.parametrize("angle", [1e-6, 3e-6, 1e-5])
def test_nearly_opposite_rows_that_can_hold_are_not_called_infeasible(angle: float) -> None:
    """x >= 0 and -x - angle y >= angle / 3, so that (0, -1/3) is nearest to the origin."""
    rows = np.array([[1.0, 0.0], [-1.0, -angle]])
    lower, upper = np.array([-2.0, -2.0, 0.0, angle / 3]), np.array([2.0, 2.0, UNBOUNDED, UNBOUNDED])
    solution = make_solver("daqp", 2, 2).solve(np.eye(2), np.zeros(2), rows, lower, upper)
    assert solution.status == "optimal"
    np.testing.assert_allclose(solution.x, [0.0, -1 / 3], rtol=0, atol=1e-4)
    assert (rows @ solution.x >= lower[2:] - FEASIBILITY_TOLERANCE).all()
