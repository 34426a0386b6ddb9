"""Our tick beside other libraries for inverse kinematics: same process, same robot, same recorded states."""

import gc
import json
import os
import platform
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import metadata
from typing import Any

import numpy as np
from rich.console import Console

from controllers.agent import Agent
from experiments.benchmarks.peer_stacks import PEERS, OurIk, Peer, Solver
from experiments.benchmarks.tick import prepared, recorded
from experiments.reports.table import Column, Row, Table, show
from experiments.running.warmup import warm_up
from experiments.scenarios.options import BenchOptions
from robots.checks import require_between
from robots.loader import load_robot
from robots.messages import Array, RobotState

TICKS = 5000
"""Ticks to measure if not said otherwise."""

BLOCK = 50
"""States after which it is the next one's turn: other load on the machine then meets all alike, caches stay warm."""

WARM_UP = 10
"""Calls at the start of each block that are not counted."""

OURS, OUR_TICK = "safewbc, filtered IK", "safewbc, whole tick"
"""Names of our two lines."""

SAME = (
    "The same for all: poses of two soles, CoM, orientation of base and torso, positions of two hands, posture; bounds "
    "of joint positions and velocities; {pairs} pairs of collision bodies."
)
NOT_SAME = (
    "Not the same problem. safewbc: strict priorities, then the ISSf filter with {rows} rows (capsule ends and "
    "workspace among them), and the dynamics reckoned on the way. {works}."
)
COLUMNS = (
    "ratio: of the medians, to our filtered IK. differs: joint velocities from our filtered ones, RMS over joints, "
    "median over states [rad/s]. no answer: states for which the library has none."
)
"""Below the table."""


@dataclass(slots=True)
class Line:
    """What was measured of one library.

    Attributes:
        name: of the line.
        version: of the library; ``None`` where it is not installed.
        seconds: of each call [s].
        differences: RMS over joints of its velocity less ours, of each call with an answer [rad/s].
        unanswered: calls without an answer.
    """

    name: str
    version: str | None
    seconds: list[float] = field(default_factory=list)
    differences: list[float] = field(default_factory=list)
    unanswered: int = 0


def bench_peers(options: BenchOptions) -> int:
    """Measure, print the table, say what is not installed; returns 0."""
    ticks = TICKS if options.ticks is None else options.ticks
    require_between("ticks", ticks, 2 * BLOCK, 100_000)
    console = Console(soft_wrap=True)
    robot = load_robot("g1")
    warm_up(console, robot)
    with console.status(f"{robot.title}: recording a run, then replaying it"):
        agent = prepared(robot, BenchOptions("peers"))
        lines = measure(agent, recorded(robot, agent, ticks))
    show(table(lines, f"microseconds a call over {ticks} states of the {robot.title}"), console)
    for note in notes(lines, len(robot.self_collision_pairs), agent.controller.barriers.size):
        console.print(note, markup=False)
    console.print(f"{platform.machine()}, {os.cpu_count()} processors, Python {platform.python_version()}")
    if options.out is not None:
        options.out.write_text(json.dumps(figures(lines), indent=2) + "\n", encoding="utf-8")
    return 0


def measure(
    agent: Agent,
    states: Sequence[RobotState],
    peers: Sequence[Peer] = PEERS,
) -> list[Line]:
    """Go through recorded states, by turns with ours and with each of the ``peers`` that is installed.

    Args:
        agent: that of the recorded run; gives robot, settings and the references at each state.
        states: recorded.
        peers: what ours is compared with.

    Returns:
        Our two lines, then one of each peer.
    """
    robot, config = agent.robot, agent.controller.config
    ours, solvers = OurIk(robot, config), [p.make(robot, config) if p.version() else None for p in peers]
    version = metadata.version("safewbc")
    lines = [Line(OURS, version), Line(OUR_TICK, version), *(Line(p.name, p.version()) for p in peers)]
    for start in range(0, len(states), BLOCK):
        block = states[start : start + BLOCK]
        expected = []
        gc.collect()
        for i, state in enumerate(block):
            expected.append(ours.velocity(state, agent.references_at(state)))
            if i >= WARM_UP:
                for line, seconds in zip(lines[:2], ours.seconds, strict=True):
                    line.seconds.append(seconds)
        for line, solver in zip(lines[2:], solvers, strict=True):
            if solver is not None:
                _measure_block(line, solver, block, expected, agent)
    return lines


def _measure_block(
    line: Line,
    solver: Solver,
    states: Sequence[RobotState],
    expected: Sequence[Array],
    agent: Agent,
) -> None:
    """Time a peer on a few states and compare with our velocities (nj,) there; the first ``WARM_UP`` do not count."""
    gc.collect()
    for i, (state, ours) in enumerate(zip(states, expected, strict=True)):
        reference = agent.references_at(state)
        start = time.perf_counter()
        velocity = solver.velocity(state, reference)
        seconds = time.perf_counter() - start
        if i < WARM_UP:
            continue
        line.seconds.append(seconds)
        if velocity is None:
            line.unanswered += 1
        else:
            line.differences.append(float(np.sqrt(np.mean((velocity - ours) ** 2))))


def figures(lines: Sequence[Line]) -> dict[str, dict[str, Any]]:
    """By name: version, median and 10 % quantile [us], both over ours, median difference [rad/s], calls without answer.

    ``None`` where there is no such figure.
    """
    ours = _quantiles(lines[0].seconds)
    out = {}
    for line in lines:
        median, low = _quantiles(line.seconds) if line.seconds else (None, None)
        out[line.name] = {
            "version": line.version,
            "median_us": median,
            "p10_us": low,
            "median_to_ours": None if median is None else median / ours[0],
            "p10_to_ours": None if low is None else low / ours[1],
            "difference_rad_s": float(np.median(line.differences)) if line.differences else None,
            "unanswered": line.unanswered,
        }
    return out


def _quantiles(seconds: Sequence[float]) -> tuple[float, float]:
    """Median and 10 % quantile [us]."""
    return 1e6 * float(np.median(seconds)), 1e6 * float(np.quantile(seconds, 0.1))


def table(lines: Sequence[Line], title: str) -> Table:
    """The figures; a dash where there is none."""
    headings = ("median", "10 %", "ratio", "differs", "no answer")
    columns = (Column("", words=True), Column("version", words=True), *map(Column, headings))
    return Table(columns, tuple(Row((name, *_cells(row))) for name, row in figures(lines).items()), title)


def _cells(row: Mapping[str, Any]) -> tuple[str, ...]:
    if row["version"] is None:
        return ("not installed", *["-"] * 5)
    difference = row["difference_rad_s"]
    shown = "-" if difference is None else f"{difference:.3g}"
    times = (f"{row['median_us']:.0f}", f"{row['p10_us']:.0f}", f"{row['median_to_ours']:.2f}")
    return (row["version"], *times, shown, str(row["unanswered"]))


def notes(lines: Sequence[Line], pairs: int, rows: int, peers: Sequence[Peer] = PEERS) -> list[str]:
    """What the table's figures are of, in how far the problems are alike, and how to install what is missing."""
    works = "; ".join(f"{p.name}: {p.work}" for p in peers)
    absent = {line.name for line in lines if line.version is None}
    missing = dict.fromkeys(p.distribution for p in peers if p.name in absent)
    out = [SAME.format(pairs=pairs), NOT_SAME.format(rows=rows, works=works), COLUMNS]
    if missing:
        out.append(f'not installed: {", ".join(missing)}; pip install -e ".[bench]" installs what is missing')
    return out
