"""Standing still on both feet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from experiments.scenarios.scenario import Scenario, Setup

if TYPE_CHECKING:
    from robots.description import RobotDescription


@dataclass(frozen=True)
class Stand(Scenario):
    """Stand still on both feet."""

    name: ClassVar[str] = "stand"

    def setup(self, robot: RobotDescription) -> Setup:
        """Nothing moves: see :meth:`Scenario.setup`."""
        return Setup()
