"""Hands that follow targets which may change at any time, in the world or in the robot's heading frame."""

import math
from dataclasses import dataclass

import numpy as np

from controllers.motions.hands import heading_axes
from controllers.reference import PointReference, WholeBodyReference
from robots.checks import all_finite, require_one_of, require_positive
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.messages import Array

FRAMES = ("world", "heading")
"""Frames of targets: the world; or origin on the ground below the reference of the CoM, axes turned with the base's
heading, so that a target goes along with a robot that walks."""

SIDES = ("left", "right")


@dataclass(frozen=True, slots=True)
class FollowerLimits:
    """How fast the reference of a hand goes after its target.

    Attributes:
        speed: largest speed, above 0 [m/s].
        acceleration: largest acceleration, above 0 [m/s^2].
        gain: of the distance, above 0 [1/s]: near the target the speed falls with it.
    """

    speed: float = 0.5
    acceleration: float = 3.0
    gain: float = 5.0

    def __post_init__(self) -> None:
        for name in ("speed", "acceleration", "gain"):
            require_positive(f"follower {name}", getattr(self, name))


class HandTargets:
    """Sends each hand after a target, without jumps of position or velocity, whenever and wherever it is set.

    Until it is given a target a hand stays where its reference was at the start, in the world.
    """

    def __init__(
        self, robot: RobotDescription, reference: WholeBodyReference, limits: FollowerLimits | None = None
    ) -> None:
        """Hands start where ``reference`` has them; so the class itself is what an agent makes the motion from.

        Raises:
            ConfigError: the reference has no hands.
        """
        if reference.hands is None:
            raise ConfigError("hands", None, "tasks of the agent: with_hands=True")
        self.limits = limits or FollowerLimits()
        self._points = [hand.position.copy() for hand in reference.hands]
        self._rates = [np.zeros(3), np.zeros(3)]
        self._targets: list[tuple[Array, str]] = [(point.copy(), "world") for point in self._points]
        self._time: float | None = None

    def set(self, side: str, position: Array, frame: str = "world") -> None:
        """Send a hand to ``position`` (3,) [m] of a frame, from the next tick on.

        Raises:
            ConfigError: no such side or frame, or no three finite numbers; the target stays as it was.
        """
        require_one_of("side", side, SIDES)
        require_one_of("frame", frame, FRAMES)
        position = np.array(position, dtype=float)
        if position.shape != (3,) or not all_finite(position):
            raise ConfigError(f"target of the {side} hand", position.tolist(), "three finite numbers")
        self._targets[SIDES.index(side)] = position, frame

    def apply(self, reference: WholeBodyReference, t: float) -> None:
        """See :meth:`controllers.motions.hands.Motion.apply`."""
        dt = 0.0 if self._time is None else max(0.0, t - self._time)
        self._time = t
        left, right = (self._follow(i, reference, dt) for i in (0, 1))
        reference.hands = left, right

    def _follow(self, i: int, reference: WholeBodyReference, dt: float) -> PointReference:
        goal, carried = self._goal(i, reference)
        limits, rate = self.limits, self._rates[i]
        offset = goal - self._points[i]
        distance = math.sqrt(offset @ offset)
        # no faster than it can still brake in
        speed = min(limits.speed, limits.gain * distance, math.sqrt(2.0 * limits.acceleration * distance))
        wanted = carried + (speed / distance) * offset if distance > 0.0 else carried
        change = wanted - rate
        size, most = math.sqrt(change @ change), limits.acceleration * dt
        if size > most:
            change *= most / size
        self._rates[i] = rate + change
        self._points[i] = self._points[i] + dt * self._rates[i]
        acceleration = change / dt if dt > 0.0 else np.zeros(3)
        return PointReference(self._points[i].copy(), self._rates[i].copy(), acceleration)

    def _goal(self, i: int, reference: WholeBodyReference) -> tuple[Array, Array]:
        """Where the target is in the world (3,) [m], and how fast it is carried along (3,) [m/s]."""
        position, frame = self._targets[i]
        if frame == "world":
            return position, np.zeros(3)
        arm = heading_axes(reference) @ position
        com, rate = reference.com, reference.turn_rate
        ground = 0.5 * (reference.soles[0].position[2] + reference.soles[1].position[2])
        origin = np.array([com.position[0], com.position[1], ground])
        velocity = np.array([com.velocity[0] - rate * arm[1], com.velocity[1] + rate * arm[0], 0.0])
        return origin + arm, velocity
