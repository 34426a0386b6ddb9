"""The active-set search: its optima, its proofs and its budget, against plain linear algebra and another solver."""

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.optimize import linprog

from robots.messages import Array, Indices
from wbc.active_limits import REACH
from wbc.active_set import CONTRADICTION, OPTIMAL, ROUNDS, SPENT, UNKNOWN, ActiveSet, active_limits, search
from wbc.limits import TOLERANCE, Limits, worst_of_all
from wbc.qp import UNBOUNDED, QpSolution, kkt_residual, make_solver
from wbc.triangular import backward, factorise, forward, squared_lengths

Problem = tuple[Array, Array, Array, Array, Array]
KKT = 1e-8


def with_equalities(problem: Problem, active: Indices) -> tuple[Array, Array]:
    """x (n,) and multipliers of limits held as equations, each given as :func:`search` gives them: in plain numpy."""
    hessian, gradient, rows, lower, upper = problem
    n, m = gradient.size, lower.size
    limits = np.abs(active) - 1
    A = np.vstack([np.eye(n), rows])[limits]
    value = np.where(active > 0, lower[limits], upper[limits])
    matrix = np.block([[hessian, A.T], [A, np.zeros((limits.size, limits.size))]])
    found = np.linalg.solve(matrix, np.append(-gradient, value))
    multipliers = np.zeros(m)
    multipliers[limits] = found[n:]
    return found[:n], multipliers


def around(rng: np.random.Generator, n: int, m: int, room: float = 0.3) -> Problem:
    """Limits that hold at one point, and a cost that pulls away from it."""
    root, rows, point = rng.normal(size=(n, n)), rng.normal(size=(m, n)), rng.normal(size=n)
    value = np.concatenate([point, rows @ point])
    lower, upper = value - rng.uniform(0, room, value.size), value + rng.uniform(0, room, value.size)
    upper[n::2] = UNBOUNDED
    return root @ root.T + 0.1 * np.eye(n), 5.0 * rng.normal(size=n), rows, lower, upper


def solve(problem: Problem, **options: object) -> tuple[int, Array, Array, ActiveSet]:
    n, m = problem[1].size, len(problem[2])
    kept = ActiveSet(n, m, **options)
    multipliers = np.zeros(n + m)
    outcome, x = kept.solve(*problem, multipliers)
    return outcome, x, multipliers, kept


def test_triangular_kernels_are_numpys() -> None:
    rng = np.random.default_rng(0)
    for n in (1, 2, 7, 41):
        root = rng.normal(size=(n, n))
        matrix, factor = root @ root.T + 0.1 * np.eye(n), np.zeros((n, n))
        assert factorise(matrix, factor)
        upper = np.triu(factor)
        np.testing.assert_allclose(upper, np.linalg.cholesky(matrix).T, rtol=0, atol=1e-10)
        x = rng.normal(size=n)
        one, two = x.copy(), x.copy()
        forward(factor, one)
        backward(factor, two)
        np.testing.assert_allclose(upper.T @ one, x, rtol=0, atol=1e-10)
        np.testing.assert_allclose(upper @ two, x, rtol=0, atol=1e-10)
        rows, which, lengths = rng.normal(size=(9, n)), np.array([7, 0, 3]), np.zeros(3)
        assert squared_lengths(matrix, rows, which, lengths)
        np.testing.assert_allclose(lengths, np.diag(rows[which] @ np.linalg.inv(matrix) @ rows[which].T), rtol=1e-9)
        assert not squared_lengths(-matrix, rows, which, lengths)
        for bad in (-matrix, np.full((n, n), np.nan), matrix * np.inf):
            assert not factorise(bad, factor)


def test_the_limit_broken_most_is_numpys() -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        _, _, rows, lower, upper = around(rng, 5, 30)
        rows[::3] *= 10.0 ** rng.uniform(-6, 0, (10, 1))
        x, held = 3 * rng.normal(size=5), rng.random(35) < 0.2
        softness = np.where(rng.random(35) < 0.5, 1.0, 0.0)
        listed, values = np.zeros(64, dtype=np.int64), np.zeros(35)
        worst, most, side, count = worst_of_all(Limits(rows, lower, upper, softness), held, x, values, listed)
        full = np.vstack([np.eye(5), rows])
        length = np.linalg.norm(full, axis=1)
        below, above = (lower - full @ x) / length, (full @ x - upper) / length
        excess = np.maximum(below, above) - TOLERANCE * np.minimum(1.0, 1.0 / length)
        excess[held & (softness > 0)] = -1.0
        assert worst == excess.argmax()
        assert most == pytest.approx(excess.max(), rel=1e-9)
        assert side == (1.0 if below[worst] > above[worst] else -1.0)
        np.testing.assert_array_equal(listed[:count], np.flatnonzero(excess > 0))


def test_an_optimum_is_that_of_its_active_set_and_of_another_solver() -> None:
    rng = np.random.default_rng(2)
    for _ in range(150):
        n, m = int(rng.integers(1, 16)), int(rng.integers(0, 60))
        problem = around(rng, n, m)
        outcome, x, multipliers, kept = solve(problem)
        assert outcome == OPTIMAL
        scale = max(1.0, np.abs(multipliers).max())
        assert kkt_residual(*problem, QpSolution(x, multipliers, "optimal", 0)) < KKT * scale
        plain, own = with_equalities(problem, kept.guess[kept.guess != 0])
        np.testing.assert_allclose(x, plain, rtol=0, atol=1e-9)
        np.testing.assert_allclose(multipliers, own, rtol=0, atol=KKT * scale)
        other = make_solver("proxqp", n, m).solve(*problem)
        assert other.status == "optimal"
        np.testing.assert_allclose(x, other.x, rtol=0, atol=1e-6)


def drifting(rng: np.random.Generator, count: int) -> Sequence[Problem]:
    hessian, gradient, rows, lower, upper = around(rng, 12, 40)
    return [
        (hessian, gradient + 2 * np.sin(0.1 * k + np.arange(12)), rows + 0.01 * np.sin(k + rows), lower, upper)
        for k in range(count)
    ]


def test_from_problem_to_problem_the_answer_does_not_depend_on_the_guess() -> None:
    rng = np.random.default_rng(3)
    for _ in range(5):
        kept, multipliers, changes = ActiveSet(12, 40), np.zeros(52), []
        for problem in drifting(rng, 40):
            outcome, x = kept.solve(*problem, multipliers)
            fresh, expected, _, new = solve(problem)
            assert outcome == fresh
            if outcome == OPTIMAL:
                np.testing.assert_allclose(x, expected, rtol=0, atol=1e-9)
                changes.append((kept.changes, new.changes))
            # any guess will do, limits twice and both sides of one among them
            n_guess = kept.guess.size
            guess = rng.integers(1, 53, n_guess) * rng.choice([-1, 1], n_guess)
            other = np.zeros(12)
            assert search(*problem, np.zeros(52), guess, ROUNDS, other, np.zeros(0))[0] in {outcome, UNKNOWN}
        warm, cold = np.sum(changes, axis=0)
        assert warm < 0.5 * cold


@pytest.mark.parametrize("noise", [0.0, 1e-14, 1e-12, 1e-9])
def test_dependent_and_nearly_dependent_rows(noise: float) -> None:
    """Many rows from a space of three dimensions: what is called an optimum is one."""
    rng = np.random.default_rng(4)
    proved = 0
    for _ in range(60):
        hessian, gradient, rows, lower, upper = around(rng, 10, 40)
        rows = rng.normal(size=(40, 3)) @ rng.normal(size=(3, 10)) + noise * rng.normal(size=(40, 10))
        lower[10:], upper[10:] = -rng.uniform(0, 0.1, 40), UNBOUNDED
        lower[:10], upper[:10] = -1.0, 1.0
        problem = hessian, gradient, rows, lower, upper
        outcome, x, multipliers, _ = solve(problem)
        assert outcome != CONTRADICTION
        if outcome == OPTIMAL:
            proved += 1
            full = np.vstack([np.eye(10), rows])
            assert (full @ x >= lower - TOLERANCE).all() and (full @ x <= upper + TOLERANCE).all()
            stationarity = hessian @ x + gradient + full.T @ multipliers
            assert np.abs(stationarity).max() < KKT * max(1.0, np.abs(multipliers).max())
    assert proved > 50


def test_what_is_called_a_contradiction_has_no_point() -> None:
    rng = np.random.default_rng(5)
    outcomes = []
    for _ in range(200):
        n, m = 6, 18
        problem = around(rng, n, m)
        problem[3][n::2] += rng.uniform(0, 1.5) * (rng.random(m // 2) < 0.5)
        _, _, rows, lower, upper = problem
        if (lower > upper).any():
            continue
        outcome, _, _, kept = solve(problem)
        sides = np.vstack([rows, -rows[upper[n:] < UNBOUNDED]])
        values = np.append(lower[n:], -upper[n:][upper[n:] < UNBOUNDED])
        bounds = list(zip(lower[:n], upper[:n], strict=True))
        feasible = linprog(np.zeros(n), -sides, -values, bounds=bounds).status == 0
        assert outcome == (OPTIMAL if feasible else CONTRADICTION)
        outcomes.append(outcome)
        if outcome == CONTRADICTION:
            # the limits that it ends with cannot hold together within the bounds
            held = np.abs(kept.guess[kept.guess != 0]) - 1
            inside = held[held >= n]
            few = linprog(
                np.zeros(n),
                np.vstack([-rows[inside - n], rows[inside - n]]),
                np.append(-lower[inside], upper[inside]),
                bounds=bounds,
            )
            assert few.status == 2
    assert 20 < outcomes.count(CONTRADICTION) < 180


def test_no_contradiction_is_seen_where_a_point_is_far_off() -> None:
    """x >= 0.9 REACH is met there; beyond REACH nothing is looked for."""
    for factor, expected in ((0.9, OPTIMAL), (1e-3, OPTIMAL)):
        lower = np.array([-UNBOUNDED, factor * REACH])
        outcome, x, _, _ = solve((np.eye(1), np.zeros(1), np.ones((1, 1)), lower, np.full(2, UNBOUNDED)))
        assert outcome == expected
        assert x[0] == pytest.approx(factor * REACH, rel=1e-12)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("slot", range(5), ids=["hessian", "gradient", "rows", "lower", "upper"])
def test_numbers_that_are_not_finite_prove_nothing(slot: int, value: float) -> None:
    rng = np.random.default_rng(6)
    for place in range(3):
        problem = [part.copy() for part in around(rng, 6, 9)]
        problem[slot].flat[place] = value
        assert solve(tuple(problem))[0] == UNKNOWN


def test_numbers_that_overflow_prove_nothing() -> None:
    rng = np.random.default_rng(7)
    for slot in range(4):
        problem = [part.copy() for part in around(rng, 6, 9)]
        problem[slot].flat[1] = 1e308
        assert solve(tuple(problem))[0] in {UNKNOWN, CONTRADICTION}


@pytest.mark.parametrize("by", [1e-12, 1e-3])
def test_crossed_sides_are_no_optimum(by: float) -> None:
    rng = np.random.default_rng(8)
    for place in (2, 8):
        problem = around(rng, 6, 9)
        problem[3][place] = problem[4][place] + by
        assert solve(problem)[0] in {UNKNOWN, CONTRADICTION}


@pytest.mark.parametrize("budget", [0, 1, 3, 8])
def test_a_spent_budget_is_no_answer_and_the_search_goes_on_from_there(budget: int) -> None:
    rng = np.random.default_rng(9)
    spent = 0
    for _ in range(20):
        problem = around(rng, 12, 40, room=0.05)
        expected, x, _, full = solve(problem)
        assert expected == OPTIMAL
        kept = ActiveSet(12, 40, budget=budget)
        for _ in range(500):
            outcome, found = kept.solve(*problem, np.zeros(0))
            assert outcome in {OPTIMAL, SPENT}
            assert kept.changes <= budget + 1
            spent += outcome == SPENT
            if outcome == OPTIMAL or budget < 2:
                break
        if outcome == OPTIMAL:
            np.testing.assert_allclose(found, x, rtol=0, atol=1e-9)
        else:
            assert full.changes > budget
    assert spent > 5


@pytest.mark.parametrize("budget", [0, 1, 3])
def test_a_guess_that_is_wrong_throughout_costs_no_more_than_the_budget(budget: int) -> None:
    rng = np.random.default_rng(12)
    for _ in range(20):
        problem = around(rng, 12, 40, room=0.05)
        kept = ActiveSet(12, 40, budget=budget)
        kept.guess[:12] = np.arange(1, 13)
        outcome, _ = kept.solve(*problem, np.zeros(0))
        assert outcome == SPENT
        assert kept.changes <= budget + 1


def test_a_search_may_be_given_a_budget_of_its_own() -> None:
    problem = around(np.random.default_rng(13), 12, 40, room=0.05)
    kept, usual = ActiveSet(12, 40, budget=0), ActiveSet(12, 40)
    assert kept.solve(*problem, np.zeros(0))[0] == SPENT
    outcome, x = kept.solve(*problem, np.zeros(0), 200)
    assert outcome == OPTIMAL
    np.testing.assert_allclose(x, usual.solve(*problem, np.zeros(0))[1], rtol=0, atol=1e-9)


def test_multipliers_of_another_solver_are_a_guess() -> None:
    rng = np.random.default_rng(10)
    for _ in range(20):
        problem = around(rng, 8, 24)
        outcome, x, multipliers, kept = solve(problem)
        assert outcome == OPTIMAL
        assert set(active_limits(multipliers, 9)) == set(kept.guess)
        new = ActiveSet(8, 24)
        new.adopt(multipliers)
        again, same = new.solve(*problem, np.zeros(0))
        assert (again, new.changes) == (OPTIMAL, 0)
        np.testing.assert_allclose(same, x, rtol=0, atol=1e-10)
        assert np.count_nonzero(active_limits(np.ones(32), 9)) == 8


def test_soft_limits_are_violated_by_multiplier_over_weight() -> None:
    rng = np.random.default_rng(11)
    for _ in range(40):
        n, m = 6, 12
        problem = around(rng, n, m)
        problem[2][m // 2 :] = -problem[2][: m // 2]
        problem[3][n:], problem[4][n:] = rng.normal(size=m), UNBOUNDED
        weights = 10.0 ** rng.uniform(-1, 3, m)
        softness = np.append(np.zeros(n), 1.0 / weights)
        outcome, x, multipliers, _ = solve(problem, softness=softness)
        assert outcome == OPTIMAL
        assert kkt_residual(*problem, QpSolution(x, multipliers, "optimal", 0), weights) < KKT * 10
