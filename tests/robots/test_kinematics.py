"""The quantities of one tick: views into pinocchio's memory, Jacobians against differences."""

import numpy as np
import pinocchio as pin
import pytest

from robots.errors import DescriptionError, UnknownNameError
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array
from robots.pinocchio_model import standing_configuration
from tests.support.states import random_state
from tests.support.velocities import frame_velocity

STEP = 1e-6
VIEWS = ("mass_matrix", "bias", "world_jacobian", "joint_transforms", "com", "com_velocity", "com_jacobian")


@pytest.fixture(params=["g1", "tocabi"])
def kin(request: pytest.FixtureRequest) -> Kinematics:
    """At a random state, after an update at another one."""
    kinematics = Kinematics(load_robot(request.param))
    kinematics.update(*random_state(kinematics, 1))
    kinematics.update(*random_state(kinematics, 2))
    return kinematics


def shifted(kin: Kinematics, direction: Array, step: float) -> Kinematics:
    """A second work space, moved from the state of ``kin`` along ``direction`` (nv,)."""
    other = Kinematics(kin.robot)
    other.update(pin.integrate(kin.model, kin.q, direction * step), kin.v)
    return other


def test_joint_transforms_are_pinocchios_placements(kin: Kinematics) -> None:
    for seed in (2, 3):
        kin.update_geometry(random_state(kin, seed)[0])
        assert kin.joint_transforms.shape == (kin.model.njoints, 12)
        for row, placement in zip(kin.joint_transforms, kin.data.oMi, strict=True):
            assert np.array_equal(row[:9].reshape(3, 3, order="F"), placement.rotation)
            assert np.array_equal(row[9:], placement.translation)


def test_every_view_follows_the_last_update(kin: Kinematics) -> None:
    data = kin.model.createData()
    mass = pin.crba(kin.model, data, kin.q)
    mass = np.triu(mass) + np.triu(mass, 1).T
    np.testing.assert_allclose(kin.mass_matrix, mass, rtol=0, atol=1e-12 * abs(mass).max())
    bias = pin.rnea(kin.model, data, kin.q, kin.v, np.zeros(kin.nv))
    np.testing.assert_allclose(kin.bias, bias, rtol=0, atol=1e-12 * abs(bias).max())
    np.testing.assert_allclose(kin.world_jacobian, pin.computeJointJacobians(kin.model, data, kin.q), atol=1e-13)
    np.testing.assert_allclose(kin.com, pin.centerOfMass(kin.model, data, kin.q), rtol=0, atol=1e-13)
    np.testing.assert_allclose(kin.com_jacobian, pin.jacobianCenterOfMass(kin.model, data, kin.q), rtol=0, atol=1e-13)
    pin.framesForwardKinematics(kin.model, data, kin.q)
    for i, placement in enumerate(data.oMf):
        np.testing.assert_allclose(kin.frame_placement(i)[0], placement.rotation, rtol=0, atol=1e-13)
        np.testing.assert_allclose(kin.frame_placement(i)[1], placement.translation, rtol=0, atol=1e-13)


def test_mass_matrix_is_symmetric_and_positive_definite(kin: Kinematics) -> None:
    np.testing.assert_allclose(kin.mass_matrix, kin.mass_matrix.T, rtol=0, atol=1e-12)
    assert np.linalg.eigvalsh(kin.mass_matrix)[0] > 0


def test_views_outlive_the_work_space_they_come_from(kin: Kinematics) -> None:
    other = shifted(kin, kin.v, 0.0)
    views = [getattr(other, n) for n in VIEWS] + [x for i in range(kin.model.nframes) for x in other.frame_placement(i)]
    copies = [view.copy() for view in views]
    del other
    for _ in range(5):
        Kinematics(kin.robot).update(np.full(kin.nq, 0.5), np.ones(kin.nv))
    for view, copy in zip(views, copies, strict=True):
        assert np.array_equal(view, copy)


def test_state_is_copied(kin: Kinematics) -> None:
    q, v = random_state(kin, 4)
    kin.update(q, v)
    q += 1.0
    v += 1.0
    expected = random_state(kin, 4)
    assert np.array_equal(kin.q, expected[0])
    assert np.array_equal(kin.v, expected[1])


def test_update_geometry_gives_the_same_places_and_jacobians(kin: Kinematics) -> None:
    other = Kinematics(kin.robot)
    other.update_geometry(kin.q)
    np.testing.assert_allclose(other.joint_transforms, kin.joint_transforms, rtol=0, atol=1e-13)
    np.testing.assert_allclose(other.world_jacobian, kin.world_jacobian, rtol=0, atol=1e-13)
    for frame in kin.robot.frames:
        i = kin.frame_id(frame.name)
        np.testing.assert_allclose(other.frame_jacobian(i), kin.frame_jacobian(i), rtol=0, atol=1e-13)
        np.testing.assert_allclose(other.frame_placement(i)[1], kin.frame_placement(i)[1], rtol=0, atol=1e-13)


def test_frame_jacobians_are_the_derivatives_of_the_poses(kin: Kinematics) -> None:
    for k in range(kin.nv):
        direction = np.eye(kin.nv)[k]
        ahead, behind = shifted(kin, direction, STEP), shifted(kin, direction, -STEP)
        for role in ("left_hand", "right_sole", "torso", "imu"):
            i = kin.frame_id(kin.robot.roles[role])
            (r_ahead, p_ahead), (r_behind, p_behind) = ahead.frame_placement(i), behind.frame_placement(i)
            column = np.concatenate([p_ahead - p_behind, pin.log3(r_ahead @ r_behind.T)]) / (2 * STEP)
            np.testing.assert_allclose(kin.frame_jacobian(i)[:, k], column, rtol=0, atol=1e-8)


def test_com_velocity_is_the_derivative_of_the_com(kin: Kinematics) -> None:
    difference = (shifted(kin, kin.v, STEP).com - shifted(kin, kin.v, -STEP).com) / (2 * STEP)
    np.testing.assert_allclose(kin.com_velocity, difference, rtol=0, atol=1e-8)
    np.testing.assert_allclose(kin.com_velocity, kin.com_jacobian @ kin.v, rtol=0, atol=1e-12)


def test_drifts_are_the_rates_of_velocities_at_constant_rates(kin: Kinematics) -> None:
    """Central differences of CoM and frame velocities along v, whose components are kept."""
    kin.update_bias_acceleration()
    ends = [Kinematics(kin.robot), Kinematics(kin.robot)]
    for other, step in zip(ends, (-STEP, STEP), strict=True):
        other.update(kin.integrate(kin.q, kin.v, step), kin.v)
    difference = (ends[1].com_velocity - ends[0].com_velocity) / (2 * STEP)
    np.testing.assert_allclose(kin.com_bias_acceleration, difference, rtol=0, atol=1e-7)
    assert np.linalg.norm(difference) > 0.1
    for role in ("left_sole", "right_sole", "left_hand", "torso", "base"):
        i = kin.frame_id(kin.robot.roles[role])
        difference = (frame_velocity(ends[1], i) - frame_velocity(ends[0], i)) / (2 * STEP)
        np.testing.assert_allclose(kin.frame_bias_acceleration(i), difference, rtol=0, atol=1e-6)


def test_drifts_vanish_at_rest_and_follow_the_last_update(kin: Kinematics) -> None:
    kin.update_bias_acceleration()
    moving = kin.com_bias_acceleration.copy()
    kin.update(kin.q, np.zeros(kin.nv))
    kin.update_bias_acceleration()
    np.testing.assert_allclose(kin.com_bias_acceleration, 0.0, rtol=0, atol=1e-12)
    np.testing.assert_allclose(kin.frame_bias_acceleration(kin.frame_id("torso")), 0.0, rtol=0, atol=1e-12)
    kin.update(*random_state(kin, 2))
    kin.update_bias_acceleration()
    np.testing.assert_allclose(kin.com_bias_acceleration, moving, rtol=0, atol=1e-12)


def test_drifts_leave_everything_else_as_it_was(kin: Kinematics) -> None:
    """Above all the rows of second order, which come later in a tick."""
    kin.update_second_order()
    names = (*VIEWS, "joint_velocities", "joint_accelerations")
    before = [getattr(kin, name).copy() for name in names]
    kin.update_bias_acceleration()
    kin.update_second_order()
    for name, value in zip(names, before, strict=True):
        np.testing.assert_allclose(getattr(kin, name), value, rtol=0, atol=1e-11, err_msg=name)


def test_bias_at_rest_is_the_gradient_of_potential_energy(kin: Kinematics) -> None:
    kin.update(kin.q, np.zeros(kin.nv))
    gradient = np.empty(kin.nv)
    for k in range(kin.nv):
        direction = np.eye(kin.nv)[k]
        rise = shifted(kin, direction, STEP).com[2] - shifted(kin, direction, -STEP).com[2]
        gradient[k] = kin.robot.total_mass * 9.81 * rise / (2 * STEP)
    np.testing.assert_allclose(kin.bias, gradient, rtol=0, atol=1e-5)


def test_support_mask_picks_the_columns_that_move_a_joint(kin: Kinematics) -> None:
    """Masked world Jacobian = pinocchio's own; every kept column does move the joint's frame."""
    assert not kin.support[0].any()
    for i in range(1, kin.model.njoints):
        masked = kin.world_jacobian * kin.support[i]
        own = pin.getJointJacobian(kin.model, kin.data, i, pin.ReferenceFrame.WORLD)
        np.testing.assert_allclose(masked, own, rtol=0, atol=1e-13)
        assert np.array_equal(abs(own).max(axis=0) > 0, kin.support[i] == 1.0)


def test_world_jacobian_moves_any_point_of_a_body(kin: Kinematics) -> None:
    """Velocity of a point p: that at the world's origin plus omega x p."""
    for frame in kin.robot.frames:
        i = kin.frame_id(frame.name)
        at_origin = (kin.world_jacobian * kin.support[kin.frame_joint(i)]) @ kin.v
        linear, omega = at_origin[:3], at_origin[3:]
        velocity = np.concatenate([linear + np.cross(omega, kin.frame_placement(i)[1]), omega])
        np.testing.assert_allclose(frame_velocity(kin, i), velocity, rtol=0, atol=1e-11)
        np.testing.assert_allclose(frame_velocity(kin, i), kin.frame_jacobian(i) @ kin.v, rtol=0, atol=1e-11)


def test_integrate_keeps_a_unit_quaternion_and_undoes_itself(kin: Kinematics) -> None:
    moved = kin.integrate(kin.q, kin.v, 0.5)
    assert abs(np.linalg.norm(moved[3:7]) - 1) < 1e-12
    back = kin.integrate(moved, kin.v, -0.5)
    np.testing.assert_allclose(back * np.sign(back[3:7] @ kin.q[3:7]) ** _quaternion(kin.nq), kin.q, atol=1e-12)


def _quaternion(nq: int) -> Array:
    """Exponents (nq,): 1 on the quaternion, whose sign is free, 0 elsewhere."""
    exponents = np.zeros(nq)
    exponents[3:7] = 1.0
    return exponents


def test_unknown_frame_names_the_known_ones(kin: Kinematics) -> None:
    with pytest.raises(UnknownNameError, match=r"unknown frame 'tail': known are .*torso"):
        kin.frame_id("tail")


def test_unknown_posture_names_the_known_ones(kin: Kinematics) -> None:
    with pytest.raises(DescriptionError, match=r"posture = 'flying': must be one of .*standing"):
        standing_configuration(kin.robot, "flying")
