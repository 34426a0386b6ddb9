"""What happens in a run, apart from its options: posture, gait, hands, obstacles, pushes."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from controllers.gaits.gait import Gait
from controllers.motions.hands import Motion
from controllers.reference import WholeBodyReference
from controllers.whole_body.controller import WholeBodyController
from experiments.scenarios.obstacles import Encounter
from robots.checks import require_non_negative
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.messages import Array

PUSH_TIME = 0.1
"""How long a push lasts [s]."""

DIRECTIONS = {"forward": 0.0, "left": 90.0, "backward": 180.0, "right": 270.0}
"""Directions of a push by name, seen from above, anticlockwise from the world's x axis [deg]."""

MakeMotion = Callable[[RobotDescription, WholeBodyReference], Motion]
MakeGait = Callable[[Kinematics], Gait]
MakeEncounter = Callable[[RobotDescription, WholeBodyReference, np.random.Generator], Encounter]
Series = dict[str, Array]


@dataclass(slots=True)
class Cast:
    """References and what moves them, in this order.

    Attributes:
        reference: of all tasks.
        gait: moves feet and balance; ``None``: the robot stands on both feet.
        motions: of what the gait leaves.
    """

    reference: WholeBodyReference
    gait: Gait | None
    motions: Sequence[Motion]


Extra = Callable[[WholeBodyController, Cast, Array, float], Series]
Figures = Callable[[RobotDescription, Series], dict[str, Any]]


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


def parse_pushes(texts: Sequence[str], duration: float) -> list[Push]:
    """The pushes of a run of ``duration`` [s], as :func:`parse_push` reads them.

    Raises:
        ConfigError: one of them is no push, or begins after the end of the run.
    """
    pushes = [parse_push(text) for text in texts]
    for push, text in zip(pushes, texts, strict=True):
        if push.time >= duration:
            raise ConfigError("push", text, f"within the run's {duration:g} s")
    return pushes


@dataclass(frozen=True, slots=True)
class Scenario:
    """What happens in a run.

    Attributes:
        experiment: its name, for the summary.
        posture: name of the posture it starts from.
        hands: makes the motion of the hands; ``None``: the hands are no task.
        gait: makes what moves feet and balance, from kinematics at the first state; ``None``: the robot stands on both
            feet.
        encounter: makes the obstacle; ``None``: there is none.
        pushes: on the torso.
        changes: fields of the controller's configuration that this scenario sets.
        settings: of the gait, by the names of their tables below ``[tuning]``: what the configuration tells of them.
        extra: further series, one value per control tick, computed before the run from a controller and a cast of their
            own, the first configuration (nq,) and the run's duration [s].
        figures: further figures of the summary, from the robot and the recorded series.
    """

    experiment: str
    posture: str = "standing"
    hands: MakeMotion | None = None
    gait: MakeGait | None = None
    encounter: MakeEncounter | None = None
    pushes: Sequence[Push] = ()
    changes: Mapping[str, Any] = field(default_factory=dict)
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    extra: Extra | None = None
    figures: Figures | None = None
