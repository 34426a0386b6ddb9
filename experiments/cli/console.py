"""Runs an experiment for a person at a terminal: progress, tables, files."""

import signal
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from experiments.recording.recording import RunResult, save_result
from experiments.recording.store import add_file, claimed
from experiments.reports.metric_tables import runs_table
from experiments.reports.table import show
from experiments.running.ending import INTERRUPTED, Interruption
from experiments.running.recorder import Progress as Told
from experiments.running.run import prepare, run_prepared
from experiments.running.warmup import warm_up
from experiments.scenarios.options import OutputOptions
from experiments.scenarios.scenario import Scenario


def run_and_save(scenario: Scenario, output: OutputOptions) -> int:
    """Run a scenario and write everything.

    Returns:
        The exit code: 0, 1 where the robot fell or was stopped, or 130 where a person stopped the run.

    Raises:
        SafeWbcError: an option is not allowed, or the results cannot be written; nothing has run then.
    """
    console = make_console()
    given = prepare(scenario)
    robot, name = given.robot, scenario.name
    if scenario.seed and not scenario.is_random(robot):
        console.print("nothing is random in this run: its seed has no effect", style="yellow")
    bars = progress(console, [f"{robot.title}, {scenario.safety.filter}"], scenario.duration)
    with results_folder(output, name) as folder:
        warm_up(console, robot)
        with bars as advance, ask_to_stop() as asked:
            result = run_prepared(given, (Told(advance[0]), Interruption(asked.is_set)))
        save_result(result, folder)
        show(runs_table([result]), console)
        write_media([result], folder, f"{name.capitalize().replace('-', ' ')}: {robot.title}", output, console)
    console.print(f"results: {folder}")
    return exit_code([result])


def exit_code(results: Sequence[RunResult]) -> int:
    """Of a command whose runs ended like this."""
    if any(r.summary["stop_cause"] == INTERRUPTED for r in results):
        return 130
    return 1 if any(r.summary["fell"] or r.summary["stop_cause"] for r in results) else 0


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


def write_media(
    results: Sequence[RunResult], folder: Path, title: str, options: OutputOptions, console: Console
) -> None:
    """Report and video of finished runs, as far as the machine can; says once what it cannot."""
    if not (options.report or options.video):
        return
    from experiments.reports.media import key_frames, make_video
    from experiments.reports.report import write_report
    from sims.rendering import rendering_problem, video_problem

    problem = rendering_problem() or (video_problem() if options.video else None)
    if problem:
        console.print(f"no pictures or no video: {problem}", style="yellow")
    video = folder / "video.mp4"
    with console.status("rendering and writing the report"):
        if options.video and not problem:
            add_file(folder, video.name, partial(make_video, results))
        if options.report:
            frames = [key_frames(r) for r in results]
            film = video if video.exists() else None
            page = partial(write_report, results=results, title=title, frames=frames, video=film, note=problem or "")
            add_file(folder, "report.html", page)
    if video.exists():
        console.print(f"video:   {video}")
    if options.report:
        console.print(f"report:  {folder / 'report.html'}")
