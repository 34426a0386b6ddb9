"""Many random walks side by side: who falls, and when."""

import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from rich.console import Console

from experiments.cli.console import results_folder
from experiments.metrics.metric import Metric, column
from experiments.recording.recording import save_result
from experiments.reports.metric_tables import rows_table
from experiments.reports.table import show
from experiments.running.pool import Row, Task, in_parallel, row
from experiments.running.run import prepare, run
from experiments.running.warmup import warm_up
from experiments.scenarios.options import OutputOptions
from experiments.scenarios.random_walk import RandomWalk
from experiments.studies.study_options import RandomWalksOptions
from robots.checks import require_between
from robots.loader import load_robot

RANDOM_WALK_COLUMNS = (
    Metric("seed", "seed"),
    Metric("ended", "fell"),
    Metric("drawn_mass", "mass"),
    Metric("drawn_links", "links' factor"),
    Metric("drawn_friction", "friction"),
    Metric("drawn_noise", "noise"),
    Metric("drawn_delay_ms", "delay", "ms"),
    Metric("drawn_commands", "commands"),
    Metric("drawn_pushes", "pushes, N s/kg"),
    column("zmp_inside_fraction", "ZMP inside"),
    column("min_h_self_collision_m", "min h self-collision"),
    column("qp_failures", "QP failures"),
)


def random_walks(options: RandomWalksOptions) -> int:
    """Run them all, print who falls and what was drawn, save configuration and summary of each; returns 0.

    Raises:
        SafeWbcError: an option is not allowed; nothing has run then.
    """
    check_random_walks(options)
    console = Console(stderr=True, markup=False, soft_wrap=True)
    with results_folder(OutputOptions(out=options.out), "random-walks") as folder:
        warm_up(console, load_robot(options.robot))
        rows = list(in_parallel(random_walk_tasks(options, folder), options.jobs, console))
    show(rows_table(rows, RANDOM_WALK_COLUMNS, caption=falls(rows)))
    console.print(f"runs: {folder}")
    return 0


def check_random_walks(options: RandomWalksOptions) -> None:
    """Check every option before anything runs.

    Raises:
        SafeWbcError: one is not allowed.
    """
    require_between("runs", options.runs, 1, 100_000)
    require_between("jobs", options.jobs, 1, 64)
    prepare(_one(options, options.first_seed))


def _one(options: RandomWalksOptions, seed: int) -> RandomWalk:
    return RandomWalk(robot=options.robot, duration=options.duration, seed=seed)


def random_walk_tasks(options: RandomWalksOptions, folder: Path) -> list[Task]:
    """A task for each seed."""
    seeds = range(options.first_seed, options.first_seed + options.runs)
    return [partial(random_walk_row, _one(options, seed), folder / f"random-walk-{seed}") for seed in seeds]


def random_walk_row(options: RandomWalk, folder: Path) -> Row:
    """Run one, save its configuration and summary, return its line."""
    start = time.process_time()
    result = run(options)
    save_result(result, folder, series=False)
    return row(result) | {"cpu_s": time.process_time() - start}


def falls(rows: Sequence[Row]) -> str:
    """Who fell or was stopped, in a sentence."""
    down = [r for r in rows if r["ended"] != "no"]
    named = ", ".join(f"{r['seed']} ({r['ended']})" for r in down)
    share = f"{len(down)} of {len(rows)} fell or were stopped ({100 * len(down) / len(rows):.3g} %)"
    return share + (f": seed {named}." if down else ".")
