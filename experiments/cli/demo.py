"""The demonstration: hand tracking on a robot heavier than its model, without and with the safety filter."""

from collections.abc import Callable, Sequence

from experiments.cli.console import exit_code, write_media
from experiments.recording.recording import Recording, write_recording
from experiments.recording.store import write_run
from experiments.reports.metric_tables import runs_table
from experiments.reports.table import show
from experiments.running.ending import INTERRUPTED, Interruption
from experiments.running.recorder import Progress
from experiments.running.run import Prepared, prepare, run_prepared
from experiments.running.terminal import ask_to_stop, make_console, progress, results_folder
from experiments.running.warmup import warm_up
from experiments.scenarios.hand_tracking import HandTracking
from experiments.scenarios.options import DemoOptions, FilterOptions, PlantOptions

FILTERS = ("none", "issf")


def demo(options: DemoOptions) -> int:
    """Run both, print a table, write the report; returns the exit code: 0 if the filter kept its guarantee."""
    console = make_console()
    given = [prepare(_scenario(options, name)) for name in FILTERS]
    robot = given[0].robot
    mass = f"{100 * (options.mass_scale - 1):+.0f} % mass"
    console.print(f"{robot.title}, {mass}: both hands are asked to circle through the robot's own torso.")
    bars = progress(console, [f"filter: {name}" for name in FILTERS], options.duration)
    with results_folder(options.output, "demo") as folder:
        warm_up(console, robot)
        with bars as advance:
            results = _run_all(given, advance)
        for result, name in zip(results, FILTERS, strict=False):
            write_recording(result, folder / name)
        # pictures of an earlier demonstration go with it
        write_run(folder, {})
        show(runs_table(results), console)
        write_media(results, folder, f"Hand tracking: {robot.title}, {mass}", options.output, console)
    console.print(f"results: {folder}")
    if any(r.summary["stop_cause"] == INTERRUPTED for r in results):
        return exit_code(results)
    smallest = results[1].summary["min_h_self_collision_m"]
    return exit_code(results[1:]) if smallest is None or smallest > 0 else 1


def _scenario(options: DemoOptions, filter_name: str) -> HandTracking:
    return HandTracking(
        robot=options.robot,
        duration=options.duration,
        plant=PlantOptions(mass_scale=options.mass_scale),
        safety=FilterOptions(filter=filter_name),
    )


def _run_all(given: Sequence[Prepared], advance: Sequence[Callable[[float], None]]) -> list[Recording]:
    """One after the other, up to one that a person stops."""
    results: list[Recording] = []
    with ask_to_stop() as asked:
        for one, tell in zip(given, advance, strict=True):
            results.append(run_prepared(one, (Progress(tell), Interruption(asked.is_set))))
            if asked.is_set():
                break
    return results
