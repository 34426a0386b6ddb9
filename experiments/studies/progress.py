"""How far a study has come: a bar on a terminal, now and then a line where the output goes elsewhere."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

INTERVAL = 10.0
"""Least time between two lines [s]."""

Advance = Callable[[bool], None]
"""To be told of every case that is done, and whether it failed."""


def study_console() -> Console:
    """Where studies say how far they are: not among the tables that they print."""
    return Console(stderr=True, markup=False, soft_wrap=True)


@contextmanager
def study_progress(console: Console, title: str, total: int) -> Iterator[Advance]:
    """Show how many of ``total`` cases are done, how many failed, and the time left."""
    if console.is_terminal:
        with _bar(console, title, total) as advance:
            yield advance
    else:
        yield _Lines(console, title, total)


@contextmanager
def _bar(console: Console, title: str, total: int) -> Iterator[Advance]:
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=None),
        MofNCompleteColumn(),
        TextColumn("{task.fields[failures]}", markup=False),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("left"),
    )
    failures = 0
    # the mean speed of the last ten minutes: cases differ too much for the usual half a minute
    with Progress(*columns, console=console, redirect_stdout=False, speed_estimate_period=600.0, expand=True) as bars:
        bar = bars.add_task(title, total=total, failures="")

        def advance(failed: bool) -> None:
            nonlocal failures
            failures += failed
            bars.update(bar, advance=1, failures=f"{failures} failed" if failures else "")

        yield advance


class _Lines:
    """Prints a line at the first case, at the last, and between them one every ``INTERVAL`` at most."""

    def __init__(self, console: Console, title: str, total: int) -> None:
        self._console, self._title, self._total = console, title, total
        self._start = time.monotonic()
        self._said, self._done, self._failures = -INTERVAL, 0, 0

    def __call__(self, failed: bool) -> None:
        self._done += 1
        self._failures += failed
        elapsed = time.monotonic() - self._start
        if self._done == self._total or elapsed - self._said >= INTERVAL:
            self._said = elapsed
            self._console.print(self._line(elapsed))

    def _line(self, elapsed: float) -> str:
        remaining = elapsed / self._done * (self._total - self._done)
        failed = f", {self._failures} failed" if self._failures else ""
        return f"{self._title}: {self._done} of {self._total} done{failed}, {duration(remaining)} left"


def duration(seconds: float) -> str:
    """A time in the unit that suits it."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
