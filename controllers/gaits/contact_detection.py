"""Which feet touch the ground: as the state has it, or from measured forces."""

from robots.checks import require_positive
from robots.messages import Array, RobotState

TOUCHES = 0.5
"""Probability of contact from which on a foot counts as touching."""

TICKS = 2
"""Ticks in a row that a force has to be above the threshold to count: one alone may be noise, or the scrape of a foot
that is about to leave the ground."""


class ContactDetector:
    """Tells touching feet from vertical forces: above the threshold for two ticks running.

    Args:
        threshold: force that counts as touching, above 0 [N].
    """

    def __init__(self, threshold: float) -> None:
        require_positive("threshold", threshold)
        self._threshold = threshold
        self._counts = (0, 0)

    def read(self, state: RobotState) -> tuple[bool, bool] | None:
        """Which feet touch in a measured state: by its contacts where it has them, else by its forces.

        ``None`` where it has neither.
        """
        if state.contact is not None:
            left, right = state.contact.tolist()
            return left > TOUCHES, right > TOUCHES
        return None if state.foot_forces is None else self.update(state.foot_forces)

    def update(self, forces: Array) -> tuple[bool, bool]:
        """Take in the forces (2,) of one tick [N]; returns which feet touch.

        A force that is no number counts as none.
        """
        threshold, (left, right), (a, b) = self._threshold, forces.tolist(), self._counts
        # written so that NaN, which is above nothing, counts as no contact
        self._counts = a, b = (a + 1 if left > threshold else 0), (b + 1 if right > threshold else 0)
        return a >= TICKS, b >= TICKS
