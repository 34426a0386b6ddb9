"""Benchmarks; that of the tick: stage by stage, over the states of a recorded run."""

import gc
import json
import os
import platform
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from controllers.agent import Agent, AgentOutput
from controllers.motions.hands import HandCircles
from controllers.whole_body.controller import STAGES
from controllers.whole_body.robot_config import controller_config
from experiments.reports.table import Column, Row, Table, show
from experiments.running.loop import ClosedLoop, Observer
from experiments.running.warmup import warm_up
from experiments.scenarios.hand_motions import start_posture
from experiments.scenarios.options import BenchOptions
from robots.checks import require_between
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.loader import load_robot
from robots.messages import Array, RobotState
from robots.mujoco_spec import PhysicalChanges
from robots.pinocchio_model import standing_configuration
from safety.filters.registry import filter_kind
from sims.plant import MujocoPlant, PlantConfig

TICKS = 5000
"""Ticks to measure if not said otherwise."""

WARM_UP = 100
"""Ticks run and not counted."""

OF_TICK = ("robots", "filter", "solver")
OF_NONE = (*OF_TICK, "filters", "ticks")

BENCHMARKS = {
    "tick": ("benchmarks.tick", "bench_tick", ("filters",)),
    "first": ("benchmarks.first", "bench_first", ("filters", "solver", "ticks")),
    "rows": ("benchmarks.rows", "bench_rows", ("filters",)),
    "worst": ("benchmarks.worst", "bench_worst", ("filters",)),
    "loop": ("benchmarks.loop", "bench_loop", ("filters", "solver", "ticks")),
    "filters": ("benchmarks.filter_bench", "bench_filters", OF_TICK),
    "peers": ("benchmarks.peers", "bench_peers", (*OF_TICK, "filters")),
    "tracking": ("benchmarks.pictured", "bench_tracking", OF_NONE),
    "recovery": ("benchmarks.pictured", "bench_recovery", OF_NONE),
    "straight": ("benchmarks.pictured", "bench_straight", OF_NONE),
}
"""Module and function of each benchmark, and the options that it does not use."""


def bench(options: BenchOptions) -> int:
    """Measure what was asked for; returns 0.

    Raises:
        ConfigError: an option that is not used is given, or ``out`` is no file that can be written.
    """
    module, function, unused = BENCHMARKS[options.what]
    for name in unused:
        if getattr(options, name) != getattr(BenchOptions, name):
            raise ConfigError(name, getattr(options, name), f"left out: bench {options.what} does not use it")
    if options.out is not None and (options.out.is_dir() or not os.access(options.out.parent, os.W_OK)):
        raise ConfigError("out", str(options.out), "a file in a folder that can be written")
    return int(getattr(import_module(f"experiments.{module}"), function)(options))


def bench_tick(options: BenchOptions) -> int:
    """Measure one control tick of every robot and print the table; returns 0."""
    ticks = TICKS if options.ticks is None else options.ticks
    require_between("ticks", ticks, 100, 1_000_000)
    filter_kind(options.filter)
    robots = [load_robot(name) for name in options.robots]
    if not robots:
        raise ConfigError("robots", options.robots, "at least one robot")
    console = Console()
    figures: dict[str, Any] = {}
    for robot in robots:
        warm_up(console, robot)
        with console.status(f"{robot.title}: recording a run, then replaying it"):
            figures[robot.name] = stage_figures(measure(robot, options, ticks))
    show(stage_table(figures, f"one tick in microseconds over {ticks} ticks, filter {options.filter}"), console)
    console.print(f"{platform.machine()}, {os.cpu_count()} processors, Python {platform.python_version()}")
    if options.out is not None:
        Path(options.out).write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    return 0


def stage_table(figures: Mapping[str, Mapping[str, Mapping[str, float]]], title: str) -> Table:
    """The figures of every robot, by stage, as :func:`stage_figures` gives them [us]."""
    columns = [Column("stage", words=True)]
    for name in figures:
        columns += [Column(f"{name} median"), Column("p99")]
    rows = []
    for stage in (*STAGES, "total"):
        times = (found[stage][k] for found in figures.values() for k in ("median_us", "p99_us"))
        rows.append(Row((stage, *(f"{t:.1f}" for t in times)), bold=stage == "total"))
    return Table(tuple(columns), tuple(rows), title)


def measure(robot: RobotDescription, options: BenchOptions, ticks: int) -> Array:
    """Stage times (ticks, len(STAGES)) [s] of the hand-tracking run at +20 % mass, replayed without the plant."""
    states = recorded(robot, prepared(robot, options), ticks + WARM_UP)
    agent = prepared(robot, options)
    agent.reset(states[0])
    out = np.zeros((len(states), len(STAGES)))
    gc.collect()
    for i, state in enumerate(states):
        result = agent.tick(state).result
        assert result is not None
        out[i] = result.stage_seconds
    return out[WARM_UP:]


def prepared(robot: RobotDescription, options: BenchOptions) -> Agent:
    """An agent whose hands are to go round circles through the torso."""
    config = controller_config(robot, filter=options.filter, dynwbc_solver=options.solver)
    return Agent(robot, config, motions=[HandCircles.for_robot], with_hands=True, settle_time=0.0)


class States(Observer):
    """Keeps the states that an agent was shown."""

    def __init__(self) -> None:
        self.kept: list[RobotState] = []

    def ticked(self, loop: ClosedLoop[Any], state: RobotState, output: AgentOutput, seconds: float) -> None:
        """See :meth:`Observer.ticked`."""
        self.kept.append(state)


def recorded(robot: RobotDescription, agent: Agent, ticks: int) -> list[RobotState]:
    """The states of a run at +20 % mass, of as many ticks."""
    plant = MujocoPlant(robot, PlantConfig(changes=PhysicalChanges(mass_scale=1.2)), np.random.default_rng(0))
    plant.reset(standing_configuration(robot, start_posture(robot)))
    agent.reset(plant.state())
    states = States()
    ClosedLoop(plant, agent, observers=[states]).run(ticks * agent.dt)
    return states.kept


def stage_figures(times: Array) -> dict[str, dict[str, float]]:
    """Median and 99th percentile [us] of each stage and of their total, from times (ticks, len(STAGES)) [s]."""
    columns = dict(zip(STAGES, times.T, strict=True)) | {"total": times.sum(axis=1)}
    return {
        name: {"median_us": 1e6 * float(np.median(t)), "p99_us": 1e6 * float(np.percentile(t, 99))}
        for name, t in columns.items()
    }
