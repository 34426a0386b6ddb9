"""Benchmark of what a tick costs against the number of barrier rows and of joints."""

import json
import os
import platform
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace

import numpy as np

from experiments.benchmarks.worst import Figures, checked_robots, play
from experiments.benchmarks.worst_course import Course, undisturbed
from experiments.benchmarks.worst_scenes import Scene
from experiments.reports.table import Column, Row, Table, show
from experiments.running.terminal import make_console
from experiments.scenarios.options import BenchOptions
from robots.checks import require_between
from robots.description import Body, CollisionShape, Posture, RobotDescription
from robots.kinematics import Kinematics
from safety.barriers.barrier import CollisionBodies

TICKS = 3000
"""Ticks of each size if not said otherwise."""

SIZES = (979, 3000)
"""Least numbers of rows that spheres around the robot make up, beside those that it has by itself."""

AROUND = 1.5
"""How far from the left hand the spheres are [m]: near enough to count, too far to be in the way."""

LOCKED = ("waist_roll", "waist_pitch", "wrist_pitch", "wrist_yaw")
"""Parts of the names of joints that the G1's edition of 23 joints does not have."""


def bench_rows(options: BenchOptions) -> int:
    """Measure every robot, fewer joints where they have some of ``LOCKED``, and every size; print the table; 0."""
    ticks = TICKS if options.ticks is None else options.ticks
    require_between("ticks", ticks, 100, 1_000_000)
    robots = [variant for robot in checked_robots(options) for variant in with_fewer_joints(robot)]
    console, found = make_console(), []
    for robot in robots:
        with console.status(f"{robot.title}: {len(robot.joints)} joints"):
            starts = undisturbed(robot, options)
            for case, scene in cases(robot):
                found.append((len(robot.joints), play([Course(case, options, scene, starts)], ticks)))
    show(table(found, f"one tick over {ticks} ticks, filter {options.filter} [us]"), console)
    console.print(f"{platform.machine()}, {os.cpu_count()} processors, Python {platform.python_version()}")
    if options.out is not None:
        out = [{"joints": joints, **asdict(figures)} for joints, figures in found]
        options.out.write_text(json.dumps(out, indent=2) + "\n", encoding="utf-8")
    return 0


def cases(robot: RobotDescription) -> Iterator[tuple[RobotDescription, Scene]]:
    """The robot with every capsule a sphere, as it is, and among so many spheres as each of ``SIZES`` needs."""
    yield with_spheres(robot), Scene(f"{robot.name}, bodies as spheres", ())
    yield robot, Scene(robot.name, ())
    kin = Kinematics(robot)
    bodies = int(CollisionBodies(kin).is_movable.sum())
    own = Course(robot, BenchOptions("rows"), Scene("", ())).controller.barriers.size
    for size in SIZES:
        count = max(0, -(-(size - own) // bodies))
        name = f"{robot.name}, {count} spheres around"
        yield robot, Scene(name, ("sphere",) * count, every=10**9, spread=AROUND, layout="shell")


def with_fewer_joints(robot: RobotDescription) -> list[RobotDescription]:
    """The robot with the joints of ``LOCKED`` fixed at zero, if it has some, and the robot itself."""
    kept = np.array([not any(part in name for part in LOCKED) for name in robot.joint_names])
    if kept.all() or robot.name != "g1":
        return [robot]
    names = [n for n, keep in zip(robot.joint_names, kept, strict=True) if not keep]
    bodies = tuple(_locked(body, names) for body in robot.bodies)
    postures = {k: Posture(p.base_height, p.joints[kept]) for k, p in robot.postures.items()}
    return [replace(robot, bodies=bodies, postures=postures), robot]


def _locked(body: Body, names: Sequence[str]) -> Body:
    if body.joint is None or body.joint.name not in names:
        return body
    return replace(body, joint=replace(body.joint, axis=np.zeros(3)))


def with_spheres(robot: RobotDescription) -> RobotDescription:
    """The robot with a sphere in the middle of every capsule in its place: one row a pair."""
    return replace(robot, collisions=tuple(_sphere(shape) for shape in robot.collisions))


def _sphere(shape: CollisionShape) -> CollisionShape:
    middle = 0.5 * (shape.start + shape.end)
    return replace(shape, start=middle, end=middle)


def table(found: Sequence[tuple[int, Figures]], title: str) -> Table:
    """One line per robot and size [us]."""
    headings = ("joints", "rows", "median", "p99", "p99.9", "rows", "safety_qp", "others")
    rows = []
    for joints, f in found:
        stages = {name: 1e3 * median for name, (median, _) in f.stages_ms.items()}
        others = sum(t for name, t in stages.items() if name not in ("rows", "safety_qp"))
        whole = (1e3 * x for x in (f.wall.median_ms, f.wall.p99_ms, f.wall.p999_ms))
        times = (*whole, stages["rows"], stages["safety_qp"], others)
        rows.append(Row((f.sequence, str(joints), str(f.rows), *(f"{t:.0f}" for t in times))))
    return Table((Column("robot", words=True), *map(Column, headings)), tuple(rows), title)
