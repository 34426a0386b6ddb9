r"""How likely each foot stands: what its force, its motion and the plan say, added up as odds.

Each cue gives the logarithm of the odds that the foot stands, and independent cues add:

.. math:: L = c \left(\frac{f}{f_0} - 1\right) + L_{plan} - \left(\frac{|v|}{v_0}\right)^2,
    \qquad P = \frac{1}{1 + e^{-L}}

with the force f along the sole's normal, the speed v of the sole, both as estimated, and the plan's say. Every term is
bounded, so that none alone outvotes the others by any amount. The same kind of fusion, by a Kalman filter over phase,
height and force: Bledt, Wensing, Ingersoll and Kim, *Contact model fusion for event-based locomotion in dynamic legged
robots*, ICRA 2018.
"""

from dataclasses import dataclass

import numpy as np

from robots.checks import require_between, require_non_negative, require_positive
from robots.messages import Array, Mask


@dataclass(frozen=True, slots=True)
class ContactCues:
    """How much each cue counts.

    Attributes:
        force: force along the normal at which it says neither, as a fraction of the robot's weight, in (0, 0.5).
        force_odds: what no force says against it, and twice that for it at most; above 0.
        speed: of the sole at which it says one unit against it [m/s].
        speed_odds: what it says against it at most.
        plan_odds: what the plan says, for or against.
        memory: time constant of the odds [s].
    """

    force: float = 0.08
    force_odds: float = 5.0
    speed: float = 0.25
    speed_odds: float = 4.0
    plan_odds: float = 2.0
    memory: float = 0.004

    def __post_init__(self) -> None:
        require_between("contact force", self.force, 1e-3, 0.5)
        require_positive("contact speed", self.speed)
        for name in ("force_odds", "speed_odds", "plan_odds", "memory"):
            require_non_negative(f"contact {name}", getattr(self, name))


class ContactBelief:
    """Probability that each foot stands.

    Attributes:
        probability: shape (2,), left first.
    """

    def __init__(self, weight: float, cues: ContactCues | None = None) -> None:
        """For a robot of this ``weight`` [N]; ``cues``: those of :class:`ContactCues` if not given."""
        require_positive("weight", weight)
        self._weight, self._cues = weight, cues or ContactCues()
        self._odds = np.zeros(2)
        self.probability = np.ones(2)
        self.reset()

    def reset(self, standing: bool = True) -> None:
        """Begin with both feet on the ground, or both in the air."""
        self._odds[:] = 2.0 * self._cues.force_odds if standing else -self._cues.force_odds
        self.probability[:] = float(standing)

    def update(self, forces: Array, speeds: Array, planned: Mask | None, dt: float) -> Array:
        """Take in one tick.

        Args:
            forces: shape (2,) along the normals [N].
            speeds: shape (2,) of the soles [m/s].
            planned: shape (2,) which feet are to stand; ``None`` without a plan.
            dt: since the last tick [s].

        Returns:
            The probabilities (2,), the object's own.
        """
        cues = self._cues
        odds = cues.force_odds * np.clip(forces / (cues.force * self._weight) - 1.0, -1.0, 2.0)
        odds -= np.minimum((speeds / cues.speed) ** 2, cues.speed_odds)
        if planned is not None:
            odds += np.where(planned, cues.plan_odds, -cues.plan_odds)
        self._odds += (odds - self._odds) * min(1.0, dt / max(cues.memory, dt))
        np.divide(1.0, 1.0 + np.exp(-self._odds), out=self.probability)
        return self.probability
