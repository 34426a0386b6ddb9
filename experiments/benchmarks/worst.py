"""Benchmark of the tick at its worst: adversarial sequences through supervisor, controller and filter; what is late."""

import gc
import json
import os
import platform
import resource
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from time import perf_counter, thread_time
from typing import Literal

import numpy as np

from controllers.whole_body.controller import STAGES
from experiments.benchmarks.worst_course import Course, undisturbed
from experiments.benchmarks.worst_scenes import SCENES
from experiments.reports.table import Column, Row, Table, show
from experiments.running.terminal import make_console
from experiments.scenarios.options import BenchOptions
from robots.checks import require_between
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.loader import load_robot
from robots.messages import Array, Mask
from safety.filters.registry import filter_kind
from safety.filters.safety_filter import FilterStatus

TICKS = 100_000
"""Ticks of all sequences of a robot together, if not said otherwise."""

WARM_UP = 50
"""Ticks of each sequence before those that count."""

EPISODE = 250
"""After as many ticks the robot is put back into a state of the undisturbed run."""

PLAYS = 2
"""How often each sequence is played, tick for tick the same: what only one of them waits for is not the code's own."""

LATE = 2e-3
"""A tick that takes longer is late [s]: the period at 500 Hz."""

CLOCKS = ("wall", "CPU", "own")
"""What times are of, see ``LEGEND``."""

STATUSES = tuple(s.name.lower() for s in FilterStatus if s is not FilterStatus.UNSAFE)
"""What a tick's filter may say, as counted."""

LEGEND = """wall: of a whole tick by the clock on the wall [ms]. CPU: by the time that the thread had a processor: what
the operating system gave to others is not in it. own: CPU, of each tick the shorter one of two plays of the same
sequence: what the machine did to one of them is not in it either. late: ticks longer than 2 ms; in a row: most of them
one after another. gc: collections of Python's collector that began within a tick; the sequence's own objects set them
off too. kept: containers more after a tick than before it, on average: what a tick itself adds to what sets them off.
heap: blocks more in use after the last tick than after the first that counts. RSS: by how much the largest memory of
the process grew meanwhile [MB]."""


@dataclass(frozen=True, slots=True)
class Times:
    """What the ticks of one sequence took.

    Attributes:
        median_ms: of the ticks [ms].
        p99_ms: 99th percentile.
        p999_ms: 99.9th percentile.
        max_ms: the longest.
        late: ticks longer than ``LATE``.
        in_a_row: most late ones one after another.
    """

    median_ms: float
    p99_ms: float
    p999_ms: float
    max_ms: float
    late: int
    in_a_row: int

    @staticmethod
    def of(seconds: Array) -> "Times":
        """The figures of ticks that took ``seconds`` (n,) [s]."""
        late = seconds > LATE
        median, p99, p999, longest = (1e3 * float(x) for x in np.percentile(seconds, [50, 99, 99.9, 100]))
        return Times(median, p99, p999, longest, int(late.sum()), longest_run(late))


@dataclass(frozen=True, slots=True)
class Figures:
    """What came of one sequence.

    Attributes:
        sequence: its name.
        rows: number of barrier rows.
        ticks: number of ticks.
        wall: by the clock on the wall.
        cpu: by the time that the thread had a processor.
        own: the same, of each tick the shortest of several plays of the sequence.
        stages_ms: median and 99.9th percentile of each stage, and of what the supervisor adds, by processor time [ms].
        statuses: number of ticks by what the filter said.
        spent: ticks on which the filter's answer is the best that was found before a budget was spent.
        unsolved: ticks on which DynWBC had no answer.
        stops: how often the supervisor stopped the robot; it was then put back.
        collections: of Python's collector that began within a tick, set off by what the sequence itself makes too.
        kept: containers that the collector knows of, more after a tick than before it, on average: what a tick adds to
            the number that sets it off.
        heap_blocks: blocks of memory more in use at the end than at the beginning.
        rss_mb: growth of the largest resident memory [MB].
    """

    sequence: str
    rows: int
    ticks: int
    wall: Times
    cpu: Times
    own: Times
    stages_ms: dict[str, tuple[float, float]]
    statuses: dict[str, int]
    spent: int
    unsolved: int
    stops: int
    collections: int
    kept: float
    heap_blocks: int
    rss_mb: float


class Collections:
    """Counts the garbage collector's collections that begin while ``counting``.

    As for a robot that is driven, what is there when the ticks begin is out of the collector's sight meanwhile
    (``gc.freeze``): to go through all that a process has imported takes it milliseconds.
    """

    def __init__(self) -> None:
        self.counting, self.count = False, 0

    def __call__(self, phase: Literal["start", "stop"], info: dict[str, int]) -> None:
        """What the collector calls."""
        self.count += self.counting and phase == "start"

    def __enter__(self) -> "Collections":
        gc.collect()
        gc.freeze()
        gc.callbacks.append(self)
        return self

    def __exit__(self, *_: object) -> None:
        gc.callbacks.remove(self)
        gc.unfreeze()


class Log:
    """What is kept of every tick, in arrays that are there before the first."""

    def __init__(self, ticks: int) -> None:
        # written once, so that their memory is taken before that of the ticks is looked at
        self.wall, self.cpu = np.full(ticks, np.nan), np.full(ticks, np.nan)
        self.stages = np.full((ticks, len(STAGES)), np.nan)
        self.status = np.full(ticks, -1, dtype=np.int8)
        self.kept = np.full(ticks, np.nan)
        self.unsolved, self.spent = np.zeros(ticks, dtype=bool), np.zeros(ticks, dtype=bool)
        self.stopped = np.zeros(ticks, dtype=bool)

    def statuses(self) -> dict[str, int]:
        """Number of ticks by what the filter said."""
        return {s.name.lower(): int((self.status == i).sum()) for i, s in enumerate(FilterStatus)}

    def stages_ms(self) -> dict[str, tuple[float, float]]:
        """See :attr:`Figures.stages_ms`; ticks of a robot that was stopped have none."""
        columns = dict(zip(STAGES, self.stages.T, strict=True)) | {"supervisor": self.cpu - self.stages.sum(axis=1)}
        return {name: _median_and_high(1e3 * column[np.isfinite(column)]) for name, column in columns.items()}


def _median_and_high(values: Array) -> tuple[float, float]:
    """Median and 99.9th percentile; not numbers where there are no values."""
    if not values.size:
        return float("nan"), float("nan")
    median, high = np.percentile(values, [50, 99.9])
    return float(median), float(high)


def play(courses: Sequence[Course], ticks: int) -> Figures:
    """Run ``WARM_UP`` and then ``ticks`` ticks of each of these courses; the figures of those of the first.

    Raises:
        RuntimeError: the courses are not the same sequence, made anew for each play.
    """
    (log, memory, blocks, collections), *others = [play_once(course, ticks) for course in courses]
    if any(not np.array_equal(other.status, log.status) for other, *_ in others):
        raise RuntimeError(f"{courses[0].adversary.scene.name}: a second play went another way than the first")
    return Figures(
        courses[0].adversary.scene.name,
        courses[0].controller.barriers.size,
        ticks,
        Times.of(log.wall),
        Times.of(log.cpu),
        Times.of(np.min([log.cpu, *(other.cpu for other, *_ in others)], axis=0)),
        log.stages_ms(),
        log.statuses(),
        int(log.spent.sum()),
        int(log.unsolved.sum()),
        int(log.stopped.sum()),
        collections,
        float(np.nanmean(log.kept)),
        blocks,
        memory,
    )


def play_once(course: Course, ticks: int) -> tuple[Log, float, int, int]:
    """What is kept of the ticks; growth of memory [MB] and of blocks in use, and collections within ticks."""
    with Collections() as collections:
        _run(course, Log(WARM_UP), collections)
        log = Log(ticks)
        blocks, memory, collections.count = heap_blocks(), resident_mb(), 0
        _run(course, log, collections)
        return log, resident_mb() - memory, heap_blocks() - blocks, collections.count


def _run(course: Course, log: Log, collections: Collections) -> None:
    """As many ticks as the log has room for; a robot that is stopped is put back at once."""
    order = list(FilterStatus)
    for i in range(log.wall.size):
        if i and i % EPISODE == 0:
            course.restart()
        state, reference, obstacles = course.prepare()
        kept, before = gc.get_count()[0], collections.count
        collections.counting = True
        used, began = thread_time(), perf_counter()
        result = course.supervisor.tick(state, reference, obstacles)[1]
        log.wall[i], log.cpu[i] = perf_counter() - began, thread_time() - used
        collections.counting = False
        if collections.count == before:
            log.kept[i] = gc.get_count()[0] - kept
        if result is not None:
            log.stages[i], log.status[i] = result.stage_seconds, order.index(result.safety.status)
            log.unsolved[i], log.spent[i] = result.dynwbc.status != "optimal", result.safety.spent
            course.follow(result)
        if course.supervisor.fading:
            log.stopped[i] = True
            course.restart()


def longest_run(late: Mask) -> int:
    """How many late ones, of ``late`` (n,) bool, follow each other at most."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], late, [False]])))
    return int(np.diff(edges)[::2].max(initial=0))


def heap_blocks() -> int:
    """Blocks of memory in use by Python's objects, without what it keeps for reuse."""
    # a full collection also empties the lists of free tuples and the like, which fill up to a bound first
    gc.collect()
    return sys.getallocatedblocks()


def resident_mb() -> float:
    """Largest resident memory that the process has had so far [MB]."""
    unit = 1.0 if sys.platform == "darwin" else 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def bench_worst(options: BenchOptions) -> int:
    """Play every sequence with every robot and print the tables; returns 0."""
    ticks = TICKS if options.ticks is None else options.ticks
    require_between("ticks", ticks, 100, 100_000_000)
    robots = checked_robots(options)
    console = make_console()
    found: dict[str, list[Figures]] = {}
    for robot in robots:
        with console.status(f"{robot.title}: an undisturbed run") as status:
            starts = undisturbed(robot, options)
            found[robot.name] = []
            for scene in SCENES:
                status.update(f"{robot.title}: {scene.name}")
                courses = [Course(robot, options, scene, starts) for _ in range(PLAYS)]
                found[robot.name].append(play(courses, ticks // len(SCENES)))
        for table in tables(found[robot.name], f"{robot.title}, filter {options.filter}"):
            show(table, console)
    console.print(" ".join(LEGEND.split()), soft_wrap=False)
    console.print(f"{platform.machine()}, {os.cpu_count()} processors, Python {platform.python_version()}")
    if options.out is not None:
        out = {name: [asdict(f) for f in figures] for name, figures in found.items()}
        options.out.write_text(json.dumps(out, indent=2) + "\n", encoding="utf-8")
    return 0


def checked_robots(options: BenchOptions) -> list[RobotDescription]:
    """The robots to measure.

    Raises:
        ConfigError: there are none, or there is no such filter.
    """
    filter_kind(options.filter)
    if not options.robots:
        raise ConfigError("robots", options.robots, "at least one robot")
    return [load_robot(name) for name in options.robots]


def tables(figures: Sequence[Figures], title: str) -> tuple[Table, Table]:
    """Times, and what came of the ticks."""
    heads = ("p99.9", "max", "late", "in a row")
    times = ("rows", "wall\nmedian", "wall\np99", *(f"{clock}\n{head}" for clock in CLOCKS for head in heads))
    events = (*STATUSES, "spent", "no torques", "stops", "gc", "kept", "heap", "RSS")
    sequence = Column("sequence", words=True)
    total = sum(f.ticks for f in figures)
    return (
        Table((sequence, *map(Column, times)), tuple(map(_times_row, figures)), f"{title}: {total} ticks"),
        Table((sequence, *map(Column, events)), tuple(map(_events_row, figures))),
    )


def _times_row(f: Figures) -> Row:
    cells = [f.sequence, str(f.rows), f"{f.wall.median_ms:.2f}", f"{f.wall.p99_ms:.2f}"]
    for t in (f.wall, f.cpu, f.own):
        cells += [f"{t.p999_ms:.2f}", f"{t.max_ms:.2f}", str(t.late), str(t.in_a_row)]
    return Row(tuple(cells))


def _events_row(f: Figures) -> Row:
    counts = (*(f.statuses[s] for s in STATUSES), f.spent, f.unsolved, f.stops, f.collections)
    return Row((f.sequence, *map(str, counts), f"{f.kept:.1f}", str(f.heap_blocks), f"{f.rss_mb:.1f}"))
