"""Side steps that would make the feet collide: the locomotion of section 5.2.1 of Lee et al."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from experiments.metrics.declared_motion import FEET
from experiments.metrics.metric import Metric
from experiments.scenarios.scenario import Scenario, Setup

if TYPE_CHECKING:
    from controllers.gaits.gait import Gait
    from robots.description import RobotDescription
    from robots.kinematics import Kinematics
    from robots.messages import Array


@dataclass(frozen=True)
class LateralSteps(Scenario):
    """Side steps whose nominal footholds lie so close that the feet would collide."""

    name: ClassVar[str] = "lateral-steps"
    metrics: ClassVar[tuple[Metric, ...]] = FEET

    duration: float = 16.0
    """Simulated time [s]."""
    load_estimate: bool = True
    """Estimate the robot's mass from the forces under its feet; the controller's model then follows."""

    def setup(self, robot: RobotDescription) -> Setup:
        """The side steps of ``[tuning.lateral_steps]``: see :meth:`Scenario.setup`."""
        from controllers.gaits.lateral_steps import lateral_step_tuning
        from controllers.gaits.walking import walk_tuning, walking_changes
        from experiments.metrics.feet import feet_column

        feet_column(robot)
        settings = {
            "walking": dataclasses.asdict(walk_tuning(robot)),
            "lateral_steps": dataclasses.asdict(lateral_step_tuning(robot)),
        }
        changes = walking_changes(robot, self.load_estimate)
        return Setup(gait=_gait, changes=changes, settings=settings)

    def measure(self, robot: RobotDescription, series: Mapping[str, Array]) -> dict[str, Any]:
        """How close feet and legs came, and the steps: see :meth:`Scenario.measure`."""
        from experiments.metrics.feet import feet_metrics

        return feet_metrics(robot, series)


def _gait(kin: Kinematics) -> Gait:
    from controllers.gaits import lateral_steps
    from controllers.gaits.walking import walk_tuning

    return lateral_steps.LateralSteps(kin, lateral_steps.lateral_step_tuning(kin.robot), walk_tuning(kin.robot))
