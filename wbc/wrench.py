"""Contact wrench reference: from a commanded CoM acceleration to a wrench for each foot."""

import numpy as np

from robots.messages import Array, Mask
from robots.rotation import skew

GRAVITY = 9.81
"""Acceleration of gravity [m/s^2], as in pinocchio and MuJoCo."""


def distribute_wrench(
    mass: float,
    com: Array,
    com_acceleration: Array,
    soles: list[tuple[Array, Array]],
    load: Array,
    half_sizes: Array,
) -> Array:
    r"""Share out the force and moment that accelerate the CoM without changing angular momentum.

    The total force :math:`m (\ddot c + g)` acts along a line through the CoM. Each foot carries the share ``load`` of
    it; the moment that is left about the loaded centre of the soles is shared the same way, and cut off where it would
    move a foot's centre of pressure out of its sole.

    Source: after Kajita et al., "Biped walking stabilization based on linear inverted pendulum tracking" (IROS 2010),
    section on the ZMP distributor; the F_c^des of eq. (16) of Lee et al.

    Args:
        mass: of the robot [kg].
        com: shape (3,) centre of mass, world [m].
        com_acceleration: shape (3,) commanded, world [m/s^2].
        soles: rotation (3, 3) and centre (3,) of each sole's frame in the world.
        load: shape (n,) share of each foot, 0 or above, summing to 1.
        half_sizes: shape (n, 2) half length and half width of each sole [m]; bound the centre of pressure.

    Returns:
        Shape (6 n,): [force; moment about the sole's centre] of each foot, in its sole's axes [N, N m].
    """
    force = mass * (com_acceleration + np.array([0.0, 0.0, GRAVITY]))
    if force[2] <= 0:
        return np.zeros(6 * len(soles))
    centre = load @ np.array([position for _, position in soles])
    moment = skew(com - centre) @ force
    out = np.zeros(6 * len(soles))
    for i, (rotation, _) in enumerate(soles):
        f = load[i] * (rotation.T @ force)
        m = load[i] * (rotation.T @ moment)
        out[6 * i : 6 * i + 3] = f
        out[6 * i + 3] = _clamp(m[0], half_sizes[i, 1] * f[2])
        out[6 * i + 4] = _clamp(m[1], half_sizes[i, 0] * f[2])
        out[6 * i + 5] = m[2]
    return out


def _clamp(value: float, bound: float) -> float:
    """``value`` moved into [-bound, bound]; 0 for a bound that is not positive (the foot pulls)."""
    return max(-bound, min(value, bound)) if bound > 0 else 0.0


def load_from_zmp(zmp: Array, centres: Array, in_contact: Mask, load_limits: Array | None = None) -> Array:
    """Share of the vertical force on each of two feet: the ZMP's place on the line between their centres.

    Args:
        zmp: shape (2,) [m].
        centres: shape (2, 2) horizontal centres of left and right sole [m].
        in_contact: shape (2,) whether each foot is on the ground.
        load_limits: shape (2,) largest share on each, 0 to 1, 1 together at least; heeded where both are on the ground.

    Returns:
        Shape (2,), 0 or above, summing to 1 with a foot on the ground, else zeros.
    """
    if not in_contact.all():
        return in_contact.astype(float)
    line = centres[0] - centres[1]
    length = float(line @ line)
    least, most = (0.0, 1.0) if load_limits is None else (1.0 - float(load_limits[1]), float(load_limits[0]))
    left = 0.5 if length < 1e-9 else max(least, min(float((zmp - centres[1]) @ line) / length, most))
    return np.array([left, 1.0 - left])


def net_wrench(wrenches: Array, soles: list[tuple[Array, Array]], about: Array) -> Array:
    """Sum (6,) about a world point of foot wrenches (6 n,) in sole axes: force, then moment, world axes."""
    total = np.zeros(6)
    for i, (rotation, position) in enumerate(soles):
        force = rotation @ wrenches[6 * i : 6 * i + 3]
        total[:3] += force
        total[3:] += rotation @ wrenches[6 * i + 3 : 6 * i + 6] + skew(position - about) @ force
    return total
