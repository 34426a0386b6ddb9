"""The cores of a rehearsal in real time: kept awake, and watched for times in which they do little for anybody.

A core of a virtual machine that has gone to sleep is given back late, and then runs slowly for a while: on each core a
process of the idle class therefore counts, to no end, and gives way to everybody. On each core a process of a higher
priority than twin, controller and guardian sleeps, wakes and does a little work besides. Where it wakes late, nothing
has run on that core; where its work takes many times as long as at best, nothing runs as it should. What fails at such
a moment tells of the machine and not of the controller, for a robot has a computer of its own. Where real-time
scheduling is not permitted, nothing is watched.
"""

import math
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
"""How long it has to last to count [s]: with a period of the controller more, the guardian brakes."""

LATE, WORK, SLOW, BETWEEN = 0.001, 1000, 5.0, 0.01
"""What makes a look bad: by how much it is late [s], what is counted to, and how many times what it takes at best; and
how long looks that are not bad may last within a pause [s]."""

AROUND = 1.0
"""How far from a pause what fails may have to do with it [s]."""

WATCH, KEEP_AWAKE = "watch", "keep awake"
"""What a process of this module does with its core."""


class Cores:
    """Keeps cores awake and watches them while it is entered, by processes of its own.

    Args:
        numbers: of the cores.
    """

    def __init__(self, numbers: Sequence[int]) -> None:
        self._numbers = numbers
        self._watchers: list[subprocess.Popen[str]] = []
        self._idlers: list[subprocess.Popen[str]] = []

    def __enter__(self) -> "Cores":
        self._watchers = [_started(WATCH, number) for number in self._numbers]
        self._idlers = [_started(KEEP_AWAKE, number) for number in self._numbers]
        return self

    def __exit__(self, *of: type[BaseException] | BaseException | TracebackType | None) -> None:
        for process in self._watchers + self._idlers:
            process.kill()
            process.communicate()

    def end(self) -> Array:
        """Stop watching; shape (n, 2): when each pause began, on the monotonic clock, and how long it was [s]."""
        found: list[list[float]] = []
        for watcher in self._watchers:
            watcher.terminate()
            said, _ = watcher.communicate(timeout=5.0)
            found += [[float(word) for word in line.split()] for line in said.splitlines()]
        self._watchers.clear()
        return np.array(sorted(found)).reshape(-1, 2)


def _started(what: str, core: int) -> subprocess.Popen[str]:
    words = [sys.executable, "-m", "experiments.rehearsal.cores", what, str(core)]
    return subprocess.Popen(words, stdout=subprocess.PIPE, text=True)


def watch(
    say: Callable[[float, float], None],
    goes_on: Callable[[], bool],
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
    work: Callable[[], None] = lambda: count(WORK),
) -> None:
    """Look at the clock again and again, and say when each pause began and how long it was [s].

    A look is bad where it comes late, or where a little work takes ``SLOW`` times what it takes at best; bad looks with
    no more than ``BETWEEN`` from one to the next are one pause.
    """
    quickest, began, last = float("inf"), float("nan"), float("nan")
    before = clock()
    while goes_on():
        sleep(PERIOD)
        now = clock()
        work()
        after = clock()
        quickest = min(quickest, after - now)
        if now - before - PERIOD >= LATE or after - now > SLOW * quickest:
            began = before + PERIOD if math.isnan(began) else began
            last = after
        elif now - last > BETWEEN:
            if last - began >= PAUSE:
                say(began, last - began)
            began = last = float("nan")
        before = after


def count(n: int) -> None:
    """Work for a while."""
    for _ in range(n):
        pass


def longest_pause(pauses: Array, since: float, until: float) -> float:
    """The longest of ``pauses`` (n, 2) that was there between two times; 0 for none [s]."""
    there = (pauses[:, 0] <= until) & (pauses[:, 0] + pauses[:, 1] >= since)
    return float(pauses[there, 1].max(initial=0.0))


def main(what: str, core: int) -> None:
    """Do it with a core until the process that started this one has gone."""
    parent = os.getppid()
    pin(core)
    if what == KEEP_AWAKE:
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
        while os.getppid() == parent:
            count(100_000)
        return
    schedule(PRIORITY)
    # without the scheduling class it would count what others do with the core
    if os.sched_getscheduler(0) == os.SCHED_FIFO:
        watch(
            lambda began, length: print(f"{began:.6f} {length:.6f}", flush=True),
            lambda: os.getppid() == parent,
        )


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
