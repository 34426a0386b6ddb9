"""Keeping real time: a period after the other at its time, what was late, what could not be caught up."""

import time
from collections.abc import Callable

EARLY = 3e-4
"""How long before its time a long sleep ends [s]; the rest is slept in short ones."""

SHORT = 5e-5
"""A short sleep [s]."""

LATE = 5e-4
"""From how much on a period counts as late [s]."""

MOST_BEHIND = 10
"""Periods that are caught up."""


class Pace:
    """Begins periods at their times.

    Args:
        period: [s].
        clock: that tells the time [s].
        sleep: for some time [s].

    Attributes:
        periods: how many have begun.
        late: how many of them more than ``LATE`` after their time.
        worst: how late one has begun [s].
        dropped: time that was given up, since it was more than can be caught up [s].
    """

    def __init__(
        self,
        period: float,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._period, self._clock, self._sleep = period, clock, sleep
        self.start = self._next = clock()
        self._stopped: float | None = None
        self.periods = self.late = 0
        self.worst = self.dropped = 0.0

    def wait(self) -> float:
        """Wait for the time of the next period; returns the time now [s]."""
        now = self._clock()
        if (left := self._next - now) > EARLY:
            self._sleep(left - EARLY)
            now = self._clock()
        while now < self._next:
            self._sleep(SHORT)
            now = self._clock()
        behind = now - self._next
        self.periods += 1
        self.late += behind > LATE
        self.worst = max(self.worst, behind)
        if (excess := behind - MOST_BEHIND * self._period) > 0.0:
            self.dropped += excess
            self._next += excess
        self._next += self._period
        return now

    def now(self) -> float:
        """The time by the clock; once stopped, that of its stop [s]."""
        return self._clock() if self._stopped is None else self._stopped

    def stop(self) -> None:
        """Let no more time pass."""
        self._stopped = self._clock()

    @property
    def passed(self) -> float:
        """Time since the begin [s]."""
        return self.now() - self.start

    def told(self, simulated: float) -> list[str]:
        """For a person, with the simulated time [s]."""
        return [
            f"real time: factor {simulated / self.passed:.4f}, {simulated:.3f} s simulated, "
            f"{1e3 * self.dropped:.1f} ms dropped",
            f"periods: {self.periods}, {self.late} late by more than 0.5 ms, worst {1e3 * self.worst:.2f} ms",
        ]
