"""The pinocchio model of a robot description: on a floating, planar or fixed base, with all or some joints moving."""

from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin

from robots.checks import require_one_of
from robots.description import Joint, RobotDescription
from robots.errors import ConfigError, UnknownNameError
from robots.messages import Array, Indices

BASE_SIZES = {"floating": (7, 6), "planar": (4, 3), "fixed": (0, 0)}
"""Kinds of base, and how many entries of q and of v each takes."""

ROOT_JOINTS = {"floating": pin.JointModelFreeFlyer, "planar": pin.JointModelPlanar}


def build_pinocchio_model(
    robot: RobotDescription, base: str = "floating", joints: Sequence[str] | None = None, posture: str = "standing"
) -> pin.Model:
    """Build the model: the base's joint, one revolute joint per joint that may move, rotor inertia as armature.

    Bodies on fixed and on locked joints are lumped into their parent (into the world where the base is fixed).
    Frames: one per body and one per named frame, the same whatever is locked. Where a named frame has a body's name,
    it stands for both.

    Args:
        robot: a checked description.
        base: ``floating``, q = [position in the world, quaternion x, y, z, w], v = [linear, angular] in the base's
            axes; ``planar``, q = [x, y, cos yaw, sin yaw], v = [vx, vy, wz] in the base's axes, upright at the
            posture's height; ``fixed``, upright at the posture's height over the world's origin.
        joints: names of the joints that may move, in any order; all of them if not given. The others are locked.
        posture: gives the height of a base that does not float, and the angles of the locked joints.

    Returns:
        The model; q and v hold the base's entries, then the joints that may move, in the order of ``robot.joints``.

    Raises:
        ConfigError: no such base, or nothing left that moves.
        UnknownNameError: no such joint.
        DescriptionError: no such posture.
    """
    require_one_of("base", base, tuple(BASE_SIZES))
    indices = moving_joint_indices(robot, joints)
    if base == "fixed" and not indices.size:
        raise ConfigError("joints", joints, "at least one joint where the base is fixed")
    chosen = robot.posture(posture)
    moving = {robot.joint_names[i] for i in indices}
    locked = {n: float(a) for n, a in zip(robot.joint_names, chosen.joints, strict=True) if n not in moving}
    model = pin.Model()
    model.name = robot.name
    place = {robot.bodies[0].name: _add_base(model, base, chosen.base_height)}
    for body in robot.bodies:
        if body.joint is not None:
            place[body.name] = _attach(model, place[body.parent or ""], body.joint, locked)
        joint_id, placement = place[body.name]
        model.appendBodyToJoint(joint_id, pin.Inertia(body.mass, body.com, body.inertia), placement)
    _add_frames(model, robot, place)
    model.armature = np.concatenate([np.zeros(BASE_SIZES[base][1]), robot.joint_array("armature")[indices]])
    return model


def moving_joint_indices(robot: RobotDescription, joints: Sequence[str] | None) -> Indices:
    """Places in ``robot.joints`` of the joints that may move, ascending, shape (nj,); all of them for ``None``.

    Raises:
        UnknownNameError: no such joint.
    """
    if joints is None:
        return np.arange(len(robot.joints))
    for name in joints:
        if name not in robot.joint_names:
            raise UnknownNameError("joint", name, list(robot.joint_names))
    return np.array([i for i, name in enumerate(robot.joint_names) if name in joints], dtype=np.intp)


def upper_body_joints(robot: RobotDescription) -> tuple[str, ...]:
    """Names of the moving joints that do not lie between the base and a sole, in the order of ``robot.joints``."""
    bodies = {b.name: b for b in robot.bodies}
    legs: set[str] = set()
    for sole in robot.soles:
        body = bodies[robot.frame(sole.frame).body]
        while body.joint is not None:
            legs.add(body.joint.name)
            body = bodies[body.parent or ""]
    return tuple(name for name in robot.joint_names if name not in legs)


def _add_base(model: pin.Model, base: str, height: float) -> tuple[int, pin.SE3]:
    """The joint that carries the base body, and the body's place in that joint's frame."""
    upright = pin.SE3(np.eye(3), np.array([0.0, 0.0, height]))
    if base == "fixed":
        return 0, upright
    origin = upright if base == "planar" else pin.SE3.Identity()
    return model.addJoint(0, ROOT_JOINTS[base](), origin, "root_joint"), pin.SE3.Identity()


def _attach(
    model: pin.Model, parent: tuple[int, pin.SE3], joint: Joint, locked: Mapping[str, float]
) -> tuple[int, pin.SE3]:
    parent_id, parent_placement = parent
    placement = parent_placement * pin.SE3(pin.rpy.rpyToMatrix(joint.rpy), joint.xyz)
    if joint.fixed:
        return parent_id, placement
    if joint.name in locked:
        return parent_id, placement * pin.SE3(pin.exp3(locked[joint.name] * joint.axis), np.zeros(3))
    joint_id = model.addJoint(parent_id, pin.JointModelRevoluteUnaligned(joint.axis), placement, joint.name)
    return joint_id, pin.SE3.Identity()


def _add_frames(model: pin.Model, robot: RobotDescription, place: dict[str, tuple[int, pin.SE3]]) -> None:
    named = {f.name for f in robot.frames}
    for body in robot.bodies:
        if body.name not in named:
            joint_id, placement = place[body.name]
            model.addFrame(pin.Frame(body.name, joint_id, placement, pin.FrameType.BODY), False)
    for frame in robot.frames:
        joint_id, placement = place[frame.body]
        offset = pin.SE3(pin.rpy.rpyToMatrix(frame.rpy), frame.xyz)
        model.addFrame(pin.Frame(frame.name, joint_id, placement * offset, pin.FrameType.OP_FRAME), False)


def standing_configuration(robot: RobotDescription, posture: str = "standing") -> Array:
    """Configuration (nq,) of a named posture: base upright over the origin at its height, pinocchio's order.

    Raises:
        DescriptionError: no such posture.
    """
    chosen = robot.posture(posture)
    return np.concatenate([[0.0, 0.0, chosen.base_height, 0.0, 0.0, 0.0, 1.0], chosen.joints])
