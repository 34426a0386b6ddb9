"""Pauses of the machine: times in which a core does nothing for anybody, as virtual machines have them.

On each core a process of a higher priority than twin, controller and guardian sleeps and wakes. Where it wakes late,
nothing has run on that core. What fails at such a moment tells of the machine and not of the controller: a robot has a
computer of its own. Where real-time scheduling is not permitted, nothing is watched.
"""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from types import TracebackType

import numpy as np

from controllers.deployment.realtime import pin, schedule
from robots.messages import Array

PRIORITY = 95
"""Of SCHED_FIFO; above those of twin, controller and guardian."""

PERIOD = 0.002
"""Between two looks [s]."""

PAUSE = 0.008
"""From how much on a look that is late counts [s]: with a period of the controller more, the guardian brakes."""

AROUND = 1.0
"""How far from a pause what fails may have to do with it [s]."""


class PauseWatch:
    """Watches cores while it is entered, in processes of their own.

    Args:
        cores: their numbers.
    """

    def __init__(self, cores: Sequence[int]) -> None:
        self._cores = cores
        self._watchers: list[subprocess.Popen[str]] = []

    def __enter__(self) -> "PauseWatch":
        for core in self._cores:
            words = [sys.executable, "-m", "experiments.rehearsal.pauses", str(core)]
            self._watchers.append(
                subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1)
            )
        return self

    def __exit__(self, *of: type[BaseException] | BaseException | TracebackType | None) -> None:
        for watcher in self._watchers:
            watcher.kill()
            watcher.wait()

    def end(self) -> Array:
        """Stop watching; shape (n, 2): when each pause began, on the monotonic clock, and how long it was [s]."""
        found: list[list[float]] = []
        for watcher in self._watchers:
            watcher.terminate()
            said, _ = watcher.communicate(timeout=5.0)
            found += [[float(word) for word in line.split()] for line in said.splitlines()]
        self._watchers.clear()
        return np.array(sorted(found)).reshape(-1, 2)


def watch(
    say: Callable[[float, float], None],
    goes_on: Callable[[], bool] = lambda: True,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Look at the clock again and again, and say when each pause began and how long it was [s]."""
    before = clock()
    while goes_on():
        sleep(PERIOD)
        now = clock()
        if (late := now - before - PERIOD) >= PAUSE:
            say(before + PERIOD, late)
        before = now


def longest_pause(pauses: Array, since: float, until: float) -> float:
    """The longest of ``pauses`` (n, 2) that was there between two times; 0 for none [s]."""
    there = (pauses[:, 0] <= until) & (pauses[:, 0] + pauses[:, 1] >= since)
    return float(pauses[there, 1].max(initial=0.0))


if __name__ == "__main__":
    pin(int(sys.argv[1]))
    schedule(PRIORITY)
    # without the scheduling class it would count what others do with the core
    if os.sched_getscheduler(0) == os.SCHED_FIFO:
        watch(lambda began, length: print(f"{began:.6f} {length:.6f}", flush=True))
