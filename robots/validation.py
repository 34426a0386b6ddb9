"""What a robot description must satisfy before anything is built from it."""

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from robots.errors import DescriptionError

if TYPE_CHECKING:
    from robots.description import Body, Joint, RobotDescription

TRIANGLE_TOLERANCE = 1e-6
"""Relative slack of the triangle inequality of principal inertias (published values are rounded)."""

RESERVED = ("", "world", "universe", "root_joint")
"""Names that pinocchio and MuJoCo give to the ground and to the base's free joint, or to nothing."""


def validate(robot: "RobotDescription", known_roles: tuple[str, ...]) -> None:
    """Check tree, inertias, limits, frames, roles, collision bodies and postures.

    Args:
        robot: the description.
        known_roles: the roles that a description must fill, and may.

    Raises:
        DescriptionError: the first entry found that is not allowed.
    """
    _check_unique(robot, "body", (b.name for b in robot.bodies))
    _check_unique(robot, "joint", (b.joint.name for b in robot.bodies if b.joint))
    _check_unique(robot, "frame", (f.name for f in robot.frames))
    _check_unique(robot, "collision", (c.name for c in robot.collisions))
    _check_unique(robot, "workspace", (w.name for w in robot.workspace))
    _check_tree(robot)
    for body in robot.bodies:
        _check_inertia(robot, body)
        if body.joint is not None:
            _check_joint(robot, body.joint)
    if not robot.joints:
        _fail(robot, "moving joints", [], "at least one")
    _check_references(robot)
    _check_roles(robot, known_roles)
    _check_shapes(robot)
    _check_postures(robot)


def _fail(robot: "RobotDescription", entry: str, value: object, allowed: str) -> None:
    raise DescriptionError(robot.file, entry, value, allowed)


def _check_unique(robot: "RobotDescription", kind: str, names: Iterable[str]) -> None:
    seen: set[str] = set()
    for name in names:
        if name in RESERVED:
            _fail(robot, f"{kind} name", name, "none of " + ", ".join(RESERVED) + ", which the models use themselves")
        if name in seen:
            _fail(robot, f"{kind} name", name, f"used by one {kind} only")
        seen.add(name)


def _check_tree(robot: "RobotDescription") -> None:
    if not robot.bodies:
        _fail(robot, "body", [], "at least one body")
    parents = {b.name: b.parent for b in robot.bodies}
    roots = [b.name for b in robot.bodies if b.parent is None]
    if len(roots) != 1:
        _fail(robot, "bodies without a parent", roots, "exactly one, the base (check for a cycle)")
    for body in robot.bodies:
        if body.parent is None:
            if body.joint is not None:
                _fail(robot, f"body '{body.name}': joint", body.joint.name, "absent for the base, which floats freely")
            continue
        if body.parent not in parents:
            _fail(robot, f"body '{body.name}': parent", body.parent, "the name of a body in this file")
        if body.joint is None:
            _fail(robot, f"body '{body.name}': joint", None, "given for every body but the base")
        _check_acyclic(robot, body.name, parents)
    _check_order(robot)


def _check_acyclic(robot: "RobotDescription", name: str, parents: dict[str, str | None]) -> None:
    path = [name]
    while (up := parents[path[-1]]) is not None:
        if up in path:
            _fail(
                robot, f"body '{name}': chain of parents", [*path, up], "a tree that ends at the base, without a cycle"
            )
        path.append(up)
        if up not in parents:
            return


def _check_order(robot: "RobotDescription") -> None:
    """Depth first: pinocchio and MuJoCo index a branch by one range of joints, and MuJoCo re-orders what is not so."""
    seen: set[str] = set()
    branch: list[str] = []
    for body in robot.bodies:
        entry = f"body '{body.name}': parent"
        if body.parent is not None and body.parent not in seen:
            _fail(robot, entry, body.parent, "a body listed before its children")
        if body.parent is not None and body.parent not in branch:
            _fail(robot, entry, body.parent, "a body whose branch is listed whole, without another one in between")
        while branch and branch[-1] != body.parent:
            branch.pop()
        branch.append(body.name)
        seen.add(body.name)


def _check_inertia(robot: "RobotDescription", body: "Body") -> None:
    entry = f"body '{body.name}'"
    if not (np.isfinite(body.mass) and body.mass > 0):
        _fail(robot, f"{entry}: mass", body.mass, "a finite number above 0 [kg]")
    if not (np.isfinite(body.com).all() and np.isfinite(body.inertia).all()):
        _fail(robot, f"{entry}: com, inertia", (body.com.tolist(), body.inertia.tolist()), "finite")
    principal = np.linalg.eigvalsh(body.inertia)
    if principal[0] <= 0:
        _fail(robot, f"{entry}: principal inertias", principal.tolist(), "above 0 [kg m^2]")
    if principal[0] + principal[1] < principal[2] * (1 - TRIANGLE_TOLERANCE):
        _fail(
            robot,
            f"{entry}: principal inertias",
            principal.tolist(),
            "such that the two smaller sum to at least the largest (is rotor inertia baked in? give it as armature)",
        )


def _check_joint(robot: "RobotDescription", joint: "Joint") -> None:
    entry = f"joint '{joint.name}'"
    if not (np.isfinite(joint.xyz).all() and np.isfinite(joint.rpy).all()):
        _fail(robot, f"{entry}: xyz, rpy", (joint.xyz.tolist(), joint.rpy.tolist()), "finite")
    if joint.fixed:
        return
    if not abs(float(np.linalg.norm(joint.axis)) - 1) <= 1e-9:
        _fail(robot, f"{entry}: axis", joint.axis.tolist(), "a unit vector")
    lower, upper = joint.position
    if not (np.isfinite(lower) and np.isfinite(upper) and lower < upper):
        _fail(robot, f"{entry}: position", [lower, upper], "finite [lower, upper] with lower < upper [rad]")
    for name in ("velocity", "effort"):
        if not (np.isfinite(getattr(joint, name)) and getattr(joint, name) > 0):
            _fail(robot, f"{entry}: {name}", getattr(joint, name), "a finite number above 0")
    for name in ("armature", "damping", "friction_loss", "kp", "kd"):
        if not (np.isfinite(getattr(joint, name)) and getattr(joint, name) >= 0):
            _fail(robot, f"{entry}: {name}", getattr(joint, name), "a finite number, 0 or above")


def _check_references(robot: "RobotDescription") -> None:
    bodies = {b.name for b in robot.bodies}
    frames = {f.name for f in robot.frames}
    shapes = {c.name for c in robot.collisions}
    for frame in robot.frames:
        if frame.body not in bodies:
            _fail(robot, f"frame '{frame.name}': body", frame.body, "the name of a body in this file")
        if frame.name in bodies and (frame.body != frame.name or frame.xyz.any() or frame.rpy.any()):
            place = (frame.body, frame.xyz.tolist(), frame.rpy.tolist())
            _fail(robot, f"frame '{frame.name}': body, xyz, rpy", place, "the body of that name, at its origin")
        if not (np.isfinite(frame.xyz).all() and np.isfinite(frame.rpy).all()):
            _fail(robot, f"frame '{frame.name}': xyz, rpy", (frame.xyz.tolist(), frame.rpy.tolist()), "finite")
    for shape in robot.collisions:
        if shape.body not in bodies:
            _fail(robot, f"collision '{shape.name}': body", shape.body, "the name of a body in this file")
    for pair in robot.self_collision_pairs:
        if unknown := [n for n in pair if n not in shapes]:
            _fail(robot, f"self_collision pair {list(pair)}", unknown, "names of collision bodies in this file")
    for bound in robot.workspace:
        if unknown := [n for n in (bound.frame_a, bound.frame_b) if n not in frames]:
            _fail(robot, f"workspace '{bound.name}': frames", unknown, "names of frames in this file")


def _check_roles(robot: "RobotDescription", known: tuple[str, ...]) -> None:
    frames = {f.name for f in robot.frames}
    for role, frame_name in robot.roles.items():
        if role not in known:
            _fail(robot, "roles", role, "one of " + ", ".join(known))
        if frame_name not in frames:
            _fail(robot, f"roles: {role}", frame_name, "the name of a frame in this file")
    if missing := [r for r in known if r not in robot.roles]:
        _fail(robot, "roles: missing", missing, "all given: " + ", ".join(known))


def _check_shapes(robot: "RobotDescription") -> None:
    home = {c.name: c.body for c in robot.collisions}
    for shape in robot.collisions:
        if not (np.isfinite(shape.radius) and shape.radius > 0):
            _fail(robot, f"collision '{shape.name}': radius", shape.radius, "a finite number above 0 [m]")
        if not (np.isfinite(shape.start).all() and np.isfinite(shape.end).all()):
            _fail(robot, f"collision '{shape.name}': start, end", (shape.start.tolist(), shape.end.tolist()), "finite")
    for a, b in robot.self_collision_pairs:
        if home[a] == home[b]:
            _fail(robot, f"self_collision pair ['{a}', '{b}']", home[a], "on two different bodies")
    for bound in robot.workspace:
        if not (np.isfinite(bound.d_max) and bound.d_max > 0):
            _fail(robot, f"workspace '{bound.name}': d_max", bound.d_max, "a finite number above 0 [m]")
    if [s.frame for s in robot.soles] != [robot.roles["left_sole"], robot.roles["right_sole"]]:
        _fail(
            robot, "sole", [s.frame for s in robot.soles], "the frames of roles left_sole and right_sole, in this order"
        )
    for sole in robot.soles:
        if not (np.isfinite([sole.half_length, sole.half_width]).all() and min(sole.half_length, sole.half_width) > 0):
            _fail(robot, f"sole '{sole.frame}': half sizes", [sole.half_length, sole.half_width], "above 0 [m]")


def _check_postures(robot: "RobotDescription") -> None:
    if "standing" not in robot.postures:
        _fail(robot, "postures", sorted(robot.postures), "among them 'standing'")
    lower, upper = robot.position_limits
    for name, posture in robot.postures.items():
        if not np.isfinite(posture.base_height):
            _fail(robot, f"posture '{name}': base_height", posture.base_height, "a finite number [m]")
        if posture.joints.shape != lower.shape:
            _fail(robot, f"posture '{name}': joints", posture.joints.shape, f"of shape {lower.shape}")
        for i, joint in enumerate(robot.joint_names):
            if not lower[i] <= posture.joints[i] <= upper[i]:
                allowed = f"within the joint's limits [{lower[i]:g}, {upper[i]:g}] rad"
                _fail(robot, f"posture '{name}': {joint}", float(posture.joints[i]), allowed)
