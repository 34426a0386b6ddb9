"""What a process does to keep its deadlines, as far as it is permitted; each returns in words what came of it."""

import contextlib
import ctypes
import gc
import os

LOCK_CURRENT = 1
"""``MCL_CURRENT`` of Linux: all pages there are now."""

CONTROLLER_PRIORITY, GUARDIAN_PRIORITY = 50, 60
"""Of SCHED_FIFO."""


def schedule(priority: int) -> str:
    """Ask for the real-time scheduling class; before the DDS participant is made, whose threads inherit it."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except (OSError, AttributeError) as error:
        return f"ordinary scheduling ({error}): ticks will be late now and then"
    return f"real-time scheduling, priority {priority}"


def pin(cpu: int | None) -> str:
    """Stay on one processor, if one is given."""
    if cpu is None:
        return "on any processor"
    try:
        os.sched_setaffinity(0, {cpu})
    except (OSError, AttributeError) as error:
        return f"on any processor ({error})"
    return f"on processor {cpu}"


def anywhere() -> None:
    """Run on any processor, wherever the parent was kept."""
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setaffinity(0, range(os.cpu_count() or 1))


def lock_memory() -> str:
    """Keep what is in memory there."""
    try:
        failed = ctypes.CDLL(None, use_errno=True).mlockall(LOCK_CURRENT)
    except (OSError, AttributeError) as error:
        return f"memory not locked ({error})"
    return f"memory not locked ({os.strerror(ctypes.get_errno())})" if failed else "memory locked"


def freeze_garbage() -> None:
    """Collect once, and not again: what a tick makes is freed by its counts."""
    gc.collect()
    gc.freeze()
    gc.disable()
