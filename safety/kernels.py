"""Compiled geometry: closest points of segments, distances and gradients of many capsule pairs in one call."""

import math

import numpy as np
from numba import njit

from robots.messages import Array, Indices

DEGENERATE = 1e-9
"""Centre lines closer than this [m] have no direction between them; the normal is then chosen (see below)."""


@njit(cache=True)
def closest_parameters(p0: Array, d1: Array, q0: Array, d2: Array) -> tuple[float, float]:
    """Parameters in [0, 1] of the closest points of the segments p0 + s d1 and q0 + t d2 (each (3,), [m]).

    Points count as segments of no length. Parallel segments that face each other touch along an interval; its middle
    is taken, so that the answer does not depend on rounding.
    """
    a = d1[0] * d1[0] + d1[1] * d1[1] + d1[2] * d1[2]
    e = d2[0] * d2[0] + d2[1] * d2[1] + d2[2] * d2[2]
    r0, r1, r2 = p0[0] - q0[0], p0[1] - q0[1], p0[2] - q0[2]
    c = d1[0] * r0 + d1[1] * r1 + d1[2] * r2
    f = d2[0] * r0 + d2[1] * r1 + d2[2] * r2
    tiny = 1e-18
    if a <= tiny and e <= tiny:
        return 0.0, 0.0
    if a <= tiny:
        return 0.0, min(max(f / e, 0.0), 1.0)
    if e <= tiny:
        return min(max(-c / a, 0.0), 1.0), 0.0
    b = d1[0] * d2[0] + d1[1] * d2[1] + d1[2] * d2[2]
    denominator = a * e - b * b
    if denominator <= 1e-12 * a * e:
        u = min(max(-c / a, 0.0), 1.0)
        w = min(max((b - c) / a, 0.0), 1.0)
        s = 0.5 * (u + w)
    else:
        s = min(max((b * f - c * e) / denominator, 0.0), 1.0)
    t = (b * s + f) / e
    if t < 0.0 or t > 1.0:
        t = min(max(t, 0.0), 1.0)
        s = min(max((b * t - c) / a, 0.0), 1.0)
    return s, t


@njit(cache=True)
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


@njit(cache=True)
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


@njit(cache=True)
def _contact(p0: Array, d1: Array, q0: Array, d2: Array, point: Array, normal: Array) -> tuple[float, float]:
    """Distance of two centre lines; writes the closest point on the first and the unit normal towards it."""
    s, t = closest_parameters(p0, d1, q0, d2)
    squared = 0.0
    for k in range(3):
        point[k] = p0[k] + s * d1[k]
        normal[k] = point[k] - (q0[k] + t * d2[k])
        squared += normal[k] * normal[k]
    distance = math.sqrt(squared)
    if distance > DEGENERATE:
        for k in range(3):
            normal[k] /= distance
    else:
        normal[0], normal[1], normal[2] = fallback_normal(d1, d2)
    return distance, t


@njit(cache=True)
def _write_gradient(point: Array, normal: Array, jacobian: Array, side_a: Array, side_b: Array, row: Array) -> None:
    """Writes ``row`` (nv,): rate along ``normal`` between two bodies at ``point``, for each joint rate.

    A force along the normal n through the closest points is the same wrench [n; p x n] on both bodies, so an entry is
    (wrench . world Jacobian), counted where exactly one of the two bodies is carried. ``side_a`` and ``side_b`` (nv,)
    are the bodies' rows of the support mask.
    """
    n0, n1, n2 = normal[0], normal[1], normal[2]
    m0 = point[1] * n2 - point[2] * n1
    m1 = point[2] * n0 - point[0] * n2
    m2 = point[0] * n1 - point[1] * n0
    for k in range(row.size):
        side = side_a[k] - side_b[k]
        if side == 0.0:
            row[k] = 0.0
        else:
            linear = n0 * jacobian[0, k] + n1 * jacobian[1, k] + n2 * jacobian[2, k]
            row[k] = side * (linear + m0 * jacobian[3, k] + m1 * jacobian[4, k] + m2 * jacobian[5, k])


@njit(cache=True)
def self_collision_rows(
    origin: Array,
    direction: Array,
    radius: Array,
    joints: Indices,
    pairs: Indices,
    jacobian: Array,
    support: Array,
    h: Array,
    jac: Array,
) -> None:
    """Distances and gradients of capsule pairs of one robot: writes ``h`` (n,) [m] and ``jac`` (n, nv)."""
    point, normal = np.empty(3), np.empty(3)
    for i in range(pairs.shape[0]):
        a, b = pairs[i, 0], pairs[i, 1]
        distance, _ = _contact(origin[a], direction[a], origin[b], direction[b], point, normal)
        h[i] = distance - (radius[a] + radius[b])
        _write_gradient(point, normal, jacobian, support[joints[a]], support[joints[b]], jac[i])


@njit(cache=True)
def obstacle_rows(
    origin: Array,
    direction: Array,
    radius: Array,
    joints: Indices,
    obstacle_origin: Array,
    obstacle_direction: Array,
    obstacle_radius: Array,
    obstacle_velocity: Array,
    obstacle_spin: Array,
    jacobian: Array,
    support: Array,
    h: Array,
    jac: Array,
    drift: Array,
) -> None:
    """Distances, gradients and drift of every robot capsule against every obstacle capsule, robot-major.

    ``obstacle_velocity`` (m, 3) is that of the obstacle's segment origin [m/s], ``obstacle_spin`` (m, 3) its angular
    velocity [rad/s], world axes. Writes ``h`` (n m,), ``jac`` (n m, nv), ``drift`` (n m,).
    """
    point, normal, arm = np.empty(3), np.empty(3), np.empty(3)
    world = support[0]
    row = 0
    for a in range(radius.size):
        for o in range(obstacle_radius.size):
            distance, t = _contact(origin[a], direction[a], obstacle_origin[o], obstacle_direction[o], point, normal)
            h[row] = distance - (radius[a] + obstacle_radius[o])
            for k in range(3):
                arm[k] = t * obstacle_direction[o, k]
            spin = obstacle_spin[o]
            vx = obstacle_velocity[o, 0] + spin[1] * arm[2] - spin[2] * arm[1]
            vy = obstacle_velocity[o, 1] + spin[2] * arm[0] - spin[0] * arm[2]
            vz = obstacle_velocity[o, 2] + spin[0] * arm[1] - spin[1] * arm[0]
            drift[row] = -(normal[0] * vx + normal[1] * vy + normal[2] * vz)
            _write_gradient(point, normal, jacobian, support[joints[a]], world, jac[row])
            row += 1


@njit(cache=True)
def workspace_rows(
    transforms: Array,
    joints: Indices,
    points: Array,
    d_max: Array,
    jacobian: Array,
    support: Array,
    h: Array,
    jac: Array,
) -> None:
    """Distances of pairs of points below a bound: writes ``h`` (n,) [m] and ``jac`` (n, nv).

    ``transforms`` as in :func:`place_segments`; ``joints`` (n, 2) carry the points, ``points`` (n, 2, 3) are in the
    joints' frames [m]. Where two points coincide the gradient is zero.
    """
    point, normal = np.empty(3), np.empty(3)
    for i in range(d_max.size):
        m, w = transforms[joints[i, 0]], transforms[joints[i, 1]]
        a, b = points[i, 0], points[i, 1]
        squared = 0.0
        for k in range(3):
            point[k] = m[k] * a[0] + m[3 + k] * a[1] + m[6 + k] * a[2] + m[9 + k]
            # towards B: the barrier grows as the points come closer
            normal[k] = w[k] * b[0] + w[3 + k] * b[1] + w[6 + k] * b[2] + w[9 + k] - point[k]
            squared += normal[k] * normal[k]
        distance = math.sqrt(squared)
        h[i] = d_max[i] - distance
        if distance > 0.0:
            for k in range(3):
                normal[k] /= distance
        _write_gradient(point, normal, jacobian, support[joints[i, 0]], support[joints[i, 1]], jac[i])
