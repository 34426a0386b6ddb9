"""Runs an experiment for a person at a terminal: progress, tables, files."""

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from experiments.recording.recording import RunResult, prepare_folder, save_result
from experiments.reports.metric_tables import runs_table
from experiments.reports.table import show
from experiments.running.run import default_folder
from experiments.running.warmup import warm_up
from experiments.scenarios.options import OutputOptions, RunOptions
from experiments.scenarios.registry import experiment_of


def run_and_save(options: RunOptions) -> int:
    """Run one experiment and write everything; returns the exit code: 0, or 1 where the robot fell or was stopped."""
    console = make_console()
    experiment = experiment_of(options)
    robot, name = experiment.check(options), experiment.name
    bars = progress(console, [f"{robot.title}, {options.safety.filter}"], options.duration)
    with results_folder(options.output, name) as folder:
        warm_up(console, robot)
        with bars as advance:
            result = run_one(options, advance[0])
    save_result(result, folder)
    show(runs_table([result]), console)
    write_media([result], folder, f"{name.capitalize().replace('-', ' ')}: {robot.title}", options.output, console)
    console.print(f"results: {folder}")
    return 1 if result.summary["fell"] or result.summary["stop_cause"] else 0


def run_one(options: RunOptions, advance: Any) -> RunResult:
    """Run the experiment that the options belong to; ``advance`` is called with the simulated time."""
    return experiment_of(options).run(options, advance)


def make_console() -> Console:
    """A terminal that shows names and paths as they are: no markup is read from them, no line of text is broken."""
    return Console(markup=False, soft_wrap=True)


def chosen_folder(options: OutputOptions, name: str) -> Path:
    """The folder that was asked for, or a new one below ``runs``; nothing is made."""
    return options.out if options.out is not None else unused(default_folder(name, time.strftime("%Y%m%d-%H%M%S")))


@contextmanager
def results_folder(options: OutputOptions, name: str) -> Iterator[Path]:
    """The folder of the results around a run, made and proved to be writable before anything runs.

    When the run is over, the pictures of an earlier one in the same folder go. When it is cut short, a folder that was
    made for it goes if it is empty.

    Raises:
        ConfigError: it cannot be written.
    """
    folder = chosen_folder(options, name)
    existed = folder.exists()
    try:
        yield prepare_folder(folder)
    except BaseException:
        if not existed:
            with suppress(OSError):
                folder.rmdir()
        raise
    for old in ("report.html", "video.mp4"):
        (folder / old).unlink(missing_ok=True)


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
    with console.status("rendering and writing the report"):
        video = make_video(results, folder / "video.mp4") if options.video else None
        if options.report:
            frames = [key_frames(r) for r in results]
            write_report(folder / "report.html", results, title, frames, video, note=problem or "")
    if video is not None:
        console.print(f"video:   {video}")
    if options.report:
        console.print(f"report:  {folder / 'report.html'}")
