"""Every bad description is refused, with the file, the entry and what is allowed."""

import dataclasses
import json
import math
import tomllib
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robots.description import ROLES, RobotDescription
from robots.errors import DescriptionError, SafeWbcError, UnknownNameError
from robots.loader import load_robot

Table = dict[str, Any]
Change = Callable[[Table], None]

KNEE, THIGH = "left_knee_link", "left_hip_yaw_link"


def to_toml(value: Any) -> str:
    """A value as TOML on one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(k)} = {to_toml(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(to_toml(v) for v in value) + "]"
    return str(value) if isinstance(value, float) else json.dumps(value)


def g1_table() -> Table:
    return tomllib.loads((resources.files("robots") / "data" / "g1.toml").read_text(encoding="utf-8"))


def write(path: Path, table: Table) -> Path:
    path.write_text("\n".join(f"{key} = {to_toml(value)}" for key, value in table.items()), encoding="utf-8")
    return path


def load_changed(folder: Path, change: Change) -> RobotDescription:
    table = g1_table()
    change(table)
    return load_robot(write(folder / "changed.toml", table))


def entry(table: Table, kind: str, name: str) -> Table:
    found: list[Table] = [x for x in table[kind] if x["name"] == name]
    return found[0]


def set_in(kind: str, name: str, key: str, value: Any) -> Change:
    """Sets a key of a named body, frame, collision body or workspace bound."""
    return lambda table: entry(table, kind, name).__setitem__(key, value)


def set_joint(key: str, value: Any) -> Change:
    """Sets a key of the left knee."""
    return lambda table: entry(table, "body", "left_knee_link")["joint"].__setitem__(key, value)


def set_top(*keys_and_value: Any) -> Change:
    """Sets a key of a table in the file, by its path."""
    *path, last, value = keys_and_value

    def change(table: Table) -> None:
        for key in path:
            table = table[key]
        table[last] = value

    return change


def remove(*path: Any) -> Change:
    def change(table: Table) -> None:
        for key in path[:-1]:
            table = table[key]
        del table[path[-1]]

    return change


def move_body(name: str, place: int) -> Change:
    def change(table: Table) -> None:
        body = entry(table, "body", name)
        table["body"].remove(body)
        table["body"].insert(place, body)

    return change


def repeat(kind: str) -> Change:
    return lambda table: table[kind].append(table[kind][-1])


def empty(table: Table) -> None:
    table.update(body=[], posture={"standing": {"base_height": 1.0}})


def base_alone(table: Table) -> None:
    empty(table)
    table["body"] = g1_table()["body"][:1]


def jointed_base(table: Table) -> None:
    table["body"][0]["joint"] = table["body"][1]["joint"] | {"name": "extra_joint"}


def rename_joint(name: str) -> Change:
    """Renames one that no posture names."""
    return lambda table: entry(table, "body", THIGH)["joint"].__setitem__("name", name)


def add_pair(*names: str) -> Change:
    return lambda table: table["self_collision"]["pairs"].append(list(names))


def cut_root(table: Table) -> None:
    del entry(table, "body", "torso_link")["parent"]


PLATE = [0.01, 0.01, 0.03, 0.0, 0.0, 0.0]
NAN, INF = math.nan, math.inf

BAD: dict[str, tuple[Change, str, str]] = {
    # name: (change, part of the entry named, part of what is allowed)
    "unknown parent": (set_in("body", KNEE, "parent", "tail"), f"body '{KNEE}': parent", "name of a body"),
    "cycle": (set_in("body", "left_hip_roll_link", "parent", KNEE), "chain of parents", "without a cycle"),
    "own parent": (set_in("body", KNEE, "parent", KNEE), f"body '{KNEE}': chain of parents", "without a cycle"),
    "two roots": (cut_root, "bodies without a parent", "exactly one"),
    "no root": (set_in("body", "pelvis", "parent", KNEE), "bodies without a parent", "exactly one"),
    "no bodies": (empty, "body", "at least one"),
    "no joints": (base_alone, "moving joints", "at least one"),
    "child before parent": (move_body(KNEE, 1), f"body '{KNEE}': parent", "before its children"),
    "interleaved": (move_body("left_ankle_roll_link", 12), "'left_ankle_roll_link': parent", "branch is listed whole"),
    "base with a joint": (jointed_base, "body 'pelvis': joint", "absent"),
    "no joint": (lambda t: entry(t, "body", THIGH).pop("joint"), f"body '{THIGH}': joint", "given for every"),
    "zero mass": (set_in("body", KNEE, "mass", 0.0), f"body '{KNEE}': mass", "above 0"),
    "negative mass": (set_in("body", KNEE, "mass", -1.0), f"body '{KNEE}': mass", "above 0"),
    "NaN mass": (set_in("body", KNEE, "mass", NAN), f"body '{KNEE}': mass", "finite"),
    "mass as text": (set_in("body", KNEE, "mass", "1.9"), f"body '{KNEE}': mass", "a number"),
    "mass as truth": (set_in("body", KNEE, "mass", True), f"body '{KNEE}': mass", "a number"),
    "no mass": (lambda t: entry(t, "body", KNEE).pop("mass"), f"body '{KNEE}': mass", "given"),
    "NaN in com": (set_in("body", KNEE, "com", [0.0, NAN, 0.0]), f"body '{KNEE}': com", "finite"),
    "com too short": (set_in("body", KNEE, "com", [0.0, 0.0]), f"body '{KNEE}': com", "3 numbers"),
    "infinite inertia": (set_in("body", KNEE, "inertia", [INF, 1.0, 1.0, 0.0, 0.0, 0.0]), "inertia", "finite"),
    "flat inertia": (set_in("body", KNEE, "inertia", [0.0, 1.0, 1.0, 0.0, 0.0, 0.0]), "principal", "above 0"),
    "triangle inequality": (set_in("body", KNEE, "inertia", PLATE), "principal inertias", "two smaller sum"),
    "limits reversed": (set_joint("position", [1.0, -1.0]), "'left_knee_joint': position", "lower < upper"),
    "limits equal": (set_joint("position", [1.0, 1.0]), "'left_knee_joint': position", "lower < upper"),
    "limits not finite": (set_joint("position", [-INF, INF]), "'left_knee_joint': position", "finite"),
    "axis not unit": (set_joint("axis", [0.0, 2.0, 0.0]), "'left_knee_joint': axis", "unit vector"),
    "axis zero": (set_joint("axis", [0.0, 0.0, 0.0]), "'left_knee_joint': axis", "unit vector"),
    "axis NaN": (set_joint("axis", [0.0, NAN, 0.0]), "'left_knee_joint': axis", "unit vector"),
    "origin NaN": (set_joint("xyz", [0.0, NAN, 0.0]), "'left_knee_joint': xyz", "finite"),
    "joint type": (set_joint("type", "ball"), "'left_knee_joint': type", "'revolute' or 'fixed'"),
    "no speed": (set_joint("velocity", 0.0), "'left_knee_joint': velocity", "above 0"),
    "no effort": (set_joint("effort", 0.0), "'left_knee_joint': effort", "above 0"),
    "negative armature": (set_joint("armature", -0.1), "'left_knee_joint': armature", "0 or above"),
    "NaN damping": (set_joint("damping", NAN), "'left_knee_joint': damping", "finite"),
    "misspelt joint key": (set_joint("friction_los", 0.1), "'left_knee_joint': keys", "friction_loss"),
    "misspelt body key": (set_in("body", KNEE, "weight", 1.0), f"body '{KNEE}': keys", "mass"),
    "body twice": (repeat("body"), "body name", "one body only"),
    "joint twice": (rename_joint("left_hip_roll_joint"), "joint name", "one joint only"),
    "frame twice": (repeat("frame"), "frame name", "one frame only"),
    "collision twice": (repeat("collision"), "collision name", "one collision only"),
    "workspace twice": (repeat("workspace"), "workspace name", "one workspace only"),
    "reserved body": (set_in("body", "pelvis", "name", "world"), "body name", "none of"),
    "reserved joint": (rename_joint("root_joint"), "joint name", "none of"),
    "frame on nothing": (set_in("frame", "torso", "body", "tail"), "frame 'torso': body", "name of a body"),
    "frame beside its body": (set_in("frame", "pelvis", "xyz", [0.1, 0.0, 0.0]), "frame 'pelvis'", "at its origin"),
    "frame NaN": (set_in("frame", "torso", "rpy", [NAN, 0.0, 0.0]), "frame 'torso'", "finite"),
    "role to nothing": (set_top("roles", "torso", "tail"), "roles: torso", "name of a frame"),
    "role unknown": (set_top("roles", "tail", "torso"), "roles", "left_shoulder"),
    "role missing": (remove("roles", "imu"), "roles: missing", "imu"),
    "role as list": (set_top("roles", "imu", ["pelvis"]), "roles: imu", "as str"),
    "collision on nothing": (set_in("collision", "head", "body", "tail"), "collision 'head': body", "name of a body"),
    "radius zero": (set_in("collision", "head", "radius", 0.0), "collision 'head': radius", "above 0"),
    "end NaN": (set_in("collision", "head", "end", [0.0, 0.0, NAN]), "collision 'head': start, end", "finite"),
    "pair of unknown": (add_pair("head", "tail"), "['head', 'tail']", "names of collision bodies"),
    "pair on one body": (add_pair("head", "torso_low"), "['head', 'torso_low']", "two different bodies"),
    "pair of one": (add_pair("head"), "self_collision", "two names"),
    "misspelt pairs": (set_top("self_collision", "pair", []), "self_collision: keys", "pairs"),
    "workspace unknown": (set_in("workspace", "left_reach", "frame_b", "tail"), "workspace 'left_reach'", "of frames"),
    "workspace zero": (set_in("workspace", "left_reach", "d_max", 0.0), "workspace 'left_reach': d_max", "above 0"),
    "one sole": (lambda t: t["sole"].pop(), "sole", "left_sole and right_sole"),
    "soles swapped": (lambda t: t["sole"].reverse(), "sole", "in this order"),
    "sole elsewhere": (set_top("sole", 0, "frame", "torso"), "sole", "left_sole and right_sole"),
    "sole too narrow": (set_top("sole", 0, "half_width", -0.1), "sole 'left_sole': half sizes", "above 0"),
    "no standing posture": (set_top("posture", {}), "postures", "'standing'"),
    "posture of unknown joint": (set_top("posture", "standing", "joints", "tail", 0.0), "joints", "left_knee_joint"),
    "posture outside limits": (set_top("posture", "standing", "joints", "left_knee_joint", 3.0), "left_knee", "within"),
    "posture NaN": (set_top("posture", "standing", "joints", "left_knee_joint", NAN), "left_knee_joint", "within"),
    "height infinite": (set_top("posture", "standing", "base_height", INF), "'standing': base_height", "finite"),
    "misspelt posture": (set_top("posture", "standing", "joint", {}), "posture 'standing': keys", "joints"),
    "unknown table": (set_top("bodies", []), "tables", "body"),
    "no name": (remove("robot", "name"), "robot: name", "given"),
    "no head": (remove("robot"), "robot: name", "given"),
    "misspelt head": (set_top("robot", "tittle", "x"), "robot: keys", "title"),
    "title as number": (set_top("robot", "title", 1), "robot: title", "as str"),
    "joint table without urdf": (set_top("joint", {}), "joint", "inside [[body]]"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_description_is_refused(case: str, tmp_path: Path) -> None:
    change, where, allowed = BAD[case]
    with pytest.raises(DescriptionError) as caught:
        load_changed(tmp_path, change)
    error = caught.value
    assert "changed.toml" in error.file
    assert where in error.entry
    assert allowed in error.allowed
    assert all(part in str(error) for part in (error.file, error.entry, error.allowed))


TABLES = ("robot", "body", "frame", "sole", "roles", "collision", "self_collision", "workspace", "posture", "tuning")


@pytest.mark.parametrize("key", TABLES)
@pytest.mark.parametrize("value", [1.0, "text", ["text"]])
def test_table_of_the_wrong_kind_is_refused(key: str, value: Any, tmp_path: Path) -> None:
    with pytest.raises(DescriptionError) as caught:
        load_changed(tmp_path, set_top(key, value))
    assert key in caught.value.entry


def test_the_unchanged_table_loads_and_equals_the_built_in_robot(tmp_path: Path) -> None:
    """So that the cases above fail for their change, not for the way they are written out."""
    ours, built_in = load_changed(tmp_path, lambda table: None), load_robot("g1")
    for field in dataclasses.fields(RobotDescription):
        if field.name != "file":
            assert repr(getattr(ours, field.name)) == repr(getattr(built_in, field.name))


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match="readable") as caught:
        load_robot(tmp_path / "absent.toml")
    assert "absent.toml" in str(caught.value)


@pytest.mark.parametrize("content", [b"[robot\nname = 1", b"\xff\xfe\x00"])
def test_file_that_is_not_toml(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "broken.toml"
    path.write_bytes(content)
    with pytest.raises(DescriptionError, match="valid TOML") as caught:
        load_robot(path)
    assert "broken.toml" in str(caught.value)


@pytest.mark.parametrize("name", ["atlas", "", "robot.urdf"])
def test_unknown_robot_lists_the_known_ones(name: str) -> None:
    with pytest.raises(UnknownNameError) as caught:
        load_robot(name)
    assert caught.value.known[:2] == ["g1", "tocabi"]
    assert str(caught.value).startswith(f"unknown robot {name!r}: known are g1, tocabi, ")


def test_errors_are_of_one_family() -> None:
    assert issubclass(DescriptionError, SafeWbcError)
    assert issubclass(DescriptionError, ValueError)
    assert issubclass(UnknownNameError, SafeWbcError)
    assert issubclass(UnknownNameError, KeyError)


def test_posture_of_the_wrong_length_is_refused(robot: RobotDescription) -> None:
    short = dataclasses.replace(robot.posture("standing"), joints=np.zeros(3))
    with pytest.raises(DescriptionError, match="'standing': joints"):
        dataclasses.replace(robot, postures={"standing": short})


def test_built_in_robots_are_complete(robot: RobotDescription) -> None:
    assert set(robot.roles) == set(ROLES)
    assert [s.frame for s in robot.soles] == [robot.roles["left_sole"], robot.roles["right_sole"]]
    assert robot.frame(robot.roles["base"]).body == robot.bodies[0].name
    assert len(robot.joint_names) == {"g1": 29, "tocabi": 33}[robot.name]
    assert set(robot.leg_pairs) <= set(robot.self_collision_pairs)
    assert len(set(map(frozenset, robot.self_collision_pairs))) == len(robot.self_collision_pairs)


def test_lookups_name_what_is_known(robot: RobotDescription) -> None:
    with pytest.raises(UnknownNameError, match=r"unknown frame 'tail': known are .*torso"):
        robot.frame("tail")
    with pytest.raises(DescriptionError) as caught:
        robot.posture("flying")
    for part in (robot.file, "posture = 'flying'", "hands_front, standing", "[posture.flying]"):
        assert part in str(caught.value)
