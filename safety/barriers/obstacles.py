"""The barrier between the robot's collision bodies and obstacles."""

from collections.abc import Sequence
from operator import attrgetter

import numpy as np

from robots.errors import UnknownNameError
from robots.kinematics import Kinematics
from robots.messages import Array, Indices
from safety.barriers.barrier import CollisionBodies
from safety.barriers.self_collision import ENDS, ContactBarrier
from safety.geometry.box_faces import blend_separation, face_edges
from safety.geometry.boxes import box_contacts
from safety.geometry.contact_rows import contact_curvature, contact_dh_dt, obstacle_motion
from safety.geometry.segments import CLOSEST, END_A, START_A, half_space_contacts, segment_contacts
from safety.geometry.shapes import KINDS, PACKED_SIZE, Obstacle, require_kinds

EDGES = (5, 6, 7, 8)
"""Contacts of a segment with the four edges of the box's face that it is over."""

NUMBERS_OF = attrgetter("packed")
"""Of an obstacle."""

LABELS = ENDS | {START_A: "start", END_A: "end"} | {e: f"edge {e - EDGES[0]}" for e in EDGES}
"""What the rows of a pair beside its distance are called."""


class ObstacleBarrier(ContactBarrier):
    r"""Signed distance of the robot's collision bodies to moving spheres, capsules, boxes and half-spaces [m].

    .. math:: h = \|p_A - p_O\| - (\rho_A + \rho_O),\quad \partial_t h = -\hat n^T v_O

    with :math:`v_O` the velocity of the obstacle's material point in contact. The kinds of the obstacles are fixed in
    advance; where they are is told by :meth:`set_obstacles` before each tick, and until then the rows are NaN.

    The first rows are one per body and obstacle. A capsule has more after all of those, for the reason given in
    :class:`safety.barriers.self_collision.SelfCollisionBarrier`, so that the set of conditions is continuous where it
    becomes parallel to the obstacle:

    - capsule obstacle: the four distances of an end of one to the other;
    - box: the distances of the capsule's two ends to the box, and those of its centre line to the four edges of the
      face that it is over (the facing interval may end at an edge); other rows once the centre line is inside, see
      below;
    - half-space: the first row is that of the start, the second that of the end. Only here is the distance of the pair
      the smaller of two rows.

    Once a capsule's centre line reaches into a box, the shortest ways out of its ends may lead through opposite faces,
    which no velocity can follow both. From there on all rows of the pair follow the way out of the whole, through the
    face that the first row's normal is most aligned with. With :math:`\hat u` the outward normal of that face:

    - an end that is over or below the face has its height :math:`h = \hat u^T (p_{end} - p_{face}) - \rho_A`;
    - an edge of the face that the centre line crosses has the signed distance of the two lines, less the radius, along
      the unit normal of both, turned so that it does not point into the box;
    - what is neither, or would be deeper than the pair, repeats the first row.

    So no row is deeper than the pair, and they cannot contradict each other: with d along the centre line and z along
    :math:`\hat u`, a translation by (-sgn(d_x d_z), -sgn(d_y d_z), 1) raises every one of them by at least its length
    over :math:`\sqrt 3`. They hold both ends of the part of the line that is below the face, so that the set of
    conditions is continuous where the line becomes parallel to it, inside as outside. It changes abruptly where the way
    out changes to another face, where part of a tilted line passes the face's rim, and where the centre line comes out:
    what is beside the face gets its own distance back, while the capsule is still in the box by its whole radius.

    Source: eqs. (46)-(48) of Lee et al., which have spheres and capsules.
    """

    family = "obstacle"

    def __init__(self, bodies: CollisionBodies, kinds: Sequence[str], only: Sequence[str] | None = None) -> None:
        """For obstacles of these ``kinds``; ``only`` names the bodies that avoid them (``None``: all that can move)."""
        require_kinds(kinds)
        for name in only or ():
            if name not in bodies.names:
                raise UnknownNameError("collision body", name, list(bodies.names))
        self.bodies = bodies
        self.kinds = tuple(kinds)
        chosen = np.flatnonzero(bodies.is_movable) if only is None else [bodies.names.index(n) for n in only]
        pairs = [(int(a), o) for a in chosen for o in range(len(self.kinds))]
        self._n_pairs = len(pairs)
        rows = [(a, o, START_A if self.kinds[o] == "half_space" else CLOSEST) for a, o in pairs]
        rows += [(a, o, f) for a, o in pairs for f in further_features(self.kinds[o], bool(bodies.is_capsule[a]))]
        self._table = np.array([(i, *row) for i, row in enumerate(rows)], dtype=np.intp).reshape(-1, 4)
        _, self._a, self._o, _ = self._table.T.copy()
        super().__init__(bodies.joints[self._a], np.zeros(self._a.size, dtype=np.intp))
        self._split_table()
        self._make_buffers(len(self.kinds))

    def _split_table(self) -> None:
        """One table per kernel."""
        kind = np.array([KINDS.index(k) for k in self.kinds], dtype=np.intp)[self._o]
        edge = self._table[:, 3] >= EDGES[0]
        self._segments = self._table[kind <= KINDS.index("capsule")]
        self._boxes = self._table[(kind == KINDS.index("box")) & ~edge]
        self._planes = self._table[kind == KINDS.index("half_space")]
        # every four edges belong to one pair, whose distance is among the first rows
        edge_rows = self._table[edge, 0].reshape(-1, 4)
        first = {(a, o): i for i, a, o, _ in self._table[: self._n_pairs]}
        pairs = [(a, o) for _, a, o, _ in self._table[edge][::4]]
        self._edge_representative = np.array([first[p] for p in pairs], dtype=np.intp)
        self._edge_boxes = np.array([o for _, o in pairs], dtype=np.intp)
        n = 4 * len(pairs)
        bodies = self._table[edge, 1]
        self._edges = np.stack([edge_rows.ravel(), bodies, np.arange(n), np.full(n, CLOSEST)], axis=1)
        self._edge_origin, self._edge_direction = np.zeros((n, 3)), np.zeros((n, 3))
        beside = [(i, first[a, o], a, o, f) for i, a, o, f in self._table[self._n_pairs :] if self.kinds[o] == "box"]
        self._beside = np.array(beside, dtype=np.intp).reshape(-1, 5)

    def _make_buffers(self, count: int) -> None:
        self._known = count == 0
        assert self.bodies is not None
        self._radius = self.bodies.radius[self._a]
        self._position, self._direction, self._half_sizes = (np.zeros((count, 3)) for _ in range(3))
        self._rotation = np.zeros((count, 3, 3))
        self._twist, self._rate = np.zeros((count, 6)), np.zeros((count, 6))
        self._reach = np.zeros(self.size)

    @property
    def count(self) -> int:
        """How many obstacles there are."""
        return len(self.kinds)

    def set_obstacles(self, obstacles: Sequence[Obstacle]) -> None:
        """The obstacles of this tick, of the kinds announced.

        Raises:
            ValueError: another number of obstacles, or another kind at some place.
        """
        if len(obstacles) != self.count:
            raise ValueError(f"{len(obstacles)} obstacles given, {self.count} announced")
        # by way of a list: a tuple made straight from an iterator counts towards the next collection of garbage
        if (given := tuple([o.kind for o in obstacles])) != self.kinds:
            i = next(i for i, kind in enumerate(given) if kind != self.kinds[i])
            raise ValueError(f"obstacle {i} is a {given[i]}, announced was a {self.kinds[i]}")
        if not obstacles:
            return
        # their bytes one after the other: a fraction of the time of joining arrays
        packed = np.frombuffer(b"".join(map(NUMBERS_OF, obstacles))).reshape(-1, PACKED_SIZE)
        self._position[:], self._direction[:] = packed[:, :3], packed[:, 3:6]
        self._rotation.reshape(-1, 9)[:] = packed[:, 6:15]
        self._half_sizes[:] = packed[:, 15:18]
        obstacle_motion(packed, self._radius, self._o, self._reach, self._twist, self._rate)
        self._known = True

    def measure(self, kin: Kinematics, h: Array) -> None:
        """See :meth:`safety.barriers.self_collision.ContactBarrier.measure`."""
        if not self._known:
            # not numbers, and the filter stops, rather than avoid the world's origin
            self.contacts[:] = np.nan
            h[:] = np.nan
            return
        assert self.bodies is not None
        lines = (self.bodies.origin, self.bodies.direction)
        if self._segments.size:
            segment_contacts(*lines, self._position, self._direction, self._segments, self.contacts)
        if self._planes.size:
            half_space_contacts(*lines, self._position, self._direction, self._planes, self.contacts)
        if self._boxes.size:
            self._measure_boxes(lines)
        np.subtract(self.contacts[:, 6], self._reach, out=h)

    def _measure_boxes(self, lines: tuple[Array, Array]) -> None:
        boxes = (self._position, self._rotation, self._half_sizes)
        box_contacts(*lines, *boxes, self._boxes, self.contacts)
        if not self._edge_boxes.size:
            return
        edges = (self._edge_origin, self._edge_direction)
        face_edges(self.contacts, self._edge_representative, *boxes, self._edge_boxes, *edges)
        segment_contacts(*lines, *edges, self._edges, self.contacts)
        blend_separation(*lines, *boxes, self._beside, self.contacts)

    def write_dh_dt(self, dh_dt: Array) -> None:
        """See :meth:`safety.barriers.self_collision.ContactBarrier.write_dh_dt`."""
        contact_dh_dt(self.contacts, self._o, self._twist, dh_dt)

    def write_curvature(self, kin: Kinematics, curvature: Array) -> None:
        """See :meth:`safety.barriers.barrier.Barrier.write_curvature`; obstacles keep velocity and angular velocity."""
        twists, rates = kin.joint_velocities, kin.joint_accelerations
        contact_curvature(self.contacts, self.joints_a, self._o, twists, rates, self._twist, self._rate, curvature)

    def representative(self) -> Indices:
        """One row per body and obstacle, in the order of the labels; then the other ends over half-spaces."""
        first = np.arange(self._n_pairs, dtype=np.intp)
        return np.concatenate([first, np.setdiff1d(self._planes[:, 0], first)])

    def labels(self) -> tuple[str, ...]:
        """``A - obstacle i`` of each pair, then ``A - obstacle i, ...`` with what a row is about."""
        assert self.bodies is not None
        pairs = [(f"{self.bodies.names[a]} - obstacle {o}", f) for _, a, o, f in self._table]
        return tuple(p if i < self._n_pairs else f"{p}, {LABELS[f]}" for i, (p, f) in enumerate(pairs))


def further_features(kind: str, is_capsule: bool) -> tuple[int, ...]:
    """Which rows a robot's body has against an obstacle of this kind beside the first; spheres have none."""
    if not is_capsule or kind == "sphere":
        return ()
    return {"capsule": tuple(ENDS), "box": (START_A, END_A, *EDGES), "half_space": (END_A,)}[kind]
