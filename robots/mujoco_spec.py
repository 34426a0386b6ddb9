"""The MuJoCo spec of a robot description: same data as the pinocchio model."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import mujoco
import numpy as np
import pinocchio as pin

from robots.checks import require_non_negative, require_positive
from robots.description import Body, RobotDescription
from robots.errors import ConfigError, UnknownNameError
from robots.messages import Array

SOLE_HALF_HEIGHT = 0.01
"""Half the thickness of the contact box under each sole [m]; its lower face is the sole."""

COLLISION_GROUP = 3
"""Geom group of the collision bodies: drawn, never in contact."""


@dataclass(frozen=True, slots=True)
class PhysicalChanges:
    """How the built MuJoCo model differs from the description. All ones and zeros: no difference.

    Attributes:
        mass_scale: factor on every body's mass and inertia.
        link_mass_scale: factor by body name, on top of ``mass_scale``.
        com_shift: shape (3,) shift of the centre of mass of the torso's body, in its axes [m].
        sole_friction: Coulomb friction coefficient of soles and ground.
        joint_friction_scale: factor on dry and viscous joint friction.
        armature_scale: factor on every armature.

    Raises:
        ConfigError: a mass factor is not positive, another one is negative, or a number is not finite.
    """

    mass_scale: float = 1.0
    link_mass_scale: Mapping[str, float] = field(default_factory=dict)
    com_shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sole_friction: float = 0.8
    joint_friction_scale: float = 1.0
    armature_scale: float = 1.0

    def __post_init__(self) -> None:
        """Check every number."""
        require_positive("mass_scale", self.mass_scale)
        for body, scale in self.link_mass_scale.items():
            require_positive(f"link_mass_scale of '{body}'", scale)
        if not (len(self.com_shift) == 3 and np.isfinite(self.com_shift).all()):
            raise ConfigError("com_shift", self.com_shift, "three finite numbers [m]")
        for name in ("sole_friction", "joint_friction_scale", "armature_scale"):
            require_non_negative(name, getattr(self, name))


def build_mujoco_spec(robot: RobotDescription, changes: PhysicalChanges | None = None) -> mujoco.MjSpec:
    """Build the MuJoCo spec: floor, free base, hinges, one torque motor per joint, sole boxes, sensors.

    Only the two sole boxes and the floor touch anything. Collision bodies are present as geoms that never collide
    (group 3), so that penetration can be measured and drawn instead of being prevented by the physics.

    Args:
        robot: a checked description.
        changes: the mismatch between this model and the description; ``None`` for none.

    Returns:
        The spec, to be compiled. Joints and motors in the order of ``robot.joints``, a free joint before them.

    Raises:
        UnknownNameError: ``changes.link_mass_scale`` names a body that the robot does not have.
    """
    changes = changes or PhysicalChanges()
    known = [b.name for b in robot.bodies]
    for name in changes.link_mass_scale:
        if name not in known:
            raise UnknownNameError("body", name, known)
    spec = mujoco.MjSpec()
    spec.modelname = robot.name
    spec.compiler.degree = False
    spec.compiler.autolimits = True
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 10.0
    _add_floor(spec, changes.sole_friction)
    handles: dict[str, mujoco.MjsBody] = {}
    for body in robot.bodies:
        parent = spec.worldbody if body.parent is None else handles[body.parent]
        handles[body.name] = _add_body(parent, body, robot, changes)
    _add_frames(robot, handles, changes.sole_friction)
    _add_collision_bodies(robot, handles)
    _add_motors(spec, robot)
    _add_sensors(spec, robot)
    return spec


def _add_floor(spec: mujoco.MjSpec, friction: float) -> None:
    floor = spec.worldbody.add_geom()
    floor.name = "floor"
    floor.type = mujoco.mjtGeom.mjGEOM_PLANE
    floor.size = [0.0, 0.0, 0.05]
    floor.rgba = [0.87, 0.88, 0.9, 1.0]
    floor.condim = 3
    floor.friction = [friction, 0.005, 0.0001]


def _add_body(parent: mujoco.MjsBody, body: Body, robot: RobotDescription, changes: PhysicalChanges) -> mujoco.MjsBody:
    handle = parent.add_body()
    handle.name = body.name
    scale = changes.mass_scale * changes.link_mass_scale.get(body.name, 1.0)
    inertia = scale * _within_triangle(body.inertia)
    handle.mass = scale * body.mass
    torso_body = robot.frame(robot.roles["torso"]).body
    handle.ipos = body.com + (np.array(changes.com_shift) if body.name == torso_body else 0.0)
    handle.fullinertia = [inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2]]
    handle.explicitinertial = True
    if body.joint is None:
        handle.add_freejoint().name = "root_joint"
        return handle
    handle.pos = body.joint.xyz
    handle.quat = _quaternion(body.joint.rpy)
    if not body.joint.fixed:
        hinge = handle.add_joint()
        hinge.name = body.joint.name
        hinge.type = mujoco.mjtJoint.mjJNT_HINGE
        hinge.axis = body.joint.axis
        hinge.range = list(body.joint.position)
        hinge.armature = body.joint.armature * changes.armature_scale
        hinge.damping = [body.joint.damping * changes.joint_friction_scale, 0.0, 0.0]
        hinge.frictionloss = body.joint.friction_loss * changes.joint_friction_scale
    return handle


def _quaternion(rpy: Array) -> Array:
    """Unit quaternion in MuJoCo's order (w, x, y, z) of roll, pitch, yaw (3,) [rad]."""
    return np.roll(pin.Quaternion(pin.rpy.rpyToMatrix(rpy)).coeffs(), 1)


def _within_triangle(inertia: Array) -> Array:
    """The inertia (3, 3) with its largest principal value cut to the sum of the others.

    A description may exceed the triangle inequality by the rounding of published values; MuJoCo refuses even that.
    """
    principal, axes = np.linalg.eigh(inertia)
    excess = principal[2] - (principal[0] + principal[1]) * (1 - 1e-9)
    return inertia - max(excess, 0.0) * np.outer(axes[:, 2], axes[:, 2])


def _add_frames(robot: RobotDescription, handles: Mapping[str, mujoco.MjsBody], friction: float) -> None:
    for frame in robot.frames:
        site = handles[frame.body].add_site()
        site.name = frame.name
        site.pos = frame.xyz
        site.quat = _quaternion(frame.rpy)
        site.size = [0.005, 0.005, 0.005]
        site.group = 4
    for sole in robot.soles:
        frame = robot.frame(sole.frame)
        box = handles[frame.body].add_geom()
        box.name = f"{sole.frame}_contact"
        box.type = mujoco.mjtGeom.mjGEOM_BOX
        box.pos = frame.xyz + pin.rpy.rpyToMatrix(frame.rpy) @ np.array([0.0, 0.0, SOLE_HALF_HEIGHT])
        box.quat = _quaternion(frame.rpy)
        box.size = [sole.half_length, sole.half_width, SOLE_HALF_HEIGHT]
        box.condim = 3
        box.friction = [friction, 0.005, 0.0001]
        box.solref = [0.005, 1.0]
        box.rgba = [0.35, 0.37, 0.4, 1.0]
        box.mass = 0.0
        # bit 1 touches only the floor's bit 0: the soles never touch each other or another link
        box.contype, box.conaffinity = 2, 1


def _add_collision_bodies(robot: RobotDescription, handles: Mapping[str, mujoco.MjsBody]) -> None:
    for shape in robot.collisions:
        geom = handles[shape.body].add_geom()
        geom.name = f"{shape.name}_collision"
        if shape.is_sphere:
            geom.type = mujoco.mjtGeom.mjGEOM_SPHERE
            geom.pos = shape.start
            geom.size = [shape.radius, 0.0, 0.0]
        else:
            geom.type = mujoco.mjtGeom.mjGEOM_CAPSULE
            geom.fromto = [*shape.start, *shape.end]
            geom.size = [shape.radius, 0.0, 0.0]
        geom.contype, geom.conaffinity = 0, 0
        geom.mass = 0.0
        geom.group = COLLISION_GROUP
        geom.rgba = [0.45, 0.62, 0.85, 1.0]


def _add_motors(spec: mujoco.MjSpec, robot: RobotDescription) -> None:
    for joint in robot.joints:
        motor = spec.add_actuator()
        motor.name = joint.name
        motor.target = joint.name
        motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
        motor.ctrlrange = [-joint.effort, joint.effort]
        motor.forcerange = [-joint.effort, joint.effort]


def _add_sensors(spec: mujoco.MjSpec, robot: RobotDescription) -> None:
    imu = robot.roles["imu"]
    kinds = {
        "imu_gyro": mujoco.mjtSensor.mjSENS_GYRO,
        "imu_accelerometer": mujoco.mjtSensor.mjSENS_ACCELEROMETER,
        "imu_quaternion": mujoco.mjtSensor.mjSENS_FRAMEQUAT,
    }
    for name, kind in kinds.items():
        sensor = spec.add_sensor()
        sensor.name = name
        sensor.type = kind
        sensor.objtype = mujoco.mjtObj.mjOBJ_SITE
        sensor.objname = imu
