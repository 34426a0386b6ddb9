"""What torque the motors are told besides their position and velocity: the whole command, or less, to compare."""

import numpy as np
import pinocchio as pin

from robots.kinematics import Kinematics
from robots.messages import Array

TORQUE_MODES = ("full", "pd-only", "gravity")
"""``full``: the torque of DynWBC, eq. (19) of Lee et al. ``pd-only``: none, so that only the joints' PD is left, the
ablation of their section 5.3.1. ``gravity``: what holds the robot up at rest, :func:`gravity_torque`."""


def gravity_torque(kin: Kinematics, contact_jacobian: Array, half_sizes: Array) -> Array:
    r"""Joint torques that balance gravity at the configuration of ``kin``, the feet in contact bearing the weight.

    .. math:: \tau = g_j - J_{c,j}^T F,\quad F = \arg\min \sum \|f\|^2 + \|m / r\|^2
        \;\text{s.t. least}\; \|J_{c,b}^T F - g_b\|

    No friction or wrench cone, no wrench to track, no motion: the pressure may be meant to lie outside the soles.
    Moments are divided by the soles' half sizes ``r`` so that they compare with forces.

    Args:
        kin: kinematics on a floating base.
        contact_jacobian: shape (6 c, nv) of the soles in contact, in their own axes; none: the joints hold their links
            only.
        half_sizes: shape (c, 2) half length and half width of each of them [m].

    Returns:
        New array (nj,) [N m].
    """
    gravity: Array = pin.computeGeneralizedGravity(kin.model, kin.data, kin.q).copy()
    if not len(half_sizes):
        return gravity[6:]
    scale = np.concatenate([[1.0, 1.0, 1.0, width, length, length] for length, width in half_sizes])
    scaled = scale[:, None] * contact_jacobian
    wrench = np.linalg.pinv(scaled[:, :6].T, rcond=1e-9) @ gravity[:6]
    torque: Array = gravity[6:] - scaled[:, 6:].T @ wrench
    return torque
