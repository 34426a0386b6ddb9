"""The second phase: its few directions are those that nothing fixes, and its answer is that of the whole problem."""

import numpy as np
import pytest

from robots.messages import Array
from safety.barriers.rows import HalfSpaces
from safety.filters.second_phase import ROUNDING, SecondPhase, along, directions_left, fixed_by
from safety.filters.working_set import Problem
from wbc.active_set import OPTIMAL
from wbc.least_slack import LeastSlack
from wbc.qp import UNBOUNDED, make_solver

NV, V_MAX, PULL = 12, 1.5, 1e-8


def problem(rng: np.random.Generator, pairs: int, others: int) -> Problem:
    """So many pairs of conditions that contradict each other, others that leave room, and a metric."""
    jac = rng.normal(size=(pairs, NV))
    A = np.vstack([jac, -jac, rng.normal(size=(others, NV))])
    b = np.concatenate([rng.uniform(0.1, 1.0, 2 * pairs), rng.uniform(-4.0, -1.0, others)])
    root, v_des, n = rng.normal(size=(6, NV)), rng.normal(size=NV), 2 * pairs + others
    hessian = np.eye(NV) + 10.0 * root.T @ root
    sides = np.full(NV, -V_MAX), np.full(NV, V_MAX)
    return Problem(HalfSpaces(A, b, np.ones(n, dtype=bool)), v_des, hessian, *sides, A @ v_des < b)


def first_phase(given: Problem) -> tuple[Array, Array]:
    """The input of least slack, and what each row is short of there."""
    A, b = given.spaces.A, given.spaces.b
    search, centre = LeastSlack(NV, b.size, steps=200, rounds=3000), given.clipped()
    soft = A, b, np.ones(b.size)
    outcome, v = search.solve(
        PULL * np.eye(NV), -PULL * centre, soft, np.zeros((0, NV)), given.lower, given.upper, centre
    )
    assert outcome == OPTIMAL
    return np.clip(v, given.lower, given.upper), search.short


def whole_problem(given: Problem, short: Array) -> Array:
    """The same by a second solver, that sees all rows and all variables."""
    A, b = given.spaces.A, given.spaces.b
    lower = np.append(given.lower, b - np.maximum(short, 0.0) - ROUNDING)
    upper = np.append(given.upper, np.full(b.size, UNBOUNDED))
    gradient = -(given.hessian @ given.v_des)
    solution = make_solver("daqp", NV, b.size).solve(given.hessian, gradient, A, lower, upper)
    assert solution.status == "optimal"
    return solution.x


def distance(given: Problem, v: Array) -> float:
    away = v - given.v_des
    return float(away @ given.hessian @ away)


@pytest.mark.parametrize("pairs", [1, 3, 6, 11])
@pytest.mark.parametrize("others", [0, 40])
def test_the_answer_is_that_of_the_whole_problem(pairs: int, others: int) -> None:
    rng = np.random.default_rng([pairs, others])
    for _ in range(25):
        given = problem(rng, pairs, others)
        A = given.spaces.A
        v, short = first_phase(given)
        found = SecondPhase(NV, A.shape[0]).solve(given, A, short, v)
        assert found is not None
        assert ((given.lower <= found) & (found <= given.upper)).all()
        # no row gives more than it has given, and no allowed input is nearer
        assert (A @ found >= given.spaces.b - np.maximum(short, 0.0) - 3 * ROUNDING).all()
        assert distance(given, found) <= distance(given, v) + 1e-9
        other = whole_problem(given, short)
        assert distance(given, found) <= distance(given, other) + 1e-4 * (1 + distance(given, other))


def test_it_goes_on_from_the_last_answer_and_says_the_same() -> None:
    rng = np.random.default_rng(5)
    kept = SecondPhase(NV, 46)
    for _ in range(30):
        given = problem(rng, 3, 40)
        v, short = first_phase(given)
        again, new = (s.solve(given, given.spaces.A, short, v) for s in (kept, SecondPhase(NV, 46)))
        assert again is not None
        assert new is not None
        np.testing.assert_allclose(again, new, rtol=0, atol=1e-7)


def test_without_a_budget_there_is_no_answer_where_one_has_to_be_looked_for() -> None:
    rng, looked_for = np.random.default_rng(6), 0
    for _ in range(20):
        given = problem(rng, 2, 60)
        v, short = first_phase(given)
        full = SecondPhase(NV, 64).solve(given, given.spaces.A, short, v)
        none = SecondPhase(NV, 64, rounds=0).solve(given, given.spaces.A, short, v)
        assert full is not None
        looked_for += none is None
        assert none is None or np.allclose(none, full, rtol=0, atol=1e-9)
    assert looked_for > 10


@pytest.mark.parametrize("rank", [0, 1, 5, 12])
def test_directions_left_are_the_null_space_of_what_is_fixed(rank: int) -> None:
    rng = np.random.default_rng(rank)
    for held_count in (0, 1, 4):
        rows, held = rng.normal(size=(rank, NV)), np.zeros(NV, dtype=bool)
        held[rng.choice(NV, held_count, replace=False)] = True
        basis = directions_left(np.triu(rows.T @ rows), held)
        assert basis.shape[1] == NV - held_count - min(rank, NV - held_count)
        assert not basis[held].any()
        assert np.abs(rows @ basis).max(initial=0.0) < 1e-7 * (1 + np.abs(basis).max(initial=0.0))
        if basis.shape[1]:
            assert np.linalg.svd(basis, compute_uv=False).min() > 1e-3
        A = rng.normal(size=(7, NV))
        np.testing.assert_allclose(along(basis, A), np.vstack([basis, A @ basis]), rtol=0, atol=1e-12)


def test_what_violated_rows_fix_is_numpys() -> None:
    rng = np.random.default_rng(8)
    A, short = rng.normal(size=(30, NV)), rng.normal(size=30)
    lower, upper, out = np.full(NV, -1.0), np.full(NV, 1.0), np.zeros((NV, NV))
    v = np.where(np.arange(NV) % 3 == 0, 0.2, np.where(np.arange(NV) % 3 == 1, -1.0, 1.0))
    held, count = fixed_by(A, short, v, lower, upper, 0.0, out)
    violated = A[short > 0]
    assert count == len(violated)
    np.testing.assert_allclose(np.triu(out), np.triu(violated.T @ violated), rtol=0, atol=1e-12)
    pull = np.maximum(short, 0.0) @ A
    np.testing.assert_array_equal(held, ((v == 1.0) & (pull > 0)) | ((v == -1.0) & (pull < 0)))
    # a row that is short of what rounding and the pull to the nominal input may leave fixes nothing
    held, count = fixed_by(A, np.full(30, 1e-6), v, lower, upper, 0.0, out)
    assert not held.any()
    assert count == 0
    assert not out.any()
    # nor what pulls no harder than the first phase pulls to the nominal input
    hard = np.linalg.norm(A, axis=1) * np.maximum(short, 0.0)
    fixed_by(A, short, v, lower, upper, float(np.median(hard[short > 0])), out)
    strong = A[hard > np.median(hard[short > 0])]
    np.testing.assert_allclose(np.triu(out), np.triu(strong.T @ strong), rtol=0, atol=1e-12)


@pytest.mark.parametrize("lever", [1e-3, 3e-3, 1e-2])
def test_a_row_that_only_the_pull_to_the_nominal_input_leaves_short_fixes_nothing(lever: float) -> None:
    """It could hold: the first phase lacks a thousandth of it, for the nominal input's sake, and no other reason."""
    A, b = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, lever]]), np.array([0.5, 0.5, 3.5 * lever])
    limit, v_des = np.full(2, 10.0), np.array([6.0, 1.0])
    given = Problem(HalfSpaces(A, b, np.ones(3, dtype=bool)), v_des, np.eye(2) + 1e3, -limit, limit, A @ v_des < b)
    soft, centre = (A, b, np.ones(3)), given.clipped()
    search = LeastSlack(2, 3)
    _, v = search.solve(PULL * np.eye(2), -PULL * centre, soft, np.zeros((0, 2)), -limit, limit, centre)
    found = SecondPhase(2, 3).solve(given, A, search.short, v)
    assert found is not None
    # along (0, 1), free above 3.5, the metric has the sum of both at the nominal 7
    np.testing.assert_allclose(found, [0.0, 6.994], rtol=0, atol=1e-3)
