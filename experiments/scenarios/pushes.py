"""Pushes on the torso, as data; nothing heavy is imported here."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from robots.checks import require_non_negative
from robots.errors import ConfigError

if TYPE_CHECKING:
    from robots.messages import Array

PUSH_TIME = 0.1
"""How long a push lasts [s]."""

DIRECTIONS = {"forward": 0.0, "left": 90.0, "backward": 180.0, "right": 270.0}
"""Directions of a push by name, seen from above, anticlockwise from the world's x axis [deg]."""


@dataclass(frozen=True, slots=True)
class Push:
    """A constant force on the torso for ``PUSH_TIME``.

    Attributes:
        force: [N].
        direction: horizontal, from the world's x axis [deg].
        time: when it begins [s].
    """

    force: float
    direction: float
    time: float

    def __post_init__(self) -> None:
        require_non_negative("push force", self.force)
        require_non_negative("push time", self.time)
        if not math.isfinite(self.direction):
            raise ConfigError("push direction", self.direction, "a finite angle in degrees")

    def at(self, t: float) -> Array:
        """Its force (3,) at ``t`` [s], world axes [N]."""
        import numpy as np

        if not -1e-9 <= t - self.time < PUSH_TIME - 1e-9:
            return np.zeros(3)
        angle = math.radians(self.direction)
        return self.force * np.array([math.cos(angle), math.sin(angle), 0.0])


def parse_push(text: str) -> Push:
    """A push from ``N,direction,time``: newtons, ``forward``, ``left``, ``backward``, ``right`` or degrees, seconds.

    Raises:
        ConfigError: it is something else.
    """
    allowed = "force,direction,time: newtons, " + ", ".join(DIRECTIONS) + " or degrees, seconds"
    try:
        force, direction, time = text.split(",")
        angle = DIRECTIONS[direction] if direction in DIRECTIONS else float(direction)
        return Push(float(force), angle, float(time))
    except ValueError as error:
        if isinstance(error, ConfigError):
            raise
        raise ConfigError("push", text, allowed) from error


def parse_pushes(texts: Sequence[str], duration: float) -> tuple[Push, ...]:
    """The pushes of a run of ``duration`` [s], as :func:`parse_push` reads them.

    Raises:
        ConfigError: one of them is no push, or begins after the end of the run.
    """
    pushes = tuple(parse_push(text) for text in texts)
    for push, text in zip(pushes, texts, strict=True):
        if push.time >= duration:
            raise ConfigError("push", text, f"within the run's {duration:g} s")
    return pushes
