"""What holding velocity or acceleration for a step costs, on robots' own rows: bounds of
``safety.filters.conditions``."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from robots.description import RobotDescription
from robots.kinematics import Kinematics
from robots.messages import Array
from robots.pinocchio_model import standing_configuration
from safety.barriers.barrier_set import BarrierSet, CollisionBodies, ObstacleBarrier, standard_barriers
from safety.barriers.rows import FAMILIES, BarrierRows
from safety.filters.conditions import BarrierParameters, FamilyParameters
from safety.filters.safety_filter import KINDS, FilterSettings, FilterStatus, SafetyFilter
from safety.filters.second_order import ecbf_rows, index_rows
from safety.geometry.shapes import Obstacle

ALPHA = SLOPE = 20.0
ETA = 0.3
LAYER = 0.015
"""Of safe sets that are to act continuously [m, rad]."""

PUSH = 0.6
"""Rate at which the nominal velocity makes the pushed row fall [m/s, rad/s]."""

STEPS = (0.001, 0.002, 0.005, 0.010, 0.020)
PARTS = 4
"""Places along a step where the rates are looked at."""

PUSHED = ("joint_limit", "workspace", "self_collision", "obstacle")
SPEED = 0.5
"""At which a sphere comes towards the robot [m/s]."""

ROUNDING = 1e-8


@dataclass
class Course:
    """One closed-loop run of n rows.

    Attributes:
        h: shape (steps + 1, n).
        rate: shape (steps, n) rate of h at the start of each step.
        bend: shape (steps, n) c: the largest mean size of the second derivative along the step.
        fall: shape (steps, n) V: the largest rate of falling along the step.
        margin: shape (n,) d_min.
        row: the row that is pushed.
        family: the rows of its family.
    """

    h: Array
    rate: Array
    bend: Array
    fall: Array
    margin: Array
    row: int
    family: slice


def coming_sphere(kin: Kinematics) -> Obstacle:
    """A sphere before the body that reaches farthest to the front, moving back; ``kin`` has its geometry."""
    bodies = CollisionBodies(kin)
    bodies.place(kin)
    front = bodies.origin[bodies.origin[:, 0].argmax()]
    return Obstacle.sphere(front + np.array([0.3, 0.1, 0.05]), 0.08, np.array([-SPEED, 0.0, 0.0]))


def set_obstacle(barriers: BarrierSet, obstacle: Obstacle) -> None:
    next(b for b in barriers.barriers if isinstance(b, ObstacleBarrier)).set_obstacles([obstacle])


def run(
    robot: RobotDescription,
    name: str,
    family: str,
    dt: float,
    duration: float = 0.3,
    push: float = PUSH,
    layer: float = 0.0,
) -> Course:
    """Push the closest row of a family and hold each velocity for ``dt``; a sphere comes nearer meanwhile."""
    kin = Kinematics(robot)
    barriers = standard_barriers(kin, ("sphere",))
    values = FamilyParameters(alpha=ALPHA, slope=SLOPE, eta=ETA, layer=layer)
    parameters = BarrierParameters(**dict.fromkeys(FAMILIES, values))
    safety_filter = SafetyFilter(name, barriers.size, parameters, np.full(kin.nv, 100.0))
    q = standing_configuration(robot, "hands_front")
    kin.update_geometry(q)
    sphere = coming_sphere(kin)
    set_obstacle(barriers, sphere)
    cut, rows = barriers.slices[family], barriers.evaluate(kin)
    margin = parameters.margins(KINDS[name].margins)[rows.family]
    row = cut.start + int((rows.h - margin)[cut].argmin())
    # the family begins some steps of the push above where the filter wakes up, whatever the posture
    lift = margin[row] + 0.08 - rows.h[row]
    heights, rates, bends, falls = [], [], [], []
    for step in range(round(duration / dt)):
        kin.update_geometry(q)
        set_obstacle(barriers, sphere.after(step * dt))
        rows = barriers.evaluate(kin)
        h, jac = rows.h.copy(), rows.jac.copy()
        h[cut] += lift
        nominal = -push * jac[row] / (jac[row] @ jac[row])
        result = safety_filter.apply(replace(rows, h=h), nominal)
        assert result.status in {FilterStatus.UNCHANGED, FilterStatus.FILTERED}
        along = []
        for k in range(PARTS + 1):
            kin.update_geometry(kin.integrate(q, result.v, k * dt / PARTS))
            set_obstacle(barriers, sphere.after((step + k / PARTS) * dt))
            rows = barriers.evaluate(kin)
            along.append(rows.jac @ result.v + rows.dh_dt)
        slopes = [np.abs(along[k] - along[0]) / (k * dt / PARTS) for k in range(1, PARTS + 1)]
        heights.append(h)
        rates.append(along[0])
        bends.append(np.max(slopes, axis=0))
        falls.append(np.maximum(0.0, -np.min(along, axis=0)))
        q = kin.integrate(q, result.v, dt)
    kin.update_geometry(q)
    set_obstacle(barriers, sphere.after(round(duration / dt) * dt))
    last = barriers.evaluate(kin).h.copy()
    last[cut] += lift
    return Course(np.array([*heights, last]), np.array(rates), np.array(bends), np.array(falls), margin, row, cut)


def sound_rows(course: Course) -> Array:
    """Rows that start outside their margin."""
    return course.h[0] >= course.margin


@pytest.mark.parametrize("dt", STEPS)
@pytest.mark.parametrize("family", PUSHED)
def test_control_barriers_lose_at_most_half_the_bend_times_the_step_over_alpha(
    robot: RobotDescription, family: str, dt: float
) -> None:
    course = run(robot, "cbf", family, dt)
    rows, h = sound_rows(course), course.h
    assert (course.rate >= -ALPHA * (h[:-1] - course.margin) - ROUNDING).all()
    # one step
    lost = 0.5 * course.bend * dt**2 + ROUNDING * dt
    assert (h[1:] >= h[:-1] + dt * course.rate - lost - 1e-12)[:, course.row].all()
    assert (h[1:] >= (1 - ALPHA * dt) * h[:-1] - lost - 1e-12)[:, course.row].all()
    # all of them
    bound = course.margin - course.bend.max(axis=0) * dt / (2 * ALPHA) - ROUNDING
    assert (h >= bound)[:, rows].all()
    # the push arrives
    assert h[-1, course.family].min() < 0.02


@pytest.mark.parametrize("dt", STEPS)
@pytest.mark.parametrize("family", PUSHED)
def test_safe_sets_are_overshot_by_no_more_than_one_step(robot: RobotDescription, family: str, dt: float) -> None:
    course = run(robot, "ssa", family, dt)
    held = sound_rows(course) & (course.bend.max(axis=0) * dt <= 2 * ETA)
    assert held[course.row]
    bound = course.margin - dt * course.fall.max(axis=0) - ROUNDING
    assert (course.h >= bound)[:, held].all()
    # which the default margins allow for, up to 10 ms
    assert dt > 0.01 or (course.h >= 0)[:, held].all()
    # it does overshoot: a row is seen only inside its margin, and it comes back out of it
    inside = (course.h <= course.margin)[:, held]
    assert (course.h < course.margin)[:, course.family].any()
    assert not (inside[:-1] & (np.diff(course.h, axis=0)[:, held] <= 0)).any()


@pytest.mark.parametrize("dt", STEPS)
@pytest.mark.parametrize("family", PUSHED)
def test_with_a_layer_safe_sets_lose_what_control_barriers_of_its_slope_lose(
    robot: RobotDescription, family: str, dt: float
) -> None:
    course = run(robot, "ssa", family, dt, layer=LAYER)
    bend = course.bend.max(axis=0)
    held = sound_rows(course) & (bend * dt <= 2 * ETA)
    assert held[course.row]
    bound = course.margin - bend * dt * LAYER / (2 * ETA) - ROUNDING
    assert (course.h >= bound)[:, held].all()
    assert (bound >= course.margin - LAYER - ROUNDING)[held].all()
    # the push arrives
    assert (course.h[-1] - course.margin)[course.family].min() < 0.02


@pytest.mark.parametrize("dt", STEPS)
@pytest.mark.parametrize("family", PUSHED)
def test_sublevel_safe_sets_lose_one_step_or_what_control_barriers_lose(
    robot: RobotDescription, family: str, dt: float
) -> None:
    course = run(robot, "sss", family, dt)
    rows = sound_rows(course)
    one_step, bent = dt * course.fall.max(axis=0), course.bend.max(axis=0) * dt / (2 * SLOPE)
    assert (course.h >= course.margin - np.maximum(one_step, bent) - ROUNDING)[:, rows].all()
    # the default margins allow for that, up to 10 ms
    assert dt > 0.01 or (course.h >= 0)[:, rows].all()
    assert (course.h <= course.margin)[:, course.family].any()


@pytest.mark.parametrize("dt", STEPS)
@pytest.mark.parametrize("name", ["ssa", "sss"])
def test_an_obstacles_own_speed_counts(robot: RobotDescription, name: str, dt: float) -> None:
    """The robot stands still until the sphere is inside the margin: its speed alone carries it in."""
    course = run(robot, name, "obstacle", dt, push=0.0)
    # it comes in within a step, from outside: before that the robot does not move, and V is the sphere's speed
    first = int((course.h[:, course.row] <= course.margin[course.row]).argmax())
    assert first > 0
    assert 0.5 * SPEED < -course.rate[first - 1, course.row] <= SPEED
    depth = course.margin[course.row] - course.h[first, course.row]
    assert 0.0 <= depth <= dt * course.fall[:first, course.row].max() + ROUNDING
    assert (
        course.h[:, course.row] >= course.margin[course.row] - dt * course.fall[:, course.row].max() - ROUNDING
    ).all()


GAIN = 0.1
"""k of the index [s]."""

LAG = 0.05
"""Time in which the nominal acceleration brings the velocity to that of the push [s]."""


@dataclass
class IndexCourse:
    """One closed-loop run with accelerations.

    Attributes:
        index: of n rows at the steps, and its rate, bend and fall, as those of h in :class:`Course`.
        within: shape (steps, PARTS + 1, n) the index along each step.
        h: shape (steps + 1, n) of the rows themselves.
        margin: shape (n,).
    """

    index: Course
    within: Array
    h: Array
    margin: Array


class Accelerated:
    """A robot on a fixed base, where constant acceleration is a parabola of the joints, and the rows that it has."""

    def __init__(self, robot: RobotDescription, name: str, family: str) -> None:
        self.kin = kin = Kinematics(robot, base="fixed")
        self.barriers = standard_barriers(kin, ("sphere",))
        values = FamilyParameters(alpha=ALPHA, slope=SLOPE, eta=ETA, index_gain=GAIN)
        self.parameters = BarrierParameters(**dict.fromkeys(FAMILIES, values))
        self.name, self.q, self.v, self.lift = name, kin.posture("hands_front"), np.zeros(kin.nv), 0.0
        kin.update_geometry(self.q)
        self.sphere = coming_sphere(kin)
        self.cut = self.barriers.slices[family]
        rows = self.rows(0.0)
        self.p = self.parameters.of_rows(rows.family, KINDS[name].margins)
        self.row = self.cut.start + int((rows.h - self.p.margin)[self.cut].argmin())
        self.lift = self.p.margin[self.row] + 0.05 - rows.h[self.row]

    def rows(self, time: float, ahead: float = 0.0, u: Array | float = 0.0) -> BarrierRows:
        """At a time [s], a bit ahead of the state with acceleration ``u``."""
        velocity = self.v + ahead * u
        self.kin.update_motion(self.q + ahead * self.v + 0.5 * ahead**2 * u, velocity)
        self.kin.update_second_order()
        set_obstacle(self.barriers, self.sphere.after(time + ahead))
        rows = self.barriers.evaluate(self.kin, second_order=True)
        assert rows.curvature is not None
        h = rows.h.copy()
        h[self.cut] += self.lift
        copies = {name: getattr(rows, name).copy() for name in ("jac", "dh_dt", "curvature")}
        return replace(rows, h=h, **copies)

    def index(self, rows: BarrierRows, velocity: Array) -> BarrierRows:
        return (ecbf_rows if self.name == "ecbf" else index_rows)(rows, velocity, self.p)

    def run(self, dt: float, duration: float = 0.4) -> IndexCourse:
        n = self.barriers.size
        safety_filter = SafetyFilter(
            self.name, n, self.parameters, np.full(self.kin.nv, 1e4), settings=FilterSettings(order=2, dt=dt)
        )
        heights, rates, bends, falls, within, raw = [], [], [], [], [], []
        for step in range(round(duration / dt)):
            rows = self.rows(step * dt)
            jac = rows.jac[self.row]
            result = safety_filter.apply(rows, (-PUSH * jac / (jac @ jac) - self.v) / LAG, velocity=self.v)
            assert result.status in {FilterStatus.UNCHANGED, FilterStatus.FILTERED}
            values, along = [], []
            for k in range(PARTS + 1):
                ahead = k * dt / PARTS
                index = self.index(self.rows(step * dt, ahead, result.v), self.v + ahead * result.v)
                values.append(index.h)
                along.append(index.jac @ result.v + index.dh_dt)
            slopes = [np.abs(along[k] - along[0]) / (k * dt / PARTS) for k in range(1, PARTS + 1)]
            rates.append(along[0])
            bends.append(np.max(slopes, axis=0))
            falls.append(np.maximum(0.0, -np.min(along, axis=0)))
            heights.append(values[0])
            within.append(values)
            raw.append(rows.h)
            self.q, self.v = self.q + dt * self.v + 0.5 * dt**2 * result.v, self.v + dt * result.v
        heights.append(values[-1])
        raw.append(self.rows(round(duration / dt) * dt).h)
        margin, zero = self.p.margin, np.zeros(n)
        parts = [np.array(part) for part in (heights, rates, bends, falls)]
        course = Course(parts[0], parts[1], parts[2], parts[3], zero, self.row, self.cut)
        return IndexCourse(course, np.array(within), np.array(raw), margin)


@pytest.mark.parametrize("dt", [0.005, 0.010])
@pytest.mark.parametrize("family", PUSHED)
@pytest.mark.parametrize("name", ["cbf", "ecbf", "ssa", "sss"])
def test_with_accelerations_the_bounds_are_those_of_the_index(
    robot: RobotDescription, name: str, family: str, dt: float
) -> None:
    course = Accelerated(robot, name, family).run(dt)
    index = course.index
    rows, bent = sound_rows(index), index.bend.max(axis=0) * dt / 2
    one_step = dt * index.fall.max(axis=0)
    if name == "ssa":
        rows &= index.bend.max(axis=0) * dt <= 2 * ETA
    lost = {"cbf": bent / ALPHA, "ecbf": bent / ALPHA, "ssa": one_step, "sss": np.maximum(one_step, bent / SLOPE)}[name]
    assert rows[index.row]
    assert (index.h >= -lost - ROUNDING)[:, rows].all()
    # within the steps too
    assert (course.within >= -lost - ROUNDING)[:, :, rows].all()
    # and then h itself sinks no lower than the index
    assert (course.h[0] >= course.margin)[rows].all()
    delta = np.maximum(0.0, -course.within.min(axis=(0, 1))) / (ALPHA if name == "ecbf" else 1.0)
    assert (course.h >= course.margin - delta - ROUNDING)[:, rows].all()
    # the push arrives
    assert index.h[:, index.row].min() < 0.02
