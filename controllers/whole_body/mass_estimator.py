"""How heavy the robot really is, from the forces under its feet."""

import math

from robots.checks import require_positive
from robots.messages import Array
from wbc.wrench import GRAVITY

LIGHTEST, HEAVIEST = 0.6, 1.6
"""Bounds of the estimate, as fractions of the model's mass: a foot in the air or a stamp is no weight."""


class MassEstimator:
    r"""Mean of the vertical force under the feet over the model's weight, by a first-order low-pass filter.

    .. math:: \dot s = (f_z / (m g) - s) / T

    The force is the weight only while the CoM is at rest or moves up and down about one height, as in walking; ``T``
    has to be long against that motion, and against the feedback of the CoM's height (an eighth of a second): a scale
    that is too large lifts the robot, and lifting it raises the force.

    Attributes:
        scale: the estimate, starts at 1.
    """

    def __init__(self, mass: float, time_constant: float) -> None:
        """``mass`` of the model [kg] and ``time_constant`` T [s], both above 0."""
        require_positive("mass", mass)
        require_positive("load time constant", time_constant)
        self._weight = mass * GRAVITY
        self._time_constant = time_constant
        self.scale = 1.0

    def reset(self) -> None:
        """Begin again with the model's mass."""
        self.scale = 1.0

    def update(self, foot_forces: Array, dt: float) -> float:
        """Take in the vertical forces (2,) [N] of one tick of ``dt`` [s]; returns the estimate.

        Forces that are not finite leave it as it is.
        """
        if not math.isfinite(total := float(foot_forces.sum())):
            return self.scale
        measured = min(max(total / self._weight, LIGHTEST), HEAVIEST)
        self.scale += (measured - self.scale) * min(1.0, dt / self._time_constant)
        return self.scale
