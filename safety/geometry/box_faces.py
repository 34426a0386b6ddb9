"""Faces of boxes that the robot's segments are over or below: their edges, and the way out through them.

Contacts are those of :mod:`safety.geometry.segments`.
"""

import numpy as np

from robots.kernel_types import njit
from robots.messages import Array, Indices
from safety.geometry.boxes import TOUCHING
from safety.geometry.segments import END_A, START_A

UPRIGHT = 1e-9
"""Sine between a segment and a face's normal below which it counts as upright on the face."""


@njit(cache=True, error_model="numpy")
def _facing(normal: Array, rotation: Array) -> tuple[int, float]:
    """Axis and side (-1 or 1) of the box's face that a unit normal is most aligned with."""
    face, most, side = 0, -1.0, 1.0
    for k in range(3):
        along = normal[0] * rotation[0, k] + normal[1] * rotation[1, k] + normal[2] * rotation[2, k]
        if abs(along) > most:
            face, most, side = k, abs(along), (1.0 if along >= 0.0 else -1.0)
    return face, side


@njit(cache=True, error_model="numpy")
def _write_height(point: Array, centre: Array, rotation: Array, e: Array, face: int, side: float, out: Array) -> bool:
    """Writes the contact of a point with the plane of a face of the box; whether it is over or below the face."""
    inside = True
    for k in range(3):
        along = 0.0
        for r in range(3):
            along += rotation[r, k] * (point[r] - centre[r])
        if k == face:
            out[6] = side * along - e[k]
        elif abs(along) > e[k]:
            inside = False
    for r in range(3):
        out[r], out[3 + r] = point[r], side * rotation[r, face]
        out[7 + r], out[10 + r] = rotation[r, (face + 1) % 3], rotation[r, (face + 2) % 3]
    out[13] = out[14] = -1.0
    return inside


@njit(cache=True, error_model="numpy")
def _turn_outwards(rotation: Array, face: int, side: float, out: Array) -> bool:
    """Gives a contact with an edge of the face the sign that is positive outside; whether the segment crosses it.

    Below the edge the normal, from the edge to the segment, points inwards. Contacts with corners and ends, and of a
    segment across the face, which has no side of the edge to be on, do not count as crossing.
    """
    outwards = 0.0
    for r in range(3):
        outwards += side * rotation[r, face] * out[3 + r]
    if outwards < 0.0:
        for r in range(3, 7):
            out[r] = -out[r]
    return out[13] > 0.0 and out[14] < 0.0 and abs(outwards) > UPRIGHT


@njit(cache=True, error_model="numpy")
def blend_separation(
    origin: Array,
    direction: Array,
    centres: Array,
    rotations: Array,
    half_sizes: Array,
    table: Indices,
    contacts: Array,
) -> None:
    """Where a centre line is in its box, makes the contacts of its features ask for the way out of the whole.

    They become the heights of its ends above the face that the way out is most aligned with, and the signed distances
    from the edges of that face of a line that crosses them. What is not over the face, crosses no edge or is deeper
    than the whole repeats the contact of the whole.

    Args:
        origin: shape (na, 3) starts of the segments [m].
        direction: shape (na, 3) from start to end [m].
        centres: shape (nb, 3) of the boxes [m].
        rotations: shape (nb, 3, 3) the boxes' axes in their columns.
        half_sizes: shape (nb, 3) [m].
        table: shape (k, 5) for each contact its row in ``contacts``, the row of its whole segment, the segment, the
            box, and kind: ``START_A``, ``END_A``, or any other for an edge.
        contacts: shape (n, ``safety.geometry.segments.CONTACT_SIZE``), as :func:`safety.geometry.boxes.box_contacts`
            writes them for whole segments and :func:`safety.geometry.segments.segment_contacts` for edges; written
            where the segment is inside.
    """
    point = np.empty(3)
    for i in range(table.shape[0]):
        # before any view of a row: most segments are outside
        if not contacts[table[i, 1], 6] <= TOUCHING:
            continue
        out, whole, feature = contacts[table[i, 0]], contacts[table[i, 1]], table[i, 4]
        start, along = origin[table[i, 2]], direction[table[i, 2]]
        centre, rotation, e = centres[table[i, 3]], rotations[table[i, 3]], half_sizes[table[i, 3]]
        face, side = _facing(whole[3:6], rotation)
        if feature in (START_A, END_A):
            for k in range(3):
                point[k] = start[k] + (feature - START_A) * along[k]
            facing = _write_height(point, centre, rotation, e, face, side, out)
        else:
            facing = _turn_outwards(rotation, face, side, out)
        if not facing or out[6] < whole[6]:
            out[:] = whole


@njit(cache=True, error_model="numpy")
def face_edges(
    contacts: Array,
    representative: Indices,
    centres: Array,
    rotations: Array,
    half_sizes: Array,
    boxes: Indices,
    origins: Array,
    directions: Array,
) -> None:
    """The four edges of the face that each contact's normal is most aligned with, as segments.

    Args:
        contacts: shape (n, ``safety.geometry.segments.CONTACT_SIZE``).
        representative: shape (k,) rows of contacts with boxes.
        centres: shape (nb, 3) of the boxes [m].
        rotations: shape (nb, 3, 3) the boxes' axes in their columns.
        half_sizes: shape (nb, 3) [m].
        boxes: shape (k,) the box of each contact.
        origins: shape (4 k, 3) starts of the edges [m], written.
        directions: shape (4 k, 3) from start to end [m], written.
    """
    for i in range(representative.size):
        normal, rotation, e = contacts[representative[i], 3:6], rotations[boxes[i]], half_sizes[boxes[i]]
        face, side = _facing(normal, rotation)
        for j in range(4):
            axis = (face + 1 + j // 2) % 3
            other = 3 - face - axis
            shift = e[other] if j % 2 else -e[other]
            for r in range(3):
                middle = centres[boxes[i], r] + side * e[face] * rotation[r, face] + shift * rotation[r, other]
                directions[4 * i + j, r] = 2.0 * e[axis] * rotation[r, axis]
                origins[4 * i + j, r] = middle - e[axis] * rotation[r, axis]
