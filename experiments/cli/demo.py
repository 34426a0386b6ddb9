"""The demonstration: hand tracking on a robot heavier than its model, without and with the safety filter."""

from experiments.cli.console import make_console, progress, results_folder, write_media
from experiments.recording.recording import save_result
from experiments.reports.metric_tables import runs_table
from experiments.reports.table import show
from experiments.running.warmup import warm_up
from experiments.scenarios.hand_tracking import check_hand_tracking, run_hand_tracking
from experiments.scenarios.options import DemoOptions, FilterOptions, HandTrackingOptions, PlantOptions

FILTERS = ("none", "issf")


def demo(options: DemoOptions) -> int:
    """Run both, print a table, write the report; returns the exit code: 0 if the filter kept its promise."""
    console = make_console()
    runs = [
        HandTrackingOptions(
            robot=options.robot,
            duration=options.duration,
            plant=PlantOptions(mass_scale=options.mass_scale),
            safety=FilterOptions(filter=name),
        )
        for name in FILTERS
    ]
    robot = check_hand_tracking(runs[0])
    mass = f"{100 * (options.mass_scale - 1):+.0f} % mass"
    console.print(f"{robot.title}, {mass}: both hands are asked to circle through the robot's own torso.")
    bars = progress(console, [f"filter: {name}" for name in FILTERS], options.duration)
    with results_folder(options.output, "demo") as folder:
        warm_up(console, robot)
        with bars as advance:
            results = [run_hand_tracking(run, a) for run, a in zip(runs, advance, strict=True)]
    for result, name in zip(results, FILTERS, strict=True):
        save_result(result, folder / name)
    show(runs_table(results), console)
    write_media(results, folder, f"Hand tracking: {robot.title}, {mass}", options.output, console)
    console.print(f"results: {folder}")
    safe = results[1].summary
    smallest = safe["min_h_self_collision_m"]
    return 0 if (smallest is None or smallest > 0) and not safe["fell"] and not safe["stop_cause"] else 1
