"""A sphere passes through where the hands are, seen through noise and a Kalman filter; the robots are too heavy."""

from functools import cache

import pytest

from experiments.recording.recording import STOPPED, Recording
from experiments.running.run import run
from experiments.scenarios.hand_tracking import HandTracking
from experiments.scenarios.options import FilterOptions, PlantOptions


@cache
def passing(robot: str, name: str) -> Recording:
    return run(
        HandTracking(
            robot=robot,
            motion="hold",
            obstacle=True,
            duration=4.0,
            plant=PlantOptions(mass_scale=1.2),
            safety=FilterOptions(filter=name),
        )
    )


@pytest.mark.parametrize("robot_name", ["g1", "tocabi"])
def test_without_a_filter_the_sphere_enters_the_hand(robot_name: str) -> None:
    assert passing(robot_name, "none").summary["min_h_obstacle_m"] < -0.05


@pytest.mark.parametrize("robot_name", ["g1", "tocabi"])
def test_with_issf_the_robot_gives_way_and_stands(robot_name: str) -> None:
    summary = passing(robot_name, "issf").summary
    assert summary["min_h_obstacle_m"] > 0
    assert summary["min_h_self_collision_m"] > 0
    assert not summary["fell"]
    assert summary["stop_cause"] is None
    assert summary["qp_failures"] == 0
    assert summary["foot_slide_max_m"] < 0.005
    assert summary["com_error_settled_max_m"] < 0.02


def test_a_lost_obstacle_stops_the_robot() -> None:
    options = HandTracking(motion="hold", obstacle=True, obstacle_lost_at=0.3, duration=1.5)
    result = run(options)
    summary = result.summary
    assert "track of obstacle 0" in summary["stop_cause"]
    # the last measurement comes at 0.283 s, and a track may be 0.2 s old
    assert summary["stop_time_s"] == pytest.approx(0.484, abs=0.003)
    # the state is sound: the controller goes on, holds the posture and keeps balance
    assert not (result.series["filter_status"] == STOPPED).any()
    assert not summary["fell"]
    assert summary["foot_slide_max_m"] < 0.005
