"""Stances, the camera's path, footprints and plots of runs that lift their feet, on a made-up walk."""

import re
from pathlib import Path

import numpy as np
import pytest

from experiments.recording.gait_phases import intervals, stances, swings, walks, without_sway
from experiments.recording.recording import Recording
from experiments.reports.media import FOOTPRINTS, _at_swings, _key_ticks, camera_path, footprints
from experiments.reports.plots import balance, distances
from experiments.reports.report import write_report
from experiments.reports.verdicts import verdict
from robots.loader import load_robot
from robots.messages import Array
from robots.pinocchio_model import standing_configuration

TICKS, DT = 2000, 0.01
G1 = load_robot("g1")
SPEED, SWAY, PERIOD = 0.2, 0.05, 1.6
"""Of the made-up walk: forward [m/s]; amplitude [m] and period [s] of the swaying sideways."""


def walk(lifted: tuple[int, ...] = (0, 1), **summary: object) -> Recording:
    """20 s at 100 ticks/s, a plant step a tick: each period the left foot is up from 0.1 to 0.6 s, then the right."""
    time = DT * np.arange(TICKS)
    phase = time % PERIOD
    contact = np.ones((TICKS, 2))
    for foot in lifted:
        start = 0.1 + 0.8 * foot
        contact[(phase > start) & (phase < start + 0.5), foot] = 0.0
    q = np.tile(standing_configuration(G1), (TICKS, 1))
    q[:, 0], q[:, 1] = SPEED * time, SWAY * np.sin(2 * np.pi * time / PERIOD)
    soles = np.stack([np.column_stack([SPEED * PERIOD * np.floor(time / PERIOD), s * np.full(TICKS, 0.12), 0 * time])
                      for s in (1, -1)], axis=1)  # fmt: skip
    corners = np.array([[0.08, 0.03], [-0.08, 0.03], [-0.08, -0.03], [0.08, -0.03]])
    com = q[:, :3].copy()
    series = {
        "time": time, "step_time": time + DT, "q": q, "v": np.zeros((TICKS, 35)), "in_contact": contact,
        "soles": soles, "soles_ref": soles + np.array([0, 0, 0.001]), "sole_corners": soles[:, :, None, :2] + corners,
        "com": com, "com_ref": com + 0.001, "zmp": com[:, :2], "dcm_ref": com[:, :2], "support_polygon": corners,
        "foot_wrench": np.ones((TICKS, 2, 6)), "command": np.tile([SPEED, 0.0, 0.0], (TICKS, 1)),
        "h_self_collision": np.full((TICKS, len(G1.self_collision_pairs)), 0.1), "h_joint_limit": np.full(TICKS, 0.2),
        "h_workspace": np.full((TICKS, 2), 0.05), "h_obstacle": np.full(TICKS, np.inf),
        "filter_status": np.zeros(TICKS, int), "v_des": np.zeros((TICKS, 35)), "v_safe": np.zeros((TICKS, 35)),
        "torque": np.zeros((TICKS, 29)), "tick_ms": np.ones(TICKS),
    }  # fmt: skip
    return Recording(G1, {"robot": "g1", "filter": "issf"}, {"fell": False, "fell_at_s": None, **summary}, series)


WALK = walk()
ONE_LEG = walk(lifted=(1,))
STAND = walk(lifted=())


# --- stances


@pytest.mark.parametrize("seed", range(20))
def test_intervals_are_the_unbroken_runs(seed: int) -> None:
    flags = np.random.default_rng(seed).random(30) < 0.5
    found = intervals(flags)
    covered = np.zeros(30, dtype=bool)
    for first, last in found:
        assert flags[first : last + 1].all()
        assert first == 0 or not flags[first - 1]
        assert last == 29 or not flags[last + 1]
        covered[first : last + 1] = True
    np.testing.assert_array_equal(covered, flags)


def test_stances_and_swings_are_those_of_the_plan() -> None:
    contact = WALK.series["in_contact"]
    found = stances(WALK.series)
    assert [s.first for s in found] == sorted(s.first for s in found)
    for foot in (0, 1):
        own = [s for s in found if s.foot == foot]
        assert sum(s.last - s.first + 1 for s in own) == contact[:, foot].sum()
        for stance in own:
            assert contact[stance.first : stance.last + 1, foot].all()
    assert sum(last - first + 1 for first, last in swings(WALK.series)) == (contact.sum(axis=1) == 1).sum()
    assert [len(swings(r.series)) for r in (WALK, ONE_LEG, STAND)] == [25, 12, 0]
    assert [walks(r.series) for r in (WALK, ONE_LEG, STAND)] == [True, False, False]
    assert (stances({}), swings({}), walks({})) == ([], [], False)


def test_smoothing_keeps_a_straight_way_and_takes_the_sway() -> None:
    base, time = WALK.series["q"][:, :2], WALK.series["time"]
    smooth, inner = without_sway(base, time), slice(300, -300)
    np.testing.assert_allclose(smooth[inner, 0], base[inner, 0], rtol=0, atol=1e-9)
    # a Gaussian lets exp(-(2 pi s / T)^2 / 2) of an oscillation through
    left = SWAY * np.exp(-0.5 * (2 * np.pi * 0.6 / PERIOD) ** 2)
    assert np.abs(smooth[inner, 1]).max() == pytest.approx(left, rel=0.01)


# --- camera, key frames, footprints


def test_the_camera_follows_a_walk_without_jerks_and_keeps_still_otherwise() -> None:
    path, base = camera_path(WALK), WALK.series["q"][:, :2]
    assert np.linalg.norm(path - base, axis=1).max() < 0.15
    speed = np.abs(np.diff(path[:, 1])) / DT
    assert np.abs(np.diff(base[:, 1])).max() / DT > 0.19
    assert speed[300:-300].max() < 0.013
    assert speed.max() < 0.025  # at its ends the path is smoothed from one side only
    still = WALK.series["q"].copy()
    still[:, 0] = 0.0
    stood = Recording(G1, WALK.config, WALK.summary, {**WALK.series, "q": still})
    np.testing.assert_array_equal(camera_path(stood), np.tile(still[0, :2], (TICKS, 1)))


def test_pictures_of_a_walk_are_spread_over_it_and_show_swings() -> None:
    ticks = _key_ticks(WALK, 8)
    assert len(ticks) == 8
    np.testing.assert_allclose(ticks, np.linspace(0, TICKS - 1, 8), atol=0.5 * PERIOD / DT)
    middles = [(first + last) // 2 for first, last in swings(WALK.series)]
    assert set(ticks[1:-1]) <= set(middles)


def test_the_one_swing_goes_to_the_nearest_picture() -> None:
    assert _at_swings(np.array([1000, 2000]), [1700], 500).tolist() == [1000, 1700]
    assert _at_swings(np.array([1000, 2000]), [1700], 200).tolist() == [1000, 2000]
    assert _at_swings(np.array([10, 20, 30]), [18, 21, 500], 9).tolist() == [18, 21, 30]
    assert _at_swings(np.array([10, 20]), [], 5).tolist() == [10, 20]


def test_footprints_are_where_soles_have_stood() -> None:
    assert footprints(STAND, TICKS - 1) == []
    tick = 805  # the left sole has moved since the middle of its stance
    shown = footprints(WALK, tick)
    begun = [s for s in stances(WALK.series) if s.first <= tick]
    assert len(shown) == min(len(begun), FOOTPRINTS)
    sole = G1.soles[0]
    for shape, stance in zip(shown, begun[-FOOTPRINTS:], strict=True):
        assert shape.size[:2] == (sole.half_length, sole.half_width)
        assert 0 < shape.center[2] + shape.size[2] < 0.003
        corners = WALK.series["sole_corners"][tick, stance.foot] if stance.last > tick else stance.corners
        np.testing.assert_allclose(shape.center[:2], corners.mean(axis=0), atol=1e-12)
    assert len(footprints(WALK, TICKS - 1)) == FOOTPRINTS


# --- plots


def test_the_span_is_of_the_soles_on_the_ground() -> None:
    low, high = balance.sole_span(WALK.series)
    tick_left_up, tick_both = 30, 5
    for tick, y in ((tick_left_up, (-0.15, -0.09)), (tick_both, (-0.15, 0.15))):
        np.testing.assert_allclose([low[tick], high[tick]], [[-0.08, y[0]], [0.08, y[1]]], atol=1e-12)
    up: Array = np.zeros((TICKS, 2))
    low, high = balance.sole_span({**WALK.series, "in_contact": up})
    assert np.isnan(low).all()
    assert np.isnan(high).all()


@pytest.mark.parametrize("robot", ["g1", "tocabi"])
def test_the_pair_of_feet_is_found_by_the_soles(robot: str) -> None:
    made = load_robot(robot)
    (column,) = distances.feet_pairs(made)
    assert set(made.self_collision_pairs[column]) == {"left_foot", "right_foot"}


def test_plots_are_made_where_feet_are_lifted() -> None:
    png = b"\x89PNG"
    only_walks = (balance.velocity_plot, distances.feet_plot)
    lifting = (balance.balance_plot, balance.feet_plot)
    for plot in (*only_walks, *lifting, balance.plan_plot):
        both = plot([WALK, STAND])
        assert both is not None
        assert both.startswith(png)
    for plot in lifting:
        assert plot([ONE_LEG]) is not None
        assert plot([STAND]) is None
    for plot in only_walks:
        assert plot([ONE_LEG]) is None


def test_the_plan_of_a_run_that_fell_ends_with_the_fall() -> None:
    """What comes after it changes nothing in the picture."""
    fell = walk(fell_at_s=5.0)
    before = balance.plan_plot([fell])
    for name in ("com", "zmp"):
        fell.series[name][600:] += 3.0
    assert balance.plan_plot([fell]) == before
    fell.series["com"][300:] += 0.01
    assert balance.plan_plot([fell]) != before


# --- report


def test_a_walk_is_reported_with_its_own_sections(tmp_path: Path) -> None:
    page = write_report(tmp_path / "r.html", [WALK], "Walk").read_text(encoding="utf-8")
    assert re.findall(r"<h2>(.*?)</h2>", page) == [
        "Outcome", "Figures", "Distances", "Feet apart", "Limits", "Balance", "Balance over time", "Feet", "Velocity",
        "Centre of mass", "Filter", "Torques", "Computing time",
    ]  # fmt: skip


def test_the_verdict_tells_the_way_and_where_the_zmp_was() -> None:
    def told(result: Recording) -> tuple[bool, str]:
        return verdict(result)[-1]

    assert told(walk(distance_m=3.214, steps=17)) == (True, "walked 3.21 m in 17 steps")
    inside = walk(lifted=(1,), zmp_inside_single_fraction=1.0)
    assert told(inside) == (True, "the ZMP stayed within the standing sole all the time on one foot")
    outside = walk(lifted=(1,), zmp_inside_single_fraction=0.994)
    assert told(outside) == (False, "the ZMP left the standing sole for 0.6 % of the time on one foot")
    assert "ZMP" not in told(walk(zmp_inside_single_fraction=0.994))[1]
