"""Runs an experiment for a person at a terminal: progress, tables, files."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from rich.console import Console

from experiments.recording.recording import Recording, write_recording
from experiments.recording.store import add_file
from experiments.reports.metric_tables import runs_table
from experiments.reports.table import show
from experiments.running.ending import INTERRUPTED, Interruption
from experiments.running.guarded import ObserverError
from experiments.running.recorder import Progress as Told
from experiments.running.run import prepare, run_prepared
from experiments.running.terminal import ask_to_stop, make_console, progress, results_folder
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
        try:
            with bars as advance, ask_to_stop() as asked:
                result = run_prepared(given, (Told(advance[0]), Interruption(asked.is_set)))
        except ObserverError as error:
            write_recording(error.recording, folder)
            raise
        write_recording(result, folder)
        show(runs_table([result]), console)
        write_media([result], folder, f"{name.capitalize().replace('-', ' ')}: {robot.title}", output, console)
    console.print(f"results: {folder}")
    return exit_code([result])


def exit_code(results: Sequence[Recording]) -> int:
    """Of a command whose runs ended like this."""
    if any(r.summary["stop_cause"] == INTERRUPTED for r in results):
        return 130
    return 1 if any(r.summary["fell"] or r.summary["stop_cause"] for r in results) else 0


def write_media(
    results: Sequence[Recording], folder: Path, title: str, options: OutputOptions, console: Console
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
