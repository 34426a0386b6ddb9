"""Episodes of the benchmarks on an integrator: what filters keep there, and what the scores say of them."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from controllers.policies.kinematic_agent import KinematicAgent
from experiments.running.benchmark_loop import (
    DT,
    FILTERS,
    HARD,
    NAIVE,
    BenchmarkEpisode,
    BenchmarkRig,
    Episode,
    rig_of,
    scores,
)
from experiments.scenarios.benchmark_case import load_cases
from robots.errors import ConfigError, UnknownNameError
from robots.kinematics import Kinematics
from robots.messages import Array
from safety.filters.safety_filter import FilterStatus

BOOK = load_cases()
FIXED = rig_of(BOOK, "G1FixedBase_D1_AG_SO_v0")


def without_obstacles(rig: BenchmarkRig) -> BenchmarkRig:
    return replace(rig, number=0)


def with_margin(rig: BenchmarkRig, margin: float) -> BenchmarkRig:
    return replace(rig, case=replace(rig.case, margin=margin))


@pytest.mark.parametrize("name", ["G1RightArm_D1_AG_SO_v0", "G1FixedBase_D1_AG_SO_v0", "G1MobileBase_D1_WG_SO_v0"])
def test_with_nothing_in_the_way_hands_and_base_come_to_their_goals(name: str) -> None:
    episode = BenchmarkEpisode(without_obstacles(rig_of(BOOK, name)), "none", 3).run(2000)
    goals = BOOK.case(name).goals
    assert episode.goals_reached == 1 and len(episode.series["hands"]) < 2000
    assert (episode.series["hands"][-1] <= goals.hand_size).all()
    assert not episode.series["base"][-1] > goals.base_size
    found = scores(BOOK.case(name), episode)
    assert found["success"] and found["success_paper"] and found["M_env"] == 1.0
    assert (found["J_base"] is None) == ("Mobile" not in name)


def test_the_commands_keep_the_benchmarks_bounds() -> None:
    episode = BenchmarkEpisode(FIXED, "cbf", 1)
    speeds: list[Array] = []
    send = episode.plant.send

    def watched(command: Array) -> None:
        speeds.append(np.abs(command))
        send(command)

    episode.plant.send = watched
    episode.run(60)
    fastest = np.max(speeds, axis=0)
    assert (fastest[:3] <= 0.1 + 1e-9).all() and (fastest[3:] <= 1.5 + 1e-9).all() and fastest.max() > 0.2


@pytest.mark.parametrize("name", ["cbf", "issf", "ssa", "pssa", "sss"])
def test_from_outside_the_margin_a_hard_filter_keeps_it(name: str) -> None:
    """Static obstacles, a scene that begins outside: h stays above the margin but for what one step may do."""
    rig = with_margin(FIXED, 0.02)
    kept = 0
    for seed in range(40):
        episode = BenchmarkEpisode(rig, name, seed)
        first = episode.run(150)
        if scores(rig.case, first)["starts_in_margin"] or (first.series["status"] == FilterStatus.RELAXED).any():
            continue
        kept += 1
        slack = 1e-3 if name in ("cbf", "issf") else 0.012
        assert first.series["h_obstacle"].min() > 0.02 - slack, seed
        assert first.series["h_self_collision"].min() > 0.01 - slack, seed
    assert kept >= 5


@pytest.mark.parametrize("name", [*HARD, "rssa", "pssa"])
def test_no_filter_lets_an_unsafe_nominal_velocity_through_but_the_naive_ones(name: str) -> None:
    for seed in range(6):
        found = scores(FIXED.case, BenchmarkEpisode(FIXED, name, seed).run(100))
        assert found["passed_unsafe"] == 0 and found["steps_in_collision"] == 0.0, seed
    if name in HARD:
        unsafe = [scores(FIXED.case, BenchmarkEpisode(FIXED, name + NAIVE, s).run(100)) for s in range(6)]
        assert sum(row["passed_unsafe"] or 0 for row in unsafe) > 0


def test_goals_ride_with_the_base() -> None:
    rig = without_obstacles(rig_of(BOOK, "G1MobileBase_D1_WG_SO_v0"))
    episode = BenchmarkEpisode(rig, "none", 5)
    goals = episode.policy.hand_goals.copy()
    done = episode.run(2000)
    assert np.linalg.norm(episode.plant.state().q[:2]) > 0.2
    np.testing.assert_array_equal(episode.policy.hand_goals, goals)
    assert (done.series["hands"][-1] < 0.05).all()


def test_goals_that_are_reached_come_anew_and_keep_off_obstacles() -> None:
    rig = rig_of(BOOK, "G1FixedBase_SO_V1")
    episode = BenchmarkEpisode(rig, "none", 2)
    before = episode.scene.hand_goals.copy()
    done = episode.run(1500)
    assert done.goals_reached >= 2 and len(done.series["hands"]) == 1500
    assert np.abs(episode.scene.hand_goals - before).max() > 0.01
    goals = episode.scene.hand_goals + np.array([0.0, 0.0, BOOK.robot.base_height])
    apart = np.linalg.norm(goals[:, None] - episode.motion.positions, axis=2)
    assert apart.min() >= rig.case.goals.hand_keep_out - 1e-12


def test_an_episode_is_the_same_again_and_filters_meet_the_same_scene() -> None:
    rig = rig_of(BOOK, "G1FixedBase_D1_AG_DO_v0")
    first, again = (BenchmarkEpisode(rig, "pssa", 4).run(80) for _ in range(2))
    for name in first.series:
        if name != "filter_ms":
            np.testing.assert_array_equal(first.series[name], again.series[name])
    other = BenchmarkEpisode(rig, "none", 4).run(1)
    np.testing.assert_array_equal(other.series["h_obstacle"][0], first.series["h_obstacle"][0])


def test_filters_are_told_the_velocity_of_obstacles_or_nothing() -> None:
    rig = rig_of(BOOK, "G1FixedBase_D1_AG_DO_v0")
    silent, told = (BenchmarkEpisode(rig, "ssa", 0, velocity) for velocity in ("none", "true"))
    for episode in (silent, told):
        episode.motion.step()
    assert not any(o.velocity.any() for o in silent.obstacles(0.0))
    np.testing.assert_allclose([o.velocity for o in told.obstacles(0.0)], told.motion.velocities)


@pytest.mark.parametrize("name", [name for name in FILTERS if name != "ecbf"])
def test_every_filter_runs_every_configuration(name: str) -> None:
    for case in ("G1RightArm_D1_AG_SO_v0", "G1FixedBase_D1_AG_DO_v0", "G1MobileBase_D1_WG_SO_v0", "G1FixedBase_DO_V1"):
        episode = BenchmarkEpisode(rig_of(BOOK, case), name, 1).run(5)
        found = scores(BOOK.case(case), episode)
        assert found["steps"] == 5 and 0.0 <= found["M_env"] <= 1.0
        assert (found["R_feas"] is None) == (name in ("none", "pfm", "sma"))


# --- moved by accelerations


SECOND = rig_of(BOOK, "G1FixedBase_D2_AG_SO_v0")


def test_by_accelerations_hands_come_to_their_goals_and_keep_the_bounds() -> None:
    episode = BenchmarkEpisode(without_obstacles(SECOND), "none", 3)
    done = episode.run(2000)
    assert done.goals_reached == 1 and np.abs(episode.plant.state().v).max() > 0.0
    assert done.series["hands"][-1].max() <= 0.05


@pytest.mark.parametrize("name", ["cbf", "ssa", "ecbf"])
def test_by_accelerations_a_hard_filter_keeps_its_margin_from_outside(name: str) -> None:
    rig, kept = with_margin(SECOND, 0.02), 0
    for seed in range(30):
        first = BenchmarkEpisode(rig, name, seed).run(150)
        if scores(rig.case, first)["starts_in_margin"] or (first.series["status"] == FilterStatus.RELAXED).any():
            continue
        kept += 1
        assert first.series["h_obstacle"].min() > 0.02 - 2e-3, seed
    assert kept >= 5


class OnlyVelocities:
    def velocity(self, kin: Kinematics) -> Array:
        return np.zeros(kin.nv)


def test_a_policy_without_accelerations_is_refused_by_a_filter_of_them() -> None:
    episode = BenchmarkEpisode(SECOND, "cbf", 0)
    with pytest.raises(ConfigError, match="OnlyVelocities"):
        KinematicAgent(episode.agent.kin, OnlyVelocities(), episode.barriers, episode.filter, DT, episode)


# --- scores, by hand


def episode_of(**changes: Any) -> Episode:
    series = {
        "hands": np.array([[0.2, 0.02], [0.04, 0.04]]),
        "base": np.full(2, np.nan),
        "h_obstacle": np.array([[0.15, 0.2], [0.08, 0.3]]),
        "h_self_collision": np.array([[0.05], [0.05]]),
        "violation": np.array([0.0, 0.1]),
        "status": np.array([0, 0]),
        "filter_ms": np.array([1.0, 3.0]),
    }
    return Episode(0, {**series, **changes}, int(changes.pop("goals", 1)) if "goals" in changes else 1)


def test_scores_are_the_papers_formulas() -> None:
    found = scores(FIXED.case, episode_of())
    # distances beyond the goals' size of 0.05 m: 0.15, and none
    assert found["J_arm"] == pytest.approx((np.exp(-(0.15**2) / 0.002) + 3.0) / 4.0)
    assert found["J"] == pytest.approx(np.mean(np.exp(-(np.array([0.2, 0.02, 0.04, 0.04]) ** 2) / 0.002)))
    # one pair is within the margin of 0.1 m, by 0.02 m
    assert found["M_env"] == pytest.approx(np.exp(-(0.02**2) / 0.0002)) and found["M_self"] == 1.0
    assert found["S"] == pytest.approx(found["M_env"])
    assert found["C"] == pytest.approx(np.exp(-(0.1**2) / 0.2)) and found["R_feas"] == 0.5
    assert found["steps_in_margin"] == 0.5 and found["steps_in_collision"] == 0.0
    assert found["success"] and found["success_paper"] and not found["starts_in_margin"]


def test_one_who_touched_has_not_succeeded_and_one_who_is_off_at_the_end_has_not_by_the_paper() -> None:
    touched = scores(FIXED.case, episode_of(h_obstacle=np.array([[0.15, -0.01], [0.2, 0.3]])))
    assert not touched["success"] and not touched["success_paper"] and touched["steps_in_collision"] == 0.5
    # the mean of both hands counts in the paper, each of them here
    uneven = scores(FIXED.case, episode_of(hands=np.array([[0.2, 0.2], [0.09, 0.0]])))
    assert uneven["success_paper"]
    off = scores(FIXED.case, episode_of(base=np.array([1.0, 0.5])))
    assert not off["success_paper"]
    assert off["J_base"] == pytest.approx((np.exp(-(0.9**2) / 0.05) + np.exp(-(0.4**2) / 0.05)) / 2.0)


def test_what_is_not_allowed_is_named() -> None:
    with pytest.raises(ConfigError, match="filter"):
        BenchmarkEpisode(FIXED, "pssa-naive", 0)
    with pytest.raises(ConfigError, match="velocity"):
        BenchmarkEpisode(FIXED, "pssa", 0, "guessed")
    with pytest.raises(ConfigError, match="counts"):
        rig_of(BOOK, "G1FixedBase_D1_AG_SO_v0", "mine")
    with pytest.raises(ConfigError, match="another one for velocities"):
        BenchmarkEpisode(FIXED, "ecbf", 0)
    with pytest.raises(ConfigError, match="walking"):
        rig_of(BOOK, "G1SportMode_D1_WG_SO_v1")
    with pytest.raises(UnknownNameError):
        rig_of(BOOK, "G1")
    with pytest.raises(ConfigError, match="steps"):
        BenchmarkEpisode(FIXED, "none", 0).run(0)
    assert rig_of(BOOK, "G1FixedBase_D1_AG_SO_v0", "paper").number == 10 and DT == 0.01
