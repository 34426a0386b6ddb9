"""Barriers: families of rows h, dh/dq and drift, evaluated together once a tick."""

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np

from robots.checks import require_one_of
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.messages import Array
from safety.kernels import obstacle_rows, place_segments, self_collision_rows, workspace_rows
from safety.obstacles import Obstacle
from safety.rows import FAMILIES, BarrierRows


class CollisionBodies:
    """The robot's spheres and capsules placed in the world; spheres are capsules of no length."""

    def __init__(self, kin: Kinematics) -> None:
        """Fix each shape to the joint that carries its body."""
        shapes = kin.robot.collisions
        placements = [kin.model.frames[kin.frame_id(_body_frame(kin.robot, s.body))] for s in shapes]
        self.names = tuple(s.name for s in shapes)
        self.joints = np.array([p.parentJoint for p in placements], dtype=np.intp)
        self.radius = np.array([s.radius for s in shapes])
        self._start = np.array([p.placement.act(s.start) for p, s in zip(placements, shapes, strict=True)]).reshape(
            -1, 3
        )
        self._end = np.array([p.placement.act(s.end) for p, s in zip(placements, shapes, strict=True)]).reshape(-1, 3)
        self.origin = np.zeros((len(shapes), 3))
        self.direction = np.zeros((len(shapes), 3))

    def place(self, kin: Kinematics) -> None:
        """Update ``origin`` and ``direction``, each (n, 3) [m], to the kinematics' configuration."""
        place_segments(kin.joint_transforms, self.joints, self._start, self._end, self.origin, self.direction)


def _body_frame(robot: RobotDescription, body: str) -> str:
    """A frame that coincides with the body's: the body's own, unless a named frame took its name."""
    for frame in robot.frames:
        if frame.name == body and (frame.body != body or frame.xyz.any() or frame.rpy.any()):
            raise ValueError(f"frame {body!r} has the name of a body but does not coincide with it")
    return body


class Barrier(ABC):
    """A number of barrier rows of one family.

    A barrier of one's own derives from this class, sets ``family`` and ``size`` and fills the rows it is handed.

    Attributes:
        family: one of ``FAMILIES``; selects the filter's parameters.
        size: number of rows.
    """

    family: str
    size: int

    @abstractmethod
    def write(self, kin: Kinematics, h: Array, jac: Array, drift: Array) -> None:
        """Fill ``h`` (size,), ``jac`` (size, nv), ``drift`` (size,) at the kinematics' configuration."""

    @abstractmethod
    def labels(self) -> tuple[str, ...]:
        """A name for each row."""


class JointLimitBarrier(Barrier):
    """h = q - q_min, then h = q_max - q, for every joint [rad]. Source: eq. (38) of Lee et al."""

    family = "joint_limit"

    def __init__(self, robot: RobotDescription) -> None:
        """Limits of the description."""
        self._lower, self._upper = robot.position_limits
        self._names = robot.joint_names
        nj = len(self._names)
        self.size = 2 * nj
        eye = np.hstack([np.zeros((nj, 6)), np.eye(nj)])
        self._jac = np.vstack([eye, -eye])

    def write(self, kin: Kinematics, h: Array, jac: Array, drift: Array) -> None:
        """See :meth:`Barrier.write`."""
        joints, nj = kin.q[7:], len(self._names)
        np.subtract(joints, self._lower, out=h[:nj])
        np.subtract(self._upper, joints, out=h[nj:])
        jac[:] = self._jac
        drift[:] = 0.0

    def labels(self) -> tuple[str, ...]:
        """``min`` and ``max`` of each joint."""
        return tuple(f"{n} min" for n in self._names) + tuple(f"{n} max" for n in self._names)


class SelfCollisionBarrier(Barrier):
    r"""Signed distance of pairs of the robot's collision bodies [m].

    .. math:: h = \|p_A - p_B\| - (\rho_A + \rho_B),\quad \nabla h = \hat n^T (J_A - J_B)

    with p the closest points of the centre lines. This is the gradient on either side of contact: the sign s_AB that
    eq. (43) of Lee et al. puts in front belongs to normals taken between surface points, which turn round when bodies
    penetrate; those between centre lines do not. Where centre lines meet, the normal is across both (see
    :func:`safety.kernels.fallback_normal`).

    Source: eqs. (41)-(44) of Lee et al.
    """

    def __init__(self, family: str, bodies: CollisionBodies, pairs: Sequence[tuple[str, str]]) -> None:
        """``pairs`` of names of collision bodies; ``family`` is ``self_collision`` or ``leg_collision``."""
        self.family = family
        self._bodies = bodies
        index = {n: i for i, n in enumerate(bodies.names)}
        self._names = tuple(pairs)
        self._pairs = np.array([[index[a], index[b]] for a, b in self._names], dtype=np.intp).reshape(-1, 2)
        self.size = len(self._names)

    def write(self, kin: Kinematics, h: Array, jac: Array, drift: Array) -> None:
        """See :meth:`Barrier.write`; the collision bodies must have been placed."""
        b = self._bodies
        self_collision_rows(
            b.origin, b.direction, b.radius, b.joints, self._pairs, kin.world_jacobian, kin.support, h, jac
        )
        drift[:] = 0.0

    def labels(self) -> tuple[str, ...]:
        """``A - B`` of each pair."""
        return tuple(f"{a} - {b}" for a, b in self._names)


class ObstacleBarrier(Barrier):
    r"""Signed distance of the robot's collision bodies to a fixed number of moving capsules [m].

    .. math:: h = \|p_A - p_O\| - (\rho_A + \rho_O),\quad \partial_t h = -\hat n^T v_O

    Source: eqs. (46)-(48) of Lee et al. Obstacles are set by :meth:`set_obstacles` before each tick.
    """

    family = "obstacle"

    def __init__(self, bodies: CollisionBodies, count: int, only: Sequence[str] | None = None) -> None:
        """For ``count`` obstacles; ``only`` names the collision bodies that heed them (all if ``None``)."""
        self._bodies = bodies
        chosen = range(len(bodies.names)) if only is None else [bodies.names.index(n) for n in only]
        self._chosen = np.array(list(chosen), dtype=np.intp)
        self._radius = bodies.radius[self._chosen]
        self._joints = bodies.joints[self._chosen]
        self.count = count
        self.size = count * self._chosen.size
        self._origin, self._direction, self._velocity, self._spin = (np.zeros((count, 3)) for _ in range(4))
        # until obstacles are set the rows are not numbers, and the filter stops, rather than avoid the world's origin
        self._origin[:] = np.nan
        self._obstacle_radius = np.zeros(count)

    def set_obstacles(self, obstacles: Sequence[Obstacle]) -> None:
        """The obstacles of this tick, as many as announced; until the first call the rows are NaN."""
        if len(obstacles) != self.count:
            raise ValueError(f"{len(obstacles)} obstacles given, {self.count} announced")
        for i, o in enumerate(obstacles):
            self._origin[i], self._direction[i] = o.start, o.end - o.start
            self._obstacle_radius[i] = o.radius
            self._velocity[i], self._spin[i] = o.velocity, o.spin

    def write(self, kin: Kinematics, h: Array, jac: Array, drift: Array) -> None:
        """See :meth:`Barrier.write`; the collision bodies must have been placed."""
        b = self._bodies
        obstacle_rows(
            b.origin[self._chosen],
            b.direction[self._chosen],
            self._radius,
            self._joints,
            self._origin,
            self._direction,
            self._obstacle_radius,
            self._velocity,
            self._spin,
            kin.world_jacobian,
            kin.support,
            h,
            jac,
            drift,
        )

    def labels(self) -> tuple[str, ...]:
        """``A - obstacle i`` of each row."""
        return tuple(f"{self._bodies.names[a]} - obstacle {i}" for a in self._chosen for i in range(self.count))


class WorkspaceBarrier(Barrier):
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
        self.size = len(bounds)

    def write(self, kin: Kinematics, h: Array, jac: Array, drift: Array) -> None:
        """See :meth:`Barrier.write`."""
        workspace_rows(
            kin.joint_transforms,
            self._joints,
            self._points,
            self._d_max,
            kin.world_jacobian,
            kin.support,
            h,
            jac,
        )
        drift[:] = 0.0

    def labels(self) -> tuple[str, ...]:
        """Name of each bound."""
        return self._names


class BarrierSet:
    """All barriers of a controller, evaluated into one block of rows that is made once and reused."""

    def __init__(self, kin: Kinematics, bodies: CollisionBodies, barriers: Sequence[Barrier]) -> None:
        """``bodies`` are placed before the barriers are written; barriers of one family must follow each other."""
        self.barriers = tuple(barriers)
        self._bodies = bodies
        n = sum(b.size for b in barriers)
        self._h, self._drift = np.zeros(n), np.zeros(n)
        self._jac = np.zeros((n, kin.nv))
        for b in barriers:
            require_one_of("barrier family", b.family, FAMILIES)
        self._family = np.concatenate(
            [np.full(b.size, FAMILIES.index(b.family), dtype=np.intp) for b in barriers] or [np.zeros(0, np.intp)]
        )
        self.slices: dict[str, slice] = {}
        start = 0
        for b in barriers:
            first = self.slices.get(b.family, slice(start, start))
            if first.stop != start:
                raise ConfigError("barriers", [b.family for b in barriers], "sorted by family")
            self.slices[b.family] = slice(first.start, start + b.size)
            start += b.size
        self.size = n
        self.labels = tuple(label for b in barriers for label in b.labels())

    def evaluate(self, kin: Kinematics) -> BarrierRows:
        """Rows at the kinematics' configuration; views that the next call overwrites."""
        self._bodies.place(kin)
        start = 0
        for b in self.barriers:
            rows = slice(start, start + b.size)
            b.write(kin, self._h[rows], self._jac[rows], self._drift[rows])
            start += b.size
        return BarrierRows(self._h, self._jac, self._drift, self._family)


def standard_barriers(kin: Kinematics, obstacle_count: int = 0) -> BarrierSet:
    """The four families of eqs. (34)-(37) of Lee et al. for a robot description."""
    bodies = CollisionBodies(kin)
    legs = kin.robot.leg_pairs
    others = [pair for pair in kin.robot.self_collision_pairs if pair not in legs]
    barriers: list[Barrier] = [
        JointLimitBarrier(kin.robot),
        SelfCollisionBarrier("self_collision", bodies, others),
        SelfCollisionBarrier("leg_collision", bodies, legs),
    ]
    if obstacle_count:
        barriers.append(ObstacleBarrier(bodies, obstacle_count))
    barriers.append(WorkspaceBarrier(kin))
    return BarrierSet(kin, bodies, barriers)
