"""Hand references that lead into the torso, or out of reach: what the filter keeps, 20 % heavier than the model."""

from functools import cache

import numpy as np
import pytest

from controllers.whole_body.robot_config import controller_config
from experiments.recording.recording import Recording
from experiments.running.run import run
from experiments.scenarios.hand_motions import arm_length
from experiments.scenarios.hand_tracking import HandTracking
from experiments.scenarios.options import FilterOptions, PlantOptions
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.pinocchio_model import standing_configuration

HEAVY = PlantOptions(mass_scale=1.2)
WITHOUT_FILTER = {"g1": -0.03, "tocabi": -0.05}
"""The hands enter the torso at least this far without a filter [m]."""


@cache
def circles(robot: str, name: str) -> Recording:
    """One full turn with a filter; without one, until the hands are past the deepest point."""
    duration = 4.0 if name == "none" else 5.5
    return run(HandTracking(robot=robot, duration=duration, plant=HEAVY, safety=FilterOptions(filter=name)))


def test_without_a_filter_the_hands_enter_the_torso(robot_name: str) -> None:
    result = circles(robot_name, "none")
    assert result.summary["min_h_self_collision_m"] <= WITHOUT_FILTER[robot_name]
    assert result.summary["collision_ratio"] > 0.9
    # as deep and at the same time as the reference asks, but for the tracking error
    series = result.series
    worst, asked = series["h_self_collision"].min(axis=1).argmin(), series["h_self_reference"].argmin()
    assert series["step_time"][worst] == pytest.approx(series["step_time"][asked], abs=0.1)
    assert series["h_self_collision"].min() == pytest.approx(series["h_self_reference"].min(), abs=0.01)


def test_with_issf_nothing_touches_though_the_robot_is_heavier_than_its_model(robot_name: str) -> None:
    summary = circles(robot_name, "issf").summary
    own = controller_config(load_robot(robot_name)).safety.self_collision
    assert (summary["alpha"], summary["epsilon"]) == (own.alpha, own.epsilon)
    assert summary["min_h_self_collision_m"] > 0
    assert summary["min_h_joint_limit_rad"] > 0
    assert summary["min_h_workspace_m"] > 0
    assert summary["collision_ratio"] == 0.0


@pytest.mark.parametrize("name", ["none", "issf"])
def test_the_robot_keeps_its_balance(robot_name: str, name: str) -> None:
    summary = circles(robot_name, name).summary
    assert not summary["fell"]
    assert summary["stop_cause"] is None
    assert summary["qp_failures"] == 0
    assert summary["com_error_settled_max_m"] < 0.02
    assert summary["foot_slide_max_m"] < 0.005
    assert summary["zmp_inside_fraction"] > 0.99
    assert summary["max_torque_fraction"] <= 1.0


def test_the_filter_acts_near_the_torso_and_nowhere_else(robot_name: str) -> None:
    """While the reference is well outside, the hands follow as closely as without a filter."""
    free, filtered = circles(robot_name, "none"), circles(robot_name, "issf")
    assert filtered.summary["filtered_fraction"] < 1.0
    tick = np.flatnonzero(free.series["time"] < 1.0)
    assert (filtered.series["filter_status"][tick] == 0).all()
    for hand in ("left_hand", "right_hand"):
        np.testing.assert_allclose(filtered.series[hand][tick], free.series[hand][tick], atol=1e-9)


def test_the_collision_ratio_is_what_its_definition_says(robot_name: str) -> None:
    """Fraction of steps in which any pair penetrates, over the fraction in the reference motion, step for step."""
    for name in ("none", "issf"):
        result = circles(robot_name, name)
        h, reference = result.series["h_self_collision"], result.series["h_self_reference"]
        assert len(h) == len(reference) == len(result.series["step_time"])
        now = sum(bool((row < 0).any()) for row in h) / len(h)
        asked = sum(bool(x < 0) for x in reference) / len(reference)
        assert result.summary["collision_ratio"] == pytest.approx(now / asked)


def test_the_reference_motion_is_the_same_whatever_the_filter(robot_name: str) -> None:
    free, filtered = (circles(robot_name, name).series["h_self_reference"] for name in ("none", "issf"))
    np.testing.assert_array_equal(free, filtered[: len(free)])
    assert free.min() < WITHOUT_FILTER[robot_name]


def test_targets_out_of_reach_leave_the_robot_upright(robot_name: str) -> None:
    result = run(HandTracking(robot=robot_name, duration=4.5, motion="beyond-reach", plant=HEAVY))
    summary, series = result.summary, result.series
    assert not summary["fell"]
    assert summary["stop_cause"] is None
    assert summary["qp_failures"] == 0
    assert summary["min_h_workspace_m"] > 0
    assert summary["foot_slide_max_m"] < 0.005
    assert summary["com_error_settled_max_m"] < 0.02
    # asked for at the end: 30 cm further from the shoulder than the arm is long, on either side
    kin = Kinematics(load_robot(robot_name))
    kin.update(standing_configuration(kin.robot, "hands_front"), np.zeros(kin.nv))
    for side in ("left", "right"):
        shoulder = kin.frame_placement(kin.frame_id(kin.robot.roles[f"{side}_shoulder"]))[1]
        distance = np.linalg.norm(series[f"{side}_hand_ref"][-1] - shoulder)
        assert distance == pytest.approx(arm_length(kin, side) + 0.3, abs=1e-9)


def test_the_arm_is_never_longer_than_its_bound(robot_name: str) -> None:
    kin = Kinematics(load_robot(robot_name))
    lower, upper = kin.robot.position_limits
    rng = np.random.default_rng(0)
    q = standing_configuration(kin.robot)
    for _ in range(300):
        q[7:] = rng.uniform(lower, upper)
        kin.update_geometry(q)
        for side in ("left", "right"):
            hand, shoulder = (
                kin.frame_placement(kin.frame_id(kin.robot.roles[f"{side}_{p}"]))[1] for p in ("hand", "shoulder")
            )
            assert np.linalg.norm(hand - shoulder) <= arm_length(kin, side) + 1e-12


def test_a_bad_measurement_stops_hand_tracking_too() -> None:
    result = run(HandTracking(duration=1.0, nan_at=0.2))
    assert result.summary["stop_cause"] == "measured position of left_hip_pitch_joint is nan"
    assert result.summary["duration_s"] == pytest.approx(0.7, abs=0.0021)
    assert len(result.series["h_self_reference"]) == len(result.series["step_time"])
