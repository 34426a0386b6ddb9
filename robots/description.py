"""A robot as data: bodies, joints, frames, soles, collision bodies; checked once, when it is made."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from robots.errors import DescriptionError, UnknownNameError
from robots.messages import Array
from robots.validation import validate

ROLES = (
    "base",
    "torso",
    "left_sole",
    "right_sole",
    "left_hand",
    "right_hand",
    "left_shoulder",
    "right_shoulder",
    "imu",
)


@dataclass(frozen=True, slots=True)
class Joint:
    """One joint: revolute, or fixed (then only name, xyz and rpy count).

    Attributes:
        name: unique name.
        xyz: shape (3,) origin in the parent body's frame [m].
        rpy: shape (3,) roll, pitch, yaw of the child's frame in the parent's at zero position [rad].
        axis: shape (3,) unit axis in the child's frame; zeros for a fixed joint.
        position: (lower, upper) [rad].
        velocity: largest speed [rad/s].
        effort: largest torque [N m].
        armature: reflected rotor inertia [kg m^2].
        damping: viscous friction [N m s/rad].
        friction_loss: dry friction [N m].
        kp: motor position gain [N m/rad].
        kd: motor velocity gain [N m s/rad].
    """

    name: str
    xyz: Array
    rpy: Array
    axis: Array
    position: tuple[float, float] = (0.0, 0.0)
    velocity: float = 0.0
    effort: float = 0.0
    armature: float = 0.0
    damping: float = 0.0
    friction_loss: float = 0.0
    kp: float = 0.0
    kd: float = 0.0

    @property
    def fixed(self) -> bool:
        """Whether the joint does not move."""
        return not self.axis.any()


@dataclass(frozen=True, slots=True)
class Body:
    """A rigid body and the joint that carries it.

    Attributes:
        name: unique name.
        mass: [kg].
        com: shape (3,) centre of mass in the body's frame [m].
        inertia: shape (3, 3) about the centre of mass, axes of the body's frame [kg m^2].
        parent: name of the parent body; ``None`` for the base.
        joint: joint to the parent; ``None`` for the base.
    """

    name: str
    mass: float
    com: Array
    inertia: Array
    parent: str | None = None
    joint: Joint | None = None


@dataclass(frozen=True, slots=True)
class Frame:
    """A named frame fixed to a body: ``xyz`` (3,) [m] and ``rpy`` (3,) [rad] in the body's frame."""

    name: str
    body: str
    xyz: Array
    rpy: Array


@dataclass(frozen=True, slots=True)
class Sole:
    """Rectangular sole about the origin of ``frame``, z up: half sizes along x and y [m]."""

    frame: str
    half_length: float
    half_width: float


@dataclass(frozen=True, slots=True)
class CollisionShape:
    """A capsule about the segment ``start``-``end`` in the body's frame, or a sphere where the two coincide [m]."""

    name: str
    body: str
    start: Array
    end: Array
    radius: float

    @property
    def is_sphere(self) -> bool:
        """Whether the segment has no length."""
        return bool(np.array_equal(self.start, self.end))


@dataclass(frozen=True, slots=True)
class WorkspaceBound:
    """Largest allowed distance [m] between the origins of two frames (shoulder and hand, say)."""

    name: str
    frame_a: str
    frame_b: str
    d_max: float


@dataclass(frozen=True, slots=True)
class Posture:
    """A named posture: height of the base's origin over the ground [m] and joint positions (nj,) [rad]."""

    base_height: float
    joints: Array


@dataclass(frozen=True)
class RobotDescription:
    """Everything the project knows of a robot. Made by :func:`robots.loader.load_robot`; immutable.

    Attributes:
        name: short name.
        title: name for people.
        file: where it was read from.
        bodies: depth first (a parent, then each branch below it whole); the first is the floating base.
        frames: named frames.
        soles: left, then right.
        roles: which frame plays which part (see ``ROLES``).
        collisions: collision bodies.
        self_collision_pairs: pairs of names of collision bodies that must stay apart.
        leg_pairs: those of them in which both bodies belong to legs; a family of their own in the safety filter,
            because the gradients of legs are several times larger than those of arms.
        workspace: workspace bounds.
        postures: by name; ``standing`` is required.
        tuning: per-robot settings by table, read by the controllers.

    Raises:
        DescriptionError: an entry is not allowed; names the file, the entry and what is allowed.
    """

    name: str
    title: str
    file: str
    bodies: tuple[Body, ...]
    frames: tuple[Frame, ...]
    soles: tuple[Sole, ...]
    roles: Mapping[str, str]
    collisions: tuple[CollisionShape, ...]
    self_collision_pairs: tuple[tuple[str, str], ...]
    workspace: tuple[WorkspaceBound, ...]
    postures: Mapping[str, Posture]
    leg_pairs: tuple[tuple[str, str], ...] = ()
    tuning: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the whole description."""
        validate(self, ROLES)

    @cached_property
    def joints(self) -> tuple[Joint, ...]:
        """The moving joints, in the order of ``q`` and ``v``."""
        return tuple(b.joint for b in self.bodies if b.joint is not None and not b.joint.fixed)

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the moving joints, in order."""
        return tuple(j.name for j in self.joints)

    @property
    def total_mass(self) -> float:
        """Mass of all bodies [kg]."""
        return float(sum(b.mass for b in self.bodies))

    def joint_array(self, attribute: str) -> Array:
        """One number per moving joint, shape (nj,): ``attribute`` is a field of :class:`Joint`."""
        return np.array([getattr(j, attribute) for j in self.joints], dtype=float)

    @cached_property
    def position_limits(self) -> tuple[Array, Array]:
        """Lower and upper joint limits, each (nj,) [rad]."""
        limits = np.array([j.position for j in self.joints])
        return limits[:, 0], limits[:, 1]

    def frame(self, name: str) -> Frame:
        """The frame of this name.

        Raises:
            UnknownNameError: there is none.
        """
        for f in self.frames:
            if f.name == name:
                return f
        raise UnknownNameError("frame", name, [f.name for f in self.frames])

    def posture(self, name: str) -> Posture:
        """The posture of this name.

        Raises:
            DescriptionError: there is none; names the file and the table to add.
        """
        if name not in self.postures:
            allowed = f"one of {', '.join(sorted(self.postures))}, or given there in a table [posture.{name}]"
            raise DescriptionError(self.file, "posture", name, allowed)
        return self.postures[name]
