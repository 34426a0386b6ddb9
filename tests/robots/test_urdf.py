"""Robots from a URDF: against pinocchio's own reader, joint settings laid over, bad files refused."""

from collections.abc import Sequence
from dataclasses import replace
from importlib import resources
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from robots.description import ROLES, Body, RobotDescription
from robots.errors import DescriptionError
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array
from robots.mujoco_spec import build_mujoco_spec
from tests.support.states import random_state


def numbers(values: Sequence[float] | Array) -> str:
    return " ".join(repr(float(x)) for x in values)


def link(name: str, mass: float, com: Array, inertia: Array, rpy: Array) -> str:
    """A link whose inertial frame is turned by ``rpy`` (3,); ``inertia`` (3, 3) in the link's axes."""
    turn = pin.rpy.rpyToMatrix(rpy)
    i = turn.T @ inertia @ turn
    places = {"ixx": (0, 0), "iyy": (1, 1), "izz": (2, 2), "ixy": (0, 1), "ixz": (0, 2), "iyz": (1, 2)}
    tensor = " ".join(f'{key}="{float(i[place])!r}"' for key, place in places.items())
    origin = f'<origin xyz="{numbers(com)}" rpy="{numbers(rpy)}"/>'
    return f'<link name="{name}"><inertial>{origin}<mass value="{mass!r}"/><inertia {tensor}/></inertial></link>'


def joint(name: str, parent: str, child: str, kind: str = "revolute", rest: str = "") -> str:
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{rest}</joint>'


LIMIT = '<limit lower="-1.5" upper="2" velocity="7" effort="50"/>'

SMALL = [
    # listed breadth first, branches interleaved, a child before its parent
    link("right", 1.1, np.array([0.0, -0.1, 0.2]), np.diag([0.02, 0.03, 0.04]), np.array([0.3, -0.5, 1.0])),
    link("trunk", 7.0, np.array([0.01, 0.02, 0.1]), np.diag([0.2, 0.3, 0.25]), np.array([0.0, 0.7, 0.0])),
    link("left", 1.3, np.array([0.0, 0.1, 0.2]), np.diag([0.02, 0.025, 0.03]), np.array([1.0, 0.2, -0.3])),
    link("left_tip", 0.4, np.array([0.1, 0.0, 0.0]), np.diag([0.001, 0.002, 0.0015]), np.array([0.1, 0.2, 0.3])),
    link("right_tip", 0.5, np.array([0.0, 0.1, 0.0]), np.diag([0.003, 0.002, 0.0025]), np.array([-2.0, 0.0, 0.3])),
    link("plate", 0.7, np.array([0.0, 0.0, 0.05]), np.diag([0.01, 0.01, 0.012]), np.array([0.0, 0.0, 0.9])),
    '<link name="marker"/>',
    joint("right_knee", "right", "right_tip", rest=f'<origin xyz="0 0 -.3" rpy="0 .2 0"/><axis xyz="0 3 4"/>{LIMIT}'),
    joint("left_hip", "trunk", "left", rest=f'<origin xyz="0 .1 0" rpy=".1 .2 .3"/><axis xyz="0 0 -1"/>{LIMIT}'),
    joint("right_hip", "trunk", "right", rest=f'{LIMIT}<dynamics damping=".3" friction=".2"/>'),
    joint("left_knee", "left", "left_tip", rest=f'<origin xyz="0 0 -.4"/><axis xyz="0 1 0"/>{LIMIT}'),
    joint("plate_mount", "left", "plate", "fixed", '<origin xyz=".1 0 .2" rpy="1 0 .5"/>'),
    joint("marker_mount", "plate", "marker", "fixed", '<origin xyz="0 0 1"/>'),
]

FRAMES = "".join(f'[[frame]]\nname = "{r}"\nbody = "trunk"\nxyz = [0, 0, 0]\nrpy = [0, 0, 0]\n' for r in ROLES)
SOLES = "".join(f'[[sole]]\nframe = "{s}_sole"\nhalf_length = 0.1\nhalf_width = 0.05\n' for s in ("left", "right"))
ROLE_TABLE = "[roles]\n" + "".join(f'{r} = "{r}"\n' for r in ROLES)
HEAD = '[robot]\nname = "small"\nurdf = "small.urdf"\n'
REST = f"{FRAMES}{SOLES}{ROLE_TABLE}[posture.standing]\nbase_height = 1.0\n"


def load_small(folder: Path, parts: Sequence[str] = SMALL, extra: str = "") -> RobotDescription:
    (folder / "small.urdf").write_text(f'<robot name="small">{"".join(parts)}</robot>', encoding="utf-8")
    (folder / "small.toml").write_text(HEAD + extra + REST, encoding="utf-8")
    return load_robot(folder / "small.toml")


def velocity_order(robot: RobotDescription, names: Sequence[str]) -> list[int]:
    """Where each of our velocity entries stands in a model with joints ``names``."""
    return [*range(6), *(6 + list(names).index(n) for n in robot.joint_names)]


def assert_same_dynamics(kin: Kinematics, other: pin.Model, seed: int) -> None:
    """Mass matrix, bias and centre of mass of ``kin`` equal those of ``other``, joints matched by name."""
    q, v = random_state(kin, seed)
    order = velocity_order(kin.robot, list(other.names)[2:])
    other_q, other_v = q.copy(), np.empty_like(v)
    other_q[np.array(order[6:]) + 1] = q[7:]
    other_v[order] = v
    kin.update(q, v)
    data = other.createData()
    pin.computeAllTerms(other, data, other_q, other_v)
    mass = data.M[np.ix_(order, order)]
    np.testing.assert_allclose(kin.mass_matrix, mass, rtol=0, atol=1e-11 * abs(mass).max())
    np.testing.assert_allclose(kin.bias, data.nle[order], rtol=0, atol=1e-11 * abs(data.nle).max())
    np.testing.assert_allclose(kin.com, data.com[0], rtol=0, atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_small_robot_equals_pinocchios_own_reading(seed: int, tmp_path: Path) -> None:
    robot = load_small(tmp_path)
    theirs = pin.buildModelFromUrdf(str(tmp_path / "small.urdf"), pin.JointModelFreeFlyer())
    assert_same_dynamics(Kinematics(robot), theirs, seed)


def test_small_robot_is_read_as_written(tmp_path: Path) -> None:
    robot = load_small(tmp_path)
    assert [b.name for b in robot.bodies] == ["trunk", "left", "left_tip", "plate", "right", "right_tip"]
    assert robot.joint_names == ("left_hip", "left_knee", "right_hip", "right_knee")
    joints = {j.name: j for j in robot.joints}
    np.testing.assert_allclose(joints["right_knee"].axis, [0.0, 0.6, 0.8], atol=1e-15)
    assert joints["right_hip"].axis.tolist() == [1.0, 0.0, 0.0]
    for j in robot.joints:
        assert (j.position, j.velocity, j.effort, j.armature) == ((-1.5, 2.0), 7.0, 50.0, 0.0)
    assert (joints["right_hip"].damping, joints["right_hip"].friction_loss) == (0.3, 0.2)


def test_small_robot_in_mujoco_has_the_same_order_and_mass_matrix(tmp_path: Path) -> None:
    robot = load_small(tmp_path)
    model, kin = build_mujoco_spec(robot).compile(), Kinematics(robot)
    assert [model.joint(i).name for i in range(1, model.njnt)] == list(robot.joint_names)
    q = random_state(kin, 0)[0]
    q[3:7] = [0.0, 0.0, 0.0, 1.0]
    kin.update(q, np.zeros(kin.nv))
    data = mujoco.MjData(model)
    data.qpos[:] = q
    data.qpos[3:7] = [1.0, 0.0, 0.0, 0.0]
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    np.testing.assert_allclose(mass, kin.mass_matrix, rtol=0, atol=1e-11 * abs(mass).max())


def test_joint_settings_are_laid_over_the_urdf(tmp_path: Path) -> None:
    plain = load_small(tmp_path)
    settings = "[joint.left_knee]\narmature = 0.02\nkp = 100\nkd = 3\nposition = [-1, 1]\neffort = 20\nvelocity = 4\n"
    robot = load_small(tmp_path, extra=f"{settings}damping = 0.5\nfriction_loss = 0.4\n")
    for before, after in zip(plain.joints, robot.joints, strict=True):
        expected = before
        if before.name == "left_knee":
            expected = replace(before, armature=0.02, kp=100.0, kd=3.0, position=(-1.0, 1.0), effort=20.0)
            expected = replace(expected, velocity=4.0, damping=0.5, friction_loss=0.4)
        assert repr(after) == repr(expected)
    assert Kinematics(robot).model.armature.tolist() == [*[0.0] * 7, 0.02, 0.0, 0.0]


def without(part: str) -> list[str]:
    kept = [p for p in SMALL if part not in p]
    assert len(kept) == len(SMALL) - 1
    return kept


def changed(old: str, new: str) -> list[str]:
    """The small robot with ``old`` replaced in every part that has it."""
    assert any(old in p for p in SMALL)
    return [p.replace(old, new) for p in SMALL]


EXTRA = link("extra", 1.0, np.zeros(3), np.eye(3), np.zeros(3))

BAD = {
    # name: (parts, part of the entry named, part of what is allowed)
    "prismatic": (changed('"left_knee" type="revolute"', '"left_knee" type="prismatic"'), "'left_knee': type", "fixed"),
    "no type": (changed('"left_knee" type="revolute"', '"left_knee"'), "'left_knee': type", "revolute"),
    "child unknown": (changed('child link="left_tip"', 'child link="x"'), "'left_knee': child", "a link of this file"),
    "parent unknown": (changed('parent link="plate"', 'parent link="x"'), "'marker_mount': parent", "a link"),
    "parent missing": (changed('<parent link="plate"/>', ""), "'marker_mount': parent", "a link of this file"),
    "two roots": ([*SMALL, EXTRA], "nobody's child", "exactly one"),
    "no links": ([], "nobody's child", "exactly one"),
    "ring": (
        [*SMALL, EXTRA, EXTRA.replace("extra", "more"), joint("a", "extra", "more"), joint("b", "more", "extra")],
        "links",
        "reached from the base 'trunk'",
    ),
    "back to the middle": ([*SMALL, joint("back", "right_tip", "right")], "child link", "once only"),
    "link twice": ([*SMALL, SMALL[0]], "link name", "once only"),
    "joint twice": (changed('name="left_knee"', 'name="left_hip"'), "joint name", "one joint only"),
    "limb without inertia": ([*without('"right_tip"><inertial'), '<link name="right_tip"/>'], "inertial", "given"),
    "base without inertia": ([*without('"trunk"><inertial'), '<link name="trunk"/>'], "'trunk': inertial", "base"),
    "massless link with children": ([*without('"plate"><inertial'), '<link name="plate"/>'], "'plate'", "has children"),
    "axis zero": (changed('axis xyz="0 0 -1"', 'axis xyz="0 0 0"'), "'left_hip': axis", "not zero"),
    "axis too short": (changed('axis xyz="0 0 -1"', 'axis xyz="0 1"'), "'left_hip': xyz", "3 numbers"),
    "words for numbers": (changed('xyz="0 0 -.4"', 'xyz="0 0 low"'), "'left_knee': xyz", "numbers"),
    "NaN": (changed('xyz="0 0 -.4"', 'xyz="0 0 nan"'), "'left_knee': xyz", "finite"),
    "no mass": (changed('<mass value="7.0"/>', ""), "'trunk': mass", "above 0"),
    "no limit": (changed(LIMIT, ""), "position", "lower < upper"),
    "no effort": (changed('effort="50"', ""), "effort", "above 0"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_urdf_is_refused(case: str, tmp_path: Path) -> None:
    parts, where, allowed = BAD[case]
    with pytest.raises(DescriptionError) as caught:
        load_small(tmp_path, parts)
    error = caught.value
    assert error.file.endswith(("small.urdf", "small.toml"))
    assert where in error.entry
    assert allowed in error.allowed


@pytest.mark.parametrize("content", [b"<robot><link>", b"\xff\xfe\x00"])
def test_file_that_is_not_xml(content: bytes, tmp_path: Path) -> None:
    load_small(tmp_path)
    (tmp_path / "small.urdf").write_bytes(content)
    with pytest.raises(DescriptionError, match=r"small\.urdf.*valid XML"):
        load_robot(tmp_path / "small.toml")


def test_missing_urdf(tmp_path: Path) -> None:
    load_small(tmp_path)
    (tmp_path / "small.urdf").unlink()
    with pytest.raises(DescriptionError, match=r"small\.urdf.*readable"):
        load_robot(tmp_path / "small.toml")


@pytest.mark.parametrize(
    ("extra", "where", "allowed"),
    [
        ("[joint.tail]\narmature = 1\n", "joint", "joints of the URDF: left_hip"),
        ("[joint.left_hip]\naxis = [1, 0, 0]\n", "joint 'left_hip': keys", "armature"),
        ("[joint.left_hip]\narmature = 'big'\n", "joint 'left_hip': armature", "a number"),
        ("[joint.left_hip]\nposition = [1]\n", "joint 'left_hip': position", "2 numbers"),
        ("[joint]\nleft_hip = 1\n", "joint: left_hip", "dict"),
        ("[[body]]\nname = 'x'\n", "body", "absent"),
    ],
)
def test_bad_joint_settings_are_refused(extra: str, where: str, allowed: str, tmp_path: Path) -> None:
    with pytest.raises(DescriptionError) as caught:
        load_small(tmp_path, extra=extra)
    assert where in caught.value.entry
    assert allowed in caught.value.allowed


def body_parts(body: Body, rng: np.random.Generator) -> tuple[str, str]:
    """Link and joint of a body as URDF, the inertial frame turned at random."""
    own = link(body.name, body.mass, body.com, body.inertia, rng.uniform(-1.5, 1.5, 3))
    j = body.joint
    if j is None or body.parent is None:
        return own, ""
    rest = f'<origin xyz="{numbers(j.xyz)}" rpy="{numbers(j.rpy)}"/>'
    if j.fixed:
        return own, joint(j.name, body.parent, body.name, "fixed", rest)
    lower, upper = j.position
    rest += f'<axis xyz="{numbers(j.axis)}"/><dynamics damping="{j.damping!r}" friction="{j.friction_loss!r}"/>'
    rest += f'<limit lower="{lower!r}" upper="{upper!r}" velocity="{j.velocity!r}" effort="{j.effort!r}"/>'
    return own, joint(j.name, body.parent, body.name, "revolute", rest)


def through_urdf(robot: RobotDescription, folder: Path, rng: np.random.Generator, shuffle: bool) -> RobotDescription:
    """The robot written as URDF and TOML additions, and read back."""
    parts = [part for body in robot.bodies for part in body_parts(body, rng) if part]
    if shuffle:
        parts = [parts[i] for i in rng.permutation(len(parts))]
    (folder / "robot.urdf").write_text(f'<robot name="x">{"".join(parts)}</robot>', encoding="utf-8")
    text = (resources.files("robots") / "data" / f"{robot.name}.toml").read_text(encoding="utf-8")
    settings = [f"[joint.{j.name}]\narmature = {j.armature}\nkp = {j.kp}\nkd = {j.kd}\n" for j in robot.joints]
    head = f'[robot]\nname = "{robot.name}"\ntitle = "{robot.title}"\nurdf = "robot.urdf"\n'
    path = folder / "robot.toml"
    path.write_text(head + "".join(settings) + text[text.index("[[frame]]") :], encoding="utf-8")
    return load_robot(path)


def test_built_in_robots_survive_the_way_through_a_urdf(robot: RobotDescription, tmp_path: Path) -> None:
    back = through_urdf(robot, tmp_path, np.random.default_rng(0), shuffle=False)
    assert back.joint_names == robot.joint_names
    for ours, theirs in zip(back.bodies, robot.bodies, strict=True):
        assert (ours.name, ours.parent, ours.mass) == (theirs.name, theirs.parent, theirs.mass)
        assert repr(ours.joint) == repr(theirs.joint)
        np.testing.assert_allclose(ours.inertia, theirs.inertia, rtol=0, atol=1e-15)
    assert back.self_collision_pairs == robot.self_collision_pairs
    np.testing.assert_array_equal(back.posture("standing").joints, robot.posture("standing").joints)


@pytest.mark.parametrize("seed", range(3))
def test_shuffled_urdf_is_the_same_robot(robot: RobotDescription, seed: int, tmp_path: Path) -> None:
    """Whatever the order in the file: branches stay whole; same dynamics as the original and as pinocchio's reading."""
    back = through_urdf(robot, tmp_path, np.random.default_rng(seed), shuffle=True)
    kin = Kinematics(back)
    assert_same_dynamics(kin, Kinematics(robot).model, seed)
    theirs = pin.buildModelFromUrdf(str(tmp_path / "robot.urdf"), pin.JointModelFreeFlyer())
    armature = {j.name: j.armature for j in back.joints}
    theirs.armature = np.array([0.0] * 6 + [armature[n] for n in list(theirs.names)[2:]])
    assert_same_dynamics(kin, theirs, seed)
    model = build_mujoco_spec(back).compile()
    assert [model.joint(i).name for i in range(1, model.njnt)] == list(back.joint_names)
