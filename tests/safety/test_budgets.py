"""What a filter does when a budget is spent: the least slack so far, between the bounds, and it says so."""

import numpy as np
import pytest

from robots.messages import Array
from safety.filters import second_phase, working_set
from safety.filters.conditions import BarrierParameters, FamilyParameters
from safety.filters.safety_filter import BUDGET_SPENT, RELAXED, FilterStatus, SafetyFilter, explain
from tests.support.budgets import limit
from tests.support.rows import rows_demanding
from wbc import active_set, least_slack

V_MAX, ETA = 2.0, 0.5
N, NV = 60, 8


def make(name: str) -> SafetyFilter:
    return SafetyFilter(name, N, BarrierParameters(obstacle=FamilyParameters(eta=ETA)), np.full(NV, V_MAX))


def problem(rng: np.random.Generator, conflict: bool) -> tuple[Array, Array, Array]:
    A, v = rng.normal(size=(N, NV)), rng.uniform(-1, 1, NV)
    b = A @ v - rng.uniform(0.0, 0.3, N)
    if conflict:
        A[: N // 2] = -A[N // 2 :]
        b = rng.uniform(-0.3, 0.5, N)
    return A, b, rng.normal(scale=2.0, size=NV)


@pytest.fixture(params=[(0, 0), (0, 1), (2, 2), (5, 30), (active_set.ROUNDS, 0)], ids=str)
def budgets(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> tuple[int, int]:
    """Changes of the active set, and Newton steps."""
    rounds, steps = request.param
    for search in (working_set.WorkingSetQp, second_phase.SecondPhase, least_slack.LeastSlack):
        budget = {"steps": steps, "rounds": 1000} if search is least_slack.LeastSlack else {"rounds": rounds}
        limit(monkeypatch, search, **budget)
    return rounds, steps


@pytest.mark.parametrize("name", ["ssa", "pssa", "rssa"])
@pytest.mark.parametrize("conflict", [False, True])
def test_the_best_so_far_is_taken_and_said_to_be(name: str, conflict: bool, budgets: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    spent = 0
    for _ in range(30):
        A, b, v_des = problem(rng, conflict)
        result = make(name).apply(rows_demanding(A, b, ETA), v_des)
        short = np.maximum(0.0, b - A @ result.v)
        assert (np.abs(result.v) <= V_MAX).all()
        assert result.status in {FilterStatus.FILTERED, FilterStatus.RELAXED}
        assert result.slack == pytest.approx(short.max(), abs=1e-12)
        assert (result.status == FilterStatus.RELAXED) == (short.max() > RELAXED)
        assert result.cause == (BUDGET_SPENT if result.spent else "")
        if result.spent:
            spent += 1
            assert BUDGET_SPENT in explain(result, [str(i) for i in range(N)])
            if name != "rssa":
                # never worse than the nominal input, cut to its bounds
                nominal = np.maximum(0.0, b - A @ np.clip(v_des, -V_MAX, V_MAX))
                assert short @ short <= nominal @ nominal + 1e-9
    assert spent > 0 or budgets in {(active_set.ROUNDS, 0), (5, 30)} or name == "rssa"


@pytest.mark.parametrize("name", ["ssa", "pssa"])
def test_more_steps_never_cost_slack(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """With nothing but the first phase: its steps one by one."""
    rng = np.random.default_rng(1)
    nothing = working_set.Optimum(None, np.zeros(0, dtype=np.int64), True)
    monkeypatch.setattr(working_set.WorkingSetQp, "solve", lambda *_: nothing)
    monkeypatch.setattr(least_slack, "STAGES", ())
    for _ in range(10):
        A, b, v_des = problem(rng, True)
        slack = []
        for steps in range(least_slack.DIRECT):
            with monkeypatch.context() as patched:
                limit(patched, least_slack.LeastSlack, steps=steps)
                result = make(name).apply(rows_demanding(A, b, ETA), v_des)
            slack.append(float(np.sum(np.maximum(0.0, b - A @ result.v) ** 2)))
        assert (np.diff(slack) <= 1e-6).all()
        assert slack[-1] < slack[0]


def test_without_a_budget_nothing_is_said() -> None:
    rng = np.random.default_rng(2)
    for name in ("ssa", "pssa", "rssa"):
        kept = make(name)
        for i in range(40):
            A, b, v_des = problem(rng, i % 2 == 1)
            result = kept.apply(rows_demanding(A, b, ETA), v_des)
            assert not result.spent
            assert result.cause == ""
    assert second_phase.ROUNDS <= active_set.ROUNDS


@pytest.mark.parametrize("name", ["ssa", "pssa"])
@pytest.mark.parametrize("conflict", [False, True])
def test_where_rounding_leaves_no_proof_daqp_is_asked(
    name: str, conflict: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A search that never proves anything: the answers are the same, only later."""
    rng = np.random.default_rng(3)
    problems = [problem(rng, conflict) for _ in range(20)]
    expected = [make(name).apply(rows_demanding(A, b, ETA), v_des) for A, b, v_des in problems]
    monkeypatch.setattr(active_set.ActiveSet, "solve", lambda *_: (active_set.UNKNOWN, np.zeros(NV)))
    same = 0
    monkeypatch.setattr(working_set, "ITERATIONS", 300)
    for (A, b, v_des), right in zip(problems, expected, strict=True):
        result = make(name).apply(rows_demanding(A, b, ETA), v_des)
        if not result.spent:
            np.testing.assert_allclose(result.v, right.v, rtol=0, atol=1e-7)
            assert result.status == right.status
            same += 1
        else:
            short, least = (np.maximum(0.0, b - A @ v) for v in (result.v, right.v))
            assert np.linalg.norm(short) <= np.linalg.norm(least) + 1e-5
    assert same > 10 or conflict


def test_daqp_is_asked_for_few_rows_only(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(4)
    asked: list[int] = []
    solve = working_set.SecondSolver.solve

    def counted(self: object, given: object, A: Array, b: Array) -> Array | None:
        asked.append(b.size)
        return solve(self, given, A, b)

    monkeypatch.setattr(working_set.SecondSolver, "solve", counted)
    monkeypatch.setattr(active_set.ActiveSet, "solve", lambda *_: (active_set.UNKNOWN, np.zeros(NV)))
    monkeypatch.setattr(working_set, "CAPACITY", 25)
    for _ in range(20):
        A, b, v_des = problem(rng, False)
        asked.clear()
        result = make("ssa").apply(rows_demanding(A, b, ETA), v_des)
        assert len(asked) <= 3 * working_set.PASSES
        assert all(size <= 25 for size in asked)
        assert result.status in {FilterStatus.FILTERED, FilterStatus.RELAXED}
