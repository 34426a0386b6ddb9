"""Hands sent into the torso in one jump, or through each other, on robots that differ from their model in mass."""

from functools import cache

import pytest

from experiments.recording.recording import Recording
from experiments.running.run import run
from experiments.scenarios.hand_tracking import HandTracking
from experiments.scenarios.options import FilterOptions, PlantOptions
from experiments.studies.tuning_scenarios import torso_targets
from robots.loader import load_robot

BETWEEN = {"g1": (0.004, 0.03, 0.149), "tocabi": (-0.04, 0.03, 0.12)}
"""Places in the torso that parameters were not tuned with: between two of its collision bodies [m]."""

MASSES = (0.8, 1.0, 1.2)


@cache
def sent(robot: str, mass: float, target: tuple[float, float, float] | None) -> Recording:
    """Both hands to a place, or through each other where none is given."""
    plant = PlantOptions(mass_scale=mass)
    if target is None:
        return run(HandTracking(robot=robot, duration=4.0, motion="cross", plant=plant))
    return run(HandTracking(robot=robot, duration=4.0, motion="target", target=target, plant=plant))


@pytest.mark.parametrize("mass", MASSES)
@pytest.mark.parametrize("motion", ["target", "cross"])
def test_the_robot_keeps_out_of_itself(robot_name: str, motion: str, mass: float) -> None:
    result = sent(robot_name, mass, BETWEEN[robot_name] if motion == "target" else None)
    assert result.summary["min_h_self_collision_m"] > 0.001
    assert result.summary["min_h_joint_limit_rad"] > 0
    assert not result.summary["fell"]
    assert result.summary["stop_cause"] is None
    # the filter had to hold them back
    assert result.summary["filtered_fraction"] > 0.3


def test_without_a_filter_the_hands_enter(robot_name: str) -> None:
    options = HandTracking(
        robot=robot_name, duration=2.0, motion="target", target=BETWEEN[robot_name], safety=FilterOptions(filter="none")
    )
    assert run(options).summary["min_h_self_collision_m"] < -0.02


def test_targets_in_every_body_of_the_torso_leave_the_hands_outside(robot_name: str) -> None:
    for target in torso_targets(load_robot(robot_name)):
        assert sent(robot_name, 1.2, target).summary["min_h_self_collision_m"] > 0.001


def test_the_estimate_of_the_disturbance_makes_room() -> None:
    """With parameters too bold for the disturbance, epsilon that follows it keeps what a fixed one loses."""
    bold = {"alpha": 5.0, "epsilon": 4.0}
    least = []
    for adaptive in (False, True):
        options = HandTracking(
            duration=4.0,
            motion="target",
            target=BETWEEN["g1"],
            plant=PlantOptions(mass_scale=1.2),
            safety=FilterOptions(adaptive=adaptive, **bold),
        )
        least.append(run(options).summary["min_h_self_collision_m"])
    assert least[0] < 0
    assert least[1] > least[0] + 0.001
