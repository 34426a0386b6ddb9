"""Clocks that programs go by: that of this machine, or a simulation's, which waits for everybody who goes by it."""

import math
import mmap
import time
from pathlib import Path
from typing import Protocol

import numpy as np

from robots.errors import ConfigError

ROLES = ("deployment", "guardian")
"""Who may go by a simulation's clock, and is waited for."""

LOOK = 1e-4
"""Pause between two looks at a simulation's clock [s]."""

STANDS_STILL = 60.0
"""In real time, after which a simulation's clock that has not moved is one that nobody moves any more [s]."""

SIZE = 8 * (2 + len(ROLES))


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
    :class:`sims.twin.lockstep.Lockstep`. Where the simulation has ended, or nobody has moved the clock for
    ``STANDS_STILL``, time passes by it as it does on this machine: whoever waits for something waits no longer than
    they would.

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
            raise ConfigError("clock", str(path), "the file of a clock, as twin --clock makes it") from None
        self._values = np.frombuffer(self._memory, dtype=np.float64)
        self._slot = None if role is None else 1 + ROLES.index(role)
        self._shown, self._shown_at, self._free_since = math.nan, 0.0, math.inf

    @classmethod
    def create(cls, path: Path, begins: float) -> "SharedClock":
        """Make one that nobody goes by yet; it shows ``begins`` [s].

        Raises:
            ConfigError: the file cannot be written.
        """
        try:
            path.write_bytes(np.array([begins] + [0.0] * len(ROLES) + [0.0]).tobytes())
        except OSError as error:
            raise ConfigError("clock", str(path), f"a file that can be written ({error.strerror})") from None
        return cls(path)

    def now(self) -> float:
        """See :class:`Clock`."""
        time_now, real = float(self._values[0]), time.monotonic()
        if self._slot is not None:
            self._values[self._slot] = time_now
        if time_now != self._shown:
            self._shown, self._shown_at, self._free_since = time_now, real, math.inf
        elif self._free_since == math.inf and (self._values[-1] or real - self._shown_at > STANDS_STILL):
            self._free_since = real
        return time_now + max(0.0, real - self._free_since)

    def sleep(self, seconds: float) -> None:
        """See :class:`Clock`."""
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

    def end(self) -> None:
        """The simulation has ended; for it alone."""
        self._values[-1] = 1.0

    def seen(self, role: str) -> float:
        """The time that somebody has come to [s]: 0 before their first look, infinite where they have left."""
        return float(self._values[1 + ROLES.index(role)])
