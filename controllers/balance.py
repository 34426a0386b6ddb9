"""Feedback of the divergent component of motion: where the ZMP has to be, and what the CoM then does."""

import numpy as np

from controllers.lipm import DcmReference
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
    command: Array = dcm - reference.velocity / reference.omega + (gain / reference.omega) * (dcm - reference.position)
    return command


def clip_to_support(
    point: Array,
    centres: Array,
    yaws: Array,
    half_sizes: Array,
    in_contact: Mask,
    load_limits: Array | None = None,
) -> Array:
    """The point (2,) moved into the soles that stand, or between them.

    With both feet down the region is a sole moved along the line between the two: the convex hull where both have one
    direction and size.

    Args:
        point: [m].
        centres: shape (2, 2) of left and right sole [m].
        yaws: shape (2,) their directions [rad].
        half_sizes: shape (2, 2) half length and half width of each [m].
        in_contact: shape (2,) which of them stand; with none the point is returned as it is.
        load_limits: shape (2,) largest share of the weight on each, 1 together at least; between two feet the ZMP's
            place on the line decides the shares.

    Returns:
        New array (2,) [m].
    """
    if not in_contact.any():
        return point.copy()
    if in_contact.all():
        line = centres[1] - centres[0]
        length = float(line @ line)
        least, most = (0.0, 1.0) if load_limits is None else (1.0 - load_limits[0], load_limits[1])
        least, most = max(0.0, least), min(1.0, most)
        share = 0.5 if length < 1e-12 else min(max(float((point - centres[0]) @ line) / length, least), most)
        centre, half = centres[0] + share * line, half_sizes.min(axis=0)
        yaw = yaws[0] + share * np.remainder(yaws[1] - yaws[0] + np.pi, 2 * np.pi) - share * np.pi
    else:
        foot = int(np.argmax(in_contact))
        centre, half, yaw = centres[foot], half_sizes[foot], yaws[foot]
    c, s = np.cos(yaw), np.sin(yaw)
    axes = np.array([[c, -s], [s, c]])
    return centre + axes @ np.clip((point - centre) @ axes, -half, half)
