"""Reads robot descriptions: the two that come with the project, a user's own file, or a URDF with additions."""

import dataclasses
import tomllib
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from robots.description import (
    Body,
    CollisionShape,
    Frame,
    Joint,
    Posture,
    RobotDescription,
    Sole,
    WorkspaceBound,
)
from robots.errors import DescriptionError, UnknownNameError
from robots.messages import Array
from robots.urdf import load_urdf_bodies

BUILT_IN = ("g1", "tocabi")
JOINT_NUMBERS = ("velocity", "effort", "armature", "damping", "friction_loss", "kp", "kd")
TABLES = {
    "robot",
    "body",
    "joint",
    "frame",
    "sole",
    "roles",
    "collision",
    "self_collision",
    "workspace",
    "posture",
    "tuning",
}


def load_robot(name_or_path: str | Path) -> RobotDescription:
    """Load a robot description.

    Args:
        name_or_path: ``g1``, ``tocabi``, or the path of a ``.toml`` description (see ``docs/robots.md``).

    Returns:
        The checked description.

    Raises:
        UnknownNameError: neither a built-in name nor a ``.toml`` path.
        DescriptionError: the file is missing, is not TOML, or holds an entry that is not allowed.
    """
    if str(name_or_path) in BUILT_IN:
        with resources.as_file(resources.files("robots") / "data" / f"{name_or_path}.toml") as path:
            return _read(path)
    path = Path(name_or_path)
    if path.suffix != ".toml":
        raise UnknownNameError("robot", str(name_or_path), [*BUILT_IN, "or the path of a .toml description"])
    return _read(path)


Pairs = tuple[tuple[str, str], ...]


def read_collisions(path: Path) -> tuple[tuple[CollisionShape, ...], Pairs, Pairs]:
    """The collision bodies of a file that holds nothing else, its self-collision pairs, and among those the legs'.

    Raises:
        DescriptionError: the file is missing, is not TOML, or holds an entry that is not allowed.
    """
    reader = _Reader(path, _parse(path))
    shapes = tuple(reader._collision(c) for c in reader._tables("collision"))
    return shapes, reader._pairs("pairs") + reader._pairs("leg_pairs"), reader._pairs("leg_pairs")


def _read(path: Path) -> RobotDescription:
    return _Reader(path, _parse(path)).description()


def _parse(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise DescriptionError(path, "file", str(path), f"readable ({error.strerror})") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise DescriptionError(path, "file", str(path), f"valid TOML ({error})") from error


class _Reader:
    """Turns the tables of one file into a description, naming the entry in every error."""

    def __init__(self, path: Path, table: Mapping[str, Any]) -> None:
        self.path = path
        self.table = table
        if unknown := sorted(set(table) - TABLES):
            raise DescriptionError(path, "tables", unknown, "among " + ", ".join(sorted(TABLES)))

    def description(self) -> RobotDescription:
        """The whole file as a checked description."""
        head = self._table("robot", ("name", "title", "urdf"))
        name = self._get(head, "name", "robot", str)
        bodies = self._bodies(head)
        joints = [b.joint.name for b in bodies if b.joint is not None and not b.joint.fixed]
        pairs, leg_pairs = self._pairs("pairs"), self._pairs("leg_pairs")
        return RobotDescription(
            name=name,
            title=self._get({"title": name} | dict(head), "title", "robot", str),
            file=str(self.path.name),
            bodies=bodies,
            frames=tuple(self._frame(f) for f in self._tables("frame")),
            soles=tuple(self._sole(s) for s in self._tables("sole")),
            roles={r: self._get(self._table("roles"), r, "roles", str) for r in self._table("roles")},
            collisions=tuple(self._collision(c) for c in self._tables("collision")),
            self_collision_pairs=pairs + leg_pairs,
            leg_pairs=leg_pairs,
            workspace=tuple(self._workspace(w) for w in self._tables("workspace")),
            postures={n: self._posture(n, joints) for n in self._table("posture")},
            tuning={n: self._get(self._table("tuning"), n, "tuning", dict) for n in self._table("tuning")},
        )

    def _bodies(self, head: Mapping[str, Any]) -> tuple[Body, ...]:
        if "urdf" not in head:
            if "joint" in self.table:
                raise DescriptionError(self.path, "joint", "given", "inside [[body]] where [robot] names no urdf")
            return tuple(self._body(b) for b in self._tables("body"))
        if "body" in self.table:
            raise DescriptionError(self.path, "body", "given", "absent where [robot] names a urdf")
        bodies = load_urdf_bodies(self.path.parent / self._get(head, "urdf", "robot", str))
        return self._with_joint_settings(bodies)

    def _with_joint_settings(self, bodies: tuple[Body, ...]) -> tuple[Body, ...]:
        """Joint settings that a URDF cannot hold (armature, gains), by joint name, laid over its joints."""
        settings = {n: self._get(self._table("joint"), n, "joint", dict) for n in self._table("joint")}
        out = []
        for body in bodies:
            joint = body.joint
            if joint is not None and joint.name in settings:
                entry = settings.pop(joint.name)
                merged = {k: getattr(joint, k) for k in Joint.__slots__} | self._joint_settings(joint.name, entry)
                out.append(dataclasses.replace(body, joint=Joint(**merged)))
            else:
                out.append(body)
        if settings:
            known = [b.joint.name for b in bodies if b.joint is not None]
            raise DescriptionError(self.path, "joint", sorted(settings), "joints of the URDF: " + ", ".join(known))
        return tuple(out)

    def _joint_settings(self, name: str, entry: Mapping[str, Any]) -> dict[str, Any]:
        self._only(entry, f"joint '{name}'", (*JOINT_NUMBERS, "position"))
        out: dict[str, Any] = {k: self._number(entry, k, f"joint '{name}'") for k in JOINT_NUMBERS if k in entry}
        if "position" in entry:
            out["position"] = tuple(self._vector(entry, "position", f"joint '{name}'", 2).tolist())
        return out

    def _body(self, table: Mapping[str, Any]) -> Body:
        name = self._get(table, "name", "body", str)
        entry = f"body '{name}'"
        self._only(table, entry, ("name", "parent", "mass", "com", "inertia", "joint"))
        ixx, iyy, izz, ixy, ixz, iyz = self._vector(table, "inertia", entry, 6)
        return Body(
            name=name,
            mass=self._number(table, "mass", entry),
            com=self._vector(table, "com", entry, 3),
            inertia=np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]]),
            parent=self._get(table, "parent", entry, str) if "parent" in table else None,
            joint=self._joint(self._get(table, "joint", entry, dict), entry) if "joint" in table else None,
        )

    def _joint(self, table: Mapping[str, Any], body_entry: str) -> Joint:
        name = self._get(table, "name", f"{body_entry}: joint", str)
        entry = f"joint '{name}'"
        self._only(table, entry, ("name", "type", "xyz", "rpy", "axis", "position", *JOINT_NUMBERS))
        xyz, rpy = (self._vector(table, k, entry, 3) for k in ("xyz", "rpy"))
        kind = table.get("type", "revolute")
        if kind == "fixed":
            return Joint(name, xyz, rpy, axis=np.zeros(3))
        if kind != "revolute":
            raise DescriptionError(self.path, f"{entry}: type", kind, "'revolute' or 'fixed'")
        lower, upper = self._vector(table, "position", entry, 2)
        numbers: dict[str, Any] = {k: self._number(table, k, entry) for k in JOINT_NUMBERS}
        axis = self._vector(table, "axis", entry, 3)
        if not axis.any():
            raise DescriptionError(self.path, f"{entry}: axis", axis.tolist(), "a unit vector")
        return Joint(name, xyz, rpy, axis, position=(float(lower), float(upper)), **numbers)

    def _frame(self, table: Mapping[str, Any]) -> Frame:
        name = self._get(table, "name", "frame", str)
        entry = f"frame '{name}'"
        self._only(table, entry, ("name", "body", "xyz", "rpy"))
        body = self._get(table, "body", entry, str)
        return Frame(name, body, self._vector(table, "xyz", entry, 3), self._vector(table, "rpy", entry, 3))

    def _sole(self, table: Mapping[str, Any]) -> Sole:
        frame = self._get(table, "frame", "sole", str)
        entry = f"sole '{frame}'"
        self._only(table, entry, ("frame", "half_length", "half_width"))
        return Sole(frame, self._number(table, "half_length", entry), self._number(table, "half_width", entry))

    def _collision(self, table: Mapping[str, Any]) -> CollisionShape:
        name = self._get(table, "name", "collision", str)
        entry = f"collision '{name}'"
        body = self._get(table, "body", entry, str)
        start_key, end_key = ("center", "center") if "center" in table else ("start", "end")
        self._only(table, entry, ("name", "body", start_key, end_key, "radius"))
        start, end = (self._vector(table, k, entry, 3) for k in (start_key, end_key))
        return CollisionShape(name, body, start, end, self._number(table, "radius", entry))

    def _pairs(self, key: str) -> tuple[tuple[str, str], ...]:
        table = {key: []} | dict(self._table("self_collision", ("pairs", "leg_pairs")))
        return tuple(self._pair(p) for p in self._get(table, key, "self_collision", list))

    def _pair(self, pair: Any) -> tuple[str, str]:
        if not (isinstance(pair, list) and len(pair) == 2 and all(isinstance(n, str) for n in pair)):
            raise DescriptionError(self.path, "self_collision: pair", pair, "two names of collision bodies")
        return pair[0], pair[1]

    def _workspace(self, table: Mapping[str, Any]) -> WorkspaceBound:
        name = self._get(table, "name", "workspace", str)
        entry = f"workspace '{name}'"
        self._only(table, entry, ("name", "frame_a", "frame_b", "d_max"))
        a, b = (self._get(table, k, entry, str) for k in ("frame_a", "frame_b"))
        return WorkspaceBound(name, a, b, self._number(table, "d_max", entry))

    def _posture(self, name: str, joints: list[str]) -> Posture:
        entry = f"posture '{name}'"
        table = self._get(self._table("posture"), name, "posture", dict)
        self._only(table, entry, ("base_height", "joints"))
        given = self._get({"joints": {}} | table, "joints", entry, dict)
        if unknown := sorted(set(given) - set(joints)):
            raise DescriptionError(self.path, f"{entry}: joints", unknown, "joints of this robot: " + ", ".join(joints))
        angles = [self._number(given, j, entry) if j in given else 0.0 for j in joints]
        return Posture(self._number(table, "base_height", entry), np.array(angles))

    def _table(self, key: str, known: tuple[str, ...] | None = None) -> Mapping[str, Any]:
        """The table ``[key]`` of the file, empty if it is not there."""
        table: Mapping[str, Any] = self._get({key: {}} | dict(self.table), key, "file", dict)
        if known is not None:
            self._only(table, key, known)
        return table

    def _tables(self, key: str) -> list[Mapping[str, Any]]:
        """The tables ``[[key]]`` of the file."""
        value = self.table.get(key, [])
        if not (isinstance(value, list) and all(isinstance(t, dict) for t in value)):
            raise DescriptionError(self.path, key, value, f"tables, each headed [[{key}]]")
        return value

    def _only(self, table: Mapping[str, Any], entry: str, known: tuple[str, ...]) -> None:
        """Refuse a key that nobody reads: it is a misspelt one, whose default would be used in silence."""
        if unknown := sorted(set(table) - set(known)):
            raise DescriptionError(self.path, f"{entry}: keys", unknown, "among " + ", ".join(dict.fromkeys(known)))

    def _get(self, table: Mapping[str, Any], key: str, entry: str, kind: type) -> Any:
        if not isinstance(table.get(key), kind):
            raise DescriptionError(self.path, f"{entry}: {key}", table.get(key), f"given, as {kind.__name__}")
        return table[key]

    def _number(self, table: Mapping[str, Any], key: str, entry: str) -> float:
        value = table.get(key)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise DescriptionError(self.path, f"{entry}: {key}", value, "given, as a number")
        return float(value)

    def _vector(self, table: Mapping[str, Any], key: str, entry: str, length: int) -> Array:
        value = table.get(key)
        is_list = isinstance(value, list) and len(value) == length
        if not (is_list and all(isinstance(x, int | float) and not isinstance(x, bool) for x in value or [])):
            raise DescriptionError(self.path, f"{entry}: {key}", value, f"a list of {length} numbers")
        return np.array(value, dtype=float)
