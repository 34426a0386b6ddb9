"""Where the feet go: footholds that follow a body-velocity command."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from controllers.gaits.step_timing import StepTiming
from robots.checks import require_finite, require_positive
from robots.errors import ConfigError
from robots.messages import Array

LEFT, RIGHT = 0, 1
"""Feet, in the order of the description's soles."""


@dataclass(frozen=True, slots=True)
class VelocityCommand:
    """How the body is to move, in its own heading.

    Attributes:
        vx: forward [m/s].
        vy: to the left [m/s].
        wz: turning to the left [rad/s].
        stepping: go on stepping where all three are zero; otherwise the robot then stops with its feet side by side.
    """

    vx: float = 0.0
    vy: float = 0.0
    wz: float = 0.0
    stepping: bool = False

    def __post_init__(self) -> None:
        for name in ("vx", "vy", "wz"):
            require_finite(name, getattr(self, name))

    def towards(self, other: "VelocityCommand", speed: float, turn: float) -> "VelocityCommand":
        """The command that goes from this one to ``other``, by at most ``speed`` [m/s] and ``turn`` [rad/s]."""
        dx, dy = other.vx - self.vx, other.vy - self.vy
        size = math.hypot(dx, dy)
        if size <= speed:
            vx, vy = other.vx, other.vy
        else:
            vx, vy = self.vx + dx * speed / size, self.vy + dy * speed / size
        wz = min(max(other.wz, self.wz - turn), self.wz + turn)
        return VelocityCommand(vx, vy, wz, other.stepping)

    def scaled(self, factor: float) -> "VelocityCommand":
        """All velocities times ``factor``."""
        return VelocityCommand(factor * self.vx, factor * self.vy, factor * self.wz, self.stepping)

    def foot_speed(self, width: float) -> float:
        """Largest speed of two places under the body, ``width`` apart, that feet have to keep up with [m/s]."""
        return math.hypot(self.vx, self.vy) + 0.5 * width * abs(self.wz)

    @property
    def walks(self) -> bool:
        """Whether the feet are to move."""
        return self.stepping or self.vx != 0.0 or self.vy != 0.0 or self.wz != 0.0


@dataclass(frozen=True, slots=True)
class Foothold:
    """A sole on the ground: centre ``x``, ``y`` [m] and direction ``yaw`` [rad] in the world."""

    x: float
    y: float
    yaw: float

    @property
    def point(self) -> Array:
        """Its centre, shape (2,) [m]."""
        return np.array([self.x, self.y])

    @property
    def axes(self) -> Array:
        """Its forward and left directions as columns, shape (2, 2)."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return np.array([[c, -s], [s, c]])

    def compose(self, x: float, y: float, yaw: float) -> "Foothold":
        """The foothold at ``x``, ``y``, ``yaw`` as seen from this one."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return Foothold(self.x + c * x - s * y, self.y + s * x + c * y, self.yaw + yaw)

    def relative(self, other: "Foothold") -> tuple[float, float, float]:
        """``other`` as seen from this one: x, y [m], yaw in (-pi, pi] [rad]."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        dx, dy = other.x - self.x, other.y - self.y
        return c * dx + s * dy, c * dy - s * dx, math.remainder(other.yaw - self.yaw, math.tau)


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
        half = 0.5 * self.limits.width * (1.0 if swing == LEFT else -1.0)
        body = stance.compose(0.0, half, 0.0)
        reach = self.timing.period(command.foot_speed(self.limits.width))
        turn = command.wz * reach
        # Exp of a planar velocity: the body turns while it moves
        a, b = (1.0, 0.5 * turn) if abs(turn) < 1e-6 else (math.sin(turn) / turn, (1.0 - math.cos(turn)) / turn)
        x = reach * (a * command.vx - b * command.vy)
        y = reach * (b * command.vx + a * command.vy)
        # what a trailing foot may not come closer, the leading one goes further
        missing = max(0.0, abs(y) - (self.limits.width - self.limits.narrowest))
        if missing > 0.0 and y * half > 0.0:
            y += math.copysign(missing, y)
        return self.limits.clamp(stance, body.compose(x, y, turn).compose(0.0, half, 0.0), swing)
