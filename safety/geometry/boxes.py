"""Closest features of the robot's segments against boxes: exact outside, and the least translation out of one inside.

The rows written are contacts as :mod:`safety.geometry.segments` describes them. Everything below happens in the box's
axes.
"""

import math

import numpy as np

from robots.kernel_types import njit
from robots.messages import Array, Indices

TOUCHING = 1e-9
"""A centre line closer to the box than this [m] counts as reaching into it."""

ALIGNED = 1e-12
"""Squared sine below which a segment counts as parallel to an edge."""


@njit(cache=True, error_model="numpy")
def _excess(x: float, e: float) -> float:
    """How far the coordinate ``x`` is outside the interval [-e, e], with its sign [m]."""
    return x - e if x > e else x + e if x < -e else 0.0


@njit(cache=True, error_model="numpy")
def _slope(s: float, p: Array, d: Array, e: Array) -> float:
    """Half the derivative by s of the squared distance of p + s d to the box: piecewise linear, never falling."""
    total = 0.0
    for k in range(3):
        total += d[k] * _excess(p[k] + s * d[k], e[k])
    return total


@njit(cache=True, error_model="numpy")
def _is_low(slope: float, flat_is_low: bool) -> bool:
    return slope < 0.0 or (flat_is_low and slope == 0.0)


@njit(cache=True, error_model="numpy")
def _zero_of_slope(p: Array, d: Array, e: Array, flat_is_low: bool) -> float:
    """First, or with ``flat_is_low`` last, s in [0, 1] where the slope is zero; an end where it is not."""
    if not _is_low(_slope(0.0, p, d, e), flat_is_low):
        return 0.0
    if _is_low(_slope(1.0, p, d, e), flat_is_low):
        return 1.0
    low, high = 0.0, 1.0
    for k in range(6):
        axis = k // 2
        if d[axis] != 0.0:
            side = e[axis] if k % 2 else -e[axis]
            s = (side - p[axis]) / d[axis]
            if low < s < high:
                if _is_low(_slope(s, p, d, e), flat_is_low):
                    low = s
                else:
                    high = s
    # no breakpoint is left between the two: the slope is linear there
    g_low, g_high = _slope(low, p, d, e), _slope(high, p, d, e)
    return low + (high - low) * (-g_low) / (g_high - g_low)


@njit(cache=True, error_model="numpy")
def box_parameter(p: Array, d: Array, e: Array) -> float:
    """Parameter in [0, 1] of the point of p + s d closest to the box of half sizes ``e``, box axes, each (3,) [m].

    The squared distance is convex and piecewise quadratic in s. Where it is least along an interval (parallel to a
    face, or inside) the middle of that interval is taken.
    """
    return 0.5 * (_zero_of_slope(p, d, e, False) + _zero_of_slope(p, d, e, True))


@njit(cache=True, error_model="numpy")
def _across_edge(d: Array, axis: int, m: Array) -> float:
    """Writes the unit vector across the segment and the box's edge along ``axis``; returns the sine between them."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    length = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    norm = math.sqrt(d[i] * d[i] + d[j] * d[j])
    m[axis] = 0.0
    if norm > 0.0:
        m[i], m[j] = d[j] / norm, -d[i] / norm
    return norm / length if length > 0.0 else 0.0


@njit(cache=True, error_model="numpy")
def _edge_parameter(p: Array, d: Array, e: Array, axis: int, n: Array) -> float:
    """Parameter of the segment's line where it is closest to the box's edge along ``axis`` on the side of ``n``."""
    along, squared = 0.0, 0.0
    for k in range(3):
        if k != axis:
            corner = e[k] if n[k] > 0.0 else -e[k]
            along += (p[k] - corner) * d[k]
            squared += d[k] * d[k]
    return -along / squared


@njit(cache=True, error_model="numpy")
def _least_translation(p: Array, d: Array, e: Array, n: Array, m: Array) -> tuple[float, float, int]:
    """The shortest way out of the box.

    The segment is out when the box inflated by it does not contain its start: a solid bounded by the faces of the box
    and by faces across the segment and one of the box's edges. Writes the unit normal ``n`` of the nearest of them;
    ``m`` (3,) is scratch.

    Returns:
        Signed distance (0 or below) [m], parameter of the contact point, and the axis of the edge, or -1 for a face.
    """
    best, parameter, edge = np.inf, 0.0, -1
    for k in range(6):
        axis, sign = k // 2, 1.0 if k % 2 else -1.0
        s = 0.0 if sign * d[axis] >= 0.0 else 1.0
        depth = e[axis] - sign * (p[axis] + s * d[axis])
        if depth < best:
            best, parameter = depth, s
            n[0] = n[1] = n[2] = 0.0
            n[axis] = sign
    for axis in range(3):
        if _across_edge(d, axis, m) ** 2 <= ALIGNED:
            continue
        reach, place = 0.0, 0.0
        for k in range(3):
            reach += e[k] * abs(m[k])
            place += m[k] * p[k]
        sign = 1.0 if place >= 0.0 else -1.0
        depth = reach - sign * place
        if depth < best:
            best, edge = depth, axis
            for k in range(3):
                n[k] = sign * m[k]
    if edge >= 0:
        parameter = _edge_parameter(p, d, e, edge, n)
    return -best, parameter, edge


@njit(cache=True, error_model="numpy")
def _write_box_axis(rotations: Array, box: int, axis: int, free: int, row: int, contacts: Array) -> None:
    """Writes an axis of the box as the contact's free direction number ``free`` (0 or 1)."""
    for k in range(3):
        contacts[row, 7 + 3 * free + k] = rotations[box, k, axis]
    contacts[row, 13 + free] = -1.0


@njit(cache=True, error_model="numpy")
def _write_segment_axis(along: Array, free: int, row: int, contacts: Array) -> None:
    """Likewise the unit vector of the segment ``along`` (3,)."""
    length = math.sqrt(along[0] ** 2 + along[1] ** 2 + along[2] ** 2)
    for k in range(3):
        contacts[row, 7 + 3 * free + k] = along[k] / length
    contacts[row, 13 + free] = 1.0


@njit(cache=True, error_model="numpy")
def _write_outside_free(
    p: Array, d: Array, e: Array, s: float, rotations: Array, box: int, along: Array, row: int, contacts: Array
) -> None:
    """Free directions outside the box: its axes where the point is not clamped, the segment's between its ends."""
    free, last = 0, -1
    for k in range(3):
        if abs(p[k] + s * d[k]) <= e[k] and free < 2:
            _write_box_axis(rotations, box, k, free, row, contacts)
            free, last = free + 1, k
    squared = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
    if free == 2 or not 0.0 < s < 1.0 or squared <= 1e-18:
        return
    # along an edge the segment adds a direction only where it is not parallel to it
    if free == 0 or squared - d[last] * d[last] > ALIGNED * squared:
        _write_segment_axis(along, free, row, contacts)


@njit(cache=True, error_model="numpy")
def box_contacts(
    origin: Array,
    direction: Array,
    centres: Array,
    rotations: Array,
    half_sizes: Array,
    table: Indices,
    contacts: Array,
) -> None:
    """Contacts of segments, or of their ends alone, with boxes.

    Where the centre line is in the box the distance is minus the least translation out of it: continuous, with a kink
    where two ways out are equally long. An end alone has a way out of its own, which need not be that of its segment:
    :func:`safety.geometry.box_faces.blend_separation` replaces it.

    Args:
        origin: shape (na, 3) starts of the segments [m].
        direction: shape (na, 3) from start to end [m].
        centres: shape (nb, 3) of the boxes [m].
        rotations: shape (nb, 3, 3) the boxes' axes in their columns.
        half_sizes: shape (nb, 3) [m].
        table: shape (k, 4) for each contact its row in ``contacts``, segment, box, and kind: 0 the whole segment,
            1 its start, 2 its end.
        contacts: shape (n, ``safety.geometry.segments.CONTACT_SIZE``), written.
    """
    # numbers and small arrays, not views of the rows: handing those on takes longer than the geometry
    p, d, e, n, m = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    along, offset = np.empty(3), np.empty(3)
    for i in range(table.shape[0]):
        row, body, box, feature = table[i, 0], table[i, 1], table[i, 2], table[i, 3]
        # an end alone is a segment of no length
        shift, fraction = (1.0 if feature == 2 else 0.0), (1.0 if feature == 0 else 0.0)
        for k in range(3):
            e[k], along[k] = half_sizes[box, k], direction[body, k]
            offset[k] = origin[body, k] + shift * along[k] - centres[box, k]
        for k in range(3):
            p[k] = d[k] = 0.0
            for r in range(3):
                p[k] += rotations[box, r, k] * offset[r]
                d[k] += rotations[box, r, k] * fraction * along[r]
        s = box_parameter(p, d, e) if feature == 0 else 0.0
        squared = 0.0
        for k in range(3):
            n[k] = _excess(p[k] + s * d[k], e[k])
            squared += n[k] * n[k]
        contacts[row, 13] = contacts[row, 14] = 0.0
        if squared > TOUCHING * TOUCHING:
            distance = math.sqrt(squared)
            for k in range(3):
                n[k] /= distance
            _write_outside_free(p, d, e, s, rotations, box, along, row, contacts)
        else:
            distance, s, edge = _least_translation(p, d, e, n, m)
            if edge >= 0:
                _write_segment_axis(along, 0, row, contacts)
                _write_box_axis(rotations, box, edge, 1, row, contacts)
            else:
                axis = 0 if n[0] != 0.0 else 1 if n[1] != 0.0 else 2
                _write_box_axis(rotations, box, (axis + 1) % 3, 0, row, contacts)
                _write_box_axis(rotations, box, (axis + 2) % 3, 1, row, contacts)
        contacts[row, 6] = distance
        for k in range(3):
            contacts[row, k] = origin[body, k] + (shift + s * fraction) * along[k]
            total = rotations[box, k, 0] * n[0] + rotations[box, k, 1] * n[1] + rotations[box, k, 2] * n[2]
            contacts[row, 3 + k] = total
