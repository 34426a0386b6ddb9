"""What a command shows and leaves while it runs: the console, progress bars, the folder of its results, Ctrl-C."""

import signal
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from experiments.recording.store import claimed
from experiments.scenarios.options import OutputOptions


def make_console() -> Console:
    """A terminal that shows names and paths as they are: no markup is read from them, no line of text is broken."""
    return Console(markup=False, soft_wrap=True)


def chosen_folder(options: OutputOptions, name: str) -> Path:
    """The folder that was asked for, or a new one below ``runs``; nothing is made."""
    return options.out if options.out is not None else unused(Path("runs") / f"{name}-{time.strftime('%Y%m%d-%H%M%S')}")


@contextmanager
def results_folder(options: OutputOptions, name: str) -> Iterator[Path]:
    """The folder of the results around a run: see :func:`experiments.recording.store.claimed`.

    Raises:
        ConfigError: it cannot be written, holds a run already, or another process writes to it.
    """
    with claimed(chosen_folder(options, name), options.overwrite) as folder:
        yield folder


def unused(folder: Path) -> Path:
    """The folder, or where runs began within the same second, the first of ``<folder>-2``, ``<folder>-3``, ..."""
    free, number = folder, 1
    while free.exists():
        number += 1
        free = folder.with_name(f"{folder.name}-{number}")
    return free


@contextmanager
def progress(console: Console, titles: Sequence[str], duration: float) -> Iterator[list[Any]]:
    """Progress bars, one per run; yields for each a function of the simulated time [s]."""
    columns = (
        TextColumn("{task.description:<34}", markup=False),
        BarColumn(),
        TextColumn("{task.completed:5.1f} of {task.total:g} s simulated"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, redirect_stdout=False) as bars:
        ids = [bars.add_task(title, total=duration, start=False) for title in titles]
        yield [_Advance(bars, i, duration) for i in ids]


class _Advance:
    """Moves one bar."""

    def __init__(self, bars: Progress, task: Any, duration: float) -> None:
        self._bars, self._task, self._duration = bars, task, duration
        self._started = False

    def __call__(self, t: float) -> None:
        if not self._started:
            self._bars.start_task(self._task)
            self._started = True
        self._bars.update(self._task, completed=min(t, self._duration))


@contextmanager
def ask_to_stop() -> Iterator[threading.Event]:
    """Have Ctrl-C set an event, once; a second one interrupts the program as usual."""
    asked = threading.Event()

    def ask(*_: object) -> None:
        asked.set()
        signal.signal(signal.SIGINT, before)

    before = signal.signal(signal.SIGINT, ask)
    try:
        yield asked
    finally:
        signal.signal(signal.SIGINT, before)
