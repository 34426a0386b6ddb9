"""Figures of merit against plain definitions."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controllers.whole_body.config import ControllerConfig, FilterTuning
from experiments.metrics.balance import (
    CONFLICT_MARGIN,
    PACKAGES,
    convex_polygon,
    depth_in_hull,
    foot_slide,
    guarantee_figures,
    summarise,
    torque_step_max,
    versions,
    zmp_inside,
    zmp_inside_single,
)
from experiments.recording.outcome import Outcome
from experiments.recording.recording import Recording, filter_title
from robots.loader import load_robot
from robots.messages import Array
from safety.filters.conditions import FamilyParameters
from safety.filters.safety_filter import FILTERS

SQUARE = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]])
SOLES = np.array([[[0.0, y], [2.0, y], [2.0, y + 0.4], [0.0, y + 0.4]] for y in (0.6, 0.0)])
"""Corners of the left and the right sole: their hull is the square."""


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


def depth_by_definition(p: Array, polygon: Array) -> float:
    """Distance to the nearest line through an edge of an anticlockwise convex polygon, negative right of one."""
    depths = []
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        normal = np.array([a[1] - b[1], b[0] - a[0]]) / np.linalg.norm(b - a)
        depths.append(normal @ (p - a))
    return min(depths)


@given(seed=st.integers(0, 10**6), k=st.integers(3, 9))
def test_the_depth_is_that_of_each_point_in_the_hull_of_its_own_corners(seed: int, k: int) -> None:
    rng = np.random.default_rng(seed)
    corners, points = rng.uniform(-1, 1, (20, k, 2)), rng.uniform(-1.2, 1.2, (20, 2))
    depths = depth_in_hull(points, corners)
    for p, own, depth in zip(points, corners, depths, strict=True):
        polygon = convex_polygon(own)
        assert depth == pytest.approx(depth_by_definition(p, polygon), abs=1e-8)
        edges = list(zip(polygon, np.roll(polygon, -1, axis=0), strict=True))
        assert (depth > 0) == crossings_inside(p, polygon)
        if depth > 0:
            # inside, the nearest line is nearest at a point of its edge
            assert depth == pytest.approx(min(distance_to_segment(p, a, b) for a, b in edges), abs=1e-8)


@given(seed=st.integers(0, 10**6), angle=st.floats(-3.2, 3.2), x=st.floats(-20, 20))
def test_the_depth_does_not_change_with_order_and_place(seed: int, angle: float, x: float) -> None:
    rng = np.random.default_rng(seed)
    corners, points = rng.uniform(-1, 1, (10, 8, 2)), rng.uniform(-1.2, 1.2, (10, 2))
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    moved = depth_in_hull(points @ turn.T + [x, -x], rng.permutation(corners, axis=1) @ turn.T + [x, -x])
    np.testing.assert_allclose(moved, depth_in_hull(points, corners), rtol=0, atol=1e-8)


@pytest.mark.parametrize("gap", [0.0, 1e-12, 1e-9, 2e-9, 1e-7, 1e-5])
def test_corners_that_coincide_or_lie_on_an_edge_make_no_difference(gap: float) -> None:
    """Soles side by side share corners and edges, but for rounding."""
    more = np.array([[0.0, gap], [gap, 0.5 * gap], [0.2, 0.1 - gap], [0.1, 0.0], [0.1 + gap, 0.1], [0.07, 0.04]])
    corners = np.concatenate([more, 0.1 * SQUARE])
    points = np.array([[0.05, 0.03], [0.01, 0.09], [0.1, 0.12], [-0.03, 0.05], [0.19, 0.05]])
    depths = depth_in_hull(points, np.tile(corners, (5, 1, 1)))
    np.testing.assert_allclose(depths, [0.03, 0.01, -0.02, -0.03, 0.01], rtol=0, atol=1e-8)


def test_the_depth_of_what_is_no_number_is_none() -> None:
    points = np.array([[np.nan, np.nan], [1.0, np.nan], [np.nan, 0.5], [1.0, 0.5]])
    np.testing.assert_array_equal(depth_in_hull(points, np.tile(SQUARE, (4, 1, 1))), [np.nan] * 3 + [0.5])


def test_nothing_lies_in_a_hull_without_area_but_its_line() -> None:
    line = np.tile(np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]), (3, 1, 1))
    depths = depth_in_hull(np.array([[1.0, 0.2], [1.0, -0.3], [1.0, 0.0]]), line)
    np.testing.assert_allclose(depths, [-0.2, -0.3, 0.0], rtol=0, atol=1e-12)


def test_the_edge_and_a_tenth_of_a_millimetre_beyond_count_as_inside() -> None:
    zmp = np.array([[0, 0], [2, 0.5], [2.00009, 0.5], [1, 1.00009], [2.00011, 0.5], [1, -0.00011]] + [[1, 0.5]] * 14)
    assert zmp_inside(recorded(step_zmp=zmp))[:6].tolist() == [True, True, True, True, False, False]


def test_the_zmp_is_inside_the_feet_that_the_plan_has_down() -> None:
    """Left sole y 0.6 to 1, right sole y 0 to 0.4, and what lies between; on one foot the other is no support."""
    contact = np.array([[1, 1], [1, 0], [0, 1], [0, 0], *[[1, 1]] * 6])
    y = np.repeat([0.5, 0.5, 0.5, 0.5, 0.9, 0.1, 0.5, 0.5, 0.5, 1.1], 2)
    y[2], y[3], y[4], y[5] = 0.61, 0.59, 0.39, 0.41
    series = recorded(in_contact=contact, step_zmp=np.column_stack([np.ones(20), y]))
    expected = [True, True, True, False, True, False, False, False, *[True] * 10, False, False]
    assert zmp_inside(series).tolist() == expected
    assert zmp_inside_single(series, zmp_inside(series)) == 0.5
    assert summarise(series, Outcome(None, 5.0))["zmp_inside_fraction"] == 14 / 20


def test_soles_are_where_they_are_at_the_tick() -> None:
    corners = np.tile(SOLES, (10, 1, 1, 1))
    corners[5:] += [10.0, -3.0]
    zmp = np.tile([1.0, 0.5], (20, 1))
    assert zmp_inside(recorded(sole_corners=corners, step_zmp=zmp)).tolist() == [True] * 10 + [False] * 10
    zmp[10:] += [10.0, -3.0]
    assert zmp_inside(recorded(sole_corners=corners, step_zmp=zmp)).all()


@given(seed=st.integers(0, 10**6))
def test_the_hull_is_convex_anticlockwise_and_holds_every_point(seed: int) -> None:
    points = np.random.default_rng(seed).uniform(-1, 1, (8, 2))
    hull = convex_polygon(points)
    edge = np.roll(hull, -1, axis=0) - hull
    following = np.roll(edge, -1, axis=0)
    assert (edge[:, 0] * following[:, 1] - edge[:, 1] * following[:, 0] > 0).all()
    assert (depth_in_hull(points, np.tile(hull, (8, 1, 1))) > -1e-9).all()
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
        "sole_corners": np.tile(SOLES, (ticks, 1, 1, 1)),
        "in_contact": np.ones((ticks, 2)),
        "foot_wrench": np.tile([0.0, 0.0, 50.0, 0.0, 0.0, 0.0], (ticks, 2, 1)),
        "torque": np.full((ticks, 4), -3.0),
        "torque_fraction": np.full((steps, 4), 0.25),
    }
    return series | changes


def summed(fell_at: float | None = None, **changes: Any) -> dict[str, Any]:
    return summarise(recorded(**changes), Outcome(fell_at, 5.0))


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
    assert (out["max_torque_fraction"], out["torque_step_max"]) == (0.25, 0.0)
    assert (out["qp_failures"], out["filtered_fraction"]) == (0, 0.0)
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
    assert summarise(series, Outcome(None, 1.0))["com_error_settled_max_m"] == 2.0


def test_foot_slide_is_horizontal_and_from_the_first_place() -> None:
    soles = np.zeros((10, 2, 3))
    soles[:, 1] += [1.0, 2.0, 0.0]
    soles[5:, 1, :2] += [0.003, 0.004]
    soles[:, 0, 2] = np.arange(10)
    assert summed(soles=soles)["foot_slide_max_m"] == pytest.approx(0.005)


def forces(left: list[float], right: list[float]) -> Array:
    wrench = np.zeros((10, 2, 6))
    wrench[:, 0, 2], wrench[:, 1, 2] = left, right
    return wrench


def test_a_step_is_no_slide() -> None:
    """The foot slides 3 mm before the step and 4 mm after it; the metre between is the step, from lift-off on."""
    soles = np.zeros((10, 2, 3))
    soles[1:, 0, 0], soles[3:, 0, 0], soles[8:, 0, 0] = 0.003, 1.0, 1.004
    contact = np.ones((10, 2))
    contact[2:5, 0] = 0
    loads = forces([50, 50, 30, 0, 0, 50, 50, 50, 50, 50], [50, 50, 70, 100, 100, 50, 50, 50, 50, 50])
    slide = foot_slide(recorded(soles=soles, in_contact=contact, foot_wrench=loads))
    np.testing.assert_allclose(slide[:, 0], [0, 0.003, *[np.nan] * 3, 0, 0, 0, 0.004, 0.004], atol=1e-12)
    np.testing.assert_array_equal(slide[:, 1], 0.0)
    assert summed(soles=soles, in_contact=contact, foot_wrench=loads)["foot_slide_max_m"] == pytest.approx(0.004)


def test_a_foot_slides_only_under_load_and_from_where_it_took_it_up() -> None:
    """Down by plan from tick 2 on, but in the air until tick 4; unloaded for a while in 6, and elsewhere after it."""
    soles = np.zeros((10, 2, 3))
    soles[:, 0, 1] = [0, 0, 0.1, 0.2, 0.3, 0.31, 0.9, 0.33, 0.33, 0.33]
    contact = np.ones((10, 2))
    contact[:2, 0] = 0
    left = [0, 0, 0, 9.9, 10.1, 50, 9.9, 50, 50, 50]
    loads = forces(left, [100.0 - f for f in left])
    slide = foot_slide(recorded(soles=soles, in_contact=contact, foot_wrench=loads))
    np.testing.assert_allclose(slide[:, 0], [*[np.nan] * 4, 0, 0.01, np.nan, 0.03, 0.03, 0.03], atol=1e-12)


def test_a_robot_in_the_air_does_not_slide() -> None:
    soles = np.cumsum(np.ones((10, 2, 3)), axis=0)
    assert summed(soles=soles, foot_wrench=np.zeros((10, 2, 6)))["foot_slide_max_m"] is None


def test_the_torque_s_step_is_between_ticks_and_a_share_of_the_limit() -> None:
    """Limits of 20 N m and 2 N m; within a tick the torque may do what it likes."""
    torque = np.tile([4.0, -1.0], (10, 1))
    torque[0] = 0.0
    torque[6:, 0], torque[3:, 1] = -6.0, -0.5
    fraction = np.full((20, 2), 0.9)
    fraction[1:-1:2] = np.abs(torque[1:]) / [20.0, 2.0]
    assert torque_step_max(recorded(torque=torque, torque_fraction=fraction)) == pytest.approx(0.5)
    torque[6:, 0] = 4.0
    fraction[1:-1:2] = np.abs(torque[1:]) / [20.0, 2.0]
    assert torque_step_max(recorded(torque=torque, torque_fraction=fraction)) == pytest.approx(0.25)
    assert torque_step_max(recorded(torque=torque[:2], torque_fraction=fraction[:4])) is None


def test_zmp_in_the_air_is_not_inside() -> None:
    zmp = np.tile([1.0, 0.5], (20, 1))
    zmp[:3], zmp[5] = np.nan, [3.0, 0.5]
    assert summed(step_zmp=zmp)["zmp_inside_fraction"] == 0.8
    assert summed(step_zmp=zmp)["zmp_inside_single_fraction"] is None


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
    """Fraction of steps in which any pair penetrates, over that of the reference motion."""
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


def guaranteed(condition: str = "issf", leg_pairs: int = 1, **changes: Any) -> dict[str, Any]:
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
    out = guaranteed()
    assert out["disturbance_max"] == 0.4
    assert out["disturbance_rms"] == pytest.approx(np.sqrt(np.mean(np.linspace(0.0, 0.4, 20) ** 2)))
    assert out["bound_m"] == pytest.approx(-2.0 * 0.4**2 / (4 * 5.0))
    gradient = np.full((20, 5), 0.9)
    gradient[:, 1], gradient[7, 1] = 0.1, 0.3
    assert guaranteed("cbf", gradient=gradient)["bound_m"] == pytest.approx(-0.3 * 0.4 / 5.0)
    assert (out["bound_running_min_m"], out["row_bound_min_m"]) == (-0.01, 0.004)


def test_margins_are_of_each_family_at_the_same_instant() -> None:
    bound = np.tile([-0.1, -0.2, -0.3, np.nan, -0.4], (20, 1))
    h = np.full((20, 3), 1.0)
    h[4, 1], h[5, 2] = -0.15, 0.1
    bound[9, 1] = 0.96  # nearer than the smallest h is to the smallest bound
    out = guaranteed(h_bound=bound, h_self_collision=h)
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
    assert guaranteed(h_bound=bound, h_self_collision=h)["bound_held"] is False


def test_the_bound_of_an_obstacle_is_no_guarantee() -> None:
    h = np.full(20, 0.1)
    h[11] = -0.03
    out = guaranteed(h_obstacle=h)
    assert out["margin_obstacle_m"] == pytest.approx(-0.02)
    assert out["bound_held"] is True


def test_steps_after_a_stop_do_not_count() -> None:
    disturbance, bound, row = np.full(20, 0.2), np.full((20, 5), -0.01), np.full(20, 0.004)
    h = np.full((20, 3), 0.1)
    disturbance[10:], bound[10:], row[10:], h[15:] = np.nan, np.nan, np.nan, -0.5
    out = guaranteed(disturbance=disturbance, h_bound=bound, h_row_bound=row, h_self_collision=h)
    assert (out["disturbance_max"], out["bound_held"], out["row_bound_min_m"]) == (0.2, True, 0.004)
    assert out["margin_self_collision_m"] == pytest.approx(0.11)


def test_where_nothing_is_guaranteed_only_the_disturbance_is_told() -> None:
    nothing = {"h_bound": np.full((20, 5), np.nan), "h_row_bound": np.full(20, np.nan)}
    free = guaranteed("none", **nothing)
    assert free.pop("disturbance_max") == 0.4
    assert free.pop("disturbance_rms") > 0
    assert set(free.values()) == {None}
    never_ran = guaranteed(disturbance=np.full(20, np.nan), **nothing)
    assert set(never_ran.values()) == {None}
    # only pairs of legs: no bound on those of arms
    assert guaranteed(leg_pairs=3)["bound_m"] is None


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
        assert filter_title(Recording(g1, {"filter": name}, {}, {})) == title
    assert filter_title(Recording(g1, {}, {}, {})) == g1.title
