"""The world of a run in MuJoCo: pushes, and what passes by."""

from collections.abc import Sequence

import numpy as np

from controllers.perception import Detection
from experiments.scenarios.obstacles import Encounter
from experiments.scenarios.scenario import Push
from safety.geometry.shapes import Obstacle
from sims.plant import MujocoPlant


class RunWorld:
    """Pushes on the torso, and one obstacle that is seen through a sensor."""

    def __init__(self, plant: MujocoPlant, pushes: Sequence[Push], encounter: Encounter | None) -> None:
        self._plant, self._pushes, self._encounter = plant, tuple(pushes), encounter

    def detections(self, t: float) -> Sequence[Detection]:
        """See :meth:`experiments.running.loop.World.detections`."""
        return () if self._encounter is None else self._encounter.detections(t)

    def act(self, t: float) -> None:
        """See :meth:`experiments.running.loop.World.act`."""
        if self._pushes:
            self._plant.push(sum((push.at(t) for push in self._pushes), np.zeros(3)))

    def true(self, t: float) -> list[Obstacle]:
        """What really is there at ``t`` [s]."""
        return [] if self._encounter is None else self._encounter.true(t)
