"""Detections of obstacles, and the places for them in the controller's barriers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from robots.messages import Array
from safety.geometry.shapes import Obstacle, require_kinds


@dataclass(frozen=True, slots=True)
class Detection:
    """One obstacle as a sensor reports it at one instant.

    Attributes:
        name: tells obstacles apart from one detection to the next.
        stamp: when it was measured [s].
        shape: kind, size and orientation, and the measured place of its reference point. Its velocity counts only where
            the tracker is set to ``measured``; else the track of that name estimates it.
        seen: whether it was found; where not, ``shape`` only says what was looked for.
    """

    name: str
    stamp: float
    shape: Obstacle
    seen: bool = True


class ObstacleSlots:
    """Places for obstacles in the controller's barriers: so many of each kind, filled or empty.

    The rows of a controller are fixed when it is made, so that no tick has to make arrays. Obstacles come and go
    through its slots: an empty one holds an obstacle that is far away, and where there are more obstacles of a kind
    than slots, the nearest count. An obstacle keeps its slot for as long as it has one: the filter's search starts from
    the rows that were active in the last tick.

    Attributes:
        kinds: of the slots.
        left_out: names of obstacles that found no slot the last time.
    """

    def __init__(self, kinds: Sequence[str]) -> None:
        """``kinds``: one of :data:`safety.geometry.shapes.KINDS` for each slot.

        Raises:
            ConfigError: no such kind.
        """
        require_kinds(kinds)
        self.kinds = tuple(kinds)
        self.left_out: tuple[str, ...] = ()
        self._empty = tuple(far_away(kind) for kind in self.kinds)
        self._holder: list[str | None] = [None] * len(self.kinds)

    def wants(self, name: str, kind: str) -> bool:
        """Whether an obstacle matters: it has a slot, or one of its kind is free."""
        free = any(holder is None and own == kind for holder, own in zip(self._holder, self.kinds, strict=True))
        return free or name in self._holder

    def fill(self, obstacles: Mapping[str, Obstacle], centre: Array) -> list[Obstacle]:
        """An obstacle for each slot.

        Args:
            obstacles: by name.
            centre: shape (3,) point of the robot from which distance is measured [m].
        """
        for i, name in enumerate(self._holder):
            if name is not None and (name not in obstacles or obstacles[name].kind != self.kinds[i]):
                self._holder[i] = None
        waiting = [name for name in obstacles if name not in self._holder]
        if waiting:
            self._place(waiting, obstacles, centre)
        self.left_out = tuple(name for name in obstacles if name not in self._holder)
        return [
            empty if name is None else obstacles[name] for name, empty in zip(self._holder, self._empty, strict=True)
        ]

    def _place(self, waiting: Sequence[str], obstacles: Mapping[str, Obstacle], centre: Array) -> None:
        """Give slots to those that wait, where need be those of obstacles further away."""
        for name in sorted(waiting, key=lambda n: obstacles[n].clearance(centre)):
            slots = [i for i, kind in enumerate(self.kinds) if kind == obstacles[name].kind]
            free = next((i for i in slots if self._holder[i] is None), None)
            if free is None and slots:
                free = max(slots, key=lambda i: obstacles[self._holder[i] or name].clearance(centre))
                if obstacles[self._holder[free] or name].clearance(centre) <= obstacles[name].clearance(centre):
                    continue
            if free is not None:
                self._holder[free] = name


FAR = 1e3
"""How far away the obstacle in an empty slot is [m]: below the ground."""


def far_away(kind: str) -> Obstacle:
    """An obstacle of this kind that is out of everybody's way."""
    place = np.array([0.0, 0.0, -FAR])
    return {
        "sphere": lambda: Obstacle.sphere(place, 0.1),
        "capsule": lambda: Obstacle.capsule(place, place + np.array([0.1, 0.0, 0.0]), 0.1),
        "box": lambda: Obstacle.box(place, np.eye(3), np.full(3, 0.1)),
        "half_space": lambda: Obstacle.half_space(place, np.array([0.0, 0.0, 1.0])),
    }[kind]()
