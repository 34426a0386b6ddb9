"""A scenario of one's own: options, what they mean, and a metric in one class; run, recorded and reported like ours.

python examples/own_scenario.py
cd examples && safewbc run own_scenario:Carry --payload 2
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import safewbc as sw
from experiments.metrics.metric import Metric
from experiments.scenarios.options import PlantOptions
from robots.messages import Array


@dataclass(frozen=True)
class Carry(sw.Scenario):
    """Turn the hands in circles with a payload in the left one that the controller does not know of."""

    name: ClassVar[str] = "carry"
    metrics: ClassVar[tuple[Metric, ...]] = (
        Metric("hand_sag", "largest sag of the left hand", "mm", 1e3, stored="m", meaning="below its reference"),
    )

    payload: float = 1.0
    """Mass in the left hand [kg]."""

    def setup(self, robot: sw.RobotDescription) -> sw.Setup:
        """See :meth:`experiments.scenarios.scenario.Scenario.setup`."""
        return sw.Setup(posture="hands_front", hands=sw.HandCircles.for_robot)

    def mismatch(self, robot: sw.RobotDescription) -> PlantOptions:
        """The robot with the payload: see :meth:`experiments.scenarios.scenario.Scenario.mismatch`."""
        hand = robot.frame(robot.roles["left_hand"]).body
        mass = next(body.mass for body in robot.bodies if body.name == hand)
        return replace(self.plant, link_mass={hand: 1.0 + self.payload / mass})

    def measure(self, robot: sw.RobotDescription, series: Mapping[str, Array]) -> dict[str, Any]:
        """See :meth:`experiments.scenarios.scenario.Scenario.measure`."""
        return {"hand_sag": float((series["left_hand_ref"][:, 2] - series["left_hand"][:, 2]).max())}


def main(duration: float = 4.0) -> list[float]:
    """Run it with three payloads; returns how far the hand sags with each [mm]."""
    sags = []
    for payload in (0.0, 0.5, 1.0):
        summary = sw.run(Carry(duration=duration, payload=payload)).summary
        sags.append(1e3 * summary["hand_sag"])
        print(f"{payload:g} kg: the hand sags by {sags[-1]:.1f} mm, fell: {summary['fell']}")
    return sags


if __name__ == "__main__":
    main()
