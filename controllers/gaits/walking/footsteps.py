"""Where the feet go: footholds that follow a body-velocity command."""

import math
from dataclasses import dataclass
from typing import Protocol

from controllers.gaits.commands import VelocityCommand
from controllers.gaits.footholds import LEFT, Foothold
from controllers.gaits.walking.timing import StepTiming
from robots.checks import require_positive
from robots.errors import ConfigError


class FootstepPlanner(Protocol):
    """Chooses footholds. Anything with this method can take the place of :class:`VelocityFootsteps`.

    It is asked for steps that lie further ahead as well, each from the foothold before, and again when plans change:
    its answer may depend on nothing but the arguments. A foothold beyond the bounds of :class:`StepLimits` is moved to
    them. The time of a step follows from the command: long steps need a command as fast as they are.
    """

    def next_foothold(self, stance: Foothold, swing: int, command: VelocityCommand) -> Foothold:
        """Where the foot ``swing`` (``LEFT`` or ``RIGHT``) is to come down, the other one standing at ``stance``."""
        ...


@dataclass(frozen=True, slots=True)
class StepLimits:
    """Bounds of one foothold, seen from the standing foot.

    Attributes:
        width: distance of the feet side by side, above 0 [m].
        forward: longest step forward or back, above 0 [m].
        narrowest: smallest distance of the feet, above 0 [m].
        widest: largest distance of the feet [m].
        turn: largest turn of a foot against the other, above 0 [rad].
    """

    width: float
    forward: float
    narrowest: float
    widest: float
    turn: float

    def __post_init__(self) -> None:
        for name in self.__slots__:
            require_positive(f"step {name}", getattr(self, name))
        if not self.narrowest <= self.width <= self.widest:
            raise ConfigError("step width", self.width, f"from narrowest {self.narrowest} to widest {self.widest}")

    def clamp(self, stance: Foothold, foothold: Foothold, swing: int) -> Foothold:
        """The foothold of the foot ``swing`` moved into the bounds."""
        # sideways outwards, so that one pair of bounds serves both feet
        side = 1.0 if swing == LEFT else -1.0
        x, y, yaw = stance.relative(foothold)
        x = min(max(x, -self.forward), self.forward)
        y = side * min(max(side * y, self.narrowest), self.widest)
        return stance.compose(x, y, min(max(yaw, -self.turn), self.turn))


class VelocityFootsteps:
    r"""Footholds under a body that moves at the commanded velocity, and turns about itself.

    Where a velocity to the side asks one foot for a place nearer to the other than the bounds allow, that foot comes
    down on the bound, and the other one makes its step the longer for it.

    The body's path is :math:`X_{k+1} = X_k \operatorname{Exp}(v T)`; the feet stand at half the width to its left and
    right, in turn. The standing foot tells where :math:`X_k` is: errors of earlier steps are not carried on.

    Args:
        limits: bounds of one foothold.
        timing: T, the time of one step at each speed.
    """

    def __init__(self, limits: StepLimits, timing: StepTiming) -> None:
        self.limits = limits
        self.timing = timing

    def next_foothold(self, stance: Foothold, swing: int, command: VelocityCommand) -> Foothold:
        """See :meth:`FootstepPlanner.next_foothold`."""
        # from the standing foot to the body, and from there on to the side of the other foot
        half = 0.5 * self.limits.width * (1.0 if swing == LEFT else -1.0)
        body = stance.compose(0.0, half, 0.0)
        period = self.timing.period(command.foot_speed(self.limits.width))
        turn = command.wz * period
        # Exp of a planar velocity: the body turns while it moves; by its series where the quotients would be 0 / 0
        a, b = (1.0, 0.5 * turn) if abs(turn) < 1e-6 else (math.sin(turn) / turn, (1.0 - math.cos(turn)) / turn)
        x = period * (a * command.vx - b * command.vy)
        y = period * (b * command.vx + a * command.vy)
        # what a trailing foot may not come closer, the leading one goes further: two steps are as long as commanded
        missing = max(0.0, abs(y) - (self.limits.width - self.limits.narrowest))
        if missing > 0.0 and y * half > 0.0:
            y += math.copysign(missing, y)
        return self.limits.clamp(stance, body.compose(x, y, turn).compose(0.0, half, 0.0), swing)
