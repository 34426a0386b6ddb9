"""Standing on one leg while the hands go to far targets, TAICHI: section 5.3.1 of Lee et al."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from experiments.metrics.declared_motion import ONE_LEG
from experiments.metrics.metric import Metric
from experiments.scenarios.pushes import Push, parse_pushes
from experiments.scenarios.scenario import Scenario, Setup

if TYPE_CHECKING:
    from robots.description import RobotDescription
    from robots.messages import Array


@dataclass(frozen=True)
class Taichi(Scenario):
    """Stand on the left leg while both hands go to far targets.

    The CoM goes over the left foot in 10 s; then the right foot is up for 10 s, and comes down again.
    """

    name: ClassVar[str] = "taichi"
    metrics: ClassVar[tuple[Metric, ...]] = ONE_LEG

    duration: float = 30.0
    """Simulated time [s]."""
    torque: str = "full"
    """What the motors are told: full; pd-only (no torque of DynWBC, only joint PD); gravity (gravity compensation and
    joint PD: no wrench tracking, no contact wrench cone)."""
    load_estimate: bool = False
    """Estimate the robot's mass from the forces under its feet; the controller's model then follows."""
    push: tuple[str, ...] = ()
    """Pushes of 0.1 s at the torso: N,direction,time, with forward, left, backward, right or degrees from the world's
    x axis; for example 60,left,17.5."""

    def setup(self, robot: RobotDescription) -> Setup:
        """One leg and two far targets: see :meth:`Scenario.setup`."""
        from experiments.scenarios.one_leg import one_leg_setup

        parse_pushes(self.push, self.duration)
        return one_leg_setup(robot, self.safety, self.torque, self.load_estimate)

    def all_pushes(self, robot: RobotDescription) -> tuple[Push, ...]:
        """Those of ``push`` and of ``pushes``."""
        return (*self.pushes, *parse_pushes(self.push, self.duration))

    def measure(self, robot: RobotDescription, series: Mapping[str, Array]) -> dict[str, Any]:
        """How long the foot was up, and what it carries at the end: see :meth:`Scenario.measure`."""
        from experiments.scenarios.one_leg import one_leg_metrics

        return one_leg_metrics(series)
