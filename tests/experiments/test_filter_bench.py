"""Comparison of filters: the recorded states are what they are said to be, and the figures say what happened."""

import json
import sys
from collections.abc import Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import linprog

from experiments.benchmarks.filter_bench import STAGES, Verdict, bench_filters
from experiments.benchmarks.filter_recording import DT, SPEED, record, run
from experiments.benchmarks.filter_scenes import BASES, OBSTACLES, RADIUS, SCENES, SQUEEZE_MARGIN, Moment, Problem
from experiments.cli import main as cli
from experiments.scenarios.options import BenchOptions
from robots.messages import Array
from safety.barriers.rows import FAMILIES, BarrierRows, HalfSpaces
from safety.filters.results import FilterResult, FilterStatus
from safety.filters.safety_filter import FILTERS, KINDS

TICKS = 10
SIZES = [(n_rows, nv) for n_rows in OBSTACLES for nv in BASES]
QP_FILTERS = [name for name in FILTERS if KINDS[name].joint]
OBSTACLE, SELF_COLLISION, WORKSPACE = (FAMILIES.index(f) for f in ("obstacle", "self_collision", "workspace"))


@cache
def recorded(n_rows: int, nv: int, scene: str) -> tuple[Problem, tuple[Moment, ...]]:
    problem = Problem(n_rows, nv, scene)
    return problem, record(problem, scene, 9)


def least_violation(A: Array, b: Array, bound: Array) -> float:
    """Smallest t with A v + t >= b, t >= 0, and v within the bounds, by linear programming."""
    n = bound.size
    cost = np.append(np.zeros(n), 1.0)
    box = [*((-x, x) for x in bound), (0, None)]
    solution = linprog(cost, A_ub=-np.hstack([A, np.ones((len(b), 1))]), b_ub=-b, bounds=box, method="highs")
    assert solution.status == 0
    return float(solution.fun)


def ssa_violation(problem: Problem, rows: BarrierRows, self_margin: float) -> float:
    """That of eta = 0.5 on the rows inside margins of 0.05 m, 0.02 m for the workspace, written out anew."""
    margin = np.select([rows.family == OBSTACLE, rows.family == WORKSPACE], [0.05, 0.02], self_margin)
    inside = rows.h <= margin
    return least_violation(rows.jac[inside], 0.5 - rows.dh_dt[inside], problem.v_max)


def cbf_violation(problem: Problem, rows: BarrierRows) -> float:
    """That of alpha = 5, without a margin, written out anew."""
    return least_violation(rows.jac, -5.0 * rows.h - rows.dh_dt, problem.v_max)


# --- what is recorded


@pytest.mark.parametrize(("n_rows", "nv"), SIZES)
def test_a_problem_has_its_size(n_rows: int, nv: int) -> None:
    problem, moments = recorded(n_rows, nv, "feasible")
    rows = problem.rows(moments[0], second_order=True)
    assert rows.jac.shape == (n_rows, nv)
    assert np.count_nonzero(rows.family == SELF_COLLISION) == 29
    assert np.count_nonzero(rows.family == OBSTACLE) == 19 * OBSTACLES[n_rows]
    assert rows.curvature is not None


@pytest.mark.parametrize(("n_rows", "nv"), SIZES)
def test_feasible_states_have_a_solution_for_hard_filters(n_rows: int, nv: int) -> None:
    problem, moments = recorded(n_rows, nv, "feasible")
    busy = 0
    for moment in moments:
        rows = problem.rows(moment)
        assert ssa_violation(problem, rows, 0.01) < 1e-9
        assert cbf_violation(problem, rows) < 1e-9
        ssa = problem.conditions("ssa", rows, moment.v)
        assert ssa is not None
        busy += int(ssa.active.any())
    assert 3 * busy >= 2 * len(moments)


@pytest.mark.parametrize(("n_rows", "nv"), SIZES)
def test_infeasible_states_have_none(n_rows: int, nv: int) -> None:
    problem, moments = recorded(n_rows, nv, "infeasible")
    for moment in moments:
        rows = problem.rows(moment)
        assert ssa_violation(problem, rows, SQUEEZE_MARGIN if n_rows == 31 else 0.01) > 1e-6


@pytest.mark.parametrize("scene", SCENES)
def test_obstacles_move_as_they_are_said_to(scene: str) -> None:
    steps = run(Problem(219, 17, scene), scene == "infeasible", np.random.default_rng(1))
    moments = [next(steps)[0] for _ in range(30)]
    for now, then in pairwise(moments):
        for before, after in zip(now.obstacles, then.obstacles, strict=True):
            np.testing.assert_allclose(after.position - before.position, DT * before.velocity, rtol=0, atol=1e-15)
            assert np.linalg.norm(before.velocity) <= SPEED + 1e-12
            assert before.radius == RADIUS


def test_the_robot_moves_as_recorded_and_within_its_bounds() -> None:
    for nv in BASES:
        problem = Problem(31, nv, "feasible")
        kin = problem.kin
        steps = run(problem, False, np.random.default_rng(2))
        moments = [next(steps)[0] for _ in range(30)]
        lower, upper = kin.position_limits
        for now, then in pairwise(moments):
            joints = then.q[kin.nq_base :]
            assert (joints >= lower).all()
            assert (joints <= upper).all()
            for v in (then.v, then.v_des):
                assert (np.abs(v) <= problem.v_max).all()
            free = (joints > lower) & (joints < upper)
            moved = (kin.integrate(now.q, then.v, DT) - then.q)[kin.nq_base :]
            np.testing.assert_allclose(moved[free], 0, rtol=0, atol=1e-12)


def test_a_recording_can_be_repeated_and_depends_on_its_seed() -> None:
    first, again, other = (record(Problem(219, 20, "infeasible"), "infeasible", 5, seed) for seed in (0, 0, 1))
    for a, b, c in zip(first, again, other, strict=True):
        assert np.array_equal(a.q, b.q)
        assert np.array_equal(a.v_des, b.v_des)
        assert [o.position.tolist() for o in a.obstacles] == [o.position.tolist() for o in b.obstacles]
        assert not np.array_equal(a.v_des, c.v_des)


# --- what is counted


HALF = HalfSpaces(np.array([[1.0, 0.0], [0.0, 1.0]]), np.array([0.5, 9.0]), np.array([True, False]))
"""First velocity at least 0.5; the second condition is not active."""

GOOD, SHORT, OUTSIDE = np.array([0.5, 0.0]), np.array([0.4, 0.0]), np.array([1.5, 0.0])


@pytest.mark.parametrize(
    ("name", "v", "status", "can_hold", "failures", "violations"),
    [
        ("ssa", GOOD, FilterStatus.FILTERED, True, 0, 0),
        ("ssa", SHORT, FilterStatus.RELAXED, True, 1, 1),
        ("ssa", SHORT, FilterStatus.RELAXED, False, 0, 0),
        ("pssa", SHORT, FilterStatus.RELAXED, True, 1, 1),
        ("rssa", SHORT, FilterStatus.RELAXED, True, 0, 1),
        ("pfm", SHORT, FilterStatus.RELAXED, True, 0, 1),
        ("cbf", OUTSIDE, FilterStatus.FILTERED, True, 1, 0),
        ("cbf", GOOD, FilterStatus.FAILED, False, 1, 0),
    ],
)
def test_a_verdict_counts(
    name: str, v: Array, status: FilterStatus, can_hold: bool, failures: int, violations: int
) -> None:
    verdict = Verdict(name, np.ones(2))
    verdict.add(FilterResult(v, status, 0.0, -1, 0), HALF, can_hold)
    assert (verdict.failures, verdict.violations, verdict.infeasible) == (failures, violations, not can_hold)
    assert verdict.statuses[status.name.lower()] == verdict.ticks == 1


# --- the whole bench, small


@pytest.fixture(scope="module")
def cells(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    """What one small run of everything writes."""
    out = tmp_path_factory.mktemp("bench") / "b.json"
    assert bench_filters(BenchOptions(what="filters", ticks=TICKS, out=out)) == 0
    report = json.loads(out.read_text(encoding="utf-8"))
    assert report["ticks"] == TICKS
    return list(report["cells"])


def test_every_filter_has_figures_at_every_size(cells: list[dict[str, Any]]) -> None:
    known = [(n_rows, nv, scene) for n_rows, nv in SIZES for scene in SCENES]
    assert [(c["rows"], c["variables"], c["scene"]) for c in cells] == known
    for cell in cells:
        assert tuple(cell["filters"]) == FILTERS
        for figures in cell["filters"].values():
            for stage in (*STAGES, "total"):
                assert 0 < figures["median_us"][stage] <= figures["p99_us"][stage] < np.inf
            assert sum(figures["statuses"].values()) == TICKS
            assert 0 <= figures["infeasible_fraction"] <= 1


def test_qp_filters_never_fail_on_feasible_states(cells: list[dict[str, Any]]) -> None:
    for cell in cells:
        if cell["scene"] == "feasible":
            for name in QP_FILTERS:
                assert cell["filters"][name]["failures"] == 0, (cell["rows"], cell["variables"], name)
            for name in ("cbf", "ssa", "rssa", "pssa"):
                assert cell["filters"][name]["infeasible_fraction"] == 0


def test_no_filter_leaves_all_as_it_is_and_ssa_has_no_solution_in_the_crowd(cells: list[dict[str, Any]]) -> None:
    for cell in cells:
        assert cell["filters"]["none"]["statuses"]["unchanged"] == TICKS
        if cell["scene"] == "infeasible":
            for name in ("ssa", "rssa", "pssa"):
                assert cell["filters"][name]["infeasible_fraction"] == 1
                assert cell["filters"][name]["statuses"]["unchanged"] == 0


# --- options


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["filters", "--ticks", "9"], ["ticks", "9", "10 to"]),
        (["filters", "--filters", "cbf", "foo"], ["filters", "'foo'", "cbf, issf"]),
        (["filters", "--filters"], ["filters", "one or more"]),
        (["filters", "--filters", "cbf", "cbf"], ["filters", "different"]),
        (["filters", "--robots", "g1"], ["robots", "left out"]),
        (["filters", "--solver", "proxqp"], ["solver", "left out"]),
        (["filters", "--filter", "cbf"], ["filter", "left out"]),
        (["tick", "--filters", "cbf"], ["filters", "left out"]),
        (["filters", "--out", "missing/x.json"], ["out", "missing/x.json"]),
        (["filters", "--out", "."], ["out", "'.'"]),
    ],
    ids=" ".join,
)
def test_what_is_not_allowed_is_refused_in_one_line(
    arguments: Sequence[str],
    told: Sequence[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["safewbc", "bench", *arguments])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    text = capsys.readouterr()
    assert caught.value.code == 2
    assert text.err.startswith("safewbc: ")
    assert text.err.count("\n") == 1
    for word in told:
        assert word in text.err
    assert list(tmp_path.iterdir()) == []
