"""The whole stack against the plant, standing: balance under mismatch, repeatable runs, controlled stops."""

from typing import Any

import numpy as np
import pytest

from experiments.recording.recording import STOPPED, Recording
from experiments.running.run import run
from experiments.scenarios.hand_tracking import HandTracking
from experiments.scenarios.options import PlantOptions
from experiments.scenarios.resolve import control_config
from experiments.scenarios.stand import Stand
from robots.loader import load_robot

TIMES = {"tick_ms", "stages"}
"""Series that tell how long something took on this machine."""


def stand(**options: Any) -> Recording:
    plant = {k: options.pop(k) for k in list(options) if k in PlantOptions.__dataclass_fields__}
    return run(Stand(plant=PlantOptions(**plant), **options))


def assert_same_run(a: Recording, b: Recording) -> None:
    """Bit for bit, apart from how long it took."""
    assert a.series.keys() == b.series.keys()
    for name in a.series.keys() - TIMES:
        np.testing.assert_array_equal(a.series[name], b.series[name], err_msg=name)
    for key in a.summary:
        if not key.startswith("tick_ms"):
            assert a.summary[key] == b.summary[key], key


@pytest.mark.parametrize("mass_scale", [0.9, 1.0, 1.2])
def test_the_robot_stands_whatever_its_mass(robot_name: str, mass_scale: float) -> None:
    """Feet stay, every QP has an answer, and the ground carries the true weight, which the controller does not know."""
    result = stand(robot=robot_name, duration=3.0, mass_scale=mass_scale)
    summary, series = result.summary, result.series
    assert not summary["fell"]
    assert summary["stop_cause"] is None
    assert summary["duration_s"] == pytest.approx(3.0)
    assert summary["com_error_settled_max_m"] < 0.02
    assert summary["foot_slide_max_m"] < 0.005
    assert summary["qp_failures"] == 0
    assert summary["zmp_inside_fraction"] > 0.99
    assert summary["min_h_self_collision_m"] > 0
    assert summary["min_h_joint_limit_rad"] > 0
    weight = 9.81 * mass_scale * load_robot(robot_name).total_mass
    late = series["time"] > 2.5
    assert series["foot_wrench"][late, :, 2].sum(axis=1).mean() == pytest.approx(weight, rel=1e-2)


def test_the_posture_is_taken_up_from_the_start(robot_name: str) -> None:
    """The first tick is at rest at time zero, and no motion starts with a jump."""
    series = stand(robot=robot_name, duration=0.2).series
    assert series["time"][0] == 0.0
    np.testing.assert_allclose(np.diff(series["time"]), 0.002, atol=1e-12)
    assert len(series["step_time"]) == 2 * len(series["time"])
    assert np.abs(series["v"][:10]).max() < 0.1
    assert np.linalg.norm(np.diff(series["com_ref"], axis=0), axis=1).max() < 1e-4


def test_a_run_is_decided_by_its_options(robot_name: str) -> None:
    """Noise included: the same seed gives the same run, another seed another one."""
    first, again, other = (stand(robot=robot_name, duration=0.4, noise_scale=1.0, seed=s) for s in (7, 7, 8))
    assert_same_run(first, again)
    assert (first.series["q"][-1] != other.series["q"][-1]).any()
    assert (first.series["v_des"][0] != other.series["v_des"][0]).any()


def test_without_noise_the_seed_decides_nothing() -> None:
    first, other = (stand(duration=0.2, seed=s) for s in (1, 2))
    np.testing.assert_array_equal(first.series["q"], other.series["q"])


def test_noise_delay_and_friction_do_not_bring_it_down(robot_name: str) -> None:
    result = stand(
        robot=robot_name,
        duration=2.0,
        noise_scale=1.0,
        actuator_delay=0.002,
        friction=0.5,
        joint_friction_scale=1.5,
        armature_scale=1.2,
        com_shift=(0.01, 0.01, 0.0),
    )
    assert not result.summary["fell"]
    assert result.summary["stop_cause"] is None
    assert result.summary["foot_slide_max_m"] < 0.005


@pytest.mark.parametrize("rate", [1000.0, 2000.0])
def test_faster_control_works_too(robot_name: str, rate: float) -> None:
    result = stand(robot=robot_name, duration=0.8, control_rate=rate, physics_dt=0.0005)
    assert not result.summary["fell"]
    assert result.summary["com_error_settled_max_m"] < 0.02
    assert len(result.series["time"]) == round(0.8 * rate)
    assert len(result.series["step_time"]) == 1600


def test_a_measurement_that_is_not_a_number_stops_the_robot(robot_name: str) -> None:
    """From that tick on nothing is computed and the motors hold; the cause names the joint, and the time is told."""
    result = stand(robot=robot_name, duration=1.5, nan_at=0.5)
    joint = load_robot(robot_name).joint_names[0]
    assert result.summary["stop_cause"] == f"measured position of {joint} is nan"
    assert result.summary["stop_time_s"] == pytest.approx(0.5, abs=0.0021)
    assert result.summary["duration_s"] == pytest.approx(1.0, abs=0.0021)
    assert result.summary["qp_failures"] == 0
    series = result.series
    for name in ("q", "v", "torque", "com", "foot_wrench"):
        assert np.isfinite(series[name]).all(), name
    after = np.flatnonzero(series["time"] >= 0.5 - 1e-9)
    assert np.isnan(series["v_safe"][after]).all()
    assert np.isfinite(series["v_safe"][: after[0]]).all()
    # half a second later the motors still hold: upright, within limits, nothing touching
    assert not result.summary["fell"]
    assert result.summary["min_h_joint_limit_rad"] > 0
    assert result.summary["min_h_self_collision_m"] > 0
    assert (series["filter_status"][after] == STOPPED).all()


def test_a_simulation_that_blows_up_ends_the_run_with_its_cause(robot_name: str) -> None:
    """Light links without rotor inertia, at too large a step, for gains that are made for the real ones."""
    result = stand(
        robot=robot_name, duration=1.0, control_rate=200.0, physics_dt=0.005, mass_scale=0.1, armature_scale=0.0
    )
    assert result.summary["stop_cause"] is not None
    assert "unstable" in result.summary["stop_cause"]
    assert 0 < result.summary["duration_s"] < 1.0
    assert np.isfinite(result.series["q"]).all()


def test_the_control_period_is_a_whole_number_of_physics_steps() -> None:
    robot = load_robot("g1")
    for rate, step in ((500.0, 0.001), (1000.0, 0.001), (2000.0, 0.0005), (200.0, 0.005), (10000.0, 0.0001)):
        options = Stand(control_rate=rate, plant=PlantOptions(physics_dt=step))
        assert control_config(robot, options).dt == pytest.approx(1 / rate)


def test_the_summary_says_what_ran() -> None:
    result = stand(duration=0.1, seed=3, mass_scale=1.1)
    head = {k: result.summary[k] for k in ("scenario", "robot", "filter", "mass_scale", "seed")}
    assert head == {"scenario": "stand", "robot": "g1", "filter": "issf", "mass_scale": 1.1, "seed": None}
    assert result.config["scenario"]["seed"] == 3
    assert result.config["plant"]["changes"]["mass_scale"] == 1.1
    assert HandTracking().duration != Stand().duration
