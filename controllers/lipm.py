"""Linear inverted pendulum: reference of the divergent component of motion for a piecewise linear ZMP."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robots.checks import require_positive
from robots.errors import ConfigError
from robots.messages import Array


@dataclass(frozen=True, slots=True)
class ZmpPhase:
    """A stretch of time in which the ZMP goes in a straight line at constant speed.

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
        self._phases = tuple(phases)
        self._ends: list[Array] = [phases[-1].end]
        for phase in reversed(phases):
            require_positive("duration of a phase", phase.duration)
            self._ends.append(_dcm_in_phase(phase, self._ends[-1], 0.0, omega))
        # _ends[i]: where the DCM is at the end of phase i, after reversing
        self._ends = self._ends[::-1][1:]

    def evaluate(self, t: float) -> DcmReference:
        """The reference at ``t`` [s] after the start of the first phase."""
        left = max(t, 0.0)
        last = len(self._phases) - 1
        for i, phase in enumerate(self._phases):
            if left < phase.duration:
                position = _dcm_in_phase(phase, self._ends[i], left, self.omega)
                zmp = phase.start + (left / phase.duration) * (phase.end - phase.start)
                return DcmReference(position, self.omega * (position - zmp), self.omega)
            if i < last:
                left -= phase.duration
        return DcmReference(self._phases[-1].end.copy(), np.zeros(2), self.omega)


def _dcm_in_phase(phase: ZmpPhase, dcm_end: Array, t: float, omega: float) -> Array:
    speed = (phase.end - phase.start) / phase.duration
    zmp = phase.start + speed * t
    return zmp + speed / omega + (dcm_end - phase.end - speed / omega) * np.exp(omega * (t - phase.duration))


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
    shares = (1.0 - decays[0]) / turns[0], (1.0 - decays[1]) / turns[1]
    # of one phase: dcm_start = zmp_start (1 - share) + zmp_end (share - decay) + dcm_end decay
    rest = zmp_end * (shares[1] - decays[1]) + dcm_end * decays[1]
    factor = (shares[0] - decays[0]) + (1.0 - shares[1]) * decays[0]
    out: Array = (dcm_start - zmp_start * (1.0 - shares[0]) - rest * decays[0]) / factor
    return out
