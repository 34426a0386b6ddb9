"""What holding the velocity for a step costs, on robots' own rows: the bounds stated in ``safety.conditions``."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from robots.description import RobotDescription
from robots.kinematics import Kinematics
from robots.messages import Array
from robots.pinocchio_model import standing_configuration
from safety.barriers import standard_barriers
from safety.conditions import BarrierParameters, FamilyParameters
from safety.filters import KINDS, FilterStatus, SafetyFilter
from safety.rows import FAMILIES

ALPHA = SLOPE = 20.0
ETA = 0.3
PUSH = 0.6
"""Rate at which the nominal velocity makes the pushed row fall [m/s, rad/s]."""

STEPS = (0.001, 0.002, 0.005, 0.010, 0.020)
PARTS = 8
"""Places along a step where the rates are looked at."""

PUSHED = ("joint_limit", "workspace", "self_collision")
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


def run(robot: RobotDescription, name: str, family: str, dt: float, duration: float = 0.3) -> Course:
    """Push the closest row of a family and hold each velocity for ``dt``."""
    kin = Kinematics(robot)
    barriers = standard_barriers(kin)
    parameters = BarrierParameters(**{f: FamilyParameters(alpha=ALPHA, slope=SLOPE, eta=ETA) for f in FAMILIES})
    safety_filter = SafetyFilter(name, barriers.size, parameters, np.full(kin.nv, 100.0))
    q = standing_configuration(robot, "hands_front")
    kin.update_geometry(q)
    cut, rows = barriers.slices[family], barriers.evaluate(kin)
    margin = parameters.margins(KINDS[name].margins)[rows.family]
    row = cut.start + int((rows.h - margin)[cut].argmin())
    # the family begins some steps of the push above where the filter wakes up, whatever the posture
    lift = margin[row] + 0.08 - rows.h[row]
    heights, rates, bends, falls = [], [], [], []
    for _ in range(round(duration / dt)):
        kin.update_geometry(q)
        rows = barriers.evaluate(kin)
        h, jac = rows.h.copy(), rows.jac.copy()
        h[cut] += lift
        nominal = -PUSH * jac[row] / (jac[row] @ jac[row])
        result = safety_filter.apply(replace(rows, h=h), nominal)
        assert result.status in {FilterStatus.UNCHANGED, FilterStatus.FILTERED}
        along = []
        for k in range(PARTS + 1):
            kin.update_geometry(kin.integrate(q, result.v, k * dt / PARTS))
            along.append(barriers.evaluate(kin).jac @ result.v)
        slopes = [np.abs(along[k] - along[0]) / (k * dt / PARTS) for k in range(1, PARTS + 1)]
        heights.append(h)
        rates.append(along[0])
        bends.append(np.max(slopes, axis=0))
        falls.append(np.maximum(0.0, -np.min(along, axis=0)))
        q = kin.integrate(q, result.v, dt)
    kin.update_geometry(q)
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
