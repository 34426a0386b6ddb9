"""Contact wrench reference: from a commanded CoM acceleration to a wrench for each foot. Compiled."""

import numpy as np
from numba import types

from robots.kernel_types import COLUMNS, FLAGS, MATRIX, PLACES, VECTOR, njit
from robots.messages import Array, Indices, Mask

GRAVITY = 9.81
"""Acceleration of gravity [m/s^2], as in pinocchio and MuJoCo."""


@njit(types.float64(types.float64, types.float64), cache=True, error_model="numpy")
def _clamp(value: float, bound: float) -> float:
    """``value`` moved into [-bound, bound]; 0 for a bound that is not positive (the foot pulls)."""
    return max(-bound, min(value, bound)) if bound > 0.0 else 0.0


@njit(types.float64[::1](types.float64, VECTOR, VECTOR, MATRIX, VECTOR, MATRIX), cache=True, error_model="numpy")
def distribute_wrench(
    mass: float, com: Array, com_acceleration: Array, soles: Array, load: Array, half_sizes: Array
) -> Array:
    r"""Share out the force and moment that accelerate the CoM without changing angular momentum.

    The total force :math:`m (\ddot c + g)` acts along a line through the CoM. Each foot carries the fraction ``load``
    of it; the moment that is left about the loaded centre of the soles is shared the same way, and cut off where it
    would move a foot's centre of pressure out of its sole.

    Source: after Kajita et al., "Biped walking stabilization based on linear inverted pendulum tracking" (IROS 2010),
    section on the ZMP distributor; the F_c^des of eq. (16) of Lee et al.

    Args:
        mass: of the robot [kg].
        com: shape (3,) centre of mass, world [m].
        com_acceleration: shape (3,) commanded, world [m/s^2].
        soles: shape (n, 12) placement of each sole's frame in the world, rotation column by column, then position.
        load: shape (n,) fraction of each foot, 0 or above, summing to 1.
        half_sizes: shape (n, 2) half length and half width of each sole [m]; bound the centre of pressure.

    Returns:
        Shape (6 n,): [force; moment about the sole's centre] of each foot, in its sole's axes [N, N m].
    """
    out, arm = np.zeros(6 * load.size), com.copy()
    for i in range(load.size):
        for k in range(3):
            arm[k] -= load[i] * soles[i, 9 + k]
    x, y, z = mass * com_acceleration[0], mass * com_acceleration[1], mass * (com_acceleration[2] + GRAVITY)
    if z <= 0.0:
        return out
    mx, my, mz = arm[1] * z - arm[2] * y, arm[2] * x - arm[0] * z, arm[0] * y - arm[1] * x
    for i in range(load.size):
        part, sole = out[6 * i : 6 * i + 6], soles[i]
        for k in range(3):
            a, b, c = sole[3 * k], sole[3 * k + 1], sole[3 * k + 2]
            part[k] = load[i] * (a * x + b * y + c * z)
            part[3 + k] = load[i] * (a * mx + b * my + c * mz)
        part[3] = _clamp(part[3], half_sizes[i, 1] * part[2])
        part[4] = _clamp(part[4], half_sizes[i, 0] * part[2])
    return out


@njit(types.float64[::1](VECTOR, MATRIX, FLAGS, VECTOR), cache=True, error_model="numpy")
def load_from_zmp(zmp: Array, centres: Array, in_contact: Mask, load_limits: Array) -> Array:
    """Fraction of the vertical force on each of two feet: the ZMP's place on the line between their centres.

    Args:
        zmp: shape (2,) [m].
        centres: shape (2, 2) horizontal centres of left and right sole [m].
        in_contact: shape (2,) whether each foot is on the ground.
        load_limits: shape (2,) largest fraction on each, 1 together at least, 1 and above for no limit; used where both
            are on the ground.

    Returns:
        Shape (2,), 0 or above, summing to 1 with a foot on the ground, else zeros.
    """
    out = np.empty(2)
    if not (in_contact[0] and in_contact[1]):
        out[0], out[1] = 1.0 * in_contact[0], 1.0 * in_contact[1]
        return out
    along, squared = 0.0, 0.0
    for k in range(2):
        line = centres[0, k] - centres[1, k]
        along += (zmp[k] - centres[1, k]) * line
        squared += line * line
    least, most = max(0.0, 1.0 - load_limits[1]), min(1.0, load_limits[0])
    out[0] = 0.5 if squared < 1e-9 else max(least, min(along / squared, most))
    out[1] = 1.0 - out[0]
    return out


@njit(
    types.float64[::1](types.float64, VECTOR, COLUMNS, VECTOR, MATRIX, PLACES, FLAGS, VECTOR, MATRIX),
    cache=True,
    error_model="numpy",
)
def reference_wrenches(
    mass: float,
    com: Array,
    com_jacobian: Array,
    command: Array,
    transforms: Array,
    frames: Indices,
    in_contact: Mask,
    load_limits: Array,
    half_sizes: Array,
) -> Array:
    """Wrenches (12,) on two soles that give the CoM the acceleration that an acceleration command asks of it.

    The ZMP of that acceleration, for the CoM's height above the soles' mean, divides the load.

    Args:
        mass: of the robot [kg].
        com: shape (3,) [m].
        com_jacobian: shape (3, nv).
        command: shape (nv,) commanded acceleration.
        transforms: shape (nframes, 12) placements of all frames: see :class:`robots.kinematics.Kinematics`.
        frames: shape (2,) the soles' frames.
        in_contact: as in :func:`load_from_zmp`.
        load_limits: likewise.
        half_sizes: as in :func:`distribute_wrench`.
    """
    acceleration, zmp = np.zeros(3), np.empty(2)
    soles, centres = np.empty((2, 12)), np.empty((2, 2))
    for j in range(command.size):
        for k in range(3):
            acceleration[k] += com_jacobian[k, j] * command[j]
    for i in range(2):
        soles[i] = transforms[frames[i]]
        centres[i] = soles[i, 9:11]
    height = com[2] - 0.5 * (soles[0, 11] + soles[1, 11])
    for k in range(2):
        zmp[k] = com[k] - acceleration[k] * (height / (GRAVITY + acceleration[2]))
    load = load_from_zmp(zmp, centres, in_contact, load_limits)
    return distribute_wrench(mass, com, acceleration, soles, load, half_sizes)
