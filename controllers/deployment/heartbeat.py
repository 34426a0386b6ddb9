"""Signs of life between controller and guardian: a few numbers in memory that both processes see."""

import mmap
import os
from pathlib import Path

import numpy as np

FIELDS = ("sent", "guarded", "latched", "ended", "asked", "heard")
"""Times on the clock of the deployment [s], 0 for never: the controller's last command, the guardian's last
sign, when the guardian took over, when the controller ended of itself, when the guardian saw L2 + B, when
somebody was there who receives the guardian's commands."""

SIZE = 8 * len(FIELDS)


COUNTED_AT_MOST = 0.003
"""What one look counts for in a silence, however late it comes [s]."""


class Silence:
    """How long a mark has not moved, counted in what has been watched of it.

    Where the whole machine stood still between two looks, the other process could do nothing either.
    """

    def __init__(self) -> None:
        self._mark, self._last, self._long = 0.0, 0.0, 0.0

    def look(self, now: float, mark: float) -> float:
        """The silence [s], at a look ``now`` that finds ``mark`` [s]."""
        passed, self._last = min(now - self._last, COUNTED_AT_MOST), now
        self._long = 0.0 if mark != self._mark else self._long + passed
        self._mark = mark
        return self._long


class Heartbeat:
    """The shared numbers; each is written by one of the two only, and as one aligned word."""

    def __init__(self, path: Path, create: bool = False) -> None:
        """In a file; ``create`` it, all zero, or join the one that is there."""
        if create:
            path.write_bytes(bytes(SIZE))
        with path.open("r+b") as file:
            self._memory = mmap.mmap(file.fileno(), SIZE)
        self._values = np.frombuffer(self._memory, dtype=np.float64)

    def mark(self, field: str, time: float) -> None:
        """Write a time [s]."""
        self._values[FIELDS.index(field)] = time

    def read(self, field: str) -> float:
        """Read one [s]."""
        return float(self._values[FIELDS.index(field)])


def memory_file(path: Path) -> Path:
    """A file of this process in memory, where there is such a place: a disk that is busy keeps nobody waiting."""
    shared = Path("/dev/shm")
    if not os.access(shared, os.W_OK):
        return path
    return shared / f"safewbc-{os.getpid()}-{path.name}"
