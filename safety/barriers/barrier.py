"""What a barrier is, and the simplest one: joint limits."""

from abc import ABC, abstractmethod

import numpy as np

from robots.kinematics import Kinematics
from robots.messages import Array, Indices
from safety.geometry.segments import place_segments


class CollisionBodies:
    """The robot's spheres and capsules placed in the world; spheres are capsules of no length.

    Attributes:
        names: of the collision bodies.
        joints: shape (n,) joint that carries each.
        radius: shape (n,) [m].
        is_capsule: shape (n,) bool, whether the centre line has a length.
        carried: shape (n,) bool, whether any rate of ``v`` moves the body.
        origin: shape (n, 3) starts of the centre lines in the world [m].
        direction: shape (n, 3) from start to end [m].
    """

    def __init__(self, kin: Kinematics) -> None:
        """Fix each shape to the joint that carries its body."""
        shapes = kin.robot.collisions
        placements = [kin.model.frames[kin.frame_id(_body_frame(kin, s.body))] for s in shapes]
        self.names = tuple(s.name for s in shapes)
        self.joints = np.array([p.parentJoint for p in placements], dtype=np.intp)
        self.radius = np.array([s.radius for s in shapes])
        self.is_capsule = np.array([not s.is_sphere for s in shapes], dtype=bool)
        self.is_movable = kin.support[self.joints].any(axis=1)
        pairs = list(zip(placements, shapes, strict=True))
        self._start = np.array([p.placement.act(s.start) for p, s in pairs]).reshape(-1, 3)
        self._end = np.array([p.placement.act(s.end) for p, s in pairs]).reshape(-1, 3)
        self.origin = np.zeros((len(shapes), 3))
        self.direction = np.zeros((len(shapes), 3))

    def place(self, kin: Kinematics) -> None:
        """Update ``origin`` and ``direction`` to the kinematics' configuration."""
        place_segments(kin.joint_transforms, self.joints, self._start, self._end, self.origin, self.direction)


def _body_frame(kin: Kinematics, body: str) -> str:
    """A frame that coincides with the body's: the body's own, unless a named frame took its name."""
    for frame in kin.robot.frames:
        if frame.name == body and (frame.body != body or frame.xyz.any() or frame.rpy.any()):
            raise ValueError(f"frame {body!r} has the name of a body but does not coincide with it")
    return body


class Barrier(ABC):
    """A number of barrier rows of one family.

    A barrier of one's own derives from this class, sets ``family`` and ``size`` and fills the rows it is handed. For
    acceleration-level filters it also gives :meth:`write_curvature`.

    Attributes:
        family: one of ``FAMILIES``; selects the filter's parameters.
        size: number of rows.
        bodies: collision bodies that must be placed before the rows are written; ``None`` for none.
    """

    family: str
    size: int
    bodies: CollisionBodies | None = None

    @abstractmethod
    def write(self, kin: Kinematics, h: Array, jac: Array, dh_dt: Array) -> None:
        """Fill ``h`` (size,), ``jac`` (size, nv), ``dh_dt`` (size,) at the kinematics' configuration."""

    @abstractmethod
    def labels(self) -> tuple[str, ...]:
        """A name for each row."""

    def representative(self) -> Indices:
        """Indices (m,) of the rows to report, one per thing kept apart: all, where none stands for another."""
        return np.arange(self.size, dtype=np.intp)

    def write_curvature(self, kin: Kinematics, curvature: Array) -> None:
        """Fill ``curvature`` (size,), the second derivative of h at zero acceleration, after :meth:`write`.

        Raises:
            NotImplementedError: this barrier has none; filters on acceleration cannot use it.
        """
        raise NotImplementedError(f"{type(self).__name__} has no write_curvature, which acceleration filters need")

    def cartesian(self, kin: Kinematics, row: int, jac: Array) -> tuple[Array, Array]:
        """What moves in row ``row``, whose gradient is ``jac`` (nv,), and where to: after :meth:`write`.

        Returns:
            A Jacobian J (k, nv) and the unit direction n (k,) in which moving raises h, with n^T J = jac. Without a
            point to speak of: the gradient itself, and 1.
        """
        return jac[None].copy(), np.ones(1)


class JointLimitBarrier(Barrier):
    """h = q - q_min, then h = q_max - q, for every joint that may move [rad]. Source: eq. (38) of Lee et al."""

    family = "joint_limit"

    def __init__(self, kin: Kinematics) -> None:
        """Limits of the model's joints."""
        self._lower, self._upper = kin.position_limits
        self._names = kin.joint_names
        self._base = kin.nq_base
        nj = len(self._names)
        self.size = 2 * nj
        eye = np.hstack([np.zeros((nj, kin.nv_base)), np.eye(nj)])
        self._jac = np.vstack([eye, -eye])

    def write(self, kin: Kinematics, h: Array, jac: Array, dh_dt: Array) -> None:
        """See :meth:`Barrier.write`."""
        joints, nj = kin.q[self._base :], len(self._names)
        np.subtract(joints, self._lower, out=h[:nj])
        np.subtract(self._upper, joints, out=h[nj:])
        jac[:] = self._jac
        dh_dt[:] = 0.0

    def write_curvature(self, kin: Kinematics, curvature: Array) -> None:
        """Zero: h is linear in the joints."""
        curvature[:] = 0.0

    def labels(self) -> tuple[str, ...]:
        """``min`` and ``max`` of each joint."""
        return tuple(f"{n} min" for n in self._names) + tuple(f"{n} max" for n in self._names)
