"""The pinocchio model of a robot description."""

import numpy as np
import pinocchio as pin

from robots.description import Joint, RobotDescription
from robots.messages import Array
from robots.rotation import rotation_from_rpy


def build_pinocchio_model(robot: RobotDescription) -> pin.Model:
    """Build the floating-base model: free-flyer root, one revolute joint per moving joint, rotor inertia as armature.

    Bodies on fixed joints are lumped into their parent. Frames: one per body and one per named frame. Where a named
    frame has a body's name, it stands for both.

    Args:
        robot: a checked description.

    Returns:
        The model; ``nq = 7 + nj``, ``nv = 6 + nj``, joints in the order of ``robot.joints``.
    """
    model = pin.Model()
    model.name = robot.name
    place: dict[str, tuple[int, pin.SE3]] = {}
    root = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root_joint")
    for body in robot.bodies:
        if body.joint is None:
            place[body.name] = (root, pin.SE3.Identity())
        else:
            place[body.name] = _attach(model, place[body.parent or ""], body.joint)
        joint_id, placement = place[body.name]
        model.appendBodyToJoint(joint_id, pin.Inertia(body.mass, body.com, body.inertia), placement)
    _add_frames(model, robot, place)
    armature = np.zeros(model.nv)
    armature[6:] = robot.joint_array("armature")
    model.armature = armature
    return model


def _attach(model: pin.Model, parent: tuple[int, pin.SE3], joint: Joint) -> tuple[int, pin.SE3]:
    parent_id, parent_placement = parent
    placement = parent_placement * pin.SE3(rotation_from_rpy(joint.rpy), joint.xyz)
    if joint.fixed:
        return parent_id, placement
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
        offset = pin.SE3(rotation_from_rpy(frame.rpy), frame.xyz)
        model.addFrame(pin.Frame(frame.name, joint_id, placement * offset, pin.FrameType.OP_FRAME), False)


def standing_configuration(robot: RobotDescription, posture: str = "standing") -> Array:
    """Configuration (nq,) of a named posture: base upright over the origin at its height, pinocchio's order.

    Raises:
        DescriptionError: no such posture.
    """
    chosen = robot.posture(posture)
    return np.concatenate([[0.0, 0.0, chosen.base_height, 0.0, 0.0, 0.0, 1.0], chosen.joints])
