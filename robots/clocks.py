"""Clocks that programs go by: that of this machine, or a simulation's, which waits for everybody who goes by it."""

import math
import mmap
import time
from pathlib import Path
from typing import Protocol

import numpy as np

from robots.errors import ConfigError, SafeWbcError

ROLES = ("deployment", "guardian")
"""Who may go by a simulation's clock, and is waited for."""

LOOK = 1e-4
"""Pause between two looks at a simulation's clock [s]."""

AFTER = 3600.0
"""What passes on a simulation's clock when it ends: whoever waits for something has waited long enough [s]."""

STANDS_STILL = 60.0
"""In real time, after which a simulation's clock that has not moved is one that nobody moves any more [s]."""

SIZE = 8 * (1 + len(ROLES))


class StoppedClockError(SafeWbcError):
    """A simulation's clock is moved no more."""


class Clock(Protocol):
    """Tells the time, which never goes back, and waits."""

    def now(self) -> float:
        """The time [s]."""
        ...

    def sleep(self, seconds: float) -> None:
        """Wait for so long by this clock [s]."""
        ...

    def leave(self) -> None:
        """Go by it no more: nobody waits for this process from now on."""
        ...


class MachineClock:
    """The monotonic clock of this machine."""

    def now(self) -> float:
        """See :class:`Clock`."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """See :class:`Clock`."""
        time.sleep(seconds)

    def leave(self) -> None:
        """See :class:`Clock`: it waits for nobody."""


MACHINE = MachineClock()


class SharedClock:
    """A simulation's clock, in memory that several processes see.

    Whoever goes by it in a role has told with each look how far they have come, see
    :class:`sims.twin.lockstep.Lockstep`.

    Args:
        path: of its file.
        role: one of ``ROLES``; ``None`` for somebody who only looks.

    Raises:
        ConfigError: there is no such clock.
    """

    def __init__(self, path: Path, role: str | None = None) -> None:
        try:
            with path.open("r+b") as file:
                self._memory = mmap.mmap(file.fileno(), SIZE)
        except (OSError, ValueError):
            raise ConfigError("clock", path, "the file of a clock, as twin --clock makes it") from None
        self._values = np.frombuffer(self._memory, dtype=np.float64)
        self._slot = None if role is None else 1 + ROLES.index(role)
        self._seen, self._seen_at = math.nan, 0.0

    @classmethod
    def create(cls, path: Path, begins: float) -> "SharedClock":
        """Make one that nobody goes by yet; it shows ``begins`` [s]."""
        path.write_bytes(np.array([begins] + [0.0] * len(ROLES)).tobytes())
        return cls(path)

    def now(self) -> float:
        """See :class:`Clock`.

        Raises:
            StoppedClockError: it has stood still for ``STANDS_STILL``.
        """
        time_now = float(self._values[0])
        if self._slot is not None:
            self._values[self._slot] = time_now
        if time_now != self._seen:
            self._seen, self._seen_at = time_now, time.monotonic()
        elif time.monotonic() - self._seen_at > STANDS_STILL:
            raise StoppedClockError(
                f"the simulation's clock has stood still for {STANDS_STILL:g} s: has it been killed?"
            )
        return time_now

    def sleep(self, seconds: float) -> None:
        """See :class:`Clock`; raises as :meth:`now`."""
        end = self.now() + seconds
        while self.now() < end:
            time.sleep(LOOK)

    def leave(self) -> None:
        """See :class:`Clock`."""
        if self._slot is not None:
            self._values[self._slot] = np.inf
            self._slot = None

    def show(self, now: float) -> None:
        """Let it show a time [s]; for the simulation alone."""
        self._values[0] = now

    def seen(self, role: str) -> float:
        """The time that somebody has come to [s]: 0 before their first look, infinite where they have left."""
        return float(self._values[1 + ROLES.index(role)])
