"""Which feet touch the ground, from measured forces."""

import numpy as np

from robots.checks import require_positive
from robots.messages import Array

TICKS = 2
"""Ticks in a row that a force has to be above the threshold to count."""


class SupportSensor:
    """Tells touching feet from vertical forces: above the threshold for two ticks running.

    Args:
        threshold: force that counts as touching, above 0 [N].
    """

    def __init__(self, threshold: float) -> None:
        require_positive("threshold", threshold)
        self._threshold = threshold
        self._count = np.zeros(2, dtype=int)

    def update(self, forces: Array) -> list[bool]:
        """Take in the forces (2,) of one tick [N]; returns which feet touch."""
        self._count = np.where(forces > self._threshold, self._count + 1, 0)
        return [bool(c >= TICKS) for c in self._count]
