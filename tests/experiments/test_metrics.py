"""Figures of merit against plain definitions."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controllers.config import ControllerConfig, FilterTuning
from experiments.loop import LoopOutcome
from experiments.metrics import (
    CONFLICT_MARGIN,
    PACKAGES,
    convex_polygon,
    guarantee_figures,
    inside_polygon,
    summarise,
    versions,
)
from experiments.results import RunResult, filter_title
from robots.loader import load_robot
from robots.messages import Array
from safety.conditions import FamilyParameters
from safety.filters import FILTERS

SQUARE = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]])


def distance_to_segment(p: Array, a: Array, b: Array) -> float:
    t = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
    return float(np.linalg.norm(p - a - t * (b - a)))


def crossings_inside(p: Array, polygon: Array) -> bool:
    """Textbook test for any simple polygon: a ray to the right crosses the boundary an odd number of times."""
    inside = False
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if (a[1] > p[1]) != (b[1] > p[1]) and p[0] < a[0] + (p[1] - a[1]) * (b[0] - a[0]) / (b[1] - a[1]):
            inside = not inside
    return inside


@given(seed=st.integers(0, 10**6), n=st.integers(3, 12))
def test_inside_agrees_with_the_crossing_test(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    polygon = convex_polygon(rng.uniform(-1, 1, (n, 2)))
    points = rng.uniform(-1.2, 1.2, (50, 2))
    answers = inside_polygon(points, polygon)
    for p, answer in zip(points, answers, strict=True):
        edges = zip(polygon, np.roll(polygon, -1, axis=0), strict=True)
        # the function is generous by a tenth of a millimetre; corners that are sharp make that more
        if min(distance_to_segment(p, a, b) for a, b in edges) > 1e-2:
            assert answer == crossings_inside(p, polygon)


def test_the_edge_and_a_tenth_of_a_millimetre_beyond_count_as_inside() -> None:
    points = np.array([[0, 0], [2, 0.5], [2.00009, 0.5], [1, 1.00009], [2.00011, 0.5], [1, -0.00011]])
    assert inside_polygon(points, SQUARE).tolist() == [True, True, True, True, False, False]


def test_nan_is_outside() -> None:
    points = np.array([[np.nan, np.nan], [1.0, np.nan], [np.nan, 0.5], [1.0, 0.5]])
    assert inside_polygon(points, SQUARE).tolist() == [False, False, False, True]


@given(seed=st.integers(0, 10**6))
def test_the_hull_is_convex_anticlockwise_and_holds_every_point(seed: int) -> None:
    points = np.random.default_rng(seed).uniform(-1, 1, (8, 2))
    hull = convex_polygon(points)
    edge = np.roll(hull, -1, axis=0) - hull
    following = np.roll(edge, -1, axis=0)
    assert (edge[:, 0] * following[:, 1] - edge[:, 1] * following[:, 0] > 0).all()
    assert inside_polygon(points, hull).all()
    assert all((points == corner).all(axis=1).any() for corner in hull)


# --- summary


def recorded(**changes: Any) -> dict[str, Array]:
    """Ten ticks of 0.5 s with two physics steps each: all is well."""
    ticks, steps = 10, 20
    rest = np.zeros((ticks, 3))
    series: dict[str, Any] = {
        "time": 0.5 * np.arange(ticks),
        "com": rest,
        "com_ref": rest,
        "soles": np.zeros((ticks, 2, 3)),
        "filter_status": np.zeros(ticks, int),
        "v_safe": np.zeros((ticks, 7)),
        "qp_failed": np.zeros(ticks, int),
        "tick_ms": np.ones(ticks),
        "h_self_collision": np.full((steps, 3), 0.1),
        "h_joint_limit": np.full(steps, 0.2),
        "h_workspace": np.full((steps, 2), 0.3),
        "h_obstacle": np.full(steps, np.inf),
        "step_zmp": np.tile([1.0, 0.5], (steps, 1)),
        "support_polygon": SQUARE,
        "torque_fraction": np.full((steps, 4), 0.25),
    }
    return series | changes


def summed(fell_at: float | None = None, **changes: Any) -> dict[str, Any]:
    return summarise(recorded(**changes), LoopOutcome(fell_at, 5.0))


def hands(left_error: float, right_error: float, ticks: int = 10) -> dict[str, Array]:
    zero, unit = np.zeros((ticks, 3)), np.tile([0.6, 0.0, 0.8], (ticks, 1))
    return {
        "left_hand": left_error * unit,
        "left_hand_ref": zero,
        "right_hand": zero,
        "right_hand_ref": right_error * unit,
    }


def test_a_run_in_which_nothing_happens() -> None:
    out = summed()
    assert (out["fell"], out["fell_at_s"], out["duration_s"]) == (False, None, 5.0)
    smallest = (out["min_h_self_collision_m"], out["min_h_joint_limit_rad"], out["min_h_workspace_m"])
    assert smallest == (0.1, 0.2, 0.3)
    assert (out["com_rmse_m"], out["foot_slide_max_m"], out["zmp_inside_fraction"]) == (0.0, 0.0, 1.0)
    assert (out["max_torque_fraction"], out["qp_failures"], out["filtered_fraction"]) == (0.25, 0, 0.0)
    assert (out["hand_rmse_m"], out["collision_ratio"]) == (None, None)


def test_the_smallest_barrier_counts_wherever_it_is() -> None:
    h = np.full((20, 3), 0.1)
    h[13, 1] = -0.02
    assert summed(h_self_collision=h)["min_h_self_collision_m"] == -0.02


def test_a_robot_without_pairs_or_bounds_has_no_smallest() -> None:
    out = summed(h_self_collision=np.zeros((20, 0)), h_workspace=np.zeros((20, 0)))
    assert out["min_h_self_collision_m"] is None
    assert out["min_h_workspace_m"] is None


def test_com_error_is_root_mean_square_and_settles_after_three_seconds() -> None:
    com = np.zeros((10, 3))
    com[2] = [0.3, 0.0, 0.4]
    com[8] = [0.0, 0.1, 0.0]
    out = summed(com=com)
    assert out["com_rmse_m"] == pytest.approx(np.sqrt((0.25 + 0.01) / 10))
    assert out["com_error_settled_max_m"] == pytest.approx(0.1)


def test_in_a_short_run_the_second_half_counts_as_settled() -> None:
    series = recorded(com=np.diag(np.arange(10.0))[:, :3])
    assert summarise(series, LoopOutcome(None, 1.0))["com_error_settled_max_m"] == 2.0


def test_foot_slide_is_horizontal_and_from_the_first_place() -> None:
    soles = np.zeros((10, 2, 3))
    soles[:, 1] += [1.0, 2.0, 0.0]
    soles[5:, 1, :2] += [0.003, 0.004]
    soles[:, 0, 2] = np.arange(10)
    assert summed(soles=soles)["foot_slide_max_m"] == pytest.approx(0.005)


def test_zmp_in_the_air_is_not_inside() -> None:
    zmp = np.tile([1.0, 0.5], (20, 1))
    zmp[:3], zmp[5] = np.nan, [3.0, 0.5]
    assert summed(step_zmp=zmp)["zmp_inside_fraction"] == 0.8


def test_a_tick_that_failed_twice_counts_once() -> None:
    out = summed(
        filter_status=np.array([0, 3, 3, 1, 2, 0, 0, 0, 0, 0]), qp_failed=np.array([0, 1, 0, 0, 1, 0, 0, 0, 0, 0])
    )
    assert out["qp_failures"] == 3
    assert out["filtered_fraction"] == 0.4
    assert out["relaxed_fraction"] == 0.1


def test_the_step_of_the_command_is_over_all_changes_from_tick_to_tick() -> None:
    v = np.zeros((10, 2))
    v[3:, 0], v[7:, 1] = 0.3, -0.4
    figures = summed(v_safe=v)
    assert figures["command_step_max"] == pytest.approx(0.4)
    assert figures["command_step_rms"] == pytest.approx(np.sqrt((0.09 + 0.16) / 18))
    assert summed(v_safe=np.full((10, 2), np.nan))["command_step_rms"] is None


def test_ticks_after_a_stop_are_no_failures() -> None:
    v_safe = np.zeros((10, 7))
    v_safe[5:] = np.nan
    out = summed(filter_status=np.array([0, 0, 1, 0, 0, 3, 3, 3, 3, 3]), v_safe=v_safe)
    assert (out["qp_failures"], out["filtered_fraction"]) == (0, 0.2)
    nothing_ran = summed(v_safe=np.full((10, 7), np.nan), filter_status=np.full(10, 3))
    assert (nothing_ran["qp_failures"], nothing_ran["filtered_fraction"]) == (0, None)


def test_hand_error_is_over_both_hands() -> None:
    assert summed(**hands(0.03, 0.04))["hand_rmse_m"] == pytest.approx(np.sqrt((0.0009 + 0.0016) / 2))


def test_collision_ratio_compares_shares_of_steps() -> None:
    """Share of steps in which any pair penetrates, over that of the reference motion."""
    reference = np.full(20, 0.1)
    reference[4:14] = -0.05
    h = np.full((20, 3), 0.1)
    h[6, 0] = h[7, 1] = h[7, 2] = h[9, 2] = h[12, 0] = -1e-6
    out = summed(**hands(0.0, 0.0), h_self_collision=h, h_self_reference=reference)
    assert out["collision_ratio"] == pytest.approx(4 / 10)
    assert out["min_h_reference_m"] == -0.05


def test_collision_ratio_is_not_defined_for_a_reference_that_touches_nothing() -> None:
    out = summed(**hands(0.0, 0.0), h_self_reference=np.full(20, 0.1))
    assert out["collision_ratio"] is None
    no_pairs = summed(**hands(0.0, 0.0), h_self_collision=np.zeros((20, 0)), h_self_reference=np.full(20, np.inf))
    assert no_pairs["collision_ratio"] is None


def test_hand_error_outside_the_conflict_leaves_out_ticks_in_conflict() -> None:
    error = np.zeros((10, 3))
    error[3:6, 0] = 1.0
    error[7, 0] = 0.5
    reference = np.repeat(np.where(np.isin(np.arange(10), [3, 4, 5]), 0.9, 1.1) * CONFLICT_MARGIN, 2)
    series = hands(0.0, 0.0) | {"left_hand": error, "h_self_reference": reference}
    assert summed(**series)["hand_rmse_outside_conflict_m"] == pytest.approx(np.sqrt(0.5 * 0.25 / 7))
    all_in_conflict = series | {"h_self_reference": np.zeros(20)}
    assert summed(**all_in_conflict)["hand_rmse_outside_conflict_m"] is None


def test_a_fall_is_told_with_its_time() -> None:
    out = summed(fell_at=3.25)
    assert (out["fell"], out["fell_at_s"]) == (True, 3.25)


def test_versions_name_everything_a_run_depends_on() -> None:
    told = versions()
    assert set(told) == {"python", *PACKAGES}
    assert all(told[name][0].isdigit() for name in told)


# --- guarantee


def promised(condition: str = "issf", leg_pairs: int = 1, **changes: Any) -> dict[str, Any]:
    """Figures of a run with alpha 5 and epsilon 2: two pairs of arms and one of legs, all well above their bounds."""
    steps = 20
    series = recorded(
        disturbance=np.linspace(0.0, 0.4, steps),
        gradient=np.full((steps, 5), 0.3),
        h_bound=np.full((steps, 5), -0.01),
        h_row_bound=np.full(steps, 0.004),
    )
    tuning = FilterTuning(self_collision=FamilyParameters(alpha=5.0, epsilon=2.0))
    return guarantee_figures(series | changes, ControllerConfig(filter=condition, safety=tuning), leg_pairs)


def test_bounds_are_those_of_the_largest_disturbance() -> None:
    out = promised()
    assert out["disturbance_max"] == 0.4
    assert out["disturbance_rms"] == pytest.approx(np.sqrt(np.mean(np.linspace(0.0, 0.4, 20) ** 2)))
    assert out["bound_m"] == pytest.approx(-2.0 * 0.4**2 / (4 * 5.0))
    gradient = np.full((20, 5), 0.9)
    gradient[:, 1], gradient[7, 1] = 0.1, 0.3
    assert promised("cbf", gradient=gradient)["bound_m"] == pytest.approx(-0.3 * 0.4 / 5.0)
    assert (out["bound_running_min_m"], out["row_bound_min_m"]) == (-0.01, 0.004)


def test_margins_are_of_each_family_at_the_same_instant() -> None:
    bound = np.tile([-0.1, -0.2, -0.3, np.nan, -0.4], (20, 1))
    h = np.full((20, 3), 1.0)
    h[4, 1], h[5, 2] = -0.15, 0.1
    bound[9, 1] = 0.96  # nearer than the smallest h is to the smallest bound
    out = promised(h_bound=bound, h_self_collision=h)
    margins = {key: value for key, value in out.items() if key.startswith("margin")}
    assert margins == {
        "margin_joint_limit_rad": pytest.approx(0.3),
        "margin_self_collision_m": pytest.approx(0.04),
        "margin_leg_collision_m": pytest.approx(0.4),
        "margin_obstacle_m": None,
        "margin_workspace_m": pytest.approx(0.7),
    }
    assert out["bound_held"] is True
    h[4, 1] = -0.21
    assert promised(h_bound=bound, h_self_collision=h)["bound_held"] is False


def test_the_bound_of_an_obstacle_is_no_promise() -> None:
    h = np.full(20, 0.1)
    h[11] = -0.03
    out = promised(h_obstacle=h)
    assert out["margin_obstacle_m"] == pytest.approx(-0.02)
    assert out["bound_held"] is True


def test_steps_after_a_stop_do_not_count() -> None:
    disturbance, bound, row = np.full(20, 0.2), np.full((20, 5), -0.01), np.full(20, 0.004)
    h = np.full((20, 3), 0.1)
    disturbance[10:], bound[10:], row[10:], h[15:] = np.nan, np.nan, np.nan, -0.5
    out = promised(disturbance=disturbance, h_bound=bound, h_row_bound=row, h_self_collision=h)
    assert (out["disturbance_max"], out["bound_held"], out["row_bound_min_m"]) == (0.2, True, 0.004)
    assert out["margin_self_collision_m"] == pytest.approx(0.11)


def test_where_nothing_is_promised_only_the_disturbance_is_told() -> None:
    nothing = {"h_bound": np.full((20, 5), np.nan), "h_row_bound": np.full(20, np.nan)}
    free = promised("none", **nothing)
    assert free.pop("disturbance_max") == 0.4
    assert free.pop("disturbance_rms") > 0
    assert set(free.values()) == {None}
    never_ran = promised(disturbance=np.full(20, np.nan), **nothing)
    assert set(never_ran.values()) == {None}
    # only pairs of legs: no bound on those of arms
    assert promised(leg_pairs=3)["bound_m"] is None


# --- titles

TITLES = {
    "none": "no filter",
    "cbf": "CBF",
    "issf": "ISSf-CBF",
    "ecbf": "eCBF",
    "ssa": "SSA",
    "rssa": "r-SSA",
    "pssa": "p-SSA",
    "sss": "SSS",
    "pfm": "PFM",
    "sma": "SMA",
}


def test_every_filter_is_shown_under_the_name_of_its_paper() -> None:
    assert set(TITLES) == set(FILTERS)
    g1 = load_robot("g1")
    for name, title in TITLES.items():
        assert filter_title(RunResult(g1, {"filter": name}, {}, {})) == title
    assert filter_title(RunResult(g1, {}, {}, {})) == g1.title
