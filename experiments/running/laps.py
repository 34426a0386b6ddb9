"""Where the wall time of a run goes."""

import time

LOOP_PARTS = ("tick", "plant", "state", "true barriers", "recording", "world", "rest")
"""Parts of the closed loop: the agent with gait and tracks; MuJoCo's step and reading its contacts; state and ZMP;
barriers at the true state and their bounds; what is recorded; what sensors see of obstacles; the rest."""

PARTS = ("set-up", "reference motion", *LOOP_PARTS, "series and summary")
"""Parts of a run."""


class Laps:
    """Books wall time by part: each lap is what has passed since the one before.

    Attributes:
        seconds: booked so far, by part of ``PARTS`` [s].
    """

    def __init__(self) -> None:
        self.seconds = dict.fromkeys(PARTS, 0.0)
        self._last = time.perf_counter()

    def book(self, part: str) -> None:
        """Book what has passed since the last lap for ``part``."""
        now = time.perf_counter()
        self.seconds[part] += now - self._last
        self._last = now
