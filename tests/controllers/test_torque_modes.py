"""Torques told to the motors: the whole command, none, or gravity compensation that holds the robot up at rest."""

import dataclasses

import numpy as np
import pinocchio as pin
import pytest

from controllers.reference import reference_here
from controllers.whole_body.config import ControllerConfig
from controllers.whole_body.controller import WholeBodyController
from controllers.whole_body.feedforward import TORQUE_MODES, gravity_torque
from controllers.whole_body.robot_config import controller_config
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.messages import Array, Mask, RobotState
from robots.pinocchio_model import standing_configuration

STANCES = [np.array([True, True]), np.array([True, False]), np.array([False, True])]


def somewhere(robot: RobotDescription, seed: int) -> Kinematics:
    """Near the standing posture, in motion: gravity compensation is not to see the motion."""
    rng = np.random.default_rng(seed)
    kin = Kinematics(robot)
    q = kin.integrate(standing_configuration(robot), 0.1 * rng.standard_normal(kin.nv), 1.0)
    kin.update(q, rng.standard_normal(kin.nv))
    return kin


def contact_jacobian(kin: Kinematics, in_contact: Mask) -> Array:
    frames = [kin.frame_id(kin.robot.roles[r]) for r in ("left_sole", "right_sole")]
    rows = [kin.frame_jacobian(f, local=True) for f, on in zip(frames, in_contact, strict=True) if on]
    return np.concatenate([np.zeros((0, kin.nv)), *rows])


def half_sizes(robot: RobotDescription) -> Array:
    return np.array([[s.half_length, s.half_width] for s in robot.soles])


@pytest.mark.parametrize("in_contact", STANCES, ids=["both", "left", "right"])
def test_gravity_torques_hold_the_robot_at_rest(robot: RobotDescription, in_contact: Mask) -> None:
    """There are foot wrenches with which M 0 + g = S^T tau + J^T F, on standing feet only."""
    for seed in range(5):
        kin = somewhere(robot, seed)
        jacobian = contact_jacobian(kin, in_contact)
        torque = gravity_torque(kin, jacobian, half_sizes(robot)[in_contact])
        model = kin.model
        gravity = pin.rnea(model, model.createData(), kin.q, np.zeros(kin.nv), np.zeros(kin.nv))
        missing = gravity - np.concatenate([np.zeros(6), torque])
        wrench, *_ = np.linalg.lstsq(jacobian.T, missing, rcond=None)
        np.testing.assert_allclose(jacobian.T @ wrench, missing, atol=1e-7 * np.abs(gravity).max())


def test_gravity_torques_are_the_least_wrenches(robot: RobotDescription) -> None:
    """Of all foot wrenches that bear the weight, those with the least scaled norm: the KKT solution by another way."""
    kin = somewhere(robot, 1)
    both = STANCES[0]
    jacobian, sizes = contact_jacobian(kin, both), half_sizes(robot)
    torque = gravity_torque(kin, jacobian, sizes)
    model = kin.model
    gravity = pin.rnea(model, model.createData(), kin.q, np.zeros(kin.nv), np.zeros(kin.nv))
    weight = np.concatenate([[1.0, 1.0, 1.0, 1 / y**2, 1 / x**2, 1 / x**2] for x, y in sizes])
    base = jacobian[:, :6].T
    kkt = np.block([[np.diag(weight), base.T], [base, np.zeros((6, 6))]])
    wrench = np.linalg.solve(kkt, np.concatenate([np.zeros(12), gravity[:6]]))[:12]
    np.testing.assert_allclose(torque, gravity[6:] - jacobian[:, 6:].T @ wrench, atol=1e-6 * np.abs(gravity).max())


def test_in_the_air_each_joint_holds_its_links(robot: RobotDescription) -> None:
    """No foot bears anything: the joints' torques are those of a robot whose base is held."""
    kin = somewhere(robot, 2)
    none = np.array([False, False])
    torque = gravity_torque(kin, contact_jacobian(kin, none), half_sizes(robot)[none])
    model = kin.model
    gravity = pin.rnea(model, model.createData(), kin.q, np.zeros(kin.nv), np.zeros(kin.nv))
    np.testing.assert_allclose(torque, gravity[6:], atol=1e-9)


def test_the_mode_decides_the_command_and_nothing_else(robot: RobotDescription) -> None:
    """Set-points and gains are the same; the torque is that of DynWBC, none, or gravity compensation."""
    q = standing_configuration(robot)
    nj = len(robot.joints)
    state = RobotState(q, np.zeros(6 + nj), np.zeros(nj), 0.0)
    results = {}
    for mode in TORQUE_MODES:
        controller = WholeBodyController(robot, controller_config(robot, torque=mode), with_hands=False)
        controller.reset(state)
        reference = reference_here(controller.kin, with_hands=False)
        reference.in_contact = np.array([True, False])
        results[mode] = controller.tick(state, reference)
    full = results["full"]
    np.testing.assert_array_equal(full.command.tau, full.dynwbc.torque)
    assert not results["pd-only"].command.tau.any()
    kin = Kinematics(robot)
    kin.update(q, np.zeros(kin.nv))
    left = np.array([True, False])
    expected = gravity_torque(kin, contact_jacobian(kin, left), half_sizes(robot)[left])
    # the controller's soles are a little smaller than the real ones, which one foot alone does not show
    np.testing.assert_allclose(results["gravity"].command.tau, expected, rtol=1e-9, atol=1e-9)
    for mode in ("pd-only", "gravity"):
        for name in ("q", "v", "kp", "kd"):
            np.testing.assert_array_equal(getattr(results[mode].command, name), getattr(full.command, name))


def test_hardware_gets_the_whole_command_only() -> None:
    with pytest.raises(ConfigError, match="torque"):
        ControllerConfig(torque="half")
    for mode in ("pd-only", "gravity"):
        with pytest.raises(ConfigError, match="torque"):
            ControllerConfig(torque=mode, drives="hardware")
    assert dataclasses.replace(ControllerConfig(drives="hardware")).torque == "full"
