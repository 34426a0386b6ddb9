"""Benchmark of the closed loop: wall time over simulated time, by part of a run."""

import json
import os
import platform
import time
from pathlib import Path
from typing import Any

from rich.console import Console

from experiments.reports.table import Column, Row, Table, show
from experiments.running.laps import LOOP_PARTS, PARTS, Laps
from experiments.running.run import run
from experiments.running.warmup import warm_up
from experiments.scenarios.hand_tracking import HandTracking
from experiments.scenarios.options import BenchOptions, FilterOptions, PlantOptions
from experiments.scenarios.scenario import Scenario
from experiments.scenarios.walk import Walk
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.loader import load_robot
from safety.filters.registry import filter_kind

DURATION = 12.0
"""Simulated time of each run [s]."""

RATES = {500.0: 0.001, 2000.0: 0.0005}
"""Control frequencies [Hz] and the physics step of each [s]."""

RUNS = ("hands", "walk")
"""What is run, at +20 % mass: both hands on their circles, and a walk straight on."""


def bench_loop(options: BenchOptions) -> int:
    """Measure the closed loop of every robot and print its table; returns 0."""
    filter_kind(options.filter)
    robots = [(name, load_robot(name)) for name in options.robots]
    if not robots:
        raise ConfigError("robots", options.robots, "at least one robot")
    console = Console()
    figures: dict[str, Any] = {}
    for name, robot in robots:
        warm_up(console, robot)
        found = figures[robot.name] = {}
        for what in RUNS:
            for rate in RATES:
                with console.status(f"{robot.title}: {what} at {rate:g} Hz"):
                    found[f"{what} {rate:g} Hz"] = loop_figures(case(name, what, rate, options.filter, DURATION))
        show(table(robot, options.filter, found), console)
    console.print(f"{platform.machine()}, {os.cpu_count()} processors, Python {platform.python_version()}")
    if options.out is not None:
        Path(options.out).write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    return 0


def case(name: str, what: str, rate: float, filter_name: str, duration: float) -> Scenario:
    """One of ``RUNS`` of a robot (as for ``--robot``), at one of ``RATES``, for ``duration`` [s]."""
    settings: dict[str, Any] = {
        "robot": name,
        "duration": duration,
        "control_rate": rate,
        "plant": PlantOptions(mass_scale=1.2, physics_dt=RATES[rate]),
        "safety": FilterOptions(filter=filter_name),
    }
    return Walk(**settings) if what == "walk" else HandTracking(**settings)


def loop_figures(scenario: Scenario) -> dict[str, float]:
    """Wall time by part of one run [ms per simulated second; the set-up in ms], and how much faster than real time.

    ``loop`` is the sum of ``LOOP_PARTS``, ``real_time_factor`` simulated time over it; ``processor_ratio`` processor
    time over wall time: clearly below 1, something else was running and the figures say little.
    """
    laps, processor = Laps(), time.process_time()
    simulated = float(run(scenario, laps=laps).summary["duration_s"])
    processor = time.process_time() - processor
    out = {part: 1e3 * seconds / simulated for part, seconds in laps.seconds.items()}
    out["set-up"] = 1e3 * laps.seconds["set-up"]
    out["loop"] = sum(out[part] for part in LOOP_PARTS)
    out["real_time_factor"] = 1e3 / out["loop"]
    out["processor_ratio"] = processor / sum(laps.seconds.values())
    return out


def table(robot: RobotDescription, filter_name: str, figures: dict[str, dict[str, float]]) -> Table:
    """The figures of one robot's runs, each :func:`loop_figures`, side by side."""
    parts = [(part, part, 1) for part in (*LOOP_PARTS, "loop")] + [("times real time", "real_time_factor", 2)]
    setup = [("set-up [ms]" if part == "set-up" else part, part, 1) for part in PARTS if part not in LOOP_PARTS]
    rows = [
        Row(
            (name, *(f"{f[key]:.{digits}f}" for f in figures.values())),
            bold=key in {"loop", "real_time_factor"},
            section=(name, key, digits) == setup[0],
        )
        for name, key, digits in (*parts, *setup, ("processor ratio", "processor_ratio", 2))
    ]
    title = f"{robot.name}, filter {filter_name}: ms of wall time per simulated second"
    return Table((Column("part", words=True), *map(Column, figures)), tuple(rows), title)
