"""Whole runs on what the robot's own sensors tell: upright, safe, and known well enough, with a heavier robot."""

from typing import Literal

import numpy as np
import pytest

from experiments.recording.recording import Recording
from experiments.running.run import estimated_body, make_agent, prepare, run
from experiments.scenarios.hand_tracking import HandTracking
from experiments.scenarios.options import PlantOptions, SensingOptions
from experiments.scenarios.scenario import Scenario
from experiments.scenarios.stand import Stand
from experiments.scenarios.taichi import Taichi
from experiments.scenarios.walk import Walk
from robots.errors import ConfigError, WithoutEffectError
from sims.plant import MujocoPlant

HEAVY = PlantOptions(mass_scale=1.2)
ESTIMATED = SensingOptions(state="estimated", gyro_drift=0.003)


def assert_known(result: Recording, velocity: float = 0.02, force: float = 0.08) -> None:
    """No fall, no stop, and errors of the size that the estimator's page states."""
    summary = result.summary
    weight = 9.81 * result.robot.total_mass
    assert summary["fell"] is False and summary["stop_cause"] is None
    assert summary["base_velocity_error_m_s"] < velocity
    assert summary["tilt_error_rad"] < 5e-3
    assert summary["height_error_m"] < 5e-3
    assert summary["foot_force_error_n"] < force * weight
    assert summary["contact_agreement"] > 0.85


@pytest.mark.parametrize("robot", ["g1", "tocabi"])
def test_a_robot_walks_on_its_own_sensors(robot: str) -> None:
    result = run(Walk(robot=robot, duration=8.0, vx=0.2, plant=HEAVY, sensing=ESTIMATED))
    assert_known(result)
    assert result.summary["steps"] >= 6
    assert result.summary["min_h_self_collision_m"] > 0
    drift = np.linalg.norm(result.series["q_estimated"][:, :2] - result.series["q"][:, :2], axis=1)
    assert drift.max() < 0.03


def test_a_robot_stands_on_one_leg_on_its_own_sensors() -> None:
    """The foot that comes down is found by force, speed and plan together."""
    assert_known(run(Taichi(duration=29.0, plant=HEAVY, sensing=ESTIMATED)))


def test_hands_are_kept_out_of_the_torso_on_the_robots_own_sensors() -> None:
    result = run(HandTracking(duration=6.0, plant=HEAVY, sensing=ESTIMATED))
    assert_known(result)
    assert result.summary["min_h_self_collision_m"] > 0


@pytest.mark.parametrize("state", ["estimated-base", "estimated-forces"])
def test_a_part_of_the_estimate_is_told_beside_the_truth(state: Literal["estimated-base", "estimated-forces"]) -> None:
    """What the agent is told: the estimate of one half, the plant's own of the other."""
    prepared = prepare(Stand(duration=0.5, sensing=SensingOptions(state=state)))
    plant = MujocoPlant(prepared.robot, prepared.plant)
    body, begun = estimated_body(prepared, plant, lambda: np.array([True, True]))
    assert begun.contact is not None
    agent = make_agent(prepared)
    agent.reset(plant.true_state())
    for _ in range(50):
        told, true, estimate = body.state(), plant.true_state(), body.estimate
        assert estimate is not None and estimate.foot_forces is not None
        base, forces = (estimate, true) if state == "estimated-base" else (true, estimate)
        np.testing.assert_array_equal(told.q, base.q)
        np.testing.assert_array_equal(told.v, base.v)
        np.testing.assert_array_equal(told.foot_forces, forces.foot_forces)
        assert (told.contact is None) == (state == "estimated-base")
        body.send(agent.tick(true).command)
        body.advance(agent.dt)
        assert not np.array_equal(estimate.v, true.v)


def test_the_simple_filter_is_the_worse_one() -> None:
    errors = {}
    for name in ("invariant", "simple"):
        sensing = SensingOptions(state="estimated", estimator=name)
        result = run(Walk(duration=5.0, vx=0.2, sensing=sensing))
        errors[name] = result.summary["base_velocity_error_m_s"], result.summary["tilt_error_rad"]
    assert errors["invariant"] < errors["simple"]
    assert errors["invariant"][1] < errors["simple"][1]


def test_the_same_seed_gives_the_same_errors_and_another_one_others() -> None:
    def estimates(seed: int) -> Recording:
        return run(Stand(duration=0.3, seed=seed, sensing=ESTIMATED))

    first, again, other = estimates(3), estimates(3), estimates(4)
    np.testing.assert_array_equal(first.series["v_estimated"], again.series["v_estimated"])
    assert not np.array_equal(first.series["v_estimated"], other.series["v_estimated"])
    assert first.summary["seed"] == 3


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"sensing": SensingOptions(sensor_errors=2.0)}, "sensor_errors"),
        ({"sensing": SensingOptions(gyro_drift=0.01)}, "gyro_drift"),
        ({"sensing": SensingOptions(estimator="simple")}, "estimator"),
        ({"sensing": ESTIMATED, "plant": PlantOptions(noise_scale=1.0)}, "noise_scale"),
        ({"sensing": SensingOptions(state="estimated", sensor_errors=-1.0)}, "sensor_errors"),
        ({"sensing": SensingOptions(state="estimated", torque_constant=0.0)}, "torque_constant"),
        ({"sensing": SensingOptions(state="estimated", gyro_drift=np.nan)}, "gyro_drift"),
    ],
)
def test_an_option_that_is_not_allowed_or_has_no_effect_is_refused(changed: dict[str, object], named: str) -> None:
    scenario: Scenario = Walk(**changed)
    with pytest.raises((ConfigError, WithoutEffectError), match=named):
        run(scenario)
