"""Barriers made of contacts between bodies of the robot: self-collision and workspace bounds."""

from abc import abstractmethod
from collections.abc import Sequence

import numpy as np

from robots.kinematics import Kinematics
from robots.messages import Array, Indices
from safety.barriers.barrier import Barrier, CollisionBodies
from safety.geometry.contact_rows import contact_curvature, contact_gradients
from safety.geometry.segments import (
    CLOSEST,
    CONTACT_SIZE,
    END_A,
    END_B,
    START_A,
    START_B,
    point_contacts,
    segment_contacts,
)

ENDS = {
    START_A: "start of the first",
    END_A: "end of the first",
    START_B: "start of the second",
    END_B: "end of the second",
}
"""What the rows of a pair beside its distance are called."""


class ContactBarrier(Barrier):
    """Rows that are signed distances of features of two bodies, one contact each (see :mod:`safety.geometry.segments`).

    Attributes:
        contacts: shape (size, ``CONTACT_SIZE``), of the last :meth:`write`.
        joints_a: shape (size,) joint that carries each first body.
        joints_b: shape (size,) likewise of the second; 0 is the world.
    """

    def __init__(self, joints_a: Indices, joints_b: Indices) -> None:
        self.size = joints_a.size
        self.joints_a, self.joints_b = joints_a, joints_b
        self.contacts = np.zeros((self.size, CONTACT_SIZE))

    @abstractmethod
    def measure(self, kin: Kinematics, h: Array) -> None:
        """Fill ``contacts`` and ``h`` (size,) at the kinematics' configuration."""

    def write(self, kin: Kinematics, h: Array, jac: Array, dh_dt: Array) -> None:
        """See :meth:`safety.barriers.barrier.Barrier.write`; collision bodies must have been placed."""
        self.measure(kin, h)
        contact_gradients(self.contacts, self.joints_a, self.joints_b, kin.world_jacobian, kin.support, jac)
        self.write_dh_dt(dh_dt)

    def write_dh_dt(self, dh_dt: Array) -> None:
        """Fill ``dh_dt`` (size,): zero, where both bodies are the robot's."""
        dh_dt[:] = 0.0

    def write_curvature(self, kin: Kinematics, curvature: Array) -> None:
        """See :meth:`safety.barriers.barrier.Barrier.write_curvature`."""
        twists, rates = kin.joint_velocities, kin.joint_accelerations
        contact_curvature(self.contacts, self.joints_a, self.joints_b, twists, rates, twists, rates, curvature)

    def cartesian(self, kin: Kinematics, row: int, jac: Array) -> tuple[Array, Array]:
        """Jacobian (3, nv) of the first body's contact point relative to the second's, and the normal (3,)."""
        contact = self.contacts[row]
        point, normal = contact[:3], contact[3:6].copy()
        other = point - contact[6] * normal
        jacobian = _point_jacobian(kin, self.joints_a[row], point) - _point_jacobian(kin, self.joints_b[row], other)
        return jacobian, normal


def _point_jacobian(kin: Kinematics, joint: int, point: Array) -> Array:
    """Jacobian (3, nv) of the material point at ``point`` (3,) of the body that a joint carries."""
    world = kin.world_jacobian
    return (world[:3] + np.cross(world[3:], point, axisa=0).T) * kin.support[joint]


class SelfCollisionBarrier(ContactBarrier):
    r"""Signed distance of pairs of the robot's collision bodies [m].

    .. math:: h = \|p_A - p_B\| - (\rho_A + \rho_B),\quad \nabla h = \hat n^T (J_A - J_B)

    with p the closest points of the centre lines. This is the gradient on either side of contact: the sign s_AB that
    eq. (43) of Lee et al. puts in front belongs to normals taken between surface points, which turn round when bodies
    penetrate; those between centre lines do not. Where centre lines meet, the normal is across both (see
    :func:`safety.geometry.segments.fallback_normal`).

    The first rows are those distances, one per pair. Where two capsules that face each other become parallel, the
    closest points jump from one end of the facing interval to the other, and a single row would let a closed loop
    chatter between the two. So each pair of proper segments has four rows more, after all the first ones: the distance
    of either end of either segment to the other segment. Each is a barrier of its own, never less than the pair's
    distance, and smooth but where centre lines meet; together they hold both ends of the facing interval, whichever is
    closer. The conditions that the set of rows puts on a velocity are therefore continuous through parallel.

    Source: eqs. (41)-(44) of Lee et al.
    """

    def __init__(
        self, family: str, bodies: CollisionBodies, pairs: Sequence[tuple[str, str]], ends: bool = True
    ) -> None:
        """``pairs`` of names of collision bodies; ``family`` is ``self_collision`` or ``leg_collision``.

        Without ``ends`` there are the distances only.
        """
        self.family, self.bodies = family, bodies
        index = {n: i for i, n in enumerate(bodies.names)}
        indices = [(index[a], index[b]) for a, b in pairs]
        self._n_pairs = len(indices)
        rows = [(a, b, CLOSEST) for a, b in indices]
        capsules = [(a, b) for a, b in indices if bodies.is_capsule[a] and bodies.is_capsule[b]]
        rows += [(a, b, end) for a, b in capsules if ends for end in ENDS]
        self._table = np.array([(i, *row) for i, row in enumerate(rows)], dtype=np.intp).reshape(-1, 4)
        _, a, b, _ = self._table.T
        self._reach = bodies.radius[a] + bodies.radius[b]
        super().__init__(bodies.joints[a], bodies.joints[b])

    def measure(self, kin: Kinematics, h: Array) -> None:
        """See :meth:`ContactBarrier.measure`."""
        assert self.bodies is not None
        lines = (self.bodies.origin, self.bodies.direction)
        segment_contacts(*lines, *lines, self._table, self.contacts)
        np.subtract(self.contacts[:, 6], self._reach, out=h)

    def representative(self) -> Indices:
        """The distances of the pairs, in their order."""
        return np.arange(self._n_pairs, dtype=np.intp)

    def labels(self) -> tuple[str, ...]:
        """``A - B`` of each pair, then ``A - B, ...`` with the end that a row is about."""
        assert self.bodies is not None
        names = self.bodies.names
        pairs = [(f"{names[a]} - {names[b]}", feature) for _, a, b, feature in self._table]
        return tuple(pair if feature == CLOSEST else f"{pair}, {ENDS[feature]}" for pair, feature in pairs)


class WorkspaceBarrier(ContactBarrier):
    r"""Distance of two frames' origins kept below d_max [m].

    .. math:: h = d_{max} - \|p_A - p_B\|,\quad \nabla h = -\hat n^T (J_A - J_B)

    Where the two coincide the gradient is zero: h is then at its largest. Source: eqs. (50)-(52) of Lee et al.
    """

    family = "workspace"

    def __init__(self, kin: Kinematics) -> None:
        """Bounds of the description."""
        bounds = kin.robot.workspace
        self._names = tuple(b.name for b in bounds)
        frames = [kin.model.frames[kin.frame_id(name)] for b in bounds for name in (b.frame_a, b.frame_b)]
        self._joints = np.array([f.parentJoint for f in frames], dtype=np.intp).reshape(-1, 2)
        self._points = np.array([f.placement.translation for f in frames]).reshape(-1, 2, 3)
        self._d_max = np.array([b.d_max for b in bounds])
        super().__init__(self._joints[:, 0].copy(), self._joints[:, 1].copy())

    def measure(self, kin: Kinematics, h: Array) -> None:
        """See :meth:`ContactBarrier.measure`."""
        point_contacts(kin.joint_transforms, self._joints, self._points, self.contacts)
        np.add(self.contacts[:, 6], self._d_max, out=h)

    def labels(self) -> tuple[str, ...]:
        """Name of each bound."""
        return self._names
