"""TAICHI in closed loop, with a shortened sequence: one leg bears the robot, and the hands stay within reach."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from experiments.recording.recording import Recording
from experiments.running.run import prepare, run
from experiments.scenarios.hand_motions import arm_length
from experiments.scenarios.one_leg import ARM, hand_targets, one_leg_metrics
from experiments.scenarios.options import PlantOptions
from experiments.scenarios.taichi import Taichi
from robots.description import RobotDescription
from robots.errors import ConfigError, DescriptionError
from robots.kinematics import Kinematics
from robots.loader import load_robot

SHORT = {"shift_time": 2.5, "lift_time": 0.8, "hold_time": 0.5, "lower_time": 1.2, "return_time": 2.0}
DATA = Path(__file__).parents[2] / "robots" / "data"


def with_tuning(robot: str, folder: Path, **tuning: float) -> str:
    """A description with a table [tuning.taichi] of its own."""
    lines = [(DATA / f"{robot}.toml").read_text(), "[tuning.taichi]", *(f"{k} = {v}" for k, v in tuning.items())]
    path = folder / f"{robot}.toml"
    path.write_text("\n".join(lines) + "\n")
    return str(path)


@pytest.fixture(scope="module")
def heavy_run(robot_name: str, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """A fifth heavier than the model, on slippery ground."""
    description = with_tuning(robot_name, tmp_path_factory.mktemp("taichi"), **SHORT)
    plant = PlantOptions(mass_scale=1.2, friction=0.5)
    return run(Taichi(robot=description, duration=7.2, plant=plant))


def test_the_foot_goes_up_and_comes_down_again(heavy_run: Recording) -> None:
    """Up for at least the time held, down in the end, and both feet share the weight again."""
    summary = heavy_run.summary
    assert not summary["fell"]
    assert summary["stop_cause"] is None
    assert summary["foot_up_s"] >= SHORT["hold_time"]
    assert 0.4 < summary["right_load_end"] < 0.6
    assert summary["qp_failures"] == 0
    np.testing.assert_allclose(heavy_run.series["in_contact"][[0, -1]], 1.0)
    # what can be run again from its configuration alone
    assert {name: heavy_run.config["taichi"][name] for name in SHORT} == SHORT


def test_the_zmp_stays_in_the_sole_all_the_time(heavy_run: Recording) -> None:
    """And the foot in the air bears nothing, by measured force, until it is put down."""
    series = heavy_run.series
    assert heavy_run.summary["zmp_inside_single_fraction"] == 1.0
    assert heavy_run.summary["zmp_inside_fraction"] == 1.0
    up = series["soles"][:, 1, 2] > 0.02
    assert (series["foot_wrench"][up, 1, 2] == 0.0).all()
    assert (series["in_contact"][up] == [1.0, 0.0]).all()


def test_hands_stay_within_reach_though_the_target_is_not(heavy_run: Recording) -> None:
    series, robot = heavy_run.series, heavy_run.robot
    assert heavy_run.summary["min_h_workspace_m"] >= 0.0
    away = np.linalg.norm(series["right_hand"] - series["right_hand_ref"], axis=1)
    assert away.max() > 0.1
    assert heavy_run.summary["min_h_joint_limit_rad"] > 0
    assert heavy_run.summary["min_h_self_collision_m"] > 0
    assert len(robot.workspace) == 2


def test_balance_is_not_given_up_for_the_hands(heavy_run: Recording) -> None:
    """A hand that pulls outwards all the time draws the CoM by less than a tenth of a narrow sole's width."""
    series = heavy_run.series
    away = series["com"][:, :2] - series["com_ref"][:, :2]
    assert np.linalg.norm(away, axis=1).max() < 0.005


def test_torques_change_smoothly(heavy_run: Recording) -> None:
    """Lift-off and touchdown included: no joint's torque jumps by a tenth of its limit from one tick to the next."""
    assert heavy_run.summary["torque_step_max"] < 0.1


def test_without_feed_forward_torques_it_falls(robot_name: str) -> None:
    """The paper's ablation: joint PD about the safe velocity holds nobody up."""
    result = run(Taichi(robot=robot_name, duration=4.0, torque="pd-only"))
    assert result.summary["fell"]
    assert result.series["in_contact"].all()


def test_what_is_not_allowed_is_named_before_anything_runs(tmp_path: Path) -> None:
    for field, value in (("torque", "none"), ("push", ("60;left;3",)), ("push", ("60,up,3",))):
        with pytest.raises(ConfigError, match=field):
            prepare(dataclasses.replace(Taichi(), **{field: value}))
    with pytest.raises(DescriptionError, match="shift"):
        prepare(Taichi(robot=with_tuning("g1", tmp_path, shift=1.0)))
    with pytest.raises(ConfigError, match="lift_time"):
        prepare(Taichi(robot=with_tuning("g1", tmp_path, lift_time=0.0)))


def test_ways_of_the_hands_are_the_papers_on_its_robot(robot: RobotDescription) -> None:
    """60 cm up and out, 30 cm down and out on TOCABI; in proportion to the arm on others."""
    assert ARM == pytest.approx(arm_length(Kinematics(load_robot("tocabi")), "left"), abs=1e-4)
    left, right = hand_targets(robot, np.zeros(3), np.ones(3))
    fraction = arm_length(Kinematics(robot), "left") / ARM
    np.testing.assert_allclose(left, fraction * np.array([0.0, 0.6, 0.6]), atol=1e-9)
    np.testing.assert_allclose(right - 1.0, fraction * np.array([0.0, -0.3, -0.3]), atol=1e-9)


def test_the_foot_counts_as_up_from_ten_centimetres(robot: RobotDescription) -> None:
    time = 0.01 * np.arange(100)
    soles = np.zeros((100, 2, 3))
    soles[:, 1, 2] = 0.3
    soles[20:50, 1, 2] += 0.11
    soles[50:60, 1, 2] += 0.09
    wrench = np.zeros((100, 2, 6))
    wrench[-1, :, 2] = [300.0, 100.0]
    figures = one_leg_metrics({"time": time, "soles": soles, "foot_wrench": wrench})
    assert figures == {"foot_up_s": pytest.approx(0.3), "right_load_end": 0.25}
    wrench[-1] = 0.0
    assert one_leg_metrics({"time": time, "soles": soles, "foot_wrench": wrench})["right_load_end"] == 0.0
