"""Side steps that would make the feet collide, 20 % heavier than the model: without and with the safety filter."""

import functools

import numpy as np
import pytest

from controllers.gaits.lateral_steps import lateral_step_tuning
from experiments.metrics.feet import feet_column, feet_metrics, steps_taken
from experiments.recording.recording import Recording
from experiments.running.run import prepare, run
from experiments.scenarios.lateral_steps import LateralSteps
from experiments.scenarios.options import FilterOptions, PlantOptions
from robots.errors import ConfigError, UnknownNameError
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array

DURATION = 4.4
"""Three touchdowns: the leading foot, the trailing one into it, the leading one again [s]."""

PENETRATION = {"g1": 0.02, "tocabi": 0.03}
"""By which the feet penetrate without a filter, at least: 3 cm in the paper, for TOCABI [m]."""


@functools.cache
def side_steps(robot: str, filter_name: str) -> Recording:
    return run(
        LateralSteps(
            robot=robot,
            duration=DURATION,
            plant=PlantOptions(mass_scale=1.2),
            safety=FilterOptions(filter=filter_name),
        )
    )


def trailing_touchdown(result: Recording) -> int:
    """The first tick of the second double support: the trailing foot is the right one."""
    down = np.diff(result.series["in_contact"][:, 1])
    return int(np.flatnonzero(down > 0)[0]) + 1


def tilt(result: Recording, tick: int, role: str) -> float:
    """Angle between a sole and the ground [rad]."""
    kin = Kinematics(result.robot)
    kin.update_geometry(result.series["q"][tick])
    rotation = kin.frame_placement(kin.frame_id(result.robot.roles[role]))[0]
    return float(np.arccos(min(rotation[2, 2], 1.0)))


def test_without_the_filter_the_feet_penetrate_each_other(robot_name: str) -> None:
    """And the robot goes on stepping: nothing but the distance tells."""
    summary = side_steps(robot_name, "none").summary
    assert not summary["fell"]
    assert summary["steps"] == 3
    assert summary["min_h_feet_m"] < -PENETRATION[robot_name]
    assert summary["feet_penetrate_fraction"] > 0.05


def test_with_the_filter_the_feet_stay_apart_and_the_robot_goes_on(robot_name: str) -> None:
    summary = side_steps(robot_name, "issf").summary
    assert not summary["fell"]
    assert summary["stop_cause"] is None
    assert summary["steps"] == 3
    assert summary["min_h_feet_m"] > 0
    assert summary["min_h_legs_m"] > 0
    assert summary["min_h_self_collision_m"] > 0
    assert summary["feet_penetrate_fraction"] == summary["legs_penetrate_fraction"] == 0
    assert summary["qp_failures"] == 0
    assert summary["relaxed_fraction"] == 0


def test_it_is_the_filter_that_keeps_the_feet_apart(robot_name: str) -> None:
    """To the end the foot is sent where the feet collide; it comes down beside, and the plan goes on from there."""
    result = side_steps(robot_name, "issf")
    series, down = result.series, trailing_touchdown(result)
    radii = sum(shape.radius for shape in result.robot.collisions if shape.name.endswith("_foot"))
    asked = abs(np.diff(series["soles_ref"][down - 1, :, 1]))[0]
    assert asked < radii - PENETRATION[robot_name]
    assert asked == pytest.approx(lateral_step_tuning(result.robot).apart, abs=0.02)
    came = abs(np.diff(series["soles"][down, :, 1]))[0]
    assert came > radii
    assert (series["filter_status"][down - 50 : down] == 1).all()
    np.testing.assert_allclose(series["soles_ref"][down, 1, :2], series["soles"][down, 1, :2], atol=0.005)


def test_feet_come_down_flat_and_do_not_slip(robot_name: str) -> None:
    """Dry friction in TOCABI's ankles leaves them some degrees from where they are told to be."""
    result = side_steps(robot_name, "issf")
    soles, down = result.series["soles"], trailing_touchdown(result)
    assert tilt(result, down - 1, "right_sole") < np.deg2rad({"g1": 1.0, "tocabi": 2.5}[robot_name])
    after = soles[down:, 1, :2]
    assert np.linalg.norm(after - after[0], axis=1).max() < 0.003
    before = soles[trailing_touchdown(result) - 300 : down, 0, :2]
    assert np.linalg.norm(before - before[0], axis=1).max() < 0.003


def test_the_figures_are_what_they_are_called() -> None:
    robot = load_robot("g1")
    pairs: Array = np.ones((4, len(robot.self_collision_pairs)))
    feet = feet_column(robot)
    assert set(robot.self_collision_pairs[feet]) == {"left_foot", "right_foot"}
    pairs[1, feet], pairs[2, feet - 1], pairs[3, 0] = -0.2, -0.3, -0.9
    contact: Array = np.array([[1, 1], [0, 1], [1, 1], [1, 0], [1, 0], [1, 1.0]])
    figures = feet_metrics(robot, {"h_self_collision": pairs, "in_contact": contact})
    assert figures == {
        "min_h_feet_m": -0.2,
        "min_h_legs_m": -0.3,
        "feet_penetrate_fraction": 0.25,
        "legs_penetrate_fraction": 0.5,
        "steps": 2,
    }
    assert steps_taken(contact[:2]) == 0


def test_bad_options_are_refused_before_anything_runs() -> None:
    with pytest.raises(ConfigError, match="duration"):
        prepare(LateralSteps(duration=-1.0))
    with pytest.raises(UnknownNameError, match="robot"):
        prepare(LateralSteps(robot="atlas"))
