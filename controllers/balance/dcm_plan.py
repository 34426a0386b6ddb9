"""Linear inverted pendulum: reference of the divergent component of motion for a piecewise linear ZMP."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robots.checks import require_positive
from robots.errors import ConfigError
from robots.messages import Array


@dataclass(frozen=True, slots=True)
class ZmpPhase:
    """A time in which the ZMP moves in a straight line at constant speed.

    Attributes:
        start: shape (2,) where it starts [m].
        end: shape (2,) where it ends [m].
        duration: above 0 [s].
    """

    start: Array
    end: Array
    duration: float


@dataclass(frozen=True, slots=True)
class DcmReference:
    r"""Divergent component of motion :math:`\xi = c + \dot c / \omega` that the robot is to have at one instant.

    Attributes:
        position: shape (2,) [m].
        velocity: shape (2,) [m/s].
        omega: :math:`\sqrt{g / z}` of the pendulum [1/s].
    """

    position: Array
    velocity: Array
    omega: float

    @property
    def zmp(self) -> Array:
        r"""The ZMP (2,) under which the reference moves as it does, :math:`\xi - \dot\xi / \omega` [m]."""
        return self.position - self.velocity / self.omega


class DcmPlan:
    r"""The bounded solution of :math:`\dot\xi = \omega (\xi - p)` for a ZMP that is piecewise linear in time.

    Over a phase with :math:`p(t) = p_0 + s t`,

    .. math:: \xi(t) = p(t) + s / \omega + (\xi(T) - p(T) - s / \omega)\, e^{\omega (t - T)}

    and the last phase ends at rest, on the ZMP; so the plan is found backwards. Before and after its phases the ZMP
    stays where it was.

    Source: Englsberger, Ott, Albu-Schaeffer, "Three-dimensional bipedal walking control based on divergent component
    of motion" (IEEE T-RO 2015), section IV, for constant ZMP; the linear one is integrated by parts.

    Args:
        phases: in order of time, one at least; each starts where the one before has ended.
        omega: of the pendulum, above 0 [1/s].

    Raises:
        ConfigError: no phase, or a duration or omega that is not positive.
    """

    def __init__(self, phases: Sequence[ZmpPhase], omega: float) -> None:
        require_positive("omega", omega)
        if not phases:
            raise ConfigError("phases", list(phases), "one phase at least")
        self.omega = omega
        x, y = self._rest = (float(phases[-1].end[0]), float(phases[-1].end[1]))
        pieces = []
        # backwards: where a phase has to end is known from those after it
        # plain floats: a plan is made and asked in every tick, and numpy's calls would cost more than the sums
        for phase in reversed(phases):
            require_positive("duration of a phase", phase.duration)
            (ax, ay), (bx, by), span = phase.start.tolist(), phase.end.tolist(), phase.duration
            sx, sy = (bx - ax) / span, (by - ay) / span
            decay = math.exp(-omega * span)
            grow_x, grow_y = (x - bx - sx / omega) * decay, (y - by - sy / omega) * decay
            pieces.append((span, ax, ay, sx, sy, grow_x, grow_y))
            x, y = ax + sx / omega + grow_x, ay + sy / omega + grow_y
        self._pieces = tuple(reversed(pieces))

    def evaluate(self, t: float) -> DcmReference:
        """The reference at ``t`` [s] after the start of the first phase."""
        x, y, vx, vy = self._at(t)
        return DcmReference(np.array([x, y]), np.array([vx, vy]), self.omega)

    def position(self, t: float) -> tuple[float, float]:
        """The reference's position at ``t`` [s] after the start of the first phase, x and y [m]."""
        return self._at(t)[:2]

    def _at(self, t: float) -> tuple[float, float, float, float]:
        """Position and velocity."""
        elapsed, omega = max(t, 0.0), self.omega
        for span, ax, ay, sx, sy, grow_x, grow_y in self._pieces:
            if elapsed < span:
                growth = math.exp(omega * elapsed)
                x, y = grow_x * growth, grow_y * growth
                px, py = ax + sx * elapsed + sx / omega + x, ay + sy * elapsed + sy / omega + y
                return px, py, sx + omega * x, sy + omega * y
            elapsed -= span
        return self._rest[0], self._rest[1], 0.0, 0.0


def waypoint(
    dcm_start: Array, zmp_start: Array, zmp_end: Array, dcm_end: Array, durations: tuple[float, float], omega: float
) -> Array:
    """Where a ZMP that goes to ``zmp_end`` by way of one more point has to turn, for the DCM to go between two points.

    So a walk begins from standing without a jump of the ZMP.

    Args:
        dcm_start: shape (2,) DCM at the start [m].
        zmp_start: shape (2,) ZMP at the start [m].
        zmp_end: shape (2,) ZMP at the end [m].
        dcm_end: shape (2,) DCM at the end [m].
        durations: to the point and from it, each above 0 [s].
        omega: of the pendulum [1/s].

    Returns:
        Shape (2,) the point [m].
    """
    turns = omega * durations[0], omega * durations[1]
    decays = np.exp(-turns[0]), np.exp(-turns[1])
    fractions = (1.0 - decays[0]) / turns[0], (1.0 - decays[1]) / turns[1]
    # of one phase: dcm_start = zmp_start (1 - fraction) + zmp_end (fraction - decay) + dcm_end decay
    rest = zmp_end * (fractions[1] - decays[1]) + dcm_end * decays[1]
    factor = (fractions[0] - decays[0]) + (1.0 - fractions[1]) * decays[0]
    out: Array = (dcm_start - zmp_start * (1.0 - fractions[0]) - rest * decays[0]) / factor
    return out
