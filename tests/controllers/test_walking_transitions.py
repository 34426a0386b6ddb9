"""Transitions of walking one by one: what they go by, and that a phase is never changed."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from controllers.gaits.commands import VelocityCommand
from controllers.gaits.foot_state import Feet
from controllers.gaits.footholds import LEFT, RIGHT
from controllers.gaits.walking import StepLimits, VelocityFootsteps, WalkTuning
from controllers.gaits.walking.adjustment import StepAdjustment
from controllers.gaits.walking.phases import DoubleSupport, SingleSupport, Standing
from controllers.gaits.walking.plan import StepPlan
from controllers.gaits.walking.transitions import (
    REPLAN_DISTANCE,
    WalkRules,
    adjust_step,
    has_landed,
    leave_double_support,
    leave_standing,
    touch_down,
)
from robots.loader import load_robot
from robots.messages import Array
from tests.support.ideal_walk import DT, IdealWalk, ideal_body

TUNING = WalkTuning()
STEPPING = VelocityCommand(stepping=True)
STOP = VelocityCommand()
BODY = ideal_body(load_robot("g1"))


def feet(error: tuple[float, float] = (0.0, 0.0), dcm: Array | None = None) -> Feet:
    """Feet as they stand, with a DCM between them, or where it is given, and an error of it."""
    out = Feet(BODY)
    out.dcm = (out.middle if dcm is None else dcm) + np.array(error)
    return out


def rules_of(tuning: WalkTuning = TUNING) -> WalkRules:
    here = Feet(BODY)
    limits: StepLimits = tuning.limits(here.width)
    plans = StepPlan(VelocityFootsteps(limits, tuning.timing), limits, tuning, here.omega)
    zmp_range = (0.05, 0.02)
    adjustment = StepAdjustment(limits, here.omega, zmp_range, tuning.double_support)
    return WalkRules(tuning, limits, plans, adjustment, (zmp_range, zmp_range))


RULES = rules_of()
STANDING = Standing(0.0, RULES.plans.standing(Feet(BODY).middle))


def started() -> DoubleSupport:
    phase = leave_standing(RULES, STANDING, feet(), 1.0, STEPPING)
    assert isinstance(phase, DoubleSupport)
    return phase


def lifted() -> SingleSupport:
    double = started()
    t = double.since + double.duration
    phase = leave_double_support(RULES, replace(double, may_lift=True), feet(dcm=double.dcm(t).position), t, DT)
    assert isinstance(phase, SingleSupport)
    return phase


def on_plan(phase: DoubleSupport | SingleSupport, t: float, error: tuple[float, float] = (0.0, 0.0)) -> Feet:
    return feet(error, phase.dcm(t).position)


def test_standing_lasts_until_a_command_and_its_own_rest() -> None:
    assert leave_standing(RULES, STANDING, feet(), 9.0, STOP) is STANDING
    assert leave_standing(RULES, STANDING, feet(), 0.9 * TUNING.stop_time, STEPPING) is STANDING
    phase = leave_standing(RULES, STANDING, feet(), 1.1 * TUNING.stop_time, STEPPING)
    assert isinstance(phase, DoubleSupport)
    assert (phase.duration, phase.command) == (TUNING.start_time, STEPPING)


@pytest.mark.parametrize(("side", "swing"), [(1.0, RIGHT), (-1.0, LEFT)])
def test_a_fall_in_standing_is_caught_at_once_from_where_the_dcm_is(side: float, swing: int) -> None:
    """Without a command, before the last plan has come to rest; the plan begins with the measured DCM."""
    here = feet((0.0, 0.3 * side))
    phase = leave_standing(RULES, STANDING, here, 0.01, STOP)
    assert isinstance(phase, DoubleSupport)
    assert (phase.swing, phase.duration) == (swing, TUNING.catch_time)
    np.testing.assert_allclose(phase.dcm(0.01).position, here.dcm, rtol=0, atol=1e-9)


def test_an_error_between_the_feet_is_no_fall() -> None:
    assert leave_standing(RULES, STANDING, feet((0.0, 2.0 * TUNING.catch_error)), 9.0, STOP) is STANDING


def test_a_wait_holds_the_plan_and_nothing_else() -> None:
    """The same point at rest, the same load, for as long as the error lasts; and the phase before stays as it was."""
    phase = replace(started(), loaded_since=(0.0, -math.inf))
    t = phase.since + phase.duration - TUNING.load_transfer_time + 1e-6
    inwards = phase.dcm(t).position - feet().footholds[1 - phase.swing].point
    error = tuple((0.03 * inwards / np.linalg.norm(inwards)).tolist())
    held = leave_double_support(RULES, phase, on_plan(phase, t, error), t, DT)
    assert isinstance(held, DoubleSupport)
    assert (held.waited, held.since) == (DT, phase.since + DT)
    assert (phase.waited, phase.may_lift) == (0.0, False)
    np.testing.assert_array_equal(held.dcm(t + DT).position, phase.dcm(t).position)
    np.testing.assert_array_equal(held.dcm(t + DT).velocity, 0.0)
    after = leave_double_support(RULES, held, on_plan(held, t + DT), t + DT, DT)
    assert isinstance(after, DoubleSupport)
    assert after.may_lift
    assert after.since == held.since


def test_a_foot_lands_by_its_force_in_the_second_half_and_by_the_clock_at_last() -> None:
    phase = lifted()
    half, whole, late = (phase.since + s for s in (0.5 * phase.duration, phase.duration, 9.0))
    for t, touches, landed in (
        (half - DT, True, False),
        (half + DT, True, True),
        (half + DT, False, False),
        (whole + DT, False, False),
        (late, False, True),
        (whole - DT, None, False),
        (whole + DT, None, True),
    ):
        assert has_landed(RULES, phase, t, touches) is landed


def test_small_errors_move_no_foothold_and_make_no_new_plan() -> None:
    phase = lifted()
    t = phase.since + 0.1
    assert adjust_step(RULES, phase, on_plan(phase, t, (0.005, 0.0)), t) is phase
    moved = adjust_step(RULES, phase, on_plan(phase, t, (0.05, 0.0)), t)
    assert moved.target.x > phase.target.x + REPLAN_DISTANCE
    assert moved.chosen == phase.chosen
    end = moved.path.evaluate(moved.duration).position
    np.testing.assert_allclose(end[:2], moved.target.point, rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        moved.plan.evaluate(moved.duration + TUNING.double_support + 1e-6).zmp, moved.target.point, rtol=0, atol=1e-6
    )


def test_after_touchdown_the_foot_that_landed_takes_on_its_load() -> None:
    phase = lifted()
    t = phase.since + phase.duration
    after = touch_down(RULES, phase, on_plan(phase, t), t, STEPPING)
    assert isinstance(after, DoubleSupport)
    assert after.swing == 1 - phase.swing
    transfer = TUNING.load_transfer_time
    assert after.load_limits(t, transfer)[phase.swing] == 0.0
    assert after.load_limits(t + 0.5 * transfer, transfer)[phase.swing] == pytest.approx(0.5)
    np.testing.assert_array_equal(after.load_limits(t + transfer + 1e-6, transfer), 1.0)
    assert after.load_limits(t + after.duration, transfer)[after.swing] == pytest.approx(0.0, abs=1e-9)


def test_a_step_that_closes_ends_in_standing_unless_the_robot_falls_or_is_told_to_walk() -> None:
    phase = replace(lifted(), command=STOP, closes=True)
    t = phase.since + phase.duration
    assert isinstance(touch_down(RULES, phase, on_plan(phase, t), t, STOP), Standing)
    assert isinstance(touch_down(RULES, phase, on_plan(phase, t), t, STEPPING), DoubleSupport)
    assert isinstance(touch_down(RULES, phase, on_plan(phase, t, (0.3, 0.0)), t, STOP), DoubleSupport)
    assert isinstance(touch_down(RULES, replace(phase, closes=False), on_plan(phase, t), t, STOP), DoubleSupport)


def test_a_step_ends_by_the_contact_that_the_state_tells_whatever_its_forces_say() -> None:
    """The same steps as with forces, of which two ticks have to agree: each lands up to two ticks sooner."""
    landings = []
    for by_contact in (False, True):
        walk = IdealWalk()
        walk.by_contact = by_contact
        walk.walking.command = VelocityCommand(vx=0.2)
        walk.run(5.0)
        landings.append([tick.t for before, tick in pairwise(walk.ticks) if tick.steps > before.steps])
    forces, contacts = landings
    assert len(forces) == len(contacts) >= 4
    sooner = np.array(forces) - np.array(contacts)
    steps = np.arange(1, len(forces) + 1)
    assert (sooner >= 0).all() and (sooner <= 2.01 * DT * steps).all()
    assert sooner[0] > 0
