"""A twin that waits for its controller: time passes when everybody who goes by its clock has come to it."""

import math
import time
from collections.abc import Callable

from robots.clocks import ROLES, SharedClock
from sims.twin.pace import Pace

GIVES_UP = 0.5
"""Who does not move for so long is not waited for until they do again, in real time [s]."""

NAP = 1e-4
"""Pause between two looks for those who are late, in real time [s]."""

COUNTED_AT_MOST = 0.003
"""What one such pause counts for, however long it was [s]."""

DEPLOYMENT = ROLES[0]


class Lockstep:
    """Begins periods as :class:`sims.twin.pace.Pace` does, but by a clock that waits.

    A period begins when all who go by the clock have looked at it since the last one began, and when the last state was
    answered, if its sender has answered before: it has one period for that. So a machine that is slow, or stops for a
    while, changes nothing of what is played. Who is killed or stopped is given up after ``GIVES_UP``; where there is
    nobody, time passes as it does.

    Args:
        period: [s].
        clock: that is moved on.
        debt: how many commands have come, and whether a state has gone out since the last of them.
        real: clock of the machine [s].
        sleep: in real time [s].

    Attributes:
        periods: how many have begun.
        given_up: how often somebody was.
    """

    def __init__(
        self,
        period: float,
        clock: SharedClock,
        debt: Callable[[], tuple[int, bool]],
        real: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._period, self._clock, self._debt, self._real, self._sleep = period, clock, debt, real, sleep
        self._pace = Pace(period, real, sleep)
        self._now = self._begin = clock.now()
        self._since, self._stopped = real(), math.nan
        self._absent: dict[str, float] = {}
        self._come, self._answers, self._owes_since = 0, False, math.inf
        self.periods = self.given_up = 0

    def wait(self) -> float:
        """Wait for everybody; returns the time of the clock [s]."""
        waited, before = 0.0, self._real()
        while late := self._late():
            if waited > GIVES_UP:
                self._give_up(late)
                break
            self._sleep(NAP)
            now = self._real()
            # where the whole machine stood still, nobody else could do anything either
            waited, before = waited + min(now - before, COUNTED_AT_MOST), now
        if not any(map(self._is_there, ROLES)):
            self._pace.wait()
        self.periods += 1
        self._now = self._begin + self.periods * self._period
        self._clock.show(self._now)
        return self._now

    def _is_there(self, role: str) -> bool:
        seen = self._clock.seen(role)
        if role in self._absent and seen != self._absent[role]:
            del self._absent[role]
        return 0.0 < seen < math.inf and role not in self._absent

    def _late(self) -> list[str]:
        """Who has not come to this time yet."""
        late = [role for role in ROLES if self._is_there(role) and self._clock.seen(role) < self._now]
        come, owes = self._debt()
        if come > self._come:
            self._come, self._answers = come, True
        self._owes_since = min(self._owes_since, self.periods) if owes else math.inf
        waits = self._answers and self.periods > self._owes_since and self._is_there(DEPLOYMENT)
        if waits and DEPLOYMENT not in late:
            late.append(DEPLOYMENT)
        return late

    def _give_up(self, late: list[str]) -> None:
        self._answers = False
        self.given_up += 1
        for role in late:
            if self._clock.seen(role) < self._now:
                self._absent[role] = self._clock.seen(role)

    def now(self) -> float:
        """The time of the clock [s]."""
        return self._now

    def stop(self) -> None:
        """Let no more time be played; by the clock it goes on to pass, as it does."""
        self._stopped = self._real()
        self._clock.end()

    @property
    def passed(self) -> float:
        """Real time since the begin [s]."""
        return (self._real() if math.isnan(self._stopped) else self._stopped) - self._since

    def told(self, simulated: float) -> list[str]:
        """For a person, with the simulated time [s]."""
        factor = simulated / self.passed
        return [
            f"real time: factor {factor:.4f}, {simulated:.3f} s simulated, by a clock that waits",
            f"periods: {self.periods}; {self.given_up} times somebody was not waited for any more",
        ]
