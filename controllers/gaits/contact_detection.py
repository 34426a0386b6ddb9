"""Which feet touch the ground, from measured forces."""

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
        self._count = [0, 0]

    def update(self, forces: Array) -> list[bool]:
        """Take in the forces (2,) of one tick [N]; returns which feet touch."""
        self._count = [
            count + 1 if force > self._threshold else 0 for count, force in zip(self._count, forces, strict=True)
        ]
        return [count >= TICKS for count in self._count]
