"""Benchmark of the tick at its worst: adversarial sequences through supervisor, controller and filter; what is late."""

import gc
import json
import os
import platform
import resource
import sys
from dataclasses import asdict, dataclass
from time import perf_counter, thread_time
from typing import Any, Literal

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from controllers.config import controller_config
from controllers.motions import HandCircles, circle_settings
from controllers.reference import WholeBodyReference, reference_here
from controllers.supervisor import Supervisor
from controllers.whole_body import STAGES, TickResult, WholeBodyController
from experiments.console import make_console
from experiments.hand_tracking import start_posture
from experiments.options import BenchOptions
from experiments.worst_scenes import SCENES, Adversary, Scene
from robots.checks import require_between, require_one_of
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array, Indices, RobotState
from robots.pinocchio_model import standing_configuration
from safety.barriers import CollisionBodies, ObstacleBarrier
from safety.filters import FILTERS, FilterStatus
from sims.kinematic import KinematicPlant

TICKS = 100_000
"""Ticks of all sequences of a robot together, if not said otherwise."""

WARM_UP = 50
"""Ticks of each sequence before those that count."""

EPISODE = 250
"""After as many ticks the robot is put back into a state of the undisturbed run."""

STARTS = 60
"""States of that run, evenly over one turn of the hands' circles."""

LATE = 2e-3
"""A tick that takes longer is late [s]: the period at 500 Hz."""

STATUSES = tuple(s.name.lower() for s in FilterStatus if s is not FilterStatus.UNSAFE)
"""What a tick's filter may say, as counted."""

LEGEND = """median to max: of a whole tick by the clock on the wall [ms]. CPU: the same by the time that the thread had a
processor: what the operating system gave to others is not in it. late: ticks longer than 2 ms; in a row: most of them
one after another. gc: collections of Python's collector that began within a tick. heap: blocks more in use after the
last tick than after the first that counts. RSS: by how much the largest memory of the process grew meanwhile [MB]."""


@dataclass(frozen=True, slots=True)
class Start:
    """Where the robot is put: configuration ``q`` (nq,), and ``t`` [s], how long its hands have been on their way."""

    q: Array
    t: float


@dataclass(frozen=True, slots=True)
class Figures:
    """What the ticks of one sequence took.

    Attributes:
        sequence: its name.
        rows: number of barrier rows.
        ticks: number of ticks.
        median_ms: by the clock on the wall, as the next three [ms].
        p99_ms: 99th percentile.
        p999_ms: 99.9th percentile.
        max_ms: the longest.
        cpu_p999_ms: by the processor time of the thread, as the next [ms].
        cpu_max_ms: the longest.
        late: ticks longer than ``LATE`` by the clock.
        cpu_late: by processor time.
        in_a_row: most late ones one after another, by the clock.
        cpu_in_a_row: by processor time.
        statuses: number of ticks by what the filter said.
        unsolved: ticks on which DynWBC had no answer.
        stops: how often the supervisor stopped the robot; it was then put back.
        collections: of Python's collector that began within a tick.
        heap_blocks: blocks of memory more in use at the end than at the beginning.
        rss_mb: growth of the largest resident memory [MB].
        stages_ms: 99.9th percentile of each stage, and of what the supervisor adds, by processor time [ms].
    """

    sequence: str
    rows: int
    ticks: int
    median_ms: float
    p99_ms: float
    p999_ms: float
    max_ms: float
    cpu_p999_ms: float
    cpu_max_ms: float
    late: int
    cpu_late: int
    in_a_row: int
    cpu_in_a_row: int
    statuses: dict[str, int]
    unsolved: int
    stops: int
    collections: int
    heap_blocks: int
    rss_mb: float
    stages_ms: dict[str, float]


class Collections:
    """Counts the garbage collector's collections that begin while ``counting``."""

    def __init__(self) -> None:
        self.counting, self.count = False, 0

    def __call__(self, phase: Literal["start", "stop"], info: dict[str, int]) -> None:
        """What the collector calls."""
        self.count += self.counting and phase == "start"

    def __enter__(self) -> "Collections":
        gc.callbacks.append(self)
        return self

    def __exit__(self, *_: object) -> None:
        gc.callbacks.remove(self)


class Course:
    """A robot that follows its filtered velocity exactly, tick by tick, while an adversary plays one scene around it.

    Args:
        robot: the description, with ``[tuning.hand_tracking]``.
        options: filter and solver are read.
        scene: what happens.
        starts: states to put the robot into; ``None`` before there are any: it then starts in its posture.
        seed: of all that is drawn.
    """

    def __init__(
        self,
        robot: RobotDescription,
        options: BenchOptions,
        scene: Scene,
        starts: tuple[Start, ...] | None = None,
        seed: int = 0,
    ) -> None:
        config = controller_config(robot, filter=options.filter, dynwbc_solver=options.solver)
        kin = Kinematics(robot)
        q = standing_configuration(robot, start_posture(robot))
        kin.update(q, np.zeros(kin.nv))
        bodies = CollisionBodies(kin)
        bodies.place(kin)
        hand = kin.frame_placement(kin.frame_id(robot.roles["left_hand"]))[1]
        nearest = nearest_bodies(bodies, hand)[: scene.nearest or None]
        self._spots = nearest_bodies(bodies, hand)
        names = [bodies.names[i] for i in nearest]

        def own_barrier(own: Kinematics) -> list[ObstacleBarrier]:
            return [ObstacleBarrier(CollisionBodies(own), scene.kinds, names)]

        announced = () if scene.nearest else scene.kinds
        extra = own_barrier if scene.nearest else None
        self.controller = WholeBodyController(robot, config, True, announced, thread_time, extra)
        self.reference: WholeBodyReference = reference_here(kin, with_hands=True)
        assert self.reference.hands is not None
        left, right = self.reference.hands
        self._motion = HandCircles(circle_settings(robot), (left.position.copy(), right.position.copy()))
        self._com = self.reference.com.position.copy()
        self._starts = starts or (Start(q, 0.0),)
        self._bodies, self._dt = CollisionBodies(self.controller.kin), config.dt
        self._rng = np.random.default_rng(seed)
        self.adversary = Adversary(scene, config.dt, self._rng)
        self.stamp = 0.0
        self.restart()

    def restart(self) -> None:
        """Put the robot into one of the states, at rest, under a new supervisor."""
        start = self._starts[self._rng.integers(len(self._starts))]
        self.plant, self.phase = KinematicPlant(self.controller.kin, start.q), start.t
        zero = np.zeros(self.controller.kin.nv - 6)
        self.controller.reset(RobotState(self.plant.q, self.plant.v, zero, self.stamp))
        self.supervisor, self._tau = Supervisor(self.controller), zero
        self.adversary.restart()

    def prepare(self) -> tuple[RobotState, WholeBodyReference, list[Any]]:
        """What the next tick is given."""
        self._bodies.place(self.controller.kin)
        obstacles = self.adversary.obstacles(self._bodies.origin[self._spots])
        self.reference.com.position = self._com
        self._motion.apply(self.reference, self.phase)
        self.adversary.retarget(self.reference)
        return RobotState(self.plant.q, self.plant.v, self._tau, self.stamp), self.reference, obstacles

    def follow(self, result: TickResult) -> None:
        """Move on as the tick decided."""
        self.plant.step(result.safety.v, self._dt)
        self._tau = result.command.tau
        self.stamp, self.phase = self.stamp + self._dt, self.phase + self._dt


def nearest_bodies(bodies: CollisionBodies, point: Array) -> Indices:
    """Indices of the bodies by the distance of their starts from ``point`` (3,), those first that move."""
    distance = np.linalg.norm(bodies.origin - point, axis=1)
    return np.argsort(np.where(bodies.carried, distance, np.inf))


def undisturbed(robot: RobotDescription, options: BenchOptions) -> tuple[Start, ...]:
    """States of a closed-loop run with hands on their circles and nothing else around."""
    course = Course(robot, options, Scene("undisturbed", ()))
    ticks = round(circle_settings(robot).period / course.controller.config.dt)
    starts = []
    for i in range(ticks):
        result = course.supervisor.tick(*course.prepare())[1]
        assert result is not None
        course.follow(result)
        if i % max(1, ticks // STARTS) == 0:
            starts.append(Start(course.plant.q, course.phase))
    return tuple(starts)


def play(course: Course, ticks: int) -> Figures:
    """Run ``WARM_UP`` and then ``ticks`` ticks; the figures of those."""
    # written once, so that their memory is there before that of the ticks is looked at
    wall, cpu, stages = (np.full(shape, np.nan) for shape in (ticks, ticks, (ticks, len(STAGES))))
    statuses, unsolved, stops = np.zeros(len(FilterStatus), dtype=int), 0, 0
    order = list(FilterStatus)
    blocks, memory = heap_blocks(), resident_mb()
    with Collections() as collections:
        for i in range(-WARM_UP, ticks):
            if i == 0:
                blocks, memory, stops, unsolved = heap_blocks(), resident_mb(), 0, 0
                collections.count = 0
                statuses[:] = 0
            if i % EPISODE == 0 and i > 0:
                course.restart()
            state, reference, obstacles = course.prepare()
            collections.counting = True
            used, began = thread_time(), perf_counter()
            result = course.supervisor.tick(state, reference, obstacles)[1]
            took, used = perf_counter() - began, thread_time() - used
            collections.counting = False
            if i >= 0:
                wall[i], cpu[i] = took, used
            if result is not None:
                stages[i] = result.stage_seconds
                statuses[order.index(result.safety.status)] += 1
                unsolved += result.dynwbc.status != "optimal"
                course.follow(result)
            if course.supervisor.blind:
                stops += 1
                course.restart()
        blocks, memory = heap_blocks() - blocks, resident_mb() - memory
    said = dict(zip((s.name.lower() for s in order), (int(n) for n in statuses), strict=True))
    rows = course.controller.barriers.size
    return Figures(
        course.adversary.scene.name,
        rows,
        ticks,
        *_times(wall, cpu),
        said,
        unsolved,
        stops,
        collections.count,
        blocks,
        memory,
        _stages(cpu, stages),
    )


def _stages(cpu: Array, stages: Array) -> dict[str, float]:
    """``stages_ms`` of :class:`Figures`; ticks of a robot that was stopped have none."""
    columns = dict(zip(STAGES, stages.T, strict=True)) | {"supervisor": cpu - stages.sum(axis=1)}
    return {name: 1e3 * float(np.nanpercentile(column, 99.9)) for name, column in columns.items()}


def _times(wall: Array, cpu: Array) -> tuple[Any, ...]:
    """The fields of :class:`Figures` from ``median_ms`` to ``cpu_in_a_row``; ``wall`` and ``cpu`` (ticks,) [s]."""
    median, p99, p999 = (float(x) for x in 1e3 * np.percentile(wall, [50, 99, 99.9]))
    late, cpu_late = wall > LATE, cpu > LATE
    return (
        *(median, p99, p999, 1e3 * float(wall.max())),
        *(1e3 * float(np.percentile(cpu, 99.9)), 1e3 * float(cpu.max())),
        *(int(late.sum()), int(cpu_late.sum()), longest_run(late), longest_run(cpu_late)),
    )


def longest_run(late: Array) -> int:
    """How many late ones, of ``late`` (n,) bool, follow each other at most."""
    longest = run = 0
    for is_late in late.tolist():
        run = run + 1 if is_late else 0
        longest = max(longest, run)
    return longest


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
    require_between("ticks", ticks, 10 * len(SCENES), 100_000_000)
    require_one_of("filter", options.filter, FILTERS)
    robots = [load_robot(name) for name in options.robots]
    if not robots:
        raise ConfigError("robots", options.robots, "at least one robot")
    console = make_console()
    found: dict[str, list[Figures]] = {}
    for robot in robots:
        with console.status(f"{robot.title}: an undisturbed run") as status:
            starts = undisturbed(robot, options)
            found[robot.name] = []
            for scene in SCENES:
                status.update(f"{robot.title}: {scene.name}")
                found[robot.name].append(play(Course(robot, options, scene, starts), ticks // len(SCENES)))
        for table in tables(found[robot.name], f"{robot.title}, filter {options.filter}"):
            console.print(table)
    console.print(LEGEND)
    console.print(f"{platform.machine()}, {os.cpu_count()} processors, Python {platform.python_version()}")
    if options.out is not None:
        out = {name: [asdict(f) for f in figures] for name, figures in found.items()}
        options.out.write_text(json.dumps(out, indent=2) + "\n", encoding="utf-8")
    return 0


def tables(figures: list[Figures], title: str) -> tuple[Table, Table]:
    """Times, and what came of the ticks."""
    times = Table(title=f"{title}: {sum(f.ticks for f in figures)} ticks [ms]", box=SIMPLE_HEAD, title_justify="left")
    events = Table(box=SIMPLE_HEAD)
    heads = ("rows", "median", "p99", "p99.9", "max", "CPU p99.9", "CPU max", "late", "CPU late", "in a row", "CPU")
    for table, columns in ((times, heads), (events, (*STATUSES, "no torques", "stops", "gc", "heap", "RSS"))):
        table.add_column("sequence")
        for column in columns:
            table.add_column(column, justify="right")
    for f in figures:
        in_ms = (f.median_ms, f.p99_ms, f.p999_ms, f.max_ms, f.cpu_p999_ms, f.cpu_max_ms)
        counts = (f.late, f.cpu_late, f.in_a_row, f.cpu_in_a_row)
        times.add_row(f.sequence, str(f.rows), *(f"{x:.2f}" for x in in_ms), *map(str, counts))
        said = (f.statuses[s] for s in STATUSES)
        others = (f.unsolved, f.stops, f.collections, f.heap_blocks)
        events.add_row(f.sequence, *map(str, (*said, *others)), f"{f.rss_mb:.1f}")
    return times, events
