"""Figures of merit of the corridor are those of the paper, and of its series."""

import numpy as np
import pytest

from experiments.metrics.scores import control_score, feasible_rate, safety_score, tracking_score
from experiments.running.corridor_loop import NAIVE, CorridorLoop, CorridorRun
from experiments.scenarios.corridor import (
    Corridor,
)
from robots.description import RobotDescription
from tests.support.corridor import conditions


def test_scores_are_those_of_the_paper() -> None:
    d = np.array([[0.0, 0.1], [0.02, 0.05]])
    by_hand = np.mean([1.0, np.exp(-0.01 / 0.002), np.exp(-0.0004 / 0.002), np.exp(-0.0025 / 0.002)])
    assert tracking_score(d) == pytest.approx(by_hand, rel=1e-12)
    s = np.array([0.0, 0.3, 0.0, 0.1])
    assert control_score(s) == pytest.approx(0.5 * (np.exp(-0.09 / 0.2) + np.exp(-0.01 / 0.2)), rel=1e-12)
    assert feasible_rate(s) == 0.5
    depth = np.array([[0.01, -0.2], [-0.1, 0.03]])
    expected = 0.5 * (np.exp(-0.0001 / 0.0002) + np.exp(-0.0009 / 0.0002))
    assert safety_score(depth) == pytest.approx(expected, rel=1e-12)


def test_figures_are_those_of_the_series(
    corridor_loops: dict[str, CorridorLoop], corridor_runs: dict[str, CorridorRun]
) -> None:
    for name, run in corridor_runs.items():
        series, summary = run.series, run.summary
        bodies = corridor_loops[name].obstacle_barrier.bodies
        assert bodies is not None
        left, right = (series["h_obstacle"][:, bodies.names.index(f"{side}_hand")] for side in ("left", "right"))
        assert summary["phi_hand_max_m"] == pytest.approx(0.05 - left.min(), abs=1e-15)
        assert summary["min_h_hand_m"] == min(left.min(), right.min())
        phi = np.concatenate([(0.05 - series["h_obstacle"]).ravel(), (0.01 - series["h_self_collision"]).ravel()])
        assert summary["S"] == pytest.approx(np.mean(np.exp(-(phi[phi > 0] ** 2) / 0.0002)), rel=1e-12)
        error = np.linalg.norm(series["hands"] - series["goals"], axis=2)
        assert summary["J"] == pytest.approx(np.mean(np.exp(-(error**2) / 0.002)), rel=1e-12)
        assert summary["infeasible_ticks"] == np.count_nonzero(series["infeasible"])
        violated = series["violation"] > 0
        assert summary["C"] == pytest.approx(np.mean(np.exp(-(series["violation"][violated] ** 2) / 0.2)), rel=1e-12)
        assert summary["feasible_rate"] == pytest.approx(1 - violated.mean(), rel=1e-12)
        assert summary["violation_mean"] == pytest.approx(series["violation"].mean(), rel=1e-12)


@pytest.mark.parametrize("name", ["pssa", "ssa", "rssa", NAIVE])
def test_the_violation_is_the_sum_over_conditions_and_its_norm_the_root_of_the_squares(
    corridor_loops: dict[str, CorridorLoop], corridor_runs: dict[str, CorridorRun], name: str
) -> None:
    run = corridor_runs[name]
    several = 0
    for tick in range(0, len(run.series["time"]), 50):
        _, spaces, _ = conditions(corridor_loops[name], run, tick)
        gap = spaces.A @ run.series["v_safe"][tick] - spaces.b
        short = np.maximum(-gap[spaces.active], 0.0)
        assert run.series["violation"][tick] == pytest.approx(short.sum(), abs=1e-5)
        assert run.series["violation_norm"][tick] == pytest.approx(np.sqrt(np.sum(short**2)), abs=1e-5)
        several += int(np.count_nonzero(short > 1e-3) > 1)
    assert several > 0


def test_without_a_filter_the_violation_is_that_of_ssa_s_conditions(corridor_g1: RobotDescription) -> None:
    loop = CorridorLoop(corridor_g1, Corridor(), "none")
    run = loop.run(4.0)
    np.testing.assert_array_equal(run.series["v_safe"], run.series["v_des"])
    for tick in (100, 300, 399):
        _, spaces, _ = conditions(loop, run, tick)
        gap = spaces.A @ run.series["v_safe"][tick] - spaces.b
        short = -np.minimum(gap[spaces.active], 0.0).sum()
        assert run.series["violation"][tick] == pytest.approx(short, abs=1e-5)
    assert run.series["violation"][300] > 0.5


def test_scores_of_nothing_are_none() -> None:
    assert control_score(np.zeros(3)) is None
    assert safety_score(-np.ones((3, 2))) is None
