"""The path of a swinging foot, which may be sent elsewhere on its way."""

import copy
import math
from typing import NamedTuple

import numpy as np

from controllers.motions.quintic import Quintic
from robots.checks import require_non_negative, require_positive
from robots.messages import Array

PEAK_ACCELERATION = 10.0 / math.sqrt(3.0)
"""Of a quintic from rest to rest, over its length and per square of its duration."""


class FootMotion(NamedTuple):
    """A foot in the air at one instant.

    Attributes:
        position: shape (3,) of the sole's centre [m].
        velocity: shape (3,) [m/s].
        acceleration: shape (3,) [m/s^2].
        yaw: direction of the sole [rad].
        turn_rate: its rate [rad/s].
        turn_acceleration: its second rate [rad/s^2].
    """

    position: Array
    velocity: Array
    acceleration: Array
    yaw: float
    turn_rate: float
    turn_acceleration: float


class SwingPath:
    """Foot from where it is to a foothold: x, y, yaw on one quintic, the height up and down on two.

    x, y and yaw arrive at ``ARRIVAL`` of the time, so that the foot comes down straight; and it goes on down at
    ``touch_speed`` until the ground stops it. A path does not change: sent elsewhere, it is another one.

    Args:
        start: shape (4,) x, y, height [m] and yaw [rad] at the start, at rest.
        target: shape (4,) the same at the end.
        apex: height over the higher of start and target [m], above 0.
        duration: above 0 [s].
        touch_speed: downward speed at the end, 0 or above [m/s].

    Attributes:
        target: shape (4,) where it ends.
        duration: when it ends [s].
    """

    ARRIVAL = 0.95
    RISE = 0.45

    def __init__(self, start: Array, target: Array, apex: float, duration: float, touch_speed: float = 0.0) -> None:
        require_positive("apex", apex)
        require_non_negative("touch_speed", touch_speed)
        self._touch = np.array([-touch_speed])
        self.duration = duration
        self.target = target.copy()
        self._flat_since = 0.0
        at_rest = np.zeros((3, 4))
        at_rest[0] = start
        self._flat = Quintic(at_rest[:, [0, 1, 3]], target[[0, 1, 3]], self.ARRIVAL * duration)
        self._top = top = np.array([max(start[2], target[2]) + apex])
        self._ground = target[2:3].copy()
        self._up_since = 0.0
        self._top_at = self.RISE * duration
        self._up = Quintic(at_rest[:, 2:3], top, self._top_at)
        self._down = Quintic(self._at_top(), self._ground, duration - self._top_at, self._touch)

    def _at_top(self) -> Array:
        return np.array([[self._top[0]], [0.0], [0.0]])

    def redirected(self, target: Array, t: float, remaining: float) -> "SwingPath":
        """The path that from time ``t`` [s] on goes to ``target`` (4,) in ``remaining`` [s].

        It goes on where this one is then, in position, velocity and acceleration. The height of the ground stays that
        of the first target.
        """
        path = copy.copy(self)
        early = (1.0 - self.ARRIVAL) * self.duration
        # close to the end there is no time left to arrive early by: half of what there is must do
        path._flat = Quintic(
            self._flat.evaluate(t - self._flat_since), target[[0, 1, 3]], max(remaining - early, 0.5 * remaining)
        )
        path._flat_since = t
        # a foot that lands when it was to land keeps its height's path: made anew it would differ by rounding only
        if abs(t + remaining - self.duration) > 1e-9:
            path._land_at(t, remaining)
        path.target = target.copy()
        return path

    def _land_at(self, t: float, remaining: float) -> None:
        """New heights: on to the top if there is time for it, and down."""
        here, end = self._height(t), t + remaining
        top_at = self.RISE * end
        if top_at - t > 0.1 * end:
            self._up, self._up_since, self._top_at = Quintic(here, self._top, top_at - t), t, top_at
            self._down = Quintic(self._at_top(), self._ground, end - top_at, self._touch)
        else:
            # past the top, or so close to it that going there first would take a jerk
            self._down, self._top_at = Quintic(here, self._ground, remaining, self._touch), t
        self.duration = end

    def _height(self, t: float) -> Array:
        return self._up.evaluate(t - self._up_since) if t < self._top_at else self._down.evaluate(t - self._top_at)

    def evaluate(self, t: float) -> FootMotion:
        """Where the foot is at ``t`` [s], and how it moves; new arrays."""
        # by way of plain floats: assignments to columns would cost more than both polynomials
        (x, y, yaw), (vx, vy, rate), (ax, ay, second_rate) = self._flat.evaluate(t - self._flat_since).tolist()
        (z,), (vz,), (az,) = self._height(t).tolist()
        position, velocity, acceleration = np.array([x, y, z, vx, vy, vz, ax, ay, az]).reshape(3, 3)
        return FootMotion(position, velocity, acceleration, yaw, rate, second_rate)
