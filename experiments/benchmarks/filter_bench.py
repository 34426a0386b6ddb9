"""Comparison of the safety filters: time, answers and failures over the same recorded states."""

import gc
import json
import os
import platform
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from time import perf_counter

import numpy as np

from experiments.benchmarks.filter_recording import Solvable, record
from experiments.benchmarks.filter_scenes import BASES, OBSTACLES, SCENES, Moment, Problem, order_of
from experiments.reports.table import Column, Row, Table, show
from experiments.running.terminal import make_console
from experiments.scenarios.options import BenchOptions
from robots.checks import require_between, require_one_of
from robots.errors import ConfigError
from robots.messages import Array
from safety.barriers.rows import HalfSpaces
from safety.filters.results import RELAXED, FilterResult, FilterStatus
from safety.filters.safety_filter import FILTERS, KINDS

STAGES = ("kinematics", "obstacles", "rows", "solve")
"""What is timed of a tick: the robot's kinematics, handing over the obstacles, barrier rows, the filter itself."""

TICKS = 300
"""Ticks to measure if not said otherwise."""

WARM_UP = 20
"""Ticks before them that are not counted."""

LEGEND = """solve: the filter itself; total: with the robot's kinematics, the obstacles handed over and the rows;
each the median, and the 99th percentile. changed: ticks on which the filter did not return the nominal input.
violated: ticks on which it violates a condition of its own though all could be met (r-SSA trades, PFM and SMA push;
the others guarantee not to). no input: ticks on which no input meets its conditions. failed: ticks without an answer,
with one beyond the bounds, or on which a guarantee is broken.
feasible: obstacles keep away and only states are taken where hard CBF and SSA can be met, most of them with SSA at
work. infeasible: two of five obstacles press from all sides, or where there are none the margin of self-collision is
0.1 m, more than shoulder and elbow are apart; only states are taken where hard SSA cannot be met."""

GUARANTEEING = ("qp", "two_phase")
"""Resolutions that meet all conditions wherever that is possible; the others trade or push."""


@dataclass(frozen=True, slots=True)
class Figures:
    """What one filter did on one sequence.

    Attributes:
        median_us: of each of ``STAGES`` and of their ``total`` [us].
        p99_us: likewise, 99th percentile [us].
        failures: ticks without an answer (status ``FAILED``), with one beyond the bounds, or, for the filters that
            guarantee all conditions, with a violation where all could be met.
        violations: ticks on which some condition is violated although all could be met, whatever the filter guarantees.
        infeasible_fraction: of the ticks, where no input meets this filter's conditions.
        statuses: number of ticks by status.
    """

    median_us: dict[str, float]
    p99_us: dict[str, float]
    failures: int
    violations: int
    infeasible_fraction: float
    statuses: dict[str, int]


@dataclass(frozen=True, slots=True)
class Cell:
    """One sequence: its size, its scene, and the figures by filter."""

    rows: int
    variables: int
    scene: str
    filters: dict[str, Figures]


def bench_filters(options: BenchOptions) -> int:
    """Measure every filter on every sequence and print the tables; returns 0."""
    ticks = TICKS if options.ticks is None else options.ticks
    require_between("ticks", ticks, 10, 100_000)
    filters = FILTERS if options.filters is None else options.filters
    check_filters(filters)
    console = make_console()
    cells = []
    with console.status("preparing (the first run compiles its kernels, which takes some 10 seconds)") as status:
        for cell in measure(filters, ticks):
            cells.append(cell)
            status.update(f"{cell.rows} rows, {cell.variables} variables, {cell.scene}: done")
            if len(cells) % len(SCENES) == 0:
                show(table(cells[-len(SCENES) :]), console)
    console.print(" ".join(LEGEND.split()), soft_wrap=False)
    machine = f"{platform.machine()}, {os.cpu_count()} processors, Python {platform.python_version()}"
    console.print(f"{ticks} ticks each; {machine}")
    if options.out is not None:
        report = {"ticks": ticks, "machine": machine, "cells": [asdict(c) for c in cells]}
        options.out.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    return 0


def check_filters(names: Sequence[str]) -> None:
    """Raise :class:`ConfigError` unless these are one or more different filters."""
    for name in names:
        require_one_of("filters", name, FILTERS)
    if not names or len(set(names)) < len(names):
        raise ConfigError("filters", list(names), "one or more different ones of " + ", ".join(FILTERS))


def measure(filters: Sequence[str], ticks: int) -> Iterator[Cell]:
    """One cell after the other: every number of rows and of variables, ``SCENES`` in turn.

    Args:
        filters: names.
        ticks: to measure of each.
    """
    for n_rows in OBSTACLES:
        for nv in BASES:
            for scene in SCENES:
                yield Cell(n_rows, nv, scene, measure_cell(n_rows, nv, scene, filters, ticks))


def measure_cell(n_rows: int, nv: int, scene: str, filters: Sequence[str], ticks: int) -> dict[str, Figures]:
    """Figures by filter on one sequence of ``ticks``; see :class:`experiments.benchmarks.filter_scenes.Problem`."""
    problem = Problem(n_rows, nv, scene)
    moments = record(problem, scene, WARM_UP + ticks)
    # once for all filters: a collection takes longer than a short replay
    gc.collect()
    gc.disable()
    try:
        replays = {name: replay(problem, moments, name) for name in filters}
    finally:
        gc.enable()
    counted = {name: results[WARM_UP:] for name, (_, results) in replays.items()}
    verdicts = judge(problem, moments[WARM_UP:], counted)
    return {name: _figures(times[WARM_UP:], verdicts[name]) for name, (times, _) in replays.items()}


def replay(problem: Problem, moments: Sequence[Moment], name: str) -> tuple[Array, list[FilterResult]]:
    """A new filter over all moments, as it would run in a controller.

    Returns:
        Times (ticks, len(STAGES)) [s], and the results.
    """
    safety_filter = problem.filter(name)
    second_order = safety_filter.settings.order == 2
    times = np.zeros((len(moments), len(STAGES)))
    results = []
    for i, moment in enumerate(moments):
        nominal = moment.u_des if second_order else moment.v_des
        start = perf_counter()
        problem.move(moment, second_order)
        moved = perf_counter()
        problem.set_obstacles(moment)
        seen = perf_counter()
        rows = problem.barriers.evaluate(problem.kin, second_order)
        evaluated = perf_counter()
        result = safety_filter.apply(rows, nominal, velocity=moment.v)
        solved = perf_counter()
        times[i] = moved - start, seen - moved, evaluated - seen, solved - evaluated
        results.append(result)
    return times, results


class Verdict:
    """Counts over one filter's answers; see :class:`Figures`."""

    def __init__(self, name: str, bound: Array) -> None:
        """``bound`` (nv,) is that of the filter ``name``."""
        self.statuses = dict.fromkeys((status.name.lower() for status in FilterStatus), 0)
        self.ticks = self.failures = self.violations = self.infeasible = 0
        self._bound = bound
        self._guarantees = KINDS[name].resolution.name in GUARANTEEING

    def add(self, result: FilterResult, spaces: HalfSpaces | None, can_hold: bool) -> None:
        """Count one answer, given its conditions (``None``: no filter, nothing is guaranteed)."""
        self.ticks += 1
        self.statuses[result.status.name.lower()] += 1
        self.infeasible += not can_hold
        if spaces is None:
            return
        short = (spaces.A @ result.v < spaces.b - RELAXED)[spaces.active].any()
        outside = (np.abs(result.v) > self._bound).any()
        violated = bool(can_hold and short)
        self.violations += violated
        self.failures += bool(result.status == FilterStatus.FAILED or outside or (violated and self._guarantees))


def judge(problem: Problem, moments: Sequence[Moment], results: dict[str, list[FilterResult]]) -> dict[str, Verdict]:
    """Check every answer against its own conditions, evaluated anew, and against a solver that sees all rows."""
    verdicts = {name: Verdict(name, problem.bound(name)) for name in results}
    # filters that share their conditions share the answer whether these can hold
    solvers = {_conditions_of(name): Solvable(problem.n_rows, problem.bound(name)) for name in results}
    for i, moment in enumerate(moments):
        rows = problem.rows(moment, second_order=True)
        can_hold: dict[object, bool] = {}
        for name, verdict in verdicts.items():
            spaces, shared = problem.conditions(name, rows, moment.v), _conditions_of(name)
            if shared not in can_hold:
                can_hold[shared] = solvers[shared](spaces)
            verdict.add(results[name][i], spaces, can_hold[shared])
    return verdicts


def _conditions_of(name: str) -> tuple[object, ...]:
    kind = KINDS[name]
    return kind.condition, tuple(kind.margins.values()), kind.orders


def _figures(times: Array, verdict: Verdict) -> Figures:
    columns = dict(zip(STAGES, times.T, strict=True)) | {"total": times.sum(axis=1)}
    return Figures(
        {stage: 1e6 * float(np.median(t)) for stage, t in columns.items()},
        {stage: 1e6 * float(np.percentile(t, 99)) for stage, t in columns.items()},
        verdict.failures,
        verdict.violations,
        verdict.infeasible / verdict.ticks,
        verdict.statuses,
    )


def table(cells: Sequence[Cell]) -> Table:
    """The figures of one number of rows and of variables, one scene below the other."""
    headings = ("solve", "p99", "total", "p99", "changed", "violated", "no input", "failed")
    rows = []
    for cell in cells:
        rows.append(Row((cell.scene,), bold=True))
        rows += [Row((f" {KINDS[name].title}", *_cells(figures))) for name, figures in cell.filters.items()]
    return Table((Column("filter", words=True), *map(Column, headings)), tuple(rows), _title(cells))


def _cells(figures: Figures) -> tuple[str, ...]:
    times = (side[stage] for stage in ("solve", "total") for side in (figures.median_us, figures.p99_us))
    ticks = sum(figures.statuses.values())
    changed = 1 - figures.statuses["unchanged"] / ticks
    fractions = (changed, figures.violations / ticks, figures.infeasible_fraction)
    return (*(f"{t:.0f}" for t in times), *(f"{100 * fraction:.0f} %" for fraction in fractions), str(figures.failures))


def _title(cells: Sequence[Cell]) -> str:
    """Size, and the stages that all filters share: medians over the filters of one order."""
    size = f"{cells[0].rows} rows, {cells[0].variables} variables (us)"
    for order, words in ((1, "velocity"), (2, "acceleration")):
        medians = [f.median_us for c in cells for n, f in c.filters.items() if order_of(n) == order]
        if medians:
            parts = (f"{stage} {np.median([m[stage] for m in medians]):.0f}" for stage in STAGES[:-1])
            size += f"\n{words} filters: " + ", ".join(parts)
    return size
