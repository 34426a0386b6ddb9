"""The pinocchio and the MuJoCo model of one description, compared at random states."""

from dataclasses import dataclass, replace

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from robots.description import RobotDescription
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array
from robots.mujoco_spec import build_mujoco_spec
from tests.support.states import random_state
from tests.support.velocities import frame_velocity

SEEDS = range(5)


@dataclass(frozen=True)
class Pair:
    """Both models of a robot at one state."""

    robot: RobotDescription
    kin: Kinematics
    model: mujoco.MjModel
    data: mujoco.MjData

    @property
    def base_rotation(self) -> Array:
        rotation: Array = pin.Quaternion(self.kin.q[3:7]).toRotationMatrix()
        return rotation

    @property
    def velocity_map(self) -> Array:
        """Matrix (nv, nv) from pinocchio's velocity to MuJoCo's: the base's linear part, from base to world axes."""
        matrix = np.eye(self.kin.nv)
        matrix[:3, :3] = self.base_rotation
        return matrix

    @property
    def mujoco_mass(self) -> Array:
        mass = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, self.data, mass)
        return mass


def at_state(robot: RobotDescription, q: Array, v: Array) -> Pair:
    model = build_mujoco_spec(robot).compile()
    data = mujoco.MjData(model)
    data.qpos[:] = q
    data.qpos[3:7] = q[[6, 3, 4, 5]]
    data.qvel[:] = v
    data.qvel[:3] = pin.Quaternion(q[3:7]).toRotationMatrix() @ v[:3]
    mujoco.mj_forward(model, data)
    kin = Kinematics(robot)
    kin.update(q, v)
    return Pair(robot, kin, model, data)


@pytest.fixture(params=[(name, seed) for name in ("g1", "tocabi") for seed in SEEDS], ids=lambda p: f"{p[0]}-{p[1]}")
def pair(request: pytest.FixtureRequest) -> Pair:
    name, seed = request.param
    robot = load_robot(name)
    return at_state(robot, *random_state(Kinematics(robot), seed))


@pytest.fixture(params=["g1", "tocabi"])
def standing(request: pytest.FixtureRequest) -> Pair:
    robot = load_robot(request.param)
    posture = robot.posture("standing")
    q = np.concatenate([[0.0, 0.0, posture.base_height, 0.0, 0.0, 0.0, 1.0], posture.joints])
    return at_state(robot, q, np.zeros(q.size - 1))


def test_mass_matrix(pair: Pair) -> None:
    change = pair.velocity_map
    mass = change.T @ pair.mujoco_mass @ change
    np.testing.assert_allclose(mass, pair.kin.mass_matrix, rtol=0, atol=1e-11 * abs(mass).max())


def test_bias_forces(pair: Pair) -> None:
    """With v_m = T v: M_m T v' + M_m T' v + b_m = f_m and f = T^T f_m, hence b = T^T (b_m + M_m T' v)."""
    omega, linear = pair.kin.v[3:6], pair.kin.v[:3]
    change_rate_times_v = np.zeros(pair.kin.nv)
    change_rate_times_v[:3] = pair.base_rotation @ np.cross(omega, linear)
    bias = pair.velocity_map.T @ (pair.data.qfrc_bias + pair.mujoco_mass @ change_rate_times_v)
    np.testing.assert_allclose(bias, pair.kin.bias, rtol=0, atol=1e-11 * abs(bias).max())


def test_forward_dynamics_accelerations(pair: Pair) -> None:
    """Same motor torques, no friction and no contact: MuJoCo's world acceleration is R (a + omega x v)."""
    model, data, kin = pair.model, pair.data, pair.kin
    model.dof_damping[:] = 0.0
    model.dof_frictionloss[:] = 0.0
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    effort = pair.robot.joint_array("effort")
    data.ctrl[:] = 0.5 * effort * np.cos(np.arange(effort.size))
    mujoco.mj_forward(model, data)
    torque = np.concatenate([np.zeros(6), data.ctrl])
    ours = np.linalg.solve(kin.mass_matrix, torque - kin.bias)
    ours[:3] = pair.base_rotation @ (ours[:3] + np.cross(kin.v[3:6], kin.v[:3]))
    np.testing.assert_allclose(data.qacc_smooth, ours, rtol=0, atol=1e-9 * abs(ours).max())


def test_frame_and_body_poses(pair: Pair) -> None:
    places = [pair.data.site(f.name) for f in pair.robot.frames] + [pair.data.body(b.name) for b in pair.robot.bodies]
    for place in places:
        rotation, position = pair.kin.frame_placement(pair.kin.frame_id(place.name))
        np.testing.assert_allclose(place.xpos, position, rtol=0, atol=1e-12)
        np.testing.assert_allclose(place.xmat.reshape(3, 3), rotation, rtol=0, atol=1e-12)


def test_frame_velocities(pair: Pair) -> None:
    found = np.zeros(6)
    for frame in pair.robot.frames:
        site = pair.model.site(frame.name).id
        mujoco.mj_objectVelocity(pair.model, pair.data, mujoco.mjtObj.mjOBJ_SITE, site, found, 0)
        expected = frame_velocity(pair.kin, pair.kin.frame_id(frame.name))
        np.testing.assert_allclose(found[[3, 4, 5, 0, 1, 2]], expected, rtol=0, atol=1e-11)


def test_centre_of_mass_and_its_velocity(pair: Pair) -> None:
    mujoco.mj_subtreeVel(pair.model, pair.data)
    np.testing.assert_allclose(pair.data.subtree_com[1], pair.kin.com, rtol=0, atol=1e-12)
    np.testing.assert_allclose(pair.data.subtree_linvel[1], pair.kin.com_velocity, rtol=0, atol=1e-12)


def test_one_small_step_leads_to_the_same_pose(pair: Pair) -> None:
    """The two differ by the curvature of pinocchio's path alone: |omega x v| dt^2 / 2."""
    dt = 1e-6
    ours = pair.kin.integrate(pair.kin.q, pair.kin.v, dt)
    theirs = pair.data.qpos.copy()
    mujoco.mj_integratePos(pair.model, theirs, pair.data.qvel, dt)
    curvature = np.linalg.norm(np.cross(pair.kin.v[3:6], pair.kin.v[:3])) * dt**2 / 2
    assert np.linalg.norm(theirs[:3] - ours[:3]) < 1.01 * curvature + 1e-15
    quaternion = theirs[[4, 5, 6, 3]]
    np.testing.assert_allclose(quaternion * np.sign(quaternion @ ours[3:7]), ours[3:7], rtol=0, atol=1e-14)
    np.testing.assert_allclose(theirs[7:], ours[7:], rtol=0, atol=1e-14)


def test_imu_sensors(pair: Pair) -> None:
    frame = pair.kin.frame_id(pair.robot.roles["imu"])
    rotation = pair.kin.frame_placement(frame)[0]
    gyro = rotation.T @ frame_velocity(pair.kin, frame)[3:]
    np.testing.assert_allclose(pair.data.sensor("imu_gyro").data, gyro, rtol=0, atol=1e-11)
    w, x, y, z = pair.data.sensor("imu_quaternion").data
    np.testing.assert_allclose(pin.Quaternion(w, x, y, z).toRotationMatrix(), rotation, rtol=0, atol=1e-12)


def test_collision_geoms_are_the_described_shapes(pair: Pair) -> None:
    for shape in pair.robot.collisions:
        geom = pair.model.geom(f"{shape.name}_collision")
        rotation, position = pair.kin.frame_placement(pair.kin.frame_id(shape.body))
        centre = position + rotation @ (0.5 * (shape.start + shape.end))
        np.testing.assert_allclose(pair.data.geom_xpos[geom.id], centre, rtol=0, atol=1e-12)
        assert geom.size[0] == shape.radius
        if shape.is_sphere:
            assert geom.type == mujoco.mjtGeom.mjGEOM_SPHERE
            continue
        assert geom.type == mujoco.mjtGeom.mjGEOM_CAPSULE
        half = 0.5 * rotation @ (shape.end - shape.start)
        np.testing.assert_allclose(geom.size[1], np.linalg.norm(half), rtol=0, atol=1e-12)
        axis = pair.data.geom_xmat[geom.id].reshape(3, 3)[:, 2]
        np.testing.assert_allclose(pin.skew(axis) @ half, np.zeros(3), rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ["g1", "tocabi"])
def test_joint_settings_and_order(name: str) -> None:
    robot = load_robot(name)
    model, kin = build_mujoco_spec(robot).compile(), Kinematics(robot)
    assert [model.joint(i).name for i in range(model.njnt)] == ["root_joint", *robot.joint_names]
    assert [model.actuator(i).name for i in range(model.nu)] == list(robot.joint_names)
    assert list(kin.model.names)[1:] == ["root_joint", *robot.joint_names]
    assert np.array_equal(model.actuator_trnid[:, 0], np.arange(1, model.njnt))
    assert np.array_equal(model.jnt_range[1:], np.transpose(robot.position_limits))
    assert model.jnt_limited[1:].all()
    for found, attribute in ((model.dof_armature, "armature"), (kin.model.armature, "armature")):
        assert np.array_equal(found, np.concatenate([np.zeros(6), robot.joint_array(attribute)]))
    for found, attribute in ((model.dof_damping, "damping"), (model.dof_frictionloss, "friction_loss")):
        assert np.array_equal(found, np.concatenate([np.zeros(6), robot.joint_array(attribute)]))
    effort = robot.joint_array("effort")
    for limits in (model.actuator_ctrlrange, model.actuator_forcerange):
        assert np.array_equal(limits, np.column_stack([-effort, effort]))


def test_motor_torque_arrives_at_its_joint_and_stops_at_the_effort_limit(standing: Pair) -> None:
    effort = standing.robot.joint_array("effort")
    for command, torque in ((0.3 * effort, 0.3 * effort), (2.0 * effort, effort), (-2.0 * effort, -effort)):
        standing.data.ctrl[:] = command
        mujoco.mj_forward(standing.model, standing.data)
        np.testing.assert_allclose(standing.data.qfrc_actuator[6:], torque, rtol=1e-15)
        assert not standing.data.qfrc_actuator[:6].any()


def test_only_soles_and_floor_can_collide(standing: Pair) -> None:
    model, soles = standing.model, {f"{s.frame}_contact" for s in standing.robot.soles}
    touching = set()
    for i in range(model.ngeom):
        for j in range(i + 1, model.ngeom):
            forth = model.geom_contype[i] & model.geom_conaffinity[j]
            back = model.geom_contype[j] & model.geom_conaffinity[i]
            if forth or back:
                touching.add(frozenset({model.geom(i).name, model.geom(j).name}))
    assert touching == {frozenset({"floor", sole}) for sole in soles}


def test_penetrating_links_and_soles_make_no_contact(pair: Pair) -> None:
    """High above the ground, folded up at random: collision bodies overlap, yet nothing is in contact."""
    rng = np.random.default_rng(0)
    overlaps = 0
    for _ in range(20):
        pair.data.qpos[:7] = [0.0, 0.0, 10.0, 1.0, 0.0, 0.0, 0.0]
        pair.data.qpos[7:] = rng.uniform(*pair.robot.position_limits)
        mujoco.mj_forward(pair.model, pair.data)
        assert pair.data.ncon == 0
        overlaps += sum(
            mujoco.mj_geomDistance(
                pair.model,
                pair.data,
                pair.model.geom(f"{a}_collision").id,
                pair.model.geom(f"{b}_collision").id,
                1.0,
                None,
            )
            < 0
            for a, b in pair.robot.self_collision_pairs
        )
    assert overlaps > 0


def test_sunk_into_the_ground_only_soles_touch(standing: Pair) -> None:
    standing.data.qpos[2] = 0.3
    mujoco.mj_forward(standing.model, standing.data)
    names = {frozenset(standing.model.geom(g).name for g in contact.geom) for contact in standing.data.contact}
    assert names == {frozenset({"floor", f"{s.frame}_contact"}) for s in standing.robot.soles}


def test_standing_posture_puts_the_soles_flat_on_the_ground(standing: Pair) -> None:
    for sole in standing.robot.soles:
        rotation, position = standing.kin.frame_placement(standing.kin.frame_id(sole.frame))
        # just inside it: a sole that only touches has no contact force in the first step of a run
        assert -2e-4 < position[2] < 0
        np.testing.assert_allclose(rotation[:, 2], [0.0, 0.0, 1.0], rtol=0, atol=1e-6)
        box = standing.model.geom(f"{sole.frame}_contact")
        centre = standing.data.geom_xpos[box.id]
        lower_face = centre - rotation[:, 2] * box.size[2]
        np.testing.assert_allclose(lower_face, position, rtol=0, atol=1e-12)
        np.testing.assert_allclose(box.size[:2], [sole.half_length, sole.half_width], rtol=0, atol=0)


def test_sole_box_turns_with_its_frame() -> None:
    """A sole frame need not be parallel to the body it is on."""
    robot = load_robot("g1")
    turned = tuple(replace(f, rpy=np.array([0.3, -0.4, 0.5])) if f.name == "left_sole" else f for f in robot.frames)
    pair = at_state(replace(robot, frames=turned), *random_state(Kinematics(robot), 0))
    rotation, position = pair.kin.frame_placement(pair.kin.frame_id("left_sole"))
    box = pair.model.geom("left_sole_contact")
    np.testing.assert_allclose(pair.data.geom_xmat[box.id].reshape(3, 3), rotation, rtol=0, atol=1e-12)
    lower_face = pair.data.geom_xpos[box.id] - rotation[:, 2] * box.size[2]
    np.testing.assert_allclose(lower_face, position, rtol=0, atol=1e-12)
