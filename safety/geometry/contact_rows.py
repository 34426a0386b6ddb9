"""Compiled rows: from contacts (:mod:`safety.geometry.segments`) to gradients, dh/dt and second derivatives."""

import math

import numpy as np
from numba import types

from robots.kernel_types import MATRIX, ORDER_FREE, VECTOR, njit
from robots.messages import Array, Indices

NO_DIRECTION = 1e-9
"""Contact points closer than this [m] turn the normal at no rate: it is chosen there, and does not depend on them."""

ALIGNED = 1e-12
"""Free directions whose Gram determinant is below this count as one: points slide the same along either."""


def all_numbers(h: Array, dh_dt: Array, jac: Array) -> bool:
    """Whether all numbers of barrier rows are finite: h (n,), dh_dt (n,), jac (n, nv)."""
    return math.isfinite(_total(*packed(h, dh_dt, jac)))


@njit(types.float64(VECTOR, VECTOR, MATRIX), cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _total(h: Array, dh_dt: Array, jac: Array) -> float:
    """Sum of all: not finite where one of them is not."""
    out = 0.0
    for i in range(h.size):
        out += h[i]
    for i in range(dh_dt.size):
        out += dh_dt[i]
    for x in jac.flat:
        out += x
    return out


def room(A: Array, v: Array, b: Array) -> Array:
    """A v - b, new: by how much conditions A (n, nv), b (n,) hold at v (nv,); below 0 they do not."""
    out = np.empty(b.size)
    A, v, b = packed(A, v, b)
    _room(A, v, b, out)
    return out


def packed(*arrays: Array) -> list[Array]:
    """The arrays themselves where their entries follow each other as compiled code has it, else copies that do."""
    return [np.ascontiguousarray(a, dtype=float) for a in arrays]


@njit(types.void(MATRIX, VECTOR, VECTOR, types.float64[::1]), cache=True, error_model="numpy", fastmath=ORDER_FREE)
def _room(A: Array, v: Array, b: Array, out: Array) -> None:
    for i in range(b.size):
        value = 0.0
        for k in range(v.size):
            value += A[i, k] * v[k]
        out[i] = value - b[i]


@njit(cache=True, error_model="numpy")
def obstacle_motion(
    packed: Array, radius: Array, obstacles: Indices, reach: Array, twists: Array, rates: Array
) -> None:
    """Distance at which each row's body touches its obstacle, and how the obstacles move.

    Args:
        packed: shape (n_obstacles, ``PACKED_SIZE``), each :attr:`safety.geometry.shapes.Obstacle.packed`.
        radius: shape (n,) of each row's body [m].
        obstacles: shape (n,) of each row.
        reach: shape (n,) sum of the radii [m], written.
        twists: shape (n_obstacles, 6) velocity of the body-fixed point at the world's origin [m/s], then angular
            velocity [rad/s], written.
        rates: shape (n_obstacles, 6) their rates where reference points keep their velocity, and all
            their angular velocity, written.
    """
    for i in range(reach.size):
        reach[i] = radius[i] + packed[obstacles[i], 18]
    for j in range(packed.shape[0]):
        p, v, w = packed[j, :3], packed[j, 19:22], packed[j, 22:25]
        for k in range(3):
            x, y = (k + 1) % 3, (k + 2) % 3
            twists[j, k] = v[k] - (w[x] * p[y] - w[y] * p[x])
            twists[j, 3 + k] = w[k]
            rates[j, k] = w[y] * v[x] - w[x] * v[y]
            rates[j, 3 + k] = 0.0


@njit(cache=True, error_model="numpy")
def contact_gradients(
    contacts: Array, joints_a: Indices, joints_b: Indices, jacobian: Array, support: Array, jac: Array
) -> None:
    """Gradients of signed distances: writes ``jac`` (n, nv).

    A force along the normal n through the contact points is the same wrench [n; p x n] on both bodies, so an entry is
    (wrench . world Jacobian), counted where exactly one of the two bodies is carried.

    Args:
        contacts: shape (n, ``CONTACT_SIZE``).
        joints_a: shape (n,) joint that carries each first body; 0 is the world.
        joints_b: shape (n,) likewise of the second bodies.
        jacobian: shape (6, nv), :attr:`robots.kinematics.Kinematics.world_jacobian`.
        support: shape (njoints, nv), :attr:`robots.kinematics.Kinematics.support`.
        jac: shape (n, nv), written.
    """
    nv = jac.shape[1]
    # side by side in memory: the inner loop then runs over four columns at a time
    columns = np.empty((6, nv))
    for r in range(6):
        for k in range(nv):
            columns[r, k] = jacobian[r, k]
    for i in range(jac.shape[0]):
        p0, p1, p2, n0, n1, n2 = contacts[i, :6]
        m0, m1, m2 = p1 * n2 - p2 * n1, p2 * n0 - p0 * n2, p0 * n1 - p1 * n0
        a, b = joints_a[i], joints_b[i]
        for k in range(nv):
            linear = n0 * columns[0, k] + n1 * columns[1, k] + n2 * columns[2, k]
            angular = m0 * columns[3, k] + m1 * columns[4, k] + m2 * columns[5, k]
            jac[i, k] = (support[a, k] - support[b, k]) * (linear + angular)


@njit(cache=True, error_model="numpy")
def contact_dh_dt(contacts: Array, bodies: Indices, twists: Array, dh_dt: Array) -> None:
    """Rate of the signed distance from the second bodies' own motion: writes ``dh_dt`` (n,) [m/s].

    ``bodies`` (n,) index the rows of ``twists`` (nb, 6): velocity of the body-fixed point at the world's origin [m/s],
    then angular velocity [rad/s].
    """
    for i in range(dh_dt.size):
        p, n, w = contacts[i, :3], contacts[i, 3:6], twists[bodies[i]]
        linear = n[0] * w[0] + n[1] * w[1] + n[2] * w[2]
        m0, m1, m2 = p[1] * n[2] - p[2] * n[1], p[2] * n[0] - p[0] * n[2], p[0] * n[1] - p[1] * n[0]
        dh_dt[i] = -(linear + m0 * w[3] + m1 * w[4] + m2 * w[5])


@njit(cache=True, error_model="numpy")
def _point_motion(twist: Array, rate: Array, p: Array, sign: float, velocity: Array, acceleration: Array) -> None:
    """Adds ``sign`` times velocity and (classical) acceleration of a body's material point at ``p`` (3,)."""
    w = twist[3:]
    vx = twist[0] + w[1] * p[2] - w[2] * p[1]
    vy = twist[1] + w[2] * p[0] - w[0] * p[2]
    vz = twist[2] + w[0] * p[1] - w[1] * p[0]
    velocity[0] += sign * vx
    velocity[1] += sign * vy
    velocity[2] += sign * vz
    acceleration[0] += sign * (rate[0] + rate[4] * p[2] - rate[5] * p[1] + w[1] * vz - w[2] * vy)
    acceleration[1] += sign * (rate[1] + rate[5] * p[0] - rate[3] * p[2] + w[2] * vx - w[0] * vz)
    acceleration[2] += sign * (rate[2] + rate[3] * p[1] - rate[4] * p[0] + w[0] * vy - w[1] * vx)


@njit(cache=True, error_model="numpy")
def _spin_across(w: Array, u: Array, n: Array) -> float:
    """Rate n . (w x u) at which a direction u fixed to a body of angular velocity w turns towards n."""
    return n[0] * (w[1] * u[2] - w[2] * u[1]) + n[1] * (w[2] * u[0] - w[0] * u[2]) + n[2] * (w[0] * u[1] - w[1] * u[0])


@njit(cache=True, error_model="numpy")
def contact_curvature(
    contacts: Array,
    bodies_a: Indices,
    bodies_b: Indices,
    twists_a: Array,
    rates_a: Array,
    twists_b: Array,
    rates_b: Array,
    curvature: Array,
) -> None:
    r"""Second derivative of signed distances at zero acceleration: writes ``curvature`` (n,) [m/s^2].

    With v and a the relative velocity and acceleration of the material points in contact, :math:`u_k` the free
    directions, :math:`\beta_k = u_k \cdot v`, :math:`\kappa_k = n \cdot \dot u_k` and :math:`G_{kl} = u_k \cdot u_l`,

    .. math:: \ddot h = n \cdot a - 2 \kappa^T G^{-1} \beta - \delta \kappa^T G^{-1} \kappa
        + \frac{|v|^2 - (n \cdot v)^2 - \beta^T G^{-1} \beta}{\delta}

    It follows from differentiating :math:`(p_A - p_B) \cdot u_k = 0`, which says how fast the contact points slide on
    their bodies. With two free directions these alone fix the normal, and the last term is zero. It is left out too
    where :math:`|\delta|` is below ``NO_DIRECTION``. Of two free directions that are parallel the first is taken.

    Args:
        contacts: shape (n, ``CONTACT_SIZE``).
        bodies_a: shape (n,) rows of ``twists_a`` and ``rates_a`` of the first bodies.
        bodies_b: shape (n,) likewise of the second bodies.
        twists_a: shape (na, 6) velocity of the body-fixed point at the world's origin [m/s], then angular [rad/s].
        rates_a: shape (na, 6) time derivatives of ``twists_a`` at zero acceleration [m/s^2, rad/s^2].
        twists_b: shape (nb, 6).
        rates_b: shape (nb, 6).
        curvature: shape (n,), written.
    """
    v, acc, p_b = np.empty(3), np.empty(3), np.empty(3)
    beta, kappa = np.empty(2), np.empty(2)
    for i in range(curvature.size):
        p, n, delta = contacts[i, :3], contacts[i, 3:6], contacts[i, 6]
        twist_a, twist_b = twists_a[bodies_a[i]], twists_b[bodies_b[i]]
        for k in range(3):
            v[k] = acc[k] = 0.0
            p_b[k] = p[k] - delta * n[k]
        _point_motion(twist_a, rates_a[bodies_a[i]], p, 1.0, v, acc)
        _point_motion(twist_b, rates_b[bodies_b[i]], p_b, -1.0, v, acc)
        free = 0
        for k in range(2):
            owner = contacts[i, 13 + k]
            if owner != 0.0:
                u = contacts[i, 7 + 3 * k : 10 + 3 * k]
                angular_velocity = twist_a[3:] if owner > 0.0 else twist_b[3:]
                beta[k] = u[0] * v[0] + u[1] * v[1] + u[2] * v[2]
                kappa[k] = _spin_across(angular_velocity, u, n)
                free = k + 1
        normal_speed = n[0] * v[0] + n[1] * v[1] + n[2] * v[2]
        across = v[0] * v[0] + v[1] * v[1] + v[2] * v[2] - normal_speed * normal_speed
        total = n[0] * acc[0] + n[1] * acc[1] + n[2] * acc[2]
        if free == 2:
            u, w = contacts[i, 7:10], contacts[i, 10:13]
            c = u[0] * w[0] + u[1] * w[1] + u[2] * w[2]
            determinant = 1.0 - c * c
            if determinant > ALIGNED:
                x = (kappa[0] - c * kappa[1]) / determinant
                y = (kappa[1] - c * kappa[0]) / determinant
                total -= 2.0 * (x * beta[0] + y * beta[1]) + delta * (x * kappa[0] + y * kappa[1])
                across = 0.0
            else:
                free = 1
        if free == 1:
            total -= kappa[0] * (2.0 * beta[0] + delta * kappa[0])
            across -= beta[0] * beta[0]
        if abs(delta) > NO_DIRECTION:
            total += across / delta
        curvature[i] = total
