"""A robot that is held and moved by torques: with a perfect model it does what it is told, otherwise it does not."""

import numpy as np
import pytest

from experiments.scenarios.benchmark_case import load_cases
from experiments.scenarios.benchmark_scene import START, benchmark_kinematics, benchmark_robot
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.mujoco_spec import PhysicalChanges
from sims.held_plant import HeldConfig, HeldPlant

BOOK = load_cases()
ROBOT = benchmark_robot(BOOK.robot)
SMOOTH = HeldConfig(changes=PhysicalChanges(joint_friction_scale=0.0))


def model(base: str) -> Kinematics:
    name = "G1FixedBase_D1_AG_SO_v0" if base == "fixed" else "G1MobileBase_D1_WG_SO_v0"
    return benchmark_kinematics(ROBOT, BOOK.case(name))


BASES = ("fixed", "planar")


@pytest.mark.parametrize("base", BASES)
def test_gravity_is_compensated_exactly_by_a_perfect_model(base: str) -> None:
    kin = model(base)
    plant = HeldPlant(kin, kin.posture(START), config=SMOOTH)
    plant.send(np.zeros(kin.nv))
    plant.advance(0.5)
    np.testing.assert_allclose(plant.state().q, kin.posture(START), atol=1e-12)
    assert plant.saturated == 0 and plant.time == pytest.approx(0.5)


@pytest.mark.parametrize("base", BASES)
def test_velocities_and_accelerations_come_out_as_asked_for(base: str) -> None:
    kin, rng = model(base), np.random.default_rng(1)
    velocity = 0.3 * rng.standard_normal(kin.nv)
    # without the motors' own feedback, whose set-points stand for a period, only the law is left
    law = HeldConfig(gain_scale=0.0, changes=SMOOTH.changes)
    plant = HeldPlant(kin, kin.posture(START), config=law)
    plant.send(velocity)
    for periods in (25, 125):
        plant.advance((periods - round(plant.time / law.period)) * law.period)
        # each period takes its part of what is lacking at its begin
        lack = velocity * (1.0 - law.stiffness * law.period) ** periods
        np.testing.assert_allclose(velocity - plant.state().v, lack, atol=2e-3)
    acceleration = 0.5 * rng.standard_normal(kin.nv)
    second = HeldPlant(kin, kin.posture(START), 2, law)
    for _ in range(20):
        second.send(acceleration)
        second.advance(0.01)
    np.testing.assert_allclose(second.state().v, 0.2 * acceleration, atol=2e-3)


@pytest.mark.parametrize("base", BASES)
def test_motors_add_their_feedback_to_the_law(base: str) -> None:
    """What is asked for is passed by a little: motors push towards where the joint is to be at the period's end."""
    kin = model(base)
    velocity = 0.3 * np.random.default_rng(1).standard_normal(kin.nv)
    passed_by = []
    for gain in (0.0, 1.0):
        plant = HeldPlant(kin, kin.posture(START), config=HeldConfig(gain_scale=gain, changes=SMOOTH.changes))
        plant.send(velocity)
        plant.advance(0.2)
        passed_by.append(float(np.mean((plant.state().v - velocity) * np.sign(velocity))))
    assert abs(passed_by[0]) < 5e-4 and 2e-3 < passed_by[1] < 1e-2


def test_the_place_is_the_integral_of_the_velocity_and_the_base_turns_as_it_should() -> None:
    kin = model("planar")
    plant = HeldPlant(kin, kin.posture(START), config=SMOOTH)
    command = np.zeros(kin.nv)
    command[:3] = 0.2, 0.1, 0.5
    q = plant.state().q
    plant.send(command)
    for _ in range(500):
        before = plant.state().v
        plant.advance(0.002)
        q = kin.integrate(q, 0.5 * (before + plant.state().v), 0.002)
    # a physics step moves with the velocity at its end
    np.testing.assert_allclose(plant.state().q, q, atol=5e-4)
    assert np.hypot(*plant.state().q[2:4]) == pytest.approx(1.0)


def test_joints_that_are_not_moved_are_held() -> None:
    kin = model("fixed")
    plant = HeldPlant(kin, kin.posture(START), config=HeldConfig(changes=PhysicalChanges(mass_scale=1.2)))
    plant.send(0.5 * np.random.default_rng(2).standard_normal(kin.nv))
    plant.advance(0.5)
    legs = np.setdiff1d(np.arange(len(ROBOT.joints)), kin.joint_indices)
    moved = plant.data.qpos[legs] - kin.full_configuration(kin.posture(START))[7:][legs]
    assert np.abs(moved).max() < 0.05


def test_a_wrong_model_and_friction_are_disturbances_and_motors_have_limits() -> None:
    kin = model("fixed")
    command = 0.3 * np.random.default_rng(1).standard_normal(kin.nv)
    errors = []
    for config in (SMOOTH, HeldConfig(), HeldConfig(changes=PhysicalChanges(mass_scale=1.2))):
        plant = HeldPlant(kin, kin.posture(START), config=config)
        plant.send(command)
        plant.advance(0.3)
        errors.append(np.abs(plant.state().v - command).max())
    assert errors[0] < errors[1] and errors[0] < errors[2]
    strong = HeldPlant(kin, kin.posture(START), config=SMOOTH)
    strong.send(np.full(kin.nv, 500.0))
    strong.advance(0.01)
    assert strong.saturated > 0
    assert np.all(np.abs(strong.state().tau) <= ROBOT.joint_array("effort") + 1e-9)


def test_what_cannot_be_held_or_done_is_refused() -> None:
    kin = model("fixed")
    with pytest.raises(ConfigError, match="order = 3"):
        HeldPlant(kin, kin.posture(START), 3)
    with pytest.raises(ConfigError, match="q0 = "):
        HeldPlant(kin, np.full(kin.nq, np.nan))
    floating = Kinematics(ROBOT)
    with pytest.raises(ConfigError, match="base = 'floating'"):
        HeldPlant(floating, floating.posture("standing"))
    plant = HeldPlant(kin, kin.posture(START))
    with pytest.raises(ConfigError, match="command = "):
        plant.send(np.zeros(3))
    with pytest.raises(ConfigError, match=r"dt = 0\.003"):
        plant.advance(0.003)
    with pytest.raises(ConfigError, match=r"period = 0\.0015"):
        HeldConfig(period=0.0015)
    with pytest.raises(ConfigError, match="gain_scale"):
        HeldConfig(gain_scale=-1.0)
    with pytest.raises(ConfigError, match="stiffness"):
        HeldConfig(stiffness=0.0)
