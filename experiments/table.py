"""The table of the documentation: every run it quotes, made anew, in Markdown."""

import dataclasses
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

from rich.console import Console
from rich.progress import Progress

from experiments.console import results_folder, run_one
from experiments.options import (
    FilterOptions,
    HandTrackingOptions,
    PlantOptions,
    RunOptions,
    StandOptions,
    TableOptions,
)
from experiments.results import RunResult, save_result
from experiments.warmup import warm_up
from robots.checks import require_between
from robots.loader import load_robot

ROBOTS = ("g1", "tocabi")
MASS_SCALES = (0.9, 1.0, 1.2)

Column = tuple[str, str, float]
"""Heading, key of the summary, factor."""

STAND_COLUMNS: tuple[Column, ...] = (
    ("robot", "robot", 1),
    ("mass", "mass_scale", 1),
    ("fell", "fell", 1),
    ("CoM error after 3 s, max [mm]", "com_error_settled_max_m", 1e3),
    ("foot slide, max [mm]", "foot_slide_max_m", 1e3),
    ("ZMP inside [%]", "zmp_inside_fraction", 1e2),
    ("torque / limit, max [%]", "max_torque_fraction", 1e2),
    ("QP failures", "qp_failures", 1),
)
HAND_COLUMNS: tuple[Column, ...] = (
    ("robot", "robot", 1),
    ("filter", "filter", 1),
    ("fell", "fell", 1),
    ("min h self-collision [mm]", "min_h_self_collision_m", 1e3),
    ("collision ratio [%]", "collision_ratio", 1e2),
    ("min h workspace [mm]", "min_h_workspace_m", 1e3),
    ("hand RMSE [mm]", "hand_rmse_m", 1e3),
    ("outside conflict [mm]", "hand_rmse_outside_conflict_m", 1e3),
    ("CoM error, max [mm]", "com_error_settled_max_m", 1e3),
    ("foot slide, max [mm]", "foot_slide_max_m", 1e3),
    ("torque / limit, max [%]", "max_torque_fraction", 1e2),
    ("QP failures", "qp_failures", 1),
)


def table(options: TableOptions) -> int:
    """Run everything, print the tables as Markdown, save the runs; returns 0."""
    require_between("jobs", options.jobs, 1, 64)
    console = Console(stderr=True, markup=False, soft_wrap=True)
    groups = runs()
    with results_folder(options.output, "table") as folder:
        # once, here: otherwise every process would compile the same kernels
        warm_up(console, load_robot("g1"))
        done = _run_all([run for group, _ in groups.values() for run in group], options.jobs, console)
        for i, (title, (group, columns)) in enumerate(groups.items()):
            results = [next(done) for _ in group]
            for j, result in enumerate(results):
                save_result(result, folder / f"{i}-{j}")
            print(f"### {title}\n\n{markdown([r.summary for r in results], columns)}\n")
    console.print(f"runs: {folder}")
    return 0


def _run_all(tasks: Sequence[RunOptions], jobs: int, console: Console) -> Iterator[RunResult]:
    """Results in the order of the tasks, some at a time."""
    # spawned, not forked: numba and MuJoCo do not survive a fork of a process that has used them
    with ProcessPoolExecutor(jobs, get_context("spawn")) as pool, Progress(console=console) as bar:
        task = bar.add_task(f"{len(tasks)} runs", total=len(tasks))
        for result in pool.map(_one, tasks):
            bar.advance(task)
            yield result


def _one(options: RunOptions) -> RunResult:
    return run_one(options, None)


def runs() -> dict[str, tuple[list[RunOptions], tuple[Column, ...]]]:
    """All runs by title, with the columns to show."""
    stand: list[RunOptions] = [
        StandOptions(robot=robot, plant=PlantOptions(mass_scale=m)) for robot in ROBOTS for m in MASS_SCALES
    ]
    circles = HandTrackingOptions(plant=PlantOptions(mass_scale=1.2))
    hands: list[RunOptions] = [
        dataclasses.replace(circles, robot=robot, safety=FilterOptions(filter=name))
        for robot in ROBOTS
        for name in ("none", "cbf", "issf")
    ]
    reach: list[RunOptions] = [
        dataclasses.replace(circles, robot=robot, motion="beyond-reach", safety=FilterOptions(filter=name))
        for robot in ROBOTS
        for name in ("none", "issf")
    ]
    sphere: list[RunOptions] = [
        dataclasses.replace(run, motion="hold", obstacle=True, duration=7.0)
        for run in hands
        if isinstance(run, HandTrackingOptions)
    ]
    return {
        "Standing for 10 s": (stand, STAND_COLUMNS),
        "Hand circles through the torso, +20 % mass, 12 s": (hands, HAND_COLUMNS),
        "Hand targets 30 cm beyond reach, +20 % mass, 12 s": (reach, HAND_COLUMNS),
        "A sphere passes through where the hands are, velocity from a Kalman filter, +20 % mass, 7 s": (
            sphere,
            (*HAND_COLUMNS[:3], ("min h obstacle [mm]", "min_h_obstacle_m", 1e3), *HAND_COLUMNS[3:]),
        ),
    }


def markdown(summaries: Sequence[Any], columns: Sequence[Column]) -> str:
    """A Markdown table of summaries."""
    lines = [[heading for heading, _, _ in columns], ["---"] * len(columns)]
    lines += [[_cell(summary.get(key), factor) for _, key, factor in columns] for summary in summaries]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _cell(value: Any, factor: float) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value * factor:.3g}" if isinstance(value, float) else str(value)
