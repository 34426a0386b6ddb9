"""Hands that move otherwise than the parameters were tuned with: circles and changes of place that were drawn."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, ClassVar

from experiments.scenarios.hand_tracking import HandTracking
from experiments.scenarios.passing_sphere import Passage
from experiments.scenarios.scenario import Setup
from experiments.scenarios.world import Vector

if TYPE_CHECKING:
    from controllers.motions.hands import Motion
    from controllers.reference import WholeBodyReference
    from robots.description import RobotDescription

ORIGIN = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class DrawnHands(HandTracking):
    """Hand tracking with what its options cannot say.

    Attributes:
        sphere: how the sphere passes, with ``obstacle``.
        circle_size: factor on the radius of the circles.
        circle_period: of a circle [s]; ``None``: the robot's own.
        cross_offsets: of where the left and the right hand go from the other's place [m].
        cross_time: time in which the hands change places [s]; ``None``: the usual one.
    """

    name: ClassVar[str] = "drawn-hands"

    sphere: Passage = dataclasses.field(default_factory=Passage)
    circle_size: float = 1.0
    circle_period: float | None = None
    cross_offsets: tuple[Vector, Vector] = (ORIGIN, ORIGIN)
    cross_time: float | None = None

    def setup(self, robot: RobotDescription) -> Setup:
        """As of :class:`HandTracking`, with the drawn motion."""
        usual = super().setup(robot)
        if self.motion == "circles" and self.circle_period is not None:
            return dataclasses.replace(usual, hands=partial(_circles, self.circle_size, self.circle_period))
        if self.motion == "cross" and self.cross_time is not None:
            return dataclasses.replace(usual, hands=partial(_cross, self.cross_offsets, self.cross_time))
        return usual

    def passage(self) -> Passage:
        """The drawn one."""
        return self.sphere


def _circles(size: float, period: float, robot: RobotDescription, reference: WholeBodyReference) -> Motion:
    from controllers.motions.hands import HandCircles, circle_settings

    assert reference.hands is not None
    left, right = (hand.position.copy() for hand in reference.hands)
    settings = circle_settings(robot)
    return HandCircles(dataclasses.replace(settings, radius=size * settings.radius, period=period), (left, right))


def _cross(
    offsets: tuple[Vector, Vector], duration: float, robot: RobotDescription, reference: WholeBodyReference
) -> Motion:
    import numpy as np

    from controllers.motions.hands import HandsToTargets

    assert reference.hands is not None
    left, right = (hand.position.copy() for hand in reference.hands)
    return HandsToTargets((left, right), (right + np.array(offsets[0]), left + np.array(offsets[1])), duration)
