"""``safewbc replay`` of a deployment: its commands computed again from its log, its recording, its MCAP file."""

from functools import partial
from pathlib import Path

from rich.console import Console

from experiments.recording.recording import write_recording
from experiments.recording.store import add_file, claimed
from experiments.reports.metric_tables import runs_table
from experiments.reports.table import show
from experiments.running.deployment_recorder import DeploymentRecorder
from experiments.running.deployment_replay import DeploymentLog, ReplayResult, read_deployment, replay
from experiments.running.deployment_tasks import build, name_of, read_task
from experiments.running.terminal import make_console
from experiments.scenarios.options import ReplayOptions

RUN = "run"
"""Folder beside a log in which its recording is."""


def replay_deployment(path: Path, options: ReplayOptions) -> int:
    """Compute the commands of a log again and print what differs; 0 where nothing does, else 1.

    Raises:
        SafeWbcError: the log's task cannot be made here, a file cannot be written, or mcap is not installed.
    """
    console = make_console()
    log = read_deployment(path)
    if options.mcap is not None:
        write_messages(log, options.mcap, console)
    built = build(task := read_task(log.head["task"]))
    recorder = DeploymentRecorder(built.robot, log) if options.report else None
    with console.status(f"computing {log.commands} commands of {name_of(task)} again"):
        result = replay(log, built, recorder)
    if recorder is not None and result.periods:
        save(recorder, result, path.parent / RUN, name_of(task), console)
    for line in verdict(log, result):
        console.print(line)
    return 0 if result.same else 1


def write_messages(log: DeploymentLog, path: Path, console: Console) -> None:
    """Write the MCAP file, and say what is in it."""
    from experiments.recording.mcap_file import write_mcap

    with console.status(f"writing {path}"):
        written = write_mcap(log.records, log.head, path)
    left_out = f", {written.broken} broken states left out" if written.broken else ""
    console.print(f"mcap: {path}: " + ", ".join(f"{n} on {topic}" for topic, n in written.messages.items()) + left_out)


def save(recorder: DeploymentRecorder, result: ReplayResult, folder: Path, name: str, console: Console) -> None:
    """Write recording and report in place of what an earlier replay left, and show the figures."""
    from experiments.reports.deployment_report import write_deployment_report

    recording = recorder.recording(result)
    with claimed(folder, overwrite=True), console.status("writing the report"):
        write_recording(recording, folder)
        page = partial(write_deployment_report, recording=recording, title=f"Deployment: {name}")
        add_file(folder, "report.html", page)
    show(runs_table([recording]), console)
    console.print(f"recording: {folder}")
    console.print(f"report:    {folder / 'report.html'}")


def verdict(log: DeploymentLog, result: ReplayResult) -> list[str]:
    """What the comparison came to, in words."""
    if result.overwritten:
        first = log.records[0].number
        return [
            f"cannot be computed again: the ring of the log has begun again, its first {first - 1} records are gone; a "
            "larger --log-seconds keeps all"
        ]
    lines = []
    if result.hole is not None:
        last = log.records[-1].number
        lines.append(f"record {result.hole} of {last} is missing: nothing is compared from there on")
    if result.difference is not None:
        number, what = result.difference
        lines.append(f"command {number} of {result.periods} is the first that differs: {what}")
        lines.append(f"not the same: {result.different} of {result.periods} commands differ")
    elif result.periods:
        lines.append(f"{result.periods} commands, all the same bit by bit")
    else:
        lines.append("no commands: the deployment ended before its first one")
    return lines
