"""Planar and fixed bases and locked joints against the floating model; velocities and accelerations of the bodies."""

from collections.abc import Callable, Sequence

import numpy as np
import pinocchio as pin
import pytest

from robots.description import RobotDescription
from robots.errors import ConfigError, DescriptionError, UnknownNameError
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array, Indices
from robots.pinocchio_model import build_pinocchio_model, standing_configuration, upper_body_joints
from tests.support.states import random_state
from tests.support.velocities import frame_velocity
from wbc.tasks import PostureTask, TaskGains

STEP = 1e-5
ROBOTS = {name: load_robot(name) for name in ("g1", "tocabi")}
JOINT_SETS: dict[str, Callable[[RobotDescription], Sequence[str] | None]] = {
    "all": lambda robot: None,
    "upper": upper_body_joints,
    "every other": lambda robot: robot.joint_names[::2],  # locks joints in the middle of every chain
}
CASES = [
    (name, base, joints)
    for name in ROBOTS
    for base, joints in (
        ("floating", "all"),
        ("floating", "every other"),
        ("planar", "all"),
        ("planar", "upper"),
        ("fixed", "upper"),
        ("fixed", "every other"),
    )
]
BASE_COLUMNS = {"floating": [0, 1, 2, 3, 4, 5], "planar": [0, 1, 5], "fixed": []}


@pytest.fixture(params=CASES, ids="-".join)
def kin(request: pytest.FixtureRequest) -> Kinematics:
    """At a random state, after an update at another one."""
    name, base, joints = request.param
    kinematics = Kinematics(ROBOTS[name], base=base, joints=JOINT_SETS[joints](ROBOTS[name]))
    kinematics.update(*random_state(kinematics, 1))
    kinematics.update(*random_state(kinematics, 2))
    return kinematics


def kept_columns(kin: Kinematics) -> Indices:
    """Places of the entries of v in the velocity of the whole robot on a floating base."""
    return np.concatenate([np.array(BASE_COLUMNS[kin.base], dtype=np.intp), 6 + kin.joint_indices])


def whole_velocity(kin: Kinematics, v: Array) -> Array:
    out = np.zeros(6 + len(kin.robot.joints))
    out[kept_columns(kin)] = v
    return out


def whole_robot(kin: Kinematics) -> Kinematics:
    """The same robot on a floating base with all joints, in the same place at the same velocity."""
    whole = Kinematics(kin.robot)
    whole.update(kin.full_configuration(kin.q), whole_velocity(kin, kin.v))
    return whole


def moved(kin: Kinematics, step: float) -> Kinematics:
    """A second work space, moved at the constant velocity of ``kin`` for ``step``."""
    other = Kinematics(kin.robot, base=kin.base, joints=kin.joint_names)
    other.update_motion(kin.integrate(kin.q, kin.v, step), kin.v)
    return other


def assert_close(actual: Array, expected: Array, tolerance: float = 1e-12) -> None:
    np.testing.assert_allclose(actual, expected, rtol=0, atol=tolerance)


def test_sizes_of_the_g1() -> None:
    robot = ROBOTS["g1"]
    upper = upper_body_joints(robot)
    sizes = [
        (k.nq, k.nv, k.nq_base, k.nv_base)
        for k in (
            Kinematics(robot),
            Kinematics(robot, base="planar", joints=upper),
            Kinematics(robot, base="fixed", joints=upper),
        )
    ]
    assert sizes == [(36, 35, 7, 6), (21, 20, 4, 3), (17, 17, 0, 0)]
    assert upper == robot.joint_names[12:]


@pytest.mark.parametrize("name", ROBOTS)
def test_upper_body_joints_are_those_that_move_no_sole(name: str) -> None:
    kin = Kinematics(ROBOTS[name])
    kin.update_geometry(random_state(kin, 3)[0])
    jacobians = [kin.frame_jacobian(kin.frame_id(sole.frame))[:, 6:] for sole in kin.robot.soles]
    still = ~np.any(jacobians, axis=(0, 1))
    assert upper_body_joints(kin.robot) == tuple(np.array(kin.joint_names)[still])


def test_joint_attributes_are_those_of_the_moving_joints(kin: Kinematics) -> None:
    by_name = {joint.name: joint for joint in kin.robot.joints}
    assert [n for n in kin.robot.joint_names if n in kin.joint_names] == list(kin.joint_names)
    assert kin.nv == kin.nv_base + len(kin.joint_names)
    assert kin.joint_array("effort").tolist() == [by_name[n].effort for n in kin.joint_names]
    assert list(zip(*kin.position_limits, strict=True)) == [by_name[n].position for n in kin.joint_names]


def test_order_of_the_names_given_does_not_matter() -> None:
    names = upper_body_joints(ROBOTS["g1"])
    assert Kinematics(ROBOTS["g1"], joints=names[::-1]).joint_names == names


def test_frames_are_those_of_the_whole_robot(kin: Kinematics) -> None:
    whole = whole_robot(kin)
    assert [f.name for f in kin.model.frames] == [f.name for f in whole.model.frames]
    for i in range(kin.model.nframes):
        for actual, expected in zip(kin.frame_placement(i), whole.frame_placement(i), strict=True):
            assert_close(actual, expected)
        assert_close(kin.frame_jacobian(i), whole.frame_jacobian(i)[:, kept_columns(kin)])
        assert_close(frame_velocity(kin, i), frame_velocity(whole, i), 1e-11)


def test_world_jacobian_has_the_columns_of_the_whole_robot(kin: Kinematics) -> None:
    assert_close(kin.world_jacobian, whole_robot(kin).world_jacobian[:, kept_columns(kin)])


def test_dynamics_are_those_of_the_whole_robot_held_still(kin: Kinematics) -> None:
    whole, kept = whole_robot(kin), kept_columns(kin)
    scale = abs(whole.mass_matrix).max()
    assert_close(kin.mass_matrix, whole.mass_matrix[np.ix_(kept, kept)], 1e-12 * scale)
    assert_close(kin.bias, whole.bias[kept], 1e-12 * abs(whole.bias).max())


def test_com_is_that_of_the_bodies_that_may_move(kin: Kinematics) -> None:
    whole, mass, moment = whole_robot(kin), 0.0, np.zeros(3)
    for body in kin.robot.bodies:
        i = kin.frame_id(body.name)
        if kin.frame_joint(i) > 0:
            rotation, position = whole.frame_placement(i)
            mass += body.mass
            moment += body.mass * (position + rotation @ body.com)
    assert_close(kin.com, moment / mass)


def test_full_configuration_moves_with_the_whole_robot(kin: Kinematics) -> None:
    """Integrating commutes with completing, up to the sign of the quaternion."""
    step = 0.3
    ahead = kin.full_configuration(kin.integrate(kin.q, kin.v, step))
    whole = whole_robot(kin)
    expected = whole.integrate(whole.q, whole.v, step)
    expected[3:7] *= np.sign(expected[3:7] @ ahead[3:7])
    assert_close(ahead, expected)


def test_postures_are_those_of_the_description(kin: Kinematics) -> None:
    assert_close(kin.full_configuration(kin.posture()), standing_configuration(kin.robot))
    posture = kin.robot.posture("hands_front")
    at_front = kin.full_configuration(kin.posture("hands_front"))
    assert np.array_equal(at_front[7:][kin.joint_indices], posture.joints[kin.joint_indices])


def test_posture_gives_height_and_locked_angles() -> None:
    robot = ROBOTS["g1"]
    legs = [n for n in robot.joint_names if n not in upper_body_joints(robot)]
    kin = Kinematics(robot, base="fixed", joints=legs, posture="hands_front")
    whole = Kinematics(robot)
    whole.update_geometry(standing_configuration(robot, "hands_front"))
    kin.update_geometry(kin.posture("hands_front"))
    hand = kin.frame_id(robot.roles["left_hand"])
    assert_close(kin.frame_placement(hand)[1], whole.frame_placement(hand)[1])
    assert kin.frame_joint(hand) == 0


def test_world_carries_what_does_not_move(kin: Kinematics) -> None:
    kin.update_motion(kin.q, kin.v)
    assert_close(kin.joint_transforms[0], np.concatenate([np.eye(3).ravel(), np.zeros(3)]), 0.0)
    assert not kin.support[0].any()
    assert not kin.joint_velocities[0].any()
    assert not kin.joint_accelerations[0].any()


def test_joint_velocities_are_the_derivatives_of_the_placements(kin: Kinematics) -> None:
    kin.update_motion(kin.q, kin.v)
    ahead, behind = moved(kin, STEP), moved(kin, -STEP)
    for i in range(kin.model.njoints):
        now, after, before = kin.data.oMi[i], ahead.data.oMi[i], behind.data.oMi[i]
        omega = pin.log3(after.rotation @ before.rotation.T) / (2 * STEP)
        origin = (after.translation - before.translation) / (2 * STEP) - np.cross(omega, now.translation)
        assert_close(kin.joint_velocities[i], np.concatenate([origin, omega]), 1e-7)


def test_joint_accelerations_are_the_derivatives_of_the_velocities(kin: Kinematics) -> None:
    kin.update_motion(kin.q, kin.v)
    difference = (moved(kin, STEP).joint_velocities - moved(kin, -STEP).joint_velocities) / (2 * STEP)
    assert_close(kin.joint_accelerations, difference, 1e-6)


def test_material_points_accelerate_as_the_attribute_says(kin: Kinematics) -> None:
    kin.update_motion(kin.q, kin.v)
    ahead, behind = moved(kin, STEP), moved(kin, -STEP)
    for frame in kin.robot.frames:
        i = kin.frame_id(frame.name)
        p, joint = kin.frame_placement(i)[1], kin.frame_joint(i)
        (u, omega), (a, alpha) = (x[joint].reshape(2, 3) for x in (kin.joint_velocities, kin.joint_accelerations))
        acceleration = a + np.cross(alpha, p) + np.cross(omega, u + np.cross(omega, p))
        difference = (frame_velocity(ahead, i) - frame_velocity(behind, i))[:3] / (2 * STEP)
        assert_close(acceleration, difference, 1e-6)


def test_joint_accelerations_are_pinocchios(kin: Kinematics) -> None:
    kin.update_motion(kin.q, kin.v)
    data = kin.model.createData()
    pin.forwardKinematics(kin.model, data, kin.q, kin.v, np.zeros(kin.nv))
    for i in range(kin.model.njoints):
        velocity = pin.getVelocity(kin.model, data, i, pin.ReferenceFrame.WORLD).vector
        acceleration = pin.getAcceleration(kin.model, data, i, pin.ReferenceFrame.WORLD).vector
        assert_close(kin.joint_velocities[i], velocity, 1e-11)
        assert_close(kin.joint_accelerations[i], acceleration, 1e-10)


def test_second_order_follows_a_full_update_too(kin: Kinematics) -> None:
    other = moved(kin, 0.0)
    kin.update_second_order()
    assert_close(kin.joint_velocities, other.joint_velocities, 1e-11)
    assert_close(kin.joint_accelerations, other.joint_accelerations, 1e-10)


def test_update_motion_gives_the_geometry_too(kin: Kinematics) -> None:
    other = Kinematics(kin.robot, base=kin.base, joints=kin.joint_names)
    other.update_motion(kin.q, kin.v)
    assert_close(other.joint_transforms, kin.joint_transforms)
    assert_close(other.world_jacobian, kin.world_jacobian)
    for i in range(kin.model.nframes):
        assert_close(other.frame_placement(i)[1], kin.frame_placement(i)[1])
    assert np.array_equal(other.q, kin.q)
    assert np.array_equal(other.v, kin.v)


def test_posture_task_reads_the_joints_behind_any_base(kin: Kinematics) -> None:
    task = PostureTask(len(kin.joint_names), TaskGains(k=2.0, max_correction=100.0), kin.nv_base)
    task.joints = kin.q[kin.nq_base :] + 0.1
    jacobian, command = task.evaluate(kin)
    assert_close(jacobian @ kin.v, kin.v[kin.nv_base :])
    assert_close(command, np.full(len(kin.joint_names), 0.2))


def test_unknown_base_names_the_known_ones() -> None:
    for build in (Kinematics, build_pinocchio_model):
        with pytest.raises(ConfigError, match=r"base = 'wheeled': must be one of floating, planar, fixed"):
            build(ROBOTS["g1"], base="wheeled")


def test_unknown_joint_names_the_known_ones() -> None:
    with pytest.raises(UnknownNameError, match=r"unknown joint 'tail': known are .*waist_yaw_joint"):
        Kinematics(ROBOTS["g1"], joints=["waist_yaw_joint", "tail"])


def test_unknown_posture_is_refused_even_where_nothing_is_locked() -> None:
    with pytest.raises(DescriptionError, match=r"posture = 'flying': must be one of .*standing"):
        Kinematics(ROBOTS["g1"], posture="flying")


def test_a_fixed_base_without_joints_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"joints = \(\): must be at least one joint where the base is fixed"):
        Kinematics(ROBOTS["g1"], base="fixed", joints=())


def test_a_model_of_another_size_is_refused() -> None:
    model = build_pinocchio_model(ROBOTS["g1"], base="planar")
    with pytest.raises(ConfigError, match=r"model = 'nq 33, nv 32': must be a model of a floating base and 29 joints"):
        Kinematics(ROBOTS["g1"], model)
    assert Kinematics(ROBOTS["g1"], model, base="planar").model is model
