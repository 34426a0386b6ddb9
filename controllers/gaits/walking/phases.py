"""Phases of walking: what each of them knows, and what it asks for.

A phase does not change; :mod:`controllers.gaits.walking.transitions` makes the next one. Times without a unit are those
of the gait's clock [s].
"""

import math
from dataclasses import dataclass
from enum import Enum
from typing import ClassVar

import numpy as np

from controllers.balance.dcm_plan import DcmPlan, DcmReference
from controllers.gaits.commands import VelocityCommand
from controllers.gaits.footholds import Foothold
from controllers.gaits.walking.swing_path import SwingPath
from robots.messages import Array

LONG_LOADED = (-math.inf, -math.inf)
"""``loaded_since`` of two feet that have carried the robot for long."""

NO_LIMITS: Array = np.ones(2)
"""Each foot may carry the whole robot."""
NO_LIMITS.setflags(write=False)


class Support(Enum):
    """What the robot stands on, by plan."""

    STAND = 0
    DOUBLE = 1
    SINGLE = 2


@dataclass(frozen=True, slots=True)
class Standing:
    """On both feet, until a command or a push makes it step.

    Attributes:
        since: when it began.
        plan: of the DCM, to rest between the feet.
        loaded_since: when left and right foot began to take on load.
    """

    support: ClassVar[Support] = Support.STAND
    since: float
    plan: DcmPlan
    loaded_since: tuple[float, float] = LONG_LOADED

    def dcm(self, t: float) -> DcmReference:
        """The planned DCM."""
        return self.plan.evaluate(t - self.since)

    def load_limits(self, t: float, transfer_time: float) -> Array:
        """Fraction of the weight that each foot may carry, shape (2,): one that has landed takes it on in time."""
        left, right = (min(1.0, (t - since) / transfer_time) for since in self.loaded_since)
        return _limits(left, right)


@dataclass(frozen=True, slots=True)
class DoubleSupport:
    """On both feet, on the way to the next step: the load goes over to the foot that will stand.

    Attributes:
        since: when it began; moved on while it waits.
        duration: after which the foot lifts [s].
        swing: the foot that lifts.
        plan: of the DCM.
        command: that the next step follows, limited in its change against the step before.
        next_single_support: time on one foot that follows [s].
        loaded_since: when left and right foot began to take on load.
        waited: for how long an error of the DCM has held the foot down [s].
        may_lift: whether the wait is over, or was not needed.
    """

    support: ClassVar[Support] = Support.DOUBLE
    since: float
    duration: float
    swing: int
    plan: DcmPlan
    command: VelocityCommand
    next_single_support: float
    loaded_since: tuple[float, float]
    waited: float = 0.0
    may_lift: bool = False

    def dcm(self, t: float) -> DcmReference:
        """The planned DCM, at rest while a foot waits to lift."""
        planned = self.plan.evaluate(t - self.since)
        if self.waited > 0.0 and not self.may_lift:
            # the plan's time stands still, and so does its point
            return DcmReference(planned.position, np.zeros(2), planned.omega)
        return planned

    def load_limits(self, t: float, transfer_time: float) -> Array:
        """Fraction of the weight that each foot may carry, shape (2,).

        The foot that has landed takes it on, and the one that lifts gives it up, each in ``transfer_time`` [s]: no
        torque jumps when a contact is added to DynWBC or taken from it.
        """
        limits = [min(1.0, (t - since) / transfer_time) for since in self.loaded_since]
        gives_up = (self.duration - (t - self.since)) / transfer_time
        limits[self.swing] = max(0.0, min(limits[self.swing], gives_up))
        return _limits(*limits)


@dataclass(frozen=True, slots=True)
class SingleSupport:
    """On one foot, the other one on its way.

    Attributes:
        since: when the foot lifted.
        duration: after which it lands, by plan [s].
        swing: the foot in the air.
        chosen: foothold that the planner has chosen for it.
        target: foothold that it is sent to: the one chosen, unless a disturbance has moved it.
        path: of the foot, on its own clock since it lifted.
        plan: of the DCM.
        dcm_at_touchdown: shape (2,) in the plan made at lift-off, which ``chosen`` belongs to [m].
        command: that the step follows.
        closes: whether the robot may stand after this step: it is to stop, and its feet will be side by side.
    """

    support: ClassVar[Support] = Support.SINGLE
    since: float
    duration: float
    swing: int
    chosen: Foothold
    target: Foothold
    path: SwingPath
    plan: DcmPlan
    dcm_at_touchdown: Array
    command: VelocityCommand
    closes: bool

    def dcm(self, t: float) -> DcmReference:
        """The planned DCM."""
        return self.plan.evaluate(t - self.since)

    def load_limits(self, t: float, transfer_time: float) -> Array:
        """None: one foot carries everything."""
        return NO_LIMITS


Phase = Standing | DoubleSupport | SingleSupport


def _limits(left: float, right: float) -> Array:
    return NO_LIMITS if left == right == 1.0 else np.array([left, right])
