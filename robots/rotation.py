"""Rotations: the few conversions that the builders and the tasks need."""

import math

import numpy as np

from robots.messages import Array


def rotation_from_rpy(rpy: Array) -> Array:
    """Rotation matrix (3, 3) of roll, pitch, yaw (3,) [rad]: R = Rz(yaw) Ry(pitch) Rx(roll), as in URDF."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(rpy), np.cos(rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def quaternion_wxyz_from_rpy(rpy: Array) -> Array:
    """Unit quaternion (w, x, y, z) of roll, pitch, yaw (3,) [rad]."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(rpy / 2), np.cos(rpy / 2)
    return np.array(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )


def skew(p: Array) -> Array:
    """Matrix (3, 3) with ``skew(p) @ x == cross(p, x)``."""
    return np.array([[0.0, -p[2], p[1]], [p[2], 0.0, -p[0]], [-p[1], p[0], 0.0]])


def rotation_log(rotation: Array) -> Array:
    """Rotation vector (3,) [rad], angle in [0, pi], of a rotation matrix (3, 3).

    Near pi the axis comes from the symmetric part, whose largest diagonal entry is then well conditioned.
    """
    # plain floats: indexing an array costs more than the arithmetic
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rotation.tolist()
    wx, wy, wz = zy - yz, xz - zx, yx - xy
    sine = 0.5 * math.sqrt(wx * wx + wy * wy + wz * wz)
    cosine = 0.5 * (xx + yy + zz - 1.0)
    angle = math.atan2(sine, cosine)
    if sine > 1e-6:
        scale = 0.5 * angle / sine
        return np.array([scale * wx, scale * wy, scale * wz])
    if cosine > 0:
        return np.array([0.5 * wx, 0.5 * wy, 0.5 * wz])
    b = 0.5 * (rotation + np.eye(3))
    k = int(np.argmax(np.diag(b)))
    axis = b[:, k] / math.sqrt(b[k, k])
    return angle * axis * (1.0 if axis @ np.array([wx, wy, wz]) >= 0 else -1.0)


def rotation_from_quaternion(quaternion: Array) -> Array:
    """Rotation matrix (3, 3) of a unit quaternion x, y, z, w (4,)."""
    x, y, z, w = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
