"""Both models against values computed from the upstream URDFs (see tests/data/README.md)."""

from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from robots.description import Body, RobotDescription
from robots.errors import DescriptionError
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array
from robots.mujoco_spec import PhysicalChanges, build_mujoco_spec
from robots.pinocchio_model import build_pinocchio_model

DATA = Path(__file__).parents[1] / "data"
NO_ARMATURE = PhysicalChanges(armature_scale=0.0)
CASES = [(name, sample) for name in ("g1", "tocabi") for sample in range(4)]


@dataclass(frozen=True)
class Sample:
    """One reference state."""

    q: Array
    com: Array
    mass_matrix: Array
    gravity: Array
    frames: dict[str, tuple[Array, Array]]


def reference(name: str, sample: int) -> Sample:
    with np.load(DATA / f"{name}_reference.npz") as data:
        assert tuple(data["joint_names"]) == load_robot(name).joint_names
        poses = zip(data["frame_rotations"][sample], data["frame_positions"][sample], strict=True)
        frames = dict(zip((str(n) for n in data["frame_names"]), poses, strict=True))
        q, com, mass, gravity = (data[key][sample] for key in ("q", "com", "mass_matrix", "gravity"))
        return Sample(q, com, mass, gravity, frames)


def without_armature(model: pin.Model) -> pin.Model:
    model.armature = np.zeros(model.nv)
    return model


def baked_axis(body: Body) -> Array:
    """Axis (3,), in the body's frame, about which the upstream link inertia holds the rotor's; zeros where it does not.

    Upstream has it about the joint's axis but for two pairs: about z in the last wrist links, though the joint turns
    about y, and not at all in neck and head.
    """
    assert body.joint is not None
    if body.name in ("Neck_Link", "Head_Link"):
        return np.zeros(3)
    return np.array([0.0, 0.0, 1.0]) if "Wrist2" in body.name else body.joint.axis


def rotor_inertia(body: Body) -> Array:
    """What was split off the upstream inertia of a link, (3, 3)."""
    if body.joint is None or body.joint.fixed:
        return np.zeros((3, 3))
    axis = baked_axis(body)
    return body.joint.armature * np.outer(axis, axis)


def pinocchio_model(robot: RobotDescription, baked: bool) -> pin.Model:
    """Model without armature; ``baked`` puts it back into the link inertias, as upstream has it."""
    model = without_armature(build_pinocchio_model(robot))
    for body in robot.bodies if baked else ():
        if body.joint is not None and not body.joint.fixed:
            i = model.getJointId(body.joint.name)
            old = model.inertias[i]
            model.inertias[i] = pin.Inertia(old.mass, old.lever, old.inertia + rotor_inertia(body))
    return model


def mujoco_model(robot: RobotDescription, baked: bool) -> mujoco.MjModel:
    """As :func:`pinocchio_model`; MuJoCo refuses baked inertias when it compiles, so they are set afterwards."""
    model = build_mujoco_spec(robot, NO_ARMATURE).compile()
    for body in robot.bodies if baked else ():
        principal, axes = np.linalg.eigh(body.inertia + rotor_inertia(body))
        axes[:, 2] *= np.linalg.det(axes)
        i = model.body(body.name).id
        model.body_inertia[i] = principal
        mujoco.mju_mat2Quat(model.body_iquat[i], axes.ravel())
    return model


def to_world_axes(q: Array) -> Array:
    """Matrix (nv, nv) that turns pinocchio's velocity into MuJoCo's: base linear velocity from base to world axes."""
    matrix = np.eye(q.size - 1)
    matrix[:3, :3] = pin.Quaternion(q[3:7]).toRotationMatrix()
    return matrix


def mujoco_at_rest(model: mujoco.MjModel, q: Array) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.qpos[:] = q
    data.qpos[3:7] = q[[6, 3, 4, 5]]
    mujoco.mj_forward(model, data)
    return data


def mujoco_mass_and_gravity(model: mujoco.MjModel, q: Array) -> tuple[Array, Array]:
    """Mass matrix and gravity terms in pinocchio's coordinates."""
    data = mujoco_at_rest(model, q)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    change = to_world_axes(q)
    return change.T @ mass @ change, change.T @ data.qfrc_bias


def assert_same_mass_and_gravity(mass: Array, gravity: Array, sample: Sample) -> None:
    np.testing.assert_allclose(mass, sample.mass_matrix, rtol=0, atol=1e-6 * abs(sample.mass_matrix).max())
    np.testing.assert_allclose(gravity, sample.gravity, rtol=0, atol=1e-5)


@pytest.mark.parametrize("name", ["g1", "tocabi"])
def test_total_mass(name: str) -> None:
    robot = load_robot(name)
    with np.load(DATA / f"{name}_reference.npz") as data:
        expected = float(data["total_mass"])
    assert abs(robot.total_mass - expected) < 1e-9
    assert abs(pin.computeTotalMass(build_pinocchio_model(robot)) - expected) < 1e-9
    assert abs(build_mujoco_spec(robot).compile().body_mass.sum() - expected) < 1e-9


@pytest.mark.parametrize(("name", "sample"), CASES)
def test_frames_and_centre_of_mass_of_pinocchio(name: str, sample: int) -> None:
    expected = reference(name, sample)
    kin = Kinematics(load_robot(name))
    kin.update(expected.q, np.zeros(kin.nv))
    np.testing.assert_allclose(kin.com, expected.com, rtol=0, atol=1e-6)
    for frame, (rotation, position) in expected.frames.items():
        ours = kin.frame_placement(kin.frame_id(frame))
        np.testing.assert_allclose(ours[0], rotation, rtol=0, atol=1e-6)
        np.testing.assert_allclose(ours[1], position, rtol=0, atol=1e-6)


@pytest.mark.parametrize(("name", "sample"), CASES)
def test_frames_and_centre_of_mass_of_mujoco(name: str, sample: int) -> None:
    expected = reference(name, sample)
    model = build_mujoco_spec(load_robot(name)).compile()
    data = mujoco_at_rest(model, expected.q)
    np.testing.assert_allclose(data.subtree_com[1], expected.com, rtol=0, atol=1e-6)
    for frame, (rotation, position) in expected.frames.items():
        body = data.body(frame)
        np.testing.assert_allclose(body.xmat.reshape(3, 3), rotation, rtol=0, atol=1e-6)
        np.testing.assert_allclose(body.xpos, position, rtol=0, atol=1e-6)


@pytest.mark.parametrize(("name", "sample"), CASES)
def test_mass_matrix_and_gravity_of_pinocchio(name: str, sample: int) -> None:
    """TOCABI with the rotor inertia back in the links, as the reference has it."""
    robot, expected = load_robot(name), reference(name, sample)
    kin = Kinematics(robot, pinocchio_model(robot, baked=name == "tocabi"))
    kin.update(expected.q, np.zeros(kin.nv))
    assert_same_mass_and_gravity(kin.mass_matrix, kin.bias, expected)


@pytest.mark.parametrize(("name", "sample"), CASES)
def test_mass_matrix_and_gravity_of_mujoco(name: str, sample: int) -> None:
    robot, expected = load_robot(name), reference(name, sample)
    model = mujoco_model(robot, baked=name == "tocabi")
    assert_same_mass_and_gravity(*mujoco_mass_and_gravity(model, expected.q), expected)


@pytest.mark.parametrize("name", ["g1", "tocabi"])
@pytest.mark.parametrize("sample", range(4))
def test_armature_adds_to_the_diagonal_only(name: str, sample: int) -> None:
    robot, expected = load_robot(name), reference(name, sample)
    full, bare = Kinematics(robot), Kinematics(robot, pinocchio_model(robot, baked=False))
    for kin in (full, bare):
        kin.update(expected.q, np.zeros(kin.nv))
    armature = np.diag(np.concatenate([np.zeros(6), robot.joint_array("armature")]))
    np.testing.assert_allclose(full.mass_matrix - bare.mass_matrix, armature, rtol=0, atol=1e-12)
    with_rotors = mujoco_mass_and_gravity(build_mujoco_spec(robot).compile(), expected.q)[0]
    without = mujoco_mass_and_gravity(build_mujoco_spec(robot, NO_ARMATURE).compile(), expected.q)[0]
    np.testing.assert_allclose(with_rotors - without, armature, rtol=0, atol=1e-12)


def rotor_coupling(robot: RobotDescription, q: Array) -> Array:
    """Sum over the joints of J (w w^T - e e^T), (nv, nv).

    w (nv,) maps the velocity to the link's angular velocity about the axis of the baked rotor inertia; e picks the
    joint's own rate. Upstream the rotor turns with the link (w); split off, it turns with the joint alone (e).
    """
    model = build_pinocchio_model(robot)
    data = model.createData()
    pin.computeJointJacobians(model, data, q)
    total = np.zeros((model.nv, model.nv))
    for body in robot.bodies:
        if body.joint is None or body.joint.fixed:
            continue
        i = model.getJointId(body.joint.name)
        w = baked_axis(body) @ pin.getJointJacobian(model, data, i, pin.ReferenceFrame.LOCAL)[3:]
        e = np.zeros(model.nv)
        e[model.idx_vs[i]] = 1.0
        total += body.joint.armature * (np.outer(w, w) - np.outer(e, e))
    return total


@pytest.mark.parametrize("sample", range(4))
def test_tocabi_differs_from_upstream_by_the_rotors_coupling_alone(sample: int) -> None:
    robot, expected = load_robot("tocabi"), reference("tocabi", sample)
    kin = Kinematics(robot)
    kin.update(expected.q, np.zeros(kin.nv))
    coupling = rotor_coupling(robot, expected.q)
    assert_same_mass_and_gravity(kin.mass_matrix + coupling, kin.bias, expected)
    mass, gravity = mujoco_mass_and_gravity(build_mujoco_spec(robot).compile(), expected.q)
    assert_same_mass_and_gravity(mass + coupling, gravity, expected)
    # the coupling is no rounding matter: a model that forgot the split would be off by this much
    assert abs(coupling).max() > 0.1


def test_tocabi_with_rotors_in_the_links_is_refused_and_says_what_to_do() -> None:
    robot = load_robot("tocabi")
    baked = tuple(replace(b, inertia=b.inertia + rotor_inertia(b)) for b in robot.bodies)
    with pytest.raises(DescriptionError, match="armature") as caught:
        replace(robot, bodies=baked)
    assert "principal inertias" in caught.value.entry
