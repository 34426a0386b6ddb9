"""The report of a deployment: what the robot measured and estimated, and how the deadlines were kept."""

import json
from pathlib import Path

from experiments.recording.plain import plain
from experiments.recording.recording import Recording
from experiments.reports.metric_tables import runs_table
from experiments.reports.page import PlotPart, write_page
from experiments.reports.plots import deployment as plots

NOTE = (
    "Made from the log by computing every command again. Base, feet and distances are as the robot estimated them: "
    "what they really were is not known here."
)

PLOTS = (
    (
        "Base",
        plots.base_plot,
        "As estimated, after the calibration. Green: stages in which the controller has the robot.",
    ),
    ("Feet", plots.feet_plot, "Estimated force along the normal of each sole, and the probability that it stands."),
    ("Torques", plots.torque_plot, "As the motors measure them, as a fraction of their limits."),
    (
        "Deadlines",
        plots.clock_plot,
        "From the first look at a state to its command, the age of the state then, and periods in a row without one. A "
        "command that is late, marked red, is not sent: the one before is, once more.",
    ),
    (
        "Distances, estimated",
        plots.barrier_plot,
        "Smallest barrier of each family at the estimated state; below zero bodies would overlap.",
    ),
    (
        "Filter and balance",
        plots.filter_plot,
        "What the safety filter changed, and the centre of mass at the estimate.",
    ),
    ("Motors and battery", plots.condition_plot, "Temperature of the hottest motor, and what is left in the battery."),
)


def write_deployment_report(path: Path, recording: Recording, title: str) -> Path:
    """Write the report as one file that needs nothing else.

    Args:
        path: the HTML file.
        recording: of a deployment, with at least one period.
        title: heading.

    Returns:
        ``path``.

    Raises:
        ConfigError: the file cannot be written.
    """
    summary = {name: value for name, value in recording.summary.items() if name != "events"}
    return write_page(
        path,
        "deployment.html.jinja",
        title=title,
        lead=recording.robot.title,
        note=NOTE,
        table=runs_table([recording]),
        plots=[PlotPart(heading, plot(recording), caption) for heading, plot, caption in PLOTS],
        events="\n".join(f"[{time:9.3f}] {text}" for time, text in recording.summary["events"]),
        settings=json.dumps({"summary": plain(summary), "config": plain(recording.config)}, indent=2),
    )
