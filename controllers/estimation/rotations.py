"""Rotations and their errors, by pinocchio's exponential and logarithm."""

import math

import numpy as np
import pinocchio as pin

from robots.messages import Array

SMALL = 1e-5
"""Angle below which the second order of a rotation is below rounding [rad]."""


def skew(v: Array) -> Array:
    """Matrix (3, 3) of the cross product with ``v`` (3,) from the left."""
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def exponential(v: Array) -> Array:
    """Rotation (3, 3) by the rotation vector ``v`` (3,) [rad]."""
    return pin.exp3(v)


def logarithm(rotation: Array) -> Array:
    """Rotation vector (3,) of ``rotation`` (3, 3) [rad]."""
    return pin.log3(rotation)


def left_jacobian(v: Array) -> Array:
    r"""Matrix (3, 3) :math:`\int_0^1 \exp(s\, v) ds` of a rotation vector ``v`` (3,) [rad]."""
    cross, angle = skew(v), math.sqrt(float(v @ v))
    if angle < SMALL:
        return np.eye(3) + 0.5 * cross
    first, second = (1.0 - math.cos(angle)) / angle**2, (angle - math.sin(angle)) / angle**3
    return np.eye(3) + first * cross + second * cross @ cross
