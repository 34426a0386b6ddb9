"""Filters side by side where conditions conflict: the scenes of figures 2(b) and 4 of the p-SSA paper in one run."""

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from experiments.cli.console import make_console, progress, results_folder
from experiments.metrics.metric import Figure
from experiments.recording.recording import plain
from experiments.running.corridor_loop import DT, MARGINS, TOUCH, VARIANTS, CorridorLoop, CorridorRun, variant_title
from experiments.scenarios.corridor import D_MIN, Corridor, corridor_robot
from experiments.scenarios.options import CorridorOptions, OutputOptions
from robots.checks import require_between, require_one_of, require_positive
from robots.description import RobotDescription
from robots.errors import ConfigError

TABLE_WIDTH = 6
"""Runs side by side in a terminal of 80 columns."""

FIGURES = (
    Figure("J", "J"),
    Figure("C", "C"),
    Figure("S", "S"),
    Figure("S_environment", "S, obstacles"),
    Figure("S_self", "S, own bodies"),
    Figure("feasible_rate", "R_feas", "%", 1e2),
    Figure("infeasible_ticks", "infeasible ticks"),
    Figure("phi_hand_max_m", "largest hand phi", "mm", 1e3),
    Figure("min_h_hand_m", "nearest hand", "mm", 1e3, "negative"),
    Figure("min_h_obstacle_m", "nearest body", "mm", 1e3, "negative"),
    Figure("min_h_self_collision_m", "own bodies", "mm", 1e3, "negative"),
    Figure("min_joint_limit_rad", "room to limits", "rad", bad="negative"),
    Figure("collision_ticks", "collision ticks", bad="positive"),
    Figure("violation_mean", "violation", "m/s"),
    Figure("excess_mean", "excess", "m/s"),
    Figure("switches_per_s", "switches", "1/s"),
    Figure("jump_rms", "jumps", "rad/s"),
    Figure("filter_ms_median", "filter, median", "ms"),
)
"""In the order to show them."""


def corridor(options: CorridorOptions) -> int:
    """Run all filters, print a table, write results and report; returns 0."""
    scene = check_corridor(options)
    console = make_console()
    titles = [variant_title(name) for name in options.filters]
    robot = corridor_robot()
    bars = progress(console, titles, options.duration)
    with results_folder(OutputOptions(out=options.out), "corridor") as folder:
        loops = [CorridorLoop(robot, scene, name, options.weight, options.margins) for name in options.filters]
        with bars as advance:
            runs = [loop.run(options.duration, a) for loop, a in zip(loops, advance, strict=True)]
    save_corridor(folder, options, runs, loops[0].labels)
    for k in range(0, len(runs), TABLE_WIDTH):
        console.print(corridor_table(runs[k : k + TABLE_WIDTH]))
    if options.report:
        _report(folder, scene, robot, runs, console)
    console.print(f"results: {folder}")
    return 0


def check_corridor(options: CorridorOptions) -> Corridor:
    """Check every option before anything is made or written; returns the scene.

    Raises:
        ConfigError: an option is not allowed.
    """
    if not options.filters:
        raise ConfigError("filters", options.filters, "at least one of " + ", ".join(VARIANTS))
    for name in options.filters:
        require_one_of("filters", name, VARIANTS)
    if len(set(options.filters)) != len(options.filters):
        raise ConfigError("filters", " ".join(options.filters), "each of them once")
    require_between("duration", options.duration, 0.1, 120.0)
    require_positive("weight", options.weight)
    require_one_of("margins", options.margins, MARGINS)
    if options.seed is not None:
        require_between("seed", options.seed, 0, 2**63 - 1)
    return Corridor(options.gap, options.seed)


def save_corridor(folder: Path, options: CorridorOptions, runs: Sequence[CorridorRun], labels: Sequence[str]) -> None:
    """Write ``config.json``, ``summary.json`` (a list, one entry per run) and ``<name>/series.npz`` of each run.

    Raises:
        ConfigError: the folder cannot be written.
    """
    settings = {k: v for k, v in dataclasses.asdict(options).items() if k not in {"out", "report"}}
    config = {"experiment": "corridor", "robot": "g1", "options": settings, "dt": DT, "d_min": D_MIN, "rows": labels}
    try:
        for name, content in (("config", config), ("summary", [run.summary for run in runs])):
            text = json.dumps(plain(content), indent=2, allow_nan=False)
            (folder / f"{name}.json").write_text(text + "\n", encoding="utf-8")
        for run in runs:
            (folder / run.name).mkdir(exist_ok=True)
            arrays: dict[str, Any] = dict(run.series)
            np.savez_compressed(folder / run.name / "series.npz", **arrays)
    except OSError as error:
        raise ConfigError("out", str(folder), f"a folder that can be written ({error.strerror or error})") from error


def corridor_table(runs: Sequence[CorridorRun]) -> Table:
    """The figures side by side, narrow enough for a terminal of 80 columns with the default filters."""
    table = Table(box=SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("")
    for run in runs:
        table.add_column(run.name, justify="right")
    for figure in FIGURES:
        unit = f" ({figure.unit})" if figure.unit else ""
        table.add_row(figure.words + unit, *(figure_text(figure, run) for run in runs))
    return table


def figure_text(figure: Figure, run: CorridorRun) -> str:
    """One figure of one run; ``none`` where there was nothing to score."""
    value = run.summary[figure.key]
    if value is None and figure.key[0] in "CS":
        return "none"
    if figure.unit == "mm":
        # overlaps that are only rounding are none
        return f"{(0.0 if -TOUCH <= value < 0 else value) * figure.factor:.1f}"
    return figure.text(value)


def is_bad(figure: Figure, run: CorridorRun) -> bool:
    """Whether a figure of a run stands out as one that should not be."""
    value = run.summary[figure.key]
    return figure.is_bad(value) and not -TOUCH <= value < 0


def _report(
    folder: Path, scene: Corridor, robot: RobotDescription, runs: Sequence[CorridorRun], console: Console
) -> None:
    from experiments.reports.corridor import corridor_frames, write_corridor_report
    from sims.rendering import rendering_problem

    if problem := rendering_problem():
        console.print(f"no pictures: {problem}", style="yellow")
    with console.status("rendering and writing the report"):
        frames = corridor_frames(scene, robot, runs)
        path = write_corridor_report(folder / "report.html", scene, robot, runs, frames, note=problem or "")
    console.print(f"report:  {path}")
