"""Deliberate differences between the simulated robot and its description."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from robots.description import Body, Joint, RobotDescription
from robots.errors import ConfigError, UnknownNameError
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array
from robots.mujoco_spec import PhysicalChanges, build_mujoco_spec
from robots.pinocchio_model import standing_configuration

DERIVED = {"actuator_acc0", "body_invweight0", "body_subtreemass", "dof_M0", "dof_invweight0", "dof_length"}
"""What MuJoCo works out from the rest when it compiles."""

ROBOTS = pytest.mark.parametrize("name", ["g1", "tocabi"])


def torso_body(robot: RobotDescription) -> str:
    return robot.frame(robot.roles["torso"]).body


def arrays(model: mujoco.MjModel) -> dict[str, Array]:
    fields = {n: getattr(model, n) for n in dir(model) if not n.startswith("_")}
    return {n: np.array(x) for n, x in fields.items() if isinstance(x, np.ndarray)}


def changed_fields(robot: RobotDescription, changes: PhysicalChanges) -> set[str]:
    """Arrays of the compiled model that differ by more than rounding, derived ones left out."""
    before, after = (arrays(build_mujoco_spec(robot, c).compile()) for c in (None, changes))
    assert before.keys() == after.keys()
    return {n for n in before if not np.allclose(before[n], after[n], rtol=1e-12, atol=1e-12)} - DERIVED


def with_bodies(robot: RobotDescription, bodies: list[Body]) -> RobotDescription:
    return replace(robot, bodies=tuple(bodies))


def with_joint(body: Body, armature_scale: float) -> Joint | None:
    joint = body.joint
    return None if joint is None else replace(joint, armature=joint.armature * armature_scale)


def scaled(body: Body, scale: float) -> Body:
    return replace(body, mass=body.mass * scale, inertia=body.inertia * scale)


def assert_dynamics_of(robot: RobotDescription, changes: PhysicalChanges, changed: RobotDescription) -> None:
    """MuJoCo's model with ``changes`` has mass matrix and gravity of pinocchio's model of ``changed``."""
    q = standing_configuration(robot)
    kin = Kinematics(changed)
    kin.update(q, np.zeros(kin.nv))
    model = build_mujoco_spec(robot, changes).compile()
    data = mujoco.MjData(model)
    data.qpos[:] = q[[0, 1, 2, 6, 3, 4, 5, *range(7, q.size)]]
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    np.testing.assert_allclose(mass, kin.mass_matrix, rtol=0, atol=1e-11 * abs(mass).max())
    np.testing.assert_allclose(data.qfrc_bias, kin.bias, rtol=0, atol=1e-11 * abs(kin.bias).max())


@ROBOTS
def test_default_changes_nothing(name: str) -> None:
    robot = load_robot(name)
    assert changed_fields(robot, PhysicalChanges()) == set()
    assert_dynamics_of(robot, PhysicalChanges(), robot)


@ROBOTS
def test_mass_scale(name: str) -> None:
    robot, changes = load_robot(name), PhysicalChanges(mass_scale=1.2)
    assert changed_fields(robot, changes) == {"body_mass", "body_inertia"}
    assert_dynamics_of(robot, changes, with_bodies(robot, [scaled(b, 1.2) for b in robot.bodies]))


@ROBOTS
def test_link_mass_scale_comes_on_top_of_mass_scale(name: str) -> None:
    robot = load_robot(name)
    torso = torso_body(robot)
    changes = PhysicalChanges(mass_scale=0.9, link_mass_scale={torso: 1.5})
    bodies = [scaled(b, 0.9 * (1.5 if b.name == torso else 1.0)) for b in robot.bodies]
    assert_dynamics_of(robot, changes, with_bodies(robot, bodies))


@ROBOTS
def test_com_shift_moves_the_torso_alone(name: str) -> None:
    robot, shift = load_robot(name), (0.02, -0.01, 0.03)
    changes = PhysicalChanges(com_shift=shift)
    assert changed_fields(robot, changes) == {"body_ipos"}
    torso = torso_body(robot)
    bodies = [replace(b, com=b.com + shift) if b.name == torso else b for b in robot.bodies]
    assert_dynamics_of(robot, changes, with_bodies(robot, bodies))


@ROBOTS
def test_armature_scale(name: str) -> None:
    robot, changes = load_robot(name), PhysicalChanges(armature_scale=0.5)
    assert changed_fields(robot, changes) == {"dof_armature"}
    bodies = [replace(b, joint=with_joint(b, 0.5)) for b in robot.bodies]
    assert_dynamics_of(robot, changes, with_bodies(robot, bodies))


@ROBOTS
def test_joint_friction_scale(name: str) -> None:
    robot, changes = load_robot(name), PhysicalChanges(joint_friction_scale=3.0)
    assert changed_fields(robot, changes) == {"dof_damping", "dof_frictionloss"}
    model = build_mujoco_spec(robot, changes).compile()
    np.testing.assert_allclose(model.dof_damping[6:], 3.0 * robot.joint_array("damping"), rtol=1e-15)
    np.testing.assert_allclose(model.dof_frictionloss[6:], 3.0 * robot.joint_array("friction_loss"), rtol=1e-15)


@ROBOTS
def test_sole_friction_is_the_friction_of_every_contact(name: str) -> None:
    robot, changes = load_robot(name), PhysicalChanges(sole_friction=0.35)
    assert changed_fields(robot, changes) == {"geom_friction"}
    model = build_mujoco_spec(robot, changes).compile()
    data = mujoco.MjData(model)
    q = standing_configuration(robot)
    data.qpos[:] = q[[0, 1, 2, 6, 3, 4, 5, *range(7, q.size)]]
    data.qpos[2] -= 0.002
    mujoco.mj_forward(model, data)
    assert data.ncon > 0
    np.testing.assert_allclose(data.contact.friction[:, :2], 0.35, rtol=1e-15)


@pytest.mark.parametrize("excess", [0.0, 4e-7])
def test_inertia_at_the_edge_of_the_triangle_inequality_compiles(excess: float) -> None:
    """A flat plate turned about an odd axis, exact or exceeding by the rounding that a description may have."""
    robot = load_robot("g1")
    axes = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    plate = 0.01 * axes @ np.diag([1.0, 1.5, 2.5 * (1 + excess)]) @ axes.T
    changed = with_bodies(robot, [replace(robot.bodies[0], inertia=plate), *robot.bodies[1:]])
    model = build_mujoco_spec(changed).compile()
    np.testing.assert_allclose(np.sort(model.body_inertia[1]), np.linalg.eigvalsh(plate), rtol=1e-6)


def test_unknown_link_is_refused() -> None:
    with pytest.raises(UnknownNameError, match=r"unknown body 'tail': known are .*torso_link"):
        build_mujoco_spec(load_robot("g1"), PhysicalChanges(link_mass_scale={"tail": 2.0}))


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"mass_scale": 0.0}, "mass_scale"),
        ({"mass_scale": float("nan")}, "mass_scale"),
        ({"link_mass_scale": {"torso_link": -1.0}}, "torso_link"),
        ({"com_shift": (0.0, float("inf"), 0.0)}, "com_shift"),
        ({"sole_friction": -0.1}, "sole_friction"),
        ({"joint_friction_scale": -1.0}, "joint_friction_scale"),
        ({"armature_scale": float("inf")}, "armature_scale"),
    ],
)
def test_bad_settings_are_refused(settings: dict[str, object], named: str) -> None:
    with pytest.raises(ConfigError) as caught:
        PhysicalChanges(**settings)
    assert named in str(caught.value)
