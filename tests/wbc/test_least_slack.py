"""Least squared violation under limits that hold: against other solvers, and where the budget is spent."""

import numpy as np
import pytest
from scipy.optimize import Bounds, minimize

from robots.messages import Array
from wbc import least_slack
from wbc.active_set import OPTIMAL, SPENT
from wbc.descent import Violated, descend
from wbc.least_slack import STEPS, LeastSlack
from wbc.qp import UNBOUNDED, make_solver

Case = tuple[Array, Array, tuple[Array, Array, Array], Array, Array, Array]


def case(rng: np.random.Generator, n: int, k: int, m: int = 0, pull: float = 1e-3) -> Case:
    """k rows that contradict each other, m rows and bounds that hold at zero."""
    root, soft, rows = rng.normal(size=(n, n)), rng.normal(size=(k, n)), rng.normal(size=(m, n))
    soft[k // 2 :] = -soft[: k - k // 2] + 1e-3 * rng.normal(size=(k - k // 2, n))
    lower = -rng.uniform(0.1, 2.0, n + m)
    upper = np.append(rng.uniform(0.1, 2.0, n), np.full(m, UNBOUNDED))
    hessian = pull * (root @ root.T + np.eye(n))
    weights = 10.0 ** rng.uniform(-1, 1, k)
    return hessian, pull * rng.normal(size=n), (soft, rng.normal(size=k), weights), rows, lower, upper


def cost(given: Case, x: Array) -> float:
    hessian, gradient, (soft, demand, weights), *_ = given
    short = np.maximum(0.0, demand - soft @ x)
    return float(x @ (0.5 * hessian @ x + gradient) + 0.5 * weights @ short**2)


def test_the_answer_is_that_of_slack_variables() -> None:
    rng = np.random.default_rng(0)
    for i in range(60):
        n, k, m = 7, 24, 5 * (i % 2)
        given = case(rng, n, k, m)
        hessian, gradient, (soft, demand, weights), rows, lower, upper = given
        kept = LeastSlack(n, k, m)
        outcome, x = kept.solve(hessian, gradient, given[2], rows, lower, upper, np.zeros(n))
        assert outcome == OPTIMAL
        np.testing.assert_allclose(kept.short, demand - soft @ x, rtol=0, atol=1e-12)
        large = np.zeros((n + k, n + k))
        large[:n, :n], large[n:, n:] = hessian, np.diag(weights)
        full = np.vstack([np.hstack([rows, np.zeros((m, k))]), np.hstack([soft, np.eye(k)])])
        low = np.concatenate([lower[:n], np.zeros(k), lower[n:], demand])
        high = np.concatenate([upper[:n], np.full(k, UNBOUNDED), upper[n:], np.full(k, UNBOUNDED)])
        other = make_solver("proxqp", n + k, m + k).solve(large, np.append(gradient, np.zeros(k)), full, low, high)
        assert other.status == "optimal"
        np.testing.assert_allclose(x, other.x[:n], rtol=0, atol=1e-5)
        assert cost(given, x) <= cost(given, other.x[:n]) + 1e-9


@pytest.mark.parametrize("k", [10, 60, 500])
def test_with_next_to_no_pull_the_violation_is_the_least(k: int) -> None:
    rng = np.random.default_rng(1)
    for _ in range(8):
        n = 12
        given = case(rng, n, k, pull=1e-8)
        hessian, gradient, (soft, demand, weights), rows, lower, upper = given
        kept = LeastSlack(n, k, steps=100)
        outcome, x = kept.solve(hessian, gradient, given[2], rows, lower, upper, np.zeros(n))
        assert outcome == OPTIMAL

        def violation(v: Array, given: Case = given) -> tuple[float, Array]:
            soft, demand, weights = given[2]
            short = np.maximum(0.0, demand - soft @ v)
            return 0.5 * float(weights @ short**2), -soft.T @ (weights * short)

        options = {"maxiter": 20000, "ftol": 1e-16, "gtol": 1e-11}
        found = minimize(violation, np.zeros(n), jac=True, bounds=Bounds(lower, upper), options=options)
        assert violation(x)[0] <= found.fun + 1e-6
        # stationary: what pushes is taken up by bounds
        push = hessian @ x + gradient - soft.T @ (weights * np.maximum(0.0, demand - soft @ x))
        free = (x > lower + 1e-12) & (x < upper - 1e-12)
        scale = max(1.0, np.abs(soft.T @ (weights * np.abs(demand))).max())
        assert np.abs(push[free]).max(initial=0.0) < 1e-10 * scale
        assert (push[x <= lower + 1e-12] > -1e-10 * scale).all()
        assert (push[x >= upper - 1e-12] < 1e-10 * scale).all()


def test_every_step_is_allowed_and_costs_no_more_than_the_one_before() -> None:
    """So the budget may end anywhere."""
    rng = np.random.default_rng(2)
    spent = 0
    for _ in range(20):
        n, k, m = 10, 80, 6
        given = case(rng, n, k, m, pull=1e-6)
        hessian, gradient, soft, rows, lower, upper = given
        full = np.vstack([np.eye(n), rows])
        last, before = np.inf, cost(given, np.zeros(n))
        for steps in range(1, 12):
            x, short = np.zeros(n), np.zeros(k)
            violated = Violated(np.zeros((n, n)), np.zeros(n), np.zeros(k, dtype=bool))
            guess = np.zeros(n + 1, dtype=np.int64)
            outcome, made, _ = descend(
                (hessian, gradient), soft, (rows, lower, upper), guess, (steps, 1000), violated, x, short
            )
            assert made <= steps
            assert cost(given, x) <= min(last, before) + 1e-12
            assert (full @ x >= lower - 1e-8).all() and (full @ x <= upper + 1e-8).all()
            np.testing.assert_allclose(short, soft[1] - soft[0] @ x, rtol=0, atol=1e-12)
            last = cost(given, x)
            spent += outcome == SPENT
    assert spent > 20


@pytest.mark.parametrize(("steps", "rounds"), [(0, 1000), (1, 1000), (3, 1000), (STEPS, 0), (STEPS, 5)])
def test_a_spent_budget_leaves_a_point_no_worse_than_the_start(steps: int, rounds: int) -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        n, k, m = 10, 80, 6
        given = case(rng, n, k, m, pull=1e-6)
        hessian, gradient, soft, rows, lower, upper = given
        kept = LeastSlack(n, k, m, steps=steps, rounds=rounds)
        outcome, x = kept.solve(hessian, gradient, soft, rows, lower, upper, np.zeros(n))
        assert kept.rounds <= rounds + STEPS
        assert cost(given, x) <= cost(given, np.zeros(n)) + 1e-12
        full = np.vstack([np.eye(n), rows])
        assert (full @ x >= lower - 1e-8).all() and (full @ x <= upper + 1e-8).all()
        np.testing.assert_allclose(kept.short, soft[1] - soft[0] @ x, rtol=0, atol=1e-10)
        assert outcome == SPENT or steps > 1


def test_a_new_start_that_is_cut_short_costs_no_more_than_what_was_found_before(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(least_slack, "DIRECT", 2)
    rng = np.random.default_rng(5)
    spent = 0
    for _ in range(20):
        n, k = 12, 80
        given = case(rng, n, k, pull=1e-3)
        found = []
        for steps in range(2, 8):
            outcome, x = LeastSlack(n, k, steps=steps).solve(*given, np.zeros(n))
            found.append(cost(given, x))
            spent += outcome == SPENT
        assert max(found) <= found[0] + 1e-12
    assert spent > 20


def test_the_next_problem_is_solved_as_by_a_new_one() -> None:
    rng = np.random.default_rng(4)
    n, k, x = 8, 30, np.zeros(8)
    kept = LeastSlack(n, k)
    hessian, gradient, (soft, demand, weights), rows, lower, upper = case(rng, n, k, pull=1e-4)
    for i in range(30):
        demand = demand + 0.02 * np.sin(i + np.arange(k))
        given = hessian, gradient, (soft, demand, weights), rows, lower, upper
        outcome, x = kept.solve(*given, x)
        _, fresh = LeastSlack(n, k).solve(*given, np.zeros(n))
        assert outcome == OPTIMAL
        np.testing.assert_allclose(x, fresh, rtol=0, atol=1e-9)
