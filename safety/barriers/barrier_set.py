"""All barriers of a controller together: families of rows h, dh/dq and dh/dt, evaluated once a tick."""

from collections.abc import Sequence

import numpy as np

from robots.checks import require_one_of
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.messages import Array, Indices
from safety.barriers.barrier import Barrier, CollisionBodies, JointLimitBarrier
from safety.barriers.obstacles import ObstacleBarrier
from safety.barriers.rows import FAMILIES, BarrierRows
from safety.barriers.self_collision import ContactBarrier, SelfCollisionBarrier, WorkspaceBarrier

__all__ = [
    "Barrier",
    "BarrierSet",
    "CollisionBodies",
    "ContactBarrier",
    "JointLimitBarrier",
    "ObstacleBarrier",
    "SelfCollisionBarrier",
    "WorkspaceBarrier",
    "standard_barriers",
]


class BarrierSet:
    """All barriers of a controller, evaluated into one block of rows that is made once and reused.

    Attributes:
        barriers: in the order of their rows.
        size: number of rows.
        slices: rows of each family.
        representative: for each family the indices of the rows to report, one per joint limit, pair or bound (two for a
            capsule over a half-space). The rows beside them are never smaller than the one of their pair (see
            :class:`safety.barriers.self_collision.SelfCollisionBarrier`).
        labels: a name for each row.
        own: indices of the rows of those barriers that are ``own``.
    """

    def __init__(
        self, kin: Kinematics, bodies: CollisionBodies, barriers: Sequence[Barrier], own: Sequence[Barrier] = ()
    ) -> None:
        """``bodies`` are placed before the barriers are written; barriers of one family must follow each other."""
        self.barriers = tuple(barriers)
        # each once: a barrier of one's own may have brought bodies of its own
        self._bodies = tuple({id(b): b for b in (bodies, *(x.bodies for x in barriers)) if b is not None}.values())
        self._kin = kin
        n = sum(b.size for b in barriers)
        self._h, self._dh_dt, self._curvature = np.zeros(n), np.zeros(n), np.zeros(n)
        self._jac = np.zeros((n, kin.nv))
        for b in barriers:
            require_one_of("barrier family", b.family, FAMILIES)
        self._family = np.repeat([FAMILIES.index(b.family) for b in barriers], [b.size for b in barriers])
        self._family = self._family.astype(np.intp)
        self.slices: dict[str, slice] = {}
        self.representative: dict[str, Indices] = {}
        self._starts: list[int] = []
        self._parts: list[tuple[Barrier, Array, Array, Array, Array]] = []
        start = 0
        for b in barriers:
            first = self.slices.get(b.family, slice(start, start))
            if first.stop != start:
                raise ConfigError("barriers", [b.family for b in barriers], "sorted by family")
            self.slices[b.family] = slice(first.start, start + b.size)
            known = self.representative.get(b.family, np.zeros(0, dtype=np.intp))
            self.representative[b.family] = np.concatenate([known, start + b.representative()])
            self._starts.append(start)
            rows = slice(start, start + b.size)
            self._parts.append((b, self._h[rows], self._jac[rows], self._dh_dt[rows], self._curvature[rows]))
            start += b.size
        self.size = n
        for b in barriers:
            if len(b.labels()) != b.size:
                raise ConfigError(f"labels of {type(b).__name__}", b.labels(), f"{b.size} names, one for each row")
        self.own: Indices = np.flatnonzero([any(b is o for o in own) for b in barriers for _ in range(b.size)])
        self.labels = tuple(label for b in barriers for label in b.labels())

    @property
    def h(self) -> Array:
        """The barriers of the last evaluation, (size,); a view that the next one overwrites."""
        return self._h

    @property
    def families(self) -> Indices:
        """Family of each row, (size,) indices into ``FAMILIES``."""
        return self._family

    def evaluate(self, kin: Kinematics, second_order: bool = False) -> BarrierRows:
        """Rows at the kinematics' configuration; views that the next call overwrites.

        Args:
            kin: updated to the state; with ``second_order``, by
                :meth:`robots.kinematics.Kinematics.update_second_order` too.
            second_order: whether to fill ``curvature``.
        """
        self._kin = kin
        for bodies in self._bodies:
            bodies.place(kin)
        for b, h, jac, dh_dt, second in self._parts:
            b.write(kin, h, jac, dh_dt)
            if second_order:
                b.write_curvature(kin, second)
        curvature = self._curvature if second_order else None
        return BarrierRows(self._h, self._jac, self._dh_dt, self._family, curvature, self.cartesian)

    def cartesian(self, row: int) -> tuple[Array, Array]:
        """Jacobian (k, nv) of what moves in a row, and the unit direction (k,) that raises h, of the last evaluation.

        For distances (k = 3) that is the contact point of the first body relative to that of the second, and the
        normal; for other rows (k = 1) the gradient itself, and 1.

        Raises:
            IndexError: there is no such row.
        """
        if not 0 <= row < self.size:
            raise IndexError(f"row {row} of {self.size}")
        for start, b in zip(self._starts, self.barriers, strict=True):
            if row < start + b.size:
                return b.cartesian(self._kin, row - start, self._jac[row])
        raise AssertionError("unreachable: the rows of the barriers are all rows")


def standard_barriers(
    kin: Kinematics,
    obstacle_kinds: Sequence[str] = (),
    extra: Sequence[Barrier] = (),
    keep_fixed: bool = False,
    distances_only: bool = False,
) -> BarrierSet:
    """The four families of eqs. (34)-(37) of Lee et al. for a robot description.

    Args:
        kin: of the robot.
        obstacle_kinds: kind of each obstacle that every tick is given.
        extra: further barriers, sorted in by their family, after the standard ones of the same family.
        keep_fixed: whether to keep the distances that no rate of ``v`` changes: between bodies that no moving joint
            separates, and of obstacles to bodies that stand still. A filter can do nothing about them, a recorder wants
            them.
        distances_only: whether to leave out the rows of capsules' ends beside the distance of two bodies of the robot.
            A filter needs them, a recorder does not.
    """
    bodies = CollisionBodies(kin)
    legs = kin.robot.leg_pairs
    pairs = [p for p in kin.robot.self_collision_pairs if keep_fixed or _separable(kin, bodies, p)]
    barriers: list[Barrier] = [
        JointLimitBarrier(kin),
        SelfCollisionBarrier("self_collision", bodies, [p for p in pairs if p not in legs], not distances_only),
        SelfCollisionBarrier("leg_collision", bodies, [p for p in pairs if p in legs], not distances_only),
        WorkspaceBarrier(kin),
    ]
    if obstacle_kinds:
        barriers.append(ObstacleBarrier(bodies, obstacle_kinds, bodies.names if keep_fixed else None))
    barriers += extra
    for b in extra:
        require_one_of("barrier family", b.family, FAMILIES)
    return BarrierSet(kin, bodies, sorted(barriers, key=lambda b: FAMILIES.index(b.family)), extra)


def _separable(kin: Kinematics, bodies: CollisionBodies, pair: tuple[str, str]) -> bool:
    """Whether some rate of ``v`` moves one body of a pair and not the other."""
    a, b = (bodies.joints[bodies.names.index(n)] for n in pair)
    return not np.array_equal(kin.support[a], kin.support[b])
