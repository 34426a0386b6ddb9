"""Rows that solvers stumble over, and what is done where they do: there is always an answer."""

from typing import Any

import numpy as np
import pytest
from scipy.optimize import Bounds, minimize

from robots.messages import Array
from safety.barriers.rows import HalfSpaces
from safety.filters.conditions import BarrierParameters, FamilyParameters
from safety.filters.resolutions import NearestQp
from safety.filters.safety_filter import FilterStatus, SafetyFilter
from safety.filters.second_phase import SecondPhase
from safety.filters.working_set import Problem
from tests.support.rows import rows_demanding
from wbc.qp import UNBOUNDED, make_solver

V_MAX, ETA = 2.0, 0.5
HARD = ("ssa", "pssa")


def make(name: str, n: int, nv: int) -> SafetyFilter:
    return SafetyFilter(name, n, BarrierParameters(obstacle=FamilyParameters(eta=ETA)), np.full(nv, V_MAX))


def problem(rng: np.random.Generator, conflict: bool, n: int = 9, nv: int = 5) -> tuple[Array, Array, Array]:
    """Rows that can hold together, or of which the last two cannot, and a nominal velocity."""
    A, v = rng.normal(size=(n, nv)), rng.uniform(-1, 1, nv)
    b = A @ v - rng.uniform(0.0, 1.0, n)
    if conflict:
        A[-1] = -A[-2]
        b[-2:] = rng.uniform(0.2, 1.0, 2)
    return A, b, rng.normal(scale=2.0, size=nv)


@pytest.mark.parametrize("name", HARD)
@pytest.mark.parametrize("conflict", [False, True])
@pytest.mark.parametrize("length", [0.0, 1e-12, 2.2e-6, 3.3e-6, 1e-5])
def test_a_row_that_next_to_nothing_moves_is_relaxed_and_leaves_the_others_alone(
    length: float, conflict: bool, name: str
) -> None:
    rng = np.random.default_rng(50)
    kept, without = make(name, 9, 5), make(name, 8, 5)
    for _ in range(30):
        A, b, v_des = problem(rng, conflict)
        A[0] *= length / np.linalg.norm(A[0])
        b[0] = rng.uniform(0.1, 1.0)
        result = kept.apply(rows_demanding(A, b, ETA), v_des)
        assert result.status == FilterStatus.RELAXED
        assert 0 in result.relaxed
        assert result.violation[0] == pytest.approx(b[0], abs=V_MAX * np.abs(A[0]).sum() + 1e-12)
        others = without.apply(rows_demanding(A[1:], b[1:], ETA), v_des)
        np.testing.assert_allclose(result.v, others.v, rtol=0, atol=1e-7)
        chosen = list(result.conflict())
        assert chosen == [0] or (conflict and 0 not in chosen and len(chosen) > 1)


def least(A: Array, b: Array) -> float:
    """Root of the least sum of squared violations within the bounds, by another solver."""

    def violation(v: Array) -> tuple[float, Array]:
        short = np.maximum(0.0, b - A @ v)
        return 0.5 * float(short @ short), -A.T @ short

    options = {"maxiter": 20000, "ftol": 1e-16, "gtol": 1e-11}
    found = minimize(violation, np.zeros(A.shape[1]), jac=True, bounds=Bounds(-V_MAX, V_MAX), options=options)
    return float(np.sqrt(2.0 * found.fun))


@pytest.mark.parametrize("name", HARD)
def test_rows_given_up_cost_at_most_a_thousandth_of_the_least_slack(name: str) -> None:
    rng = np.random.default_rng(56)
    given_up = 0
    for i in range(60):
        A, _, v_des = problem(rng, False, n=12, nv=8)
        A[:4] *= 10.0 ** rng.uniform(-6, -2, (4, 1))
        if i % 2:
            A[5] = -A[4]
        b = np.full(12, ETA)
        own = np.maximum(0.0, b - A @ make(name, 12, 8).apply(rows_demanding(A, b, ETA), v_des).v)
        assert np.linalg.norm(own) <= (1 + 1e-3) * least(A, b) + 1e-6
        span = 2 * V_MAX * np.abs(A).sum(axis=1)
        # beyond its best no row loses more than a ten-thousandth of the bounds' range
        tiny = (span <= 1e-4 * 2 * V_MAX) & (span <= 1e-3 * (b - 0.5 * span))
        assert (own <= b + 0.5 * span)[tiny].all()
        given_up += tiny.any()
    assert 10 < given_up < 60


@pytest.mark.parametrize("name", HARD)
@pytest.mark.parametrize("fraction", [0.99, 1.01])
@pytest.mark.parametrize("limit", ["lever", "ease"])
def test_the_bound_on_what_a_row_given_up_costs_is_reached_and_not_passed(
    name: str, fraction: float, limit: str
) -> None:
    """One row just below and just above either limit, and a nominal velocity that goes the wrong way."""
    lever, ease = 1e-4 * 2 * V_MAX, 1e-3
    span = lever * (fraction if limit == "lever" else 0.5)
    short = span / ease / (fraction if limit == "ease" else 0.5)
    A, b = np.array([[span / (2 * V_MAX), 0.0], [0.0, 1.0]]), np.array([short + 0.5 * span, -1.0])
    result = make(name, 2, 2).apply(rows_demanding(A, b, ETA), np.array([-5.0, 0.0]))
    if fraction < 1:
        # nearest to the nominal velocity: it costs all of the row's span
        np.testing.assert_allclose(result.v, [-V_MAX, 0.0], rtol=0, atol=1e-9)
        assert result.slack == pytest.approx(short + span, rel=1e-12)
        assert result.slack <= (1 + ease) * short
    else:
        # held as far as it can be, though that takes full speed
        assert result.slack == pytest.approx(short, abs=1e-7)


def test_a_row_that_only_a_velocity_beyond_the_bounds_could_meet_is_named() -> None:
    A, b = np.array([[1e-6, 0.0], [0.0, 1.0]]), np.array([0.5, -1.0])
    result = make("ssa", 2, 2).apply(rows_demanding(A, b, ETA), np.array([1e6, 0.0]))
    assert result.status == FilterStatus.RELAXED
    np.testing.assert_array_equal(result.relaxed, [0])
    np.testing.assert_allclose(result.v, [V_MAX, 0.0], rtol=0, atol=1e-9)
    assert result.conflict() == (0,)


@pytest.mark.parametrize("name", HARD)
@pytest.mark.parametrize("length", [1e-4, 3e-6, 2.2e-6, 1e-7])
def test_a_short_row_that_can_hold_is_held(length: float, name: str) -> None:
    rng = np.random.default_rng(51)
    kept = make(name, 9, 5)
    for _ in range(40):
        A, b, v_des = problem(rng, False)
        short = np.append(np.full(3, length), np.ones(6))
        result = kept.apply(rows_demanding(A * short[:, None], b * short, ETA), v_des)
        assert result.status in {FilterStatus.FILTERED, FilterStatus.UNCHANGED}
        # measured at unit length: the answer is that for rows of ordinary length
        ordinary = make(name, 9, 5).apply(rows_demanding(A, b, ETA), v_des)
        np.testing.assert_allclose(result.v, ordinary.v, rtol=0, atol=1e-6)


def nearly_dependent(rng: np.random.Generator, nv: int = 12, n: int = 40) -> tuple[Array, Array, Array]:
    """Rows from a space of few dimensions, some nearly opposite, which ask for more than can be had."""
    A = rng.normal(size=(n, 4)) @ rng.normal(size=(4, nv)) / 4 + 1e-5 * rng.normal(size=(n, nv))
    A[n // 2 :] = -A[: n - n // 2] + 1e-6 * rng.normal(size=(n - n // 2, nv))
    return A, rng.uniform(-0.3, 0.6, n), rng.normal(scale=2.0, size=nv)


@pytest.mark.parametrize("name", HARD)
def test_nearly_dependent_rows_have_an_answer_of_least_slack(name: str) -> None:
    rng = np.random.default_rng(52)
    kept, nv, n = make(name, 40, 12), 12, 40
    soft = make_solver("daqp", nv, n, np.full(n, 1e8))
    lower, upper = np.full(nv + n, -V_MAX), np.full(nv + n, V_MAX)
    for _ in range(60):
        A, b, v_des = nearly_dependent(rng)
        result = kept.apply(rows_demanding(A, b, ETA), v_des)
        assert result.status == FilterStatus.RELAXED
        own = np.maximum(0.0, b - A @ result.v)
        lower[nv:], upper[nv:] = b, UNBOUNDED
        least = soft.solve(np.eye(nv), np.zeros(nv), A, lower, upper)
        assert least.status == "optimal"
        slack = np.maximum(0.0, b - A @ least.x)
        assert np.sqrt(own @ own) <= np.sqrt(slack @ slack) + 1e-6


def _problem(A: Array, b: Array, v_des: Array) -> Problem:

    nv = v_des.size
    spaces = HalfSpaces(A, b, np.ones(b.size, dtype=bool))
    return Problem(spaces, v_des, np.eye(nv), np.full(nv, -V_MAX), np.full(nv, V_MAX), A @ v_des < b)


@pytest.mark.parametrize("name", HARD)
def test_without_a_second_phase_the_first_one_is_the_answer(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(53)
    A, b, v_des = problem(rng, True)
    full = make(name, 9, 5).apply(rows_demanding(A, b, ETA), v_des)
    monkeypatch.setattr(SecondPhase, "solve", lambda *_: None)
    result = make(name, 9, 5).apply(rows_demanding(A, b, ETA), v_des)
    assert result.status == FilterStatus.RELAXED
    assert result.spent and "best found so far" in result.cause
    own, least = (np.maximum(0.0, b - A @ v) for v in (result.v, full.v))
    np.testing.assert_allclose(own, least, rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", HARD)
def test_on_the_way_in_and_out_of_a_conflict_answers_do_not_depend_on_the_past(name: str) -> None:
    """A demand rises through the point where all can just hold, and falls back."""
    rng = np.random.default_rng(54)
    A, b, v_des = problem(rng, True)
    kept, seen = make(name, 9, 5), set()
    for demand in (*np.linspace(-0.3, 0.3, 25), *np.linspace(0.3, -0.3, 25), -1e-6, 1e-6, -1e-9, 1e-5, 0.0):
        # the last two rows hold together for demands up to 0
        b[-2:] = 0.1 + demand, -0.1
        one, two = (f.apply(rows_demanding(A, b, ETA), v_des) for f in (kept, make(name, 9, 5)))
        assert one.status == two.status
        np.testing.assert_allclose(one.v, two.v, rtol=0, atol=1e-7)
        assert (one.status == FilterStatus.RELAXED) == (demand > 1e-7)
        seen.add(one.status)
    assert FilterStatus.RELAXED in seen
    assert len(seen) > 1


def test_a_conflict_is_proved_before_the_hard_conditions_are_left_out() -> None:
    """After a conflict the hard problem is solved only where nothing proves that it has no solution."""
    rng = np.random.default_rng(55)
    resolution = NearestQp(5, 9)
    asked = []
    hard = resolution._hard.solve

    def counted(*given: Any, **named: Any) -> Any:
        asked.append(1)
        return hard(*given, **named)

    resolution._hard.solve = counted
    for conflict, expected in ((True, 1), (True, 0), (True, 0), (False, 1), (False, 1), (True, 1)):
        A, b, v_des = problem(rng, conflict)
        asked.clear()
        found = resolution.resolve(_problem(A, b, v_des), rows_demanding(A, b, ETA))
        assert len(asked) == expected
        assert (found.candidates is not None) == conflict
