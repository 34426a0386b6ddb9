"""Feedback of the divergent component of motion: where the ZMP has to be, and what the CoM then does."""

import math
from collections.abc import Sequence

import numpy as np

from controllers.balance.dcm_plan import DcmReference
from robots.messages import Array, Mask


def zmp_command(dcm: Array, reference: DcmReference, gain: float) -> Array:
    r"""ZMP (2,) that makes the error of the DCM decay at ``gain``.

    .. math:: p = \xi - \dot\xi_{ref} / \omega + (k / \omega)(\xi - \xi_{ref})
        \;\Rightarrow\; \dot\xi = \dot\xi_{ref} - k (\xi - \xi_{ref})

    Source: Englsberger, Ott, Albu-Schaeffer, "Three-dimensional bipedal walking control based on divergent component
    of motion" (IEEE T-RO 2015), section V.

    Args:
        dcm: shape (2,) measured [m].
        reference: of the same instant.
        gain: k, above 0 [1/s].
    """
    # plain floats, here and below: this is asked in every tick, and numpy's calls would cost more than the sums
    (x, y), (px, py), (vx, vy) = dcm.tolist(), reference.position.tolist(), reference.velocity.tolist()
    omega, k = reference.omega, gain / reference.omega
    return np.array([x - vx / omega + k * (x - px), y - vy / omega + k * (y - py)])


def clip_to_support(
    point: Array,
    centres: Sequence[Sequence[float]],
    yaws: Sequence[float],
    half_sizes: Sequence[Sequence[float]],
    in_contact: Mask,
    load_limits: Array | None = None,
) -> Array:
    """The point (2,) moved into the soles that stand, or between them.

    With both feet down the region is a sole moved along the line between the two: the convex hull where both have one
    direction and size.

    Args:
        point: [m].
        centres: x and y of left and right sole [m].
        yaws: their directions [rad].
        half_sizes: half length and half width of each [m].
        in_contact: shape (2,) which of them stand; with none the point is returned as it is.
        load_limits: shape (2,) largest fraction of the weight on each, 1 together at least; between two feet the
            ZMP's place on the line decides the fractions.

    Returns:
        New array (2,) [m].
    """
    standing = [i for i in (0, 1) if in_contact[i]]
    if not standing:
        return point.copy()
    x, y = point.tolist()
    foot = standing[0]
    (cx, cy), yaw, (length, width) = centres[foot], yaws[foot], half_sizes[foot]
    if len(standing) == 2:
        dx, dy = centres[1][0] - cx, centres[1][1] - cy
        squared = dx * dx + dy * dy
        # the ZMP's place on the line is the second foot's fraction of the weight: at least what the first may not carry
        least, most = (0.0, 1.0) if load_limits is None else (1.0 - float(load_limits[0]), float(load_limits[1]))
        # feet on one spot have no line between them
        fraction = 0.5 if squared < 1e-12 else ((x - cx) * dx + (y - cy) * dy) / squared
        fraction = min(max(fraction, 0.0, least), 1.0, most)
        cx, cy = cx + fraction * dx, cy + fraction * dy
        yaw += fraction * math.remainder(yaws[1] - yaw, math.tau)
        # of two sizes the smaller, which fits into either sole
        length, width = min(length, half_sizes[1][0]), min(width, half_sizes[1][1])
    c, s = math.cos(yaw), math.sin(yaw)
    forward, sideways = c * (x - cx) + s * (y - cy), c * (y - cy) - s * (x - cx)
    forward, sideways = min(max(forward, -length), length), min(max(sideways, -width), width)
    return np.array([cx + c * forward - s * sideways, cy + s * forward + c * sideways])
