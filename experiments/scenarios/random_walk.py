"""A walk in which everything is drawn from a seed: the robot's masses, the ground, sensors, commands, pushes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import tyro

from experiments.metrics.declared_motion import DRAWN, WALKING
from experiments.metrics.metric import Metric
from experiments.scenarios.options import PlantOptions
from experiments.scenarios.pushes import Push
from experiments.scenarios.scenario import Scenario, Setup
from robots.checks import require_between
from robots.errors import ConfigError

if TYPE_CHECKING:
    from experiments.scenarios.random_draw import RandomDraw
    from robots.description import RobotDescription
    from robots.messages import Array

SHORTEST = 6.0
"""Shortest walk [s]: pushes come from two seconds on, one a second at most."""


@dataclass(frozen=True)
class RandomWalk(Scenario):
    """Walk with everything drawn from --seed: masses, friction, sensor noise, delay, commands, pushes."""

    name: ClassVar[str] = "random-walk"
    metrics: ClassVar[tuple[Metric, ...]] = (*WALKING, *DRAWN)

    duration: float = 20.0
    """Simulated time [s]."""
    plant: Annotated[PlantOptions, tyro.conf.Suppress] = field(default_factory=PlantOptions)
    """Drawn from the seed: not an option."""

    def draw(self, robot: RobotDescription) -> RandomDraw:
        """What the seed gives for a robot."""
        from experiments.scenarios.random_draw import draw_walk

        return draw_walk(robot, self.seed, self.duration)

    def setup(self, robot: RobotDescription) -> Setup:
        """A walk by drawn commands; what was drawn is recorded: see :meth:`Scenario.setup`."""
        from dataclasses import replace

        from experiments.scenarios.walk_plan import walk_setup

        if self.plant != PlantOptions():
            raise ConfigError("plant", self.plant, "left as it is: it is drawn from the seed")
        require_between("duration", self.duration, SHORTEST, 600.0)
        drawn = self.draw(robot)
        commands = [[t, asdict(c)] for t, c in zip(drawn.script.times, drawn.script.commands, strict=True)]
        told = {"commands": commands, "pushes": [asdict(push) for push in drawn.pushes]}
        setup = walk_setup(robot, drawn.script)
        return replace(setup, settings={**setup.settings, "drawn": told})

    def mismatch(self, robot: RobotDescription) -> PlantOptions:
        """The drawn one: see :meth:`Scenario.mismatch`."""
        return self.draw(robot).plant

    def all_pushes(self, robot: RobotDescription) -> tuple[Push, ...]:
        """The drawn ones, and those of ``pushes``."""
        return (*self.pushes, *self.draw(robot).pushes)

    def measure(self, robot: RobotDescription, series: Mapping[str, Array]) -> dict[str, Any]:
        """Metrics of a walk, and what was drawn: see :meth:`Scenario.measure`."""
        from experiments.metrics.locomotion import walk_metrics
        from experiments.scenarios.random_draw import drawn_metrics

        return walk_metrics(series, series["command"]) | drawn_metrics(robot, self.draw(robot))

    def is_random(self, robot: RobotDescription) -> bool:
        """Always: see :meth:`Scenario.is_random`."""
        return True
