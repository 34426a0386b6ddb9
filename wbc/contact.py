"""Sole contacts: the contact wrench cone and the points it stands for."""

from dataclasses import dataclass

import numpy as np

from robots.checks import require_positive
from robots.messages import Array


@dataclass(frozen=True, slots=True)
class SoleContact:
    """A rectangular sole that can press on the ground.

    Attributes:
        frame: name of the sole's frame (z up from the ground).
        half_length: half size along x that the controller uses [m].
        half_width: half size along y that the controller uses [m].
        friction: Coulomb coefficient that the controller assumes.
    """

    frame: str
    half_length: float
    half_width: float
    friction: float

    def __post_init__(self) -> None:
        for name in ("half_length", "half_width", "friction"):
            require_positive(f"contact {name}", getattr(self, name))


def wrench_cone(contact: SoleContact) -> Array:
    r"""Matrix U of the contact wrench cone :math:`U F \le 0` of a rectangular sole.

    F = [force; moment about the sole's centre], in the sole's axes. The cone is exactly the set of sums of forces at
    the four corners that lie in the friction pyramid :math:`|f_x|, |f_y| \le \mu f_z`: 4 rows of friction, 4 of
    centre of pressure, 8 of yaw torque.

    Source: Caron, Pham, Nakamura, "Stability of surface contacts for humanoid robots" (ICRA 2015), proposition 1;
    used as eq. (17) of Lee et al.

    Args:
        contact: sole and friction.

    Returns:
        Shape (16, 6).
    """
    x, y, mu = contact.half_length, contact.half_width, contact.friction
    rows = [[sx * (axis == 0), sx * (axis == 1), -mu, 0.0, 0.0, 0.0] for axis in (0, 1) for sx in (-1.0, 1.0)]
    rows += [[0.0, 0.0, -y, s, 0.0, 0.0] for s in (-1.0, 1.0)]
    rows += [[0.0, 0.0, -x, 0.0, s, 0.0] for s in (-1.0, 1.0)]
    for a in (-1.0, 1.0):
        for b in (-1.0, 1.0):
            # m_z >= -mu (x + y) f_z + |y f_x - mu m_x| + |x f_y - mu m_y|
            rows.append([a * y, b * x, -mu * (x + y), -a * mu, -b * mu, -1.0])
            # m_z <= mu (x + y) f_z - |y f_x + mu m_x| - |x f_y + mu m_y|
            rows.append([a * y, b * x, -mu * (x + y), a * mu, b * mu, 1.0])
    return np.array(rows)


def sole_corners(half_length: float, half_width: float) -> Array:
    """Corners of a sole in its frame, shape (4, 3) [m], anticlockwise seen from above."""
    x, y = half_length, half_width
    return np.array([[x, y, 0.0], [-x, y, 0.0], [-x, -y, 0.0], [x, -y, 0.0]])
