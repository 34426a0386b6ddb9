"""Closest features of the robot's segments against segments, planes and points, many pairs in one compiled call.

Every pair of features is written as one row of a *contact* array, which :mod:`safety.geometry.contact_rows` turns into
gradients, dh/dt and curvature. A contact holds ``CONTACT_SIZE`` numbers, lengths in m, world axes:

========  ==================================================================================================
0 to 2    point p_A on the first body's centre line
3 to 5    unit normal n, from the second body towards the first
6         signed distance of the centre lines; the point on the second body is p_B = p_A - distance n
7 to 12   up to two unit directions along which a contact point is free to slide on its body
13, 14    which body each of the two belongs to: 1 the first, -1 the second, 0 there is none
========  ==================================================================================================

A point is free to slide along its segment where it is not at an end of it, and on a plane in any direction.

Nothing here iterates until something converges, nor in :mod:`safety.geometry.boxes`, :mod:`safety.geometry.box_faces`
and :mod:`safety.geometry.contact_rows`: a contact takes a fixed number of steps, at most one per side, edge or axis,
for all numbers.
"""

import math

import numpy as np

from robots.kernel_types import njit
from robots.messages import Array, Indices

CONTACT_SIZE = 15
"""Numbers in a row of a contact array."""

DEGENERATE = 1e-9
"""Centre lines closer than this [m] have no direction between them; the normal is then chosen (see below)."""

TINY = 1e-18
"""Squared length [m^2] from which on a segment counts as a point."""

CLOSEST, START_A, END_A, START_B, END_B = range(5)
"""Which points of two segments a contact is about: the closest ones, or an end and what is closest to it."""


@njit(cache=True, error_model="numpy")
def _ratio(numerator: float, squared: float) -> float:
    """Parameter in [0, 1] of a point along a segment of this squared length [m^2]; 0 where it has no length."""
    return min(max(numerator / squared, 0.0), 1.0) if squared > TINY else 0.0


@njit(cache=True, error_model="numpy")
def _closest_end(a: float, e: float, b: float, c: float, f: float) -> tuple[float, float]:
    """Parameters of the closest pair of points of which one at least is an end of its segment; products as below."""
    best, s, t = np.inf, 0.0, 0.0
    for end in range(4):
        if end < 2:
            u = float(end)
            w = _ratio(b * u + f, e)
        else:
            w = end - 2.0
            u = _ratio(b * w - c, a)
        # squared distance, less that of the two starts
        gap = u * (2.0 * c + u * a) + w * (w * e - 2.0 * f) - 2.0 * u * w * b
        if gap < best:
            best, s, t = gap, u, w
    return s, t


@njit(cache=True, error_model="numpy")
def _parameters(a: float, e: float, b: float, c: float, f: float, feature: int) -> tuple[float, float]:
    """Parameters of the points that a contact of this kind (``CLOSEST`` and so on) is about.

    With r from the second segment's start to the first's, the products are a = d1 d1, e = d2 d2, b = d1 d2, c = d1 r,
    f = d2 r [m^2].
    """
    if feature in (START_A, END_A):
        s = float(feature - START_A)
        return s, _ratio(b * s + f, e)
    if feature in (START_B, END_B):
        t = float(feature - START_B)
        return _ratio(b * t - c, a), t
    if a <= TINY:
        return 0.0, _ratio(f, e)
    if e <= TINY:
        return _ratio(-c, a), 0.0
    denominator = a * e - b * b
    if denominator <= 1e-12 * a * e:
        return _closest_end(a, e, b, c, f)
    s = min(max((b * f - c * e) / denominator, 0.0), 1.0)
    t = (b * s + f) / e
    if t < 0.0 or t > 1.0:
        t = min(max(t, 0.0), 1.0)
        s = min(max((b * t - c) / a, 0.0), 1.0)
    return s, t


@njit(cache=True, error_model="numpy")
def fallback_normal(d1: Array, d2: Array) -> tuple[float, float, float]:
    """Unit normal for centre lines that meet: across both segments, else across the longer one, else world x."""
    nx = d1[1] * d2[2] - d1[2] * d2[1]
    ny = d1[2] * d2[0] - d1[0] * d2[2]
    nz = d1[0] * d2[1] - d1[1] * d2[0]
    norm = math.sqrt(nx * nx + ny * ny + nz * nz)
    if norm > DEGENERATE:
        return nx / norm, ny / norm, nz / norm
    a = d1[0] * d1[0] + d1[1] * d1[1] + d1[2] * d1[2]
    e = d2[0] * d2[0] + d2[1] * d2[1] + d2[2] * d2[2]
    d = d1 if a >= e else d2
    horizontal = math.sqrt(d[0] * d[0] + d[1] * d[1])
    if horizontal > DEGENERATE:
        return -d[1] / horizontal, d[0] / horizontal, 0.0
    return 1.0, 0.0, 0.0


@njit(cache=True, error_model="numpy")
def segment_contacts(
    origin_a: Array, direction_a: Array, origin_b: Array, direction_b: Array, table: Indices, contacts: Array
) -> None:
    """Contacts of pairs of segments, points among them.

    Where two centre lines are closer than ``DEGENERATE`` the normal is :func:`fallback_normal`, so that everything
    stays finite; h has a kink there, and its gradient is that of one side.

    Args:
        origin_a: shape (na, 3) starts of the first bodies' centre lines [m].
        direction_a: shape (na, 3) from start to end [m].
        origin_b: shape (nb, 3), likewise of the second bodies.
        direction_b: shape (nb, 3).
        table: shape (k, 4) for each contact its row in ``contacts``, first body, second body, and kind.
        contacts: shape (n, ``CONTACT_SIZE``), written.
    """
    # numbers and three small arrays, not views of the rows: handing those on takes longer than the geometry
    d1, d2, n = np.empty(3), np.empty(3), np.empty(3)
    for i in range(table.shape[0]):
        row, a, b = table[i, 0], table[i, 1], table[i, 2]
        aa = bb = ab = ar = br = 0.0
        for k in range(3):
            d1[k], d2[k] = direction_a[a, k], direction_b[b, k]
            r = origin_a[a, k] - origin_b[b, k]
            aa += d1[k] * d1[k]
            bb += d2[k] * d2[k]
            ab += d1[k] * d2[k]
            ar += d1[k] * r
            br += d2[k] * r
        s, t = _parameters(aa, bb, ab, ar, br, table[i, 3])
        squared = 0.0
        for k in range(3):
            contacts[row, k] = origin_a[a, k] + s * d1[k]
            n[k] = contacts[row, k] - (origin_b[b, k] + t * d2[k])
            squared += n[k] * n[k]
        distance = math.sqrt(squared)
        contacts[row, 6] = distance
        if distance > DEGENERATE:
            for k in range(3):
                contacts[row, 3 + k] = n[k] / distance
        else:
            contacts[row, 3], contacts[row, 4], contacts[row, 5] = fallback_normal(d1, d2)
        contacts[row, 13] = contacts[row, 14] = 0.0
        free = 0
        if 0.0 < s < 1.0:
            _write_direction(d1, 1.0, free, row, contacts)
            free = 1
        if 0.0 < t < 1.0:
            _write_direction(d2, -1.0, free, row, contacts)


@njit(cache=True, error_model="numpy")
def _write_direction(d: Array, owner: float, free: int, row: int, contacts: Array) -> None:
    """Writes the unit vector along ``d`` as the contact's free direction number ``free`` (0 or 1)."""
    length = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    for k in range(3):
        contacts[row, 7 + 3 * free + k] = d[k] / length
    contacts[row, 13 + free] = owner


@njit(cache=True, error_model="numpy")
def half_space_contacts(
    origin: Array, direction: Array, points: Array, normals: Array, table: Indices, contacts: Array
) -> None:
    """Contacts of segments' ends with planes: smooth everywhere, whatever the depth.

    ``points`` and ``normals`` (nb, 3) [m] are the planes'; the other arguments are those of :func:`segment_contacts`,
    the kinds being ``START_A`` and ``END_A``.
    """
    for i in range(table.shape[0]):
        out = contacts[table[i, 0]]
        p, d = origin[table[i, 1]], direction[table[i, 1]]
        q, n = points[table[i, 2]], normals[table[i, 2]]
        s = 1.0 if table[i, 3] == END_A else 0.0
        distance = 0.0
        for k in range(3):
            out[k] = p[k] + s * d[k]
            out[3 + k] = n[k]
            distance += n[k] * (out[k] - q[k])
        out[6] = distance
        # two directions along the plane: across the normal and the axis it is least aligned with
        x, y, z = abs(n[0]), abs(n[1]), abs(n[2])
        ax = 1.0 if x <= y and x <= z else 0.0
        ay = 1.0 if ax == 0.0 and y <= z else 0.0
        az = 1.0 - ax - ay
        ux, uy, uz = n[1] * az - n[2] * ay, n[2] * ax - n[0] * az, n[0] * ay - n[1] * ax
        length = math.sqrt(ux * ux + uy * uy + uz * uz)
        out[7], out[8], out[9] = ux / length, uy / length, uz / length
        out[10] = n[1] * out[9] - n[2] * out[8]
        out[11] = n[2] * out[7] - n[0] * out[9]
        out[12] = n[0] * out[8] - n[1] * out[7]
        out[13] = out[14] = -1.0


@njit(cache=True, error_model="numpy")
def point_contacts(transforms: Array, joints: Indices, points: Array, contacts: Array) -> None:
    """Contacts of pairs of points, as the barrier that keeps them together sees them.

    The normal points from the first to the second and the distance is negative, so that moving along the normal
    raises the barrier. Where two points coincide the normal is zero: the barrier is then at its largest.

    Args:
        transforms: shape (njoints, 12) as :attr:`robots.kinematics.Kinematics.joint_transforms`.
        joints: shape (n, 2) the joints that carry the points.
        points: shape (n, 2, 3) in the joints' frames [m].
        contacts: shape (n, ``CONTACT_SIZE``), written.
    """
    for i in range(joints.shape[0]):
        out = contacts[i]
        m, w = transforms[joints[i, 0]], transforms[joints[i, 1]]
        a, b = points[i, 0], points[i, 1]
        squared = 0.0
        for k in range(3):
            out[k] = m[k] * a[0] + m[3 + k] * a[1] + m[6 + k] * a[2] + m[9 + k]
            out[3 + k] = w[k] * b[0] + w[3 + k] * b[1] + w[6 + k] * b[2] + w[9 + k] - out[k]
            squared += out[3 + k] * out[3 + k]
        distance = math.sqrt(squared)
        out[6] = -distance
        if distance > 0.0:
            for k in range(3):
                out[3 + k] /= distance
        out[13] = out[14] = 0.0


@njit(cache=True, error_model="numpy")
def place_segments(
    transforms: Array, joints: Indices, start: Array, end: Array, origin: Array, direction: Array
) -> None:
    """Segments fixed to joints, into the world: writes ``origin`` and ``direction``, each (n, 3).

    ``transforms`` (njoints, 12) as :attr:`robots.kinematics.Kinematics.joint_transforms`, ``joints`` (n,) the joint
    of each segment, ``start`` and ``end`` (n, 3) in the joint's frame [m].
    """
    for i in range(joints.size):
        m = transforms[joints[i]]
        for k in range(3):
            p = m[k] * start[i, 0] + m[3 + k] * start[i, 1] + m[6 + k] * start[i, 2] + m[9 + k]
            q = m[k] * end[i, 0] + m[3 + k] * end[i, 1] + m[6 + k] * end[i, 2] + m[9 + k]
            origin[i, k] = p
            direction[i, k] = q - p
