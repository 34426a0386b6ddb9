"""The kinematic plant integrates what it says: screws exactly, and the discrete parabola."""

import numpy as np
import pinocchio as pin
import pytest

from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.loader import load_robot
from sims.kinematic import KinematicPlant


def kinematics(base: str) -> Kinematics:
    return Kinematics(load_robot("g1"), base=base)


@pytest.mark.parametrize("base", ["floating", "planar", "fixed"])
def test_a_constant_velocity_is_integrated_exactly_whatever_the_step(base: str) -> None:
    """On the group: the base moves along a screw, so many steps end where one does."""
    kin = kinematics(base)
    q0 = kin.posture()
    v = np.random.default_rng(0).normal(size=kin.nv)
    many, one = KinematicPlant(kin, q0), KinematicPlant(kin, q0)
    for _ in range(50):
        many.step(v, 0.02)
    one.step(v, 1.0)
    np.testing.assert_allclose(many.q, one.q, rtol=0, atol=1e-12)
    assert many.time == pytest.approx(1.0)


def test_a_free_flyer_follows_the_screw_of_its_twist() -> None:
    kin = kinematics("floating")
    q0 = kin.posture()
    twist = np.array([0.3, -0.2, 0.1, 0.5, 1.0, -0.7])
    plant = KinematicPlant(kin, q0)
    for _ in range(40):
        plant.step(np.concatenate([twist, np.zeros(kin.nv - 6)]), 0.05)
    expected = pin.XYZQUATToSE3(q0[:7]) * pin.exp6(pin.Motion(2.0 * twist))
    np.testing.assert_allclose(pin.XYZQUATToSE3(plant.q[:7]).homogeneous, expected.homogeneous, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(plant.q[7:], q0[7:])


def test_a_planar_base_drives_a_circle() -> None:
    """Forward at v and turning at w: radius v / w, on whichever side it turns to."""
    kin = kinematics("planar")
    plant = KinematicPlant(kin, kin.posture())
    command = np.zeros(kin.nv)
    command[0], command[2] = 0.6, 1.5
    for _ in range(100):
        plant.step(command, 0.01)
    np.testing.assert_allclose(plant.q[:2], 0.4 * np.array([np.sin(1.5), 1 - np.cos(1.5)]), rtol=0, atol=1e-12)
    np.testing.assert_allclose(plant.q[2:4], [np.cos(1.5), np.sin(1.5)], rtol=0, atol=1e-12)


def test_second_order_is_the_semi_implicit_parabola() -> None:
    """After n steps u dt^2 n (n + 1) / 2, ahead of the exact parabola by u t dt / 2."""
    kin = kinematics("fixed")
    q0, u, dt, n = kin.posture(), np.linspace(-2.0, 3.0, kin.nv), 0.01, 80
    plant = KinematicPlant(kin, q0, order=2)
    for _ in range(n):
        plant.step(u, dt)
    t = n * dt
    np.testing.assert_allclose(plant.v, u * t, rtol=0, atol=1e-12)
    np.testing.assert_allclose(plant.q - q0, 0.5 * u * t**2 + 0.5 * u * t * dt, rtol=0, atol=1e-12)


def test_second_order_coasts_without_acceleration() -> None:
    kin = kinematics("floating")
    plant = KinematicPlant(kin, kin.posture(), order=2)
    u = np.random.default_rng(1).normal(size=kin.nv)
    plant.step(u, 0.1)
    v = plant.v.copy()
    for _ in range(5):
        plant.step(np.zeros(kin.nv), 0.1)
    np.testing.assert_array_equal(plant.v, v)


def test_arrays_that_were_handed_in_or_out_stay(robot: RobotDescription) -> None:
    kin = Kinematics(robot, base="fixed")
    q0, command = kin.posture(), np.ones(kin.nv)
    plant = KinematicPlant(kin, q0)
    before = plant.q
    kept = before.copy()
    plant.step(command, 0.1)
    np.testing.assert_array_equal(before, kept)
    np.testing.assert_array_equal(q0, kept)
    command[:] = 7.0
    np.testing.assert_array_equal(plant.v, np.ones(kin.nv))


def test_bad_input_is_refused_by_name() -> None:
    kin = kinematics("fixed")
    q0 = kin.posture()
    with pytest.raises(ConfigError, match=r"order = 3: must be 1 \(velocity\) or 2"):
        KinematicPlant(kin, q0, order=3)
    with pytest.raises(ConfigError, match="q0"):
        KinematicPlant(kin, q0[:-1])
    plant = KinematicPlant(kin, q0)
    for dt in (0.0, -0.1, np.nan):
        with pytest.raises(ConfigError, match="dt"):
            plant.step(np.zeros(kin.nv), dt)
    with pytest.raises(ConfigError, match="command"):
        plant.step(np.full(kin.nv, np.nan), 0.1)
    np.testing.assert_array_equal(plant.q, q0)
