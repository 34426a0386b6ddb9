"""One filter in the corridor, as data; :mod:`experiments.scenarios.corridor` is the scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from experiments.scenarios.scenario import Runnable


@dataclass(frozen=True)
class CorridorCase(Runnable):
    """A G1 on a fixed base in the corridor, moved by velocities at 100 Hz; options as of ``safewbc run corridor``.

    Attributes:
        filter: one of ``experiments.running.corridor_loop.VARIANTS``.
        duration: simulated time [s].
        seed: moves goals and sphere; ``None``: where they were designed to be.
        weight: of the squared violations in r-SSA [rad^2/m^2].
        margins: ``shared`` or ``own``.
        gap: distance of the boards once they have closed [m].
    """

    name: ClassVar[str] = "corridor"

    filter: str = "issf"
    duration: float = 12.0
    seed: int | None = None
    weight: float = 10.0
    margins: str = "shared"
    gap: float = 0.14
