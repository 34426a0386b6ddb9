"""The first tick of a new process, with and without a warm-up before it, beside the median of those that follow."""

import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from experiments.benchmarks.worst_course import Course
from experiments.benchmarks.worst_scenes import Scene
from experiments.reports.table import Column, Row, Table, show
from experiments.running.warmup import fill_caches
from experiments.scenarios.options import BenchOptions
from robots.errors import ConfigError
from robots.loader import load_robot
from safety.filters.registry import filter_kind

PROCESSES = 5
"""How many processes are started for each line; the middle one counts."""

TICKS = 2500
"""Ticks after the second, of which the median is taken: a turn of the hands, as `bench tick` has it."""

KINDS = ("warm_up_ms", "first_ms", "second_ms", "median_ms")
"""Figures of one process."""


def bench_first(options: BenchOptions) -> int:
    """Measure every robot, print the table; returns 0."""
    filter_kind(options.filter)
    robots = [load_robot(name) for name in options.robots]
    if not robots:
        raise ConfigError("robots", options.robots, "at least one robot")
    console = Console()
    with console.status("filling the kernels' cache"):
        fill_caches()
    figures: dict[str, dict[str, dict[str, float]]] = {}
    with console.status(f"starting {2 * PROCESSES} processes for each robot"):
        for given, robot in zip(options.robots, robots, strict=True):
            figures[robot.name] = {}
            for warm in ("no", "yes"):
                found = middle([in_a_process(given, options.filter, warm) for _ in range(PROCESSES)])
                figures[robot.name][warm] = found
    show(table(figures, f"a new process in milliseconds, filter {options.filter}, cache filled"), console)
    console.print(f"medians of {PROCESSES} processes; {platform.machine()}, {os.cpu_count()} processors")
    if options.out is not None:
        options.out.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    return 0


def table(figures: Mapping[str, Mapping[str, Mapping[str, float]]], title: str) -> Table:
    """The figures ``KINDS`` by robot, and by whether the process warmed up."""
    columns = [Column(name, words=True) for name in ("robot", "warm_up")]
    columns += [Column(name) for name in ("warming up", "first tick", "second", "median")]
    rows = (
        Row((robot, warm, *(f"{found[k]:.2f}" for k in KINDS)))
        for robot, lines in figures.items()
        for warm, found in lines.items()
    )
    return Table(tuple(columns), tuple(rows), title)


def in_a_process(robot: str, safety_filter: str, warm: str) -> dict[str, Any]:
    """What a new process measures; ``warm``: ``yes`` or ``no``."""
    command = [sys.executable, "-m", "experiments.benchmarks.first", robot, safety_filter, warm]
    root = str(Path(__file__).resolve().parents[2])
    path = os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])])
    done = subprocess.run(command, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True, check=True)
    return dict(json.loads(done.stdout))


def middle(found: list[dict[str, Any]]) -> dict[str, float]:
    """The median of each figure."""
    return {k: float(np.median([f[k] for f in found])) for k in KINDS}


def measure_here(robot_name: str, safety_filter: str, warm: bool) -> dict[str, float]:
    """The figures ``KINDS`` [ms] of this process, whose first ticks these have to be."""
    options = BenchOptions("first", filter=safety_filter)
    course = Course(load_robot(robot_name), options, Scene("undisturbed", ()))
    start = time.perf_counter()
    if warm:
        course.controller.warm_up()
    times = [time.perf_counter() - start]
    for _ in range(2 + TICKS):
        given = course.prepare()
        start = time.perf_counter()
        result = course.supervisor.tick(*given)[1]
        times.append(time.perf_counter() - start)
        assert result is not None
        course.follow(result)
    values = (times[0], times[1], times[2], float(np.median(times[3:])))
    return {k: 1e3 * t for k, t in zip(KINDS, values, strict=True)}


if __name__ == "__main__":
    print(json.dumps(measure_here(sys.argv[1], sys.argv[2], sys.argv[3] == "yes")))
