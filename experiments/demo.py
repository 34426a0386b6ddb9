"""The demonstration: hand tracking on a robot heavier than its model, without and with the safety filter."""

from rich.console import Console

from experiments.console import output_folder, progress, summary_table, write_media
from experiments.hand_tracking import run_hand_tracking
from experiments.options import DemoOptions, FilterOptions, HandTrackingOptions, PlantOptions
from experiments.results import save_result
from experiments.session import check_options

FILTERS = ("none", "issf")


def demo(options: DemoOptions) -> int:
    """Run both, print a table, write the report; returns the exit code: 0 if the filter kept its promise."""
    console = Console()
    runs = [
        HandTrackingOptions(
            robot=options.robot,
            duration=options.duration,
            plant=PlantOptions(mass_scale=options.mass_scale),
            safety=FilterOptions(filter=name),
        )
        for name in FILTERS
    ]
    robot = check_options(runs[0])
    folder = output_folder(options.output, "demo")
    mass = f"{100 * (options.mass_scale - 1):+.0f} % mass"
    console.print(f"{robot.title}, {mass}: both hands are asked to circle through the robot's own torso.")
    with progress(console, [f"filter: {name}" for name in FILTERS], options.duration) as advance:
        results = [run_hand_tracking(run, a) for run, a in zip(runs, advance, strict=True)]
    for result, name in zip(results, FILTERS, strict=True):
        save_result(result, folder / name)
    console.print(summary_table(results))
    write_media(results, folder, f"Hand tracking: {robot.title}, {mass}", options.output, console)
    console.print(f"results: {folder}")
    safe = results[1].summary
    return 0 if safe["min_h_self_collision_m"] > 0 and not safe["fell"] else 1
