"""When a robot no longer stands on the ground."""

import numpy as np

from robots.messages import Array

TILT = float(np.cos(np.deg2rad(60.0)))
"""Cosine of the base's tilt from which the robot counts as fallen."""

LOW = 0.6
"""Fraction of the height at which the base stands over the soles, below which over the ground it counts as fallen."""

SUNK = 0.05
"""A sole's corner deeper in the ground than this is no contact: the robot was put there [m]."""

THROWN = 0.1
"""Higher than this above the ground with every corner of both soles, the robot does not stand on it any more [m]."""


def has_fallen(q: Array, corners: Array, stands_at: float) -> bool:
    """Whether the robot has fallen, was thrown up, or stands in the ground.

    Args:
        q: shape (nq,) true configuration, pinocchio's order, the ground at height 0.
        corners: shape (2, 4, 3) of the soles, world [m].
        stands_at: height of the base over the soles while it stands [m].
    """
    upright = 1 - 2 * (q[3] * q[3] + q[4] * q[4])
    heights = corners[..., 2]
    off_the_ground = heights.min() > THROWN or heights.min() < -SUNK
    return bool(upright < TILT or q[2] < LOW * stands_at or off_the_ground)
