"""A robot that stands or walks, and is pushed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

from experiments.metrics.declared_motion import WALKING
from experiments.metrics.metric import Metric
from experiments.scenarios.pushes import Push, parse_pushes
from experiments.scenarios.scenario import Scenario, Setup
from robots.checks import require_one_of

if TYPE_CHECKING:
    from controllers.gaits.commands import VelocityCommand
    from robots.description import RobotDescription
    from robots.messages import Array

ACTIVITIES = ("standing", "walking")

START, SPEED = 1.0, 0.2
"""Walking: when the command begins [s], and its velocity forward [m/s]."""


@dataclass(frozen=True)
class Pushed(Scenario):
    """Stand ready to step, or walk forward at 0.2 m/s to the end, and be pushed."""

    name: ClassVar[str] = "pushed"
    metrics: ClassVar[tuple[Metric, ...]] = WALKING

    activity: str = "standing"
    """What the robot does: standing (it steps where a push makes it) or walking."""
    push: tuple[str, ...] = ()
    """Pushes of 0.1 s at the torso: N,direction,time, with forward, left, backward, right or degrees from the world's
    x axis; for example 80,left,2."""

    def setup(self, robot: RobotDescription) -> Setup:
        """A walk at a constant command: see :meth:`Scenario.setup`."""
        from experiments.scenarios.walk_plan import walk_setup

        require_one_of("activity", self.activity, ACTIVITIES)
        parse_pushes(self.push, self.duration)
        return walk_setup(robot, partial(_command, self.activity == "walking"))

    def all_pushes(self, robot: RobotDescription) -> tuple[Push, ...]:
        """Those of ``push`` and of ``pushes``."""
        return (*self.pushes, *parse_pushes(self.push, self.duration))

    def measure(self, robot: RobotDescription, series: Mapping[str, Array]) -> dict[str, Any]:
        """Metrics of a walk: see :meth:`Scenario.measure`."""
        from experiments.metrics.locomotion import walk_metrics

        return walk_metrics(series, series["command"])


def _command(walks: bool, t: float) -> VelocityCommand:
    from controllers.gaits.commands import VelocityCommand

    return VelocityCommand(vx=SPEED) if walks and t >= START - 1e-9 else VelocityCommand()
