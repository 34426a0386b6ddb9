"""Phases of walking: standing, double and single support, what ends each, and references that do not jump."""

import math
from itertools import pairwise

import numpy as np
import pytest

from controllers.gaits.commands import VelocityCommand
from controllers.gaits.footholds import LEFT, RIGHT
from controllers.gaits.walking import Support
from tests.support.ideal_walk import DT, IdealWalk, assert_side_by_side, swinging

AHEAD = VelocityCommand(vx=0.2)
STOP = VelocityCommand()


@pytest.fixture
def walk() -> IdealWalk:
    return IdealWalk()


def test_it_stands_where_it_is_until_it_is_told_to_walk(walk: IdealWalk) -> None:
    soles = walk.body.soles.copy()
    walk.run(1.0)
    assert all(t.support is Support.STAND and t.contact.all() for t in walk.ticks)
    np.testing.assert_allclose(walk.series("soles"), np.tile(soles[:, :3], (500, 1, 1)), rtol=0, atol=1e-12)
    np.testing.assert_allclose(walk.series("dcm"), np.tile(soles[:, :2].mean(axis=0), (500, 1)), rtol=0, atol=1e-12)
    np.testing.assert_array_equal(walk.series("limits"), 1.0)


def test_feet_swing_in_turn_for_the_times_of_the_tuning(walk: IdealWalk) -> None:
    walk.walking.command = AHEAD
    walk.run(6.0)
    contact, tuning = walk.series("contact"), walk.tuning
    assert contact.any(axis=1).all()
    lifts = [(i, swinging(walk.ticks[i + 1])) for i in np.flatnonzero(np.diff(contact.sum(axis=1)) < 0)]
    assert len(lifts) >= 6
    feet = [foot for _, foot in lifts]
    assert all(a != b for a, b in pairwise(feet))
    np.testing.assert_allclose(
        np.diff([i for i, _ in lifts]) * DT,
        tuning.timing.period(AHEAD.foot_speed(walk.walking.limits.width)),
        rtol=0,
        atol=2.01 * DT,
    )
    single = (contact.sum(axis=1) == 1).sum() * DT / len(lifts)
    assert single == pytest.approx(tuning.single_support, abs=0.1)
    first = lifts[0][0] * DT
    assert first == pytest.approx(tuning.stop_time + tuning.start_time, abs=2.01 * DT)


def test_references_do_not_jump(walk: IdealWalk) -> None:
    """Start, stepping, walking, stop: soles, DCM and ZMP, tick to tick, with feet that land in time."""
    walk.walking.command = VelocityCommand(vx=0.2, wz=0.2)
    walk.run(5.0)
    walk.walking.command = STOP
    walk.run(4.0)
    assert_side_by_side(walk)
    soles = np.linalg.norm(np.diff(walk.series("soles"), axis=0), axis=2)
    assert soles.max() < 2.0 * DT
    landing = np.diff(walk.series("steps")) > 0
    dcm, zmp = (np.linalg.norm(np.diff(walk.series(name), axis=0), axis=1) for name in ("dcm", "zmp"))
    assert dcm[~landing].max() < 1.0 * DT
    # from sole to sole in double support: no faster than their distance allows
    assert zmp[~landing].max() < 0.5 / walk.tuning.double_support * DT
    # a change of speed moves the end of the next step, and the DCM by what is left of that at its beginning
    assert walk.reference.dcm is not None
    period = walk.tuning.timing.period(0.0)
    growth = math.exp(walk.reference.dcm.omega * period)
    assert dcm[landing].max() < 1.1 * walk.tuning.speed_change * period / (growth - 1.0)


def test_at_a_constant_command_the_dcm_does_not_jump_at_touchdowns(walk: IdealWalk) -> None:
    walk.walking.command = VelocityCommand(vx=0.15)
    walk.run(5.0)
    dcm = walk.series("dcm")
    assert walk.walking.steps >= 5
    # a touchdown comes up to two ticks late: that much of the DCM's way is lost, no more
    assert np.linalg.norm(np.diff(dcm, axis=0), axis=1).max() < 1.0 * DT


def test_load_goes_over_in_the_transfer_time(walk: IdealWalk) -> None:
    """A foot gives up its load before it lifts, and takes it on from nothing after it has landed."""
    walk.walking.command = AHEAD
    walk.run(5.0)
    contact, limits = walk.series("contact"), walk.series("limits")
    rate = 1.01 * DT / walk.tuning.load_transfer_time
    for foot in (LEFT, RIGHT):
        change = np.diff(contact[:, foot].astype(int))
        for lift in np.flatnonzero(change < 0):
            assert limits[lift, foot] <= rate
        for land in np.flatnonzero(change > 0) + 1:
            assert limits[land, foot] == 0.0
            assert limits[land + round(walk.tuning.load_transfer_time / DT) + 1, foot] == 1.0
        both = contact[1:].all(axis=1) & contact[:-1].all(axis=1)
        assert np.abs(np.diff(limits[:, foot]))[both].max() <= rate
    assert (limits.sum(axis=1) >= 1.0 - 1e-9).all()
    assert (limits.min(axis=1) >= 0.0).all()


def test_a_second_start_takes_the_load_over_as_smoothly_as_the_first(walk: IdealWalk) -> None:
    """From standing, where both feet have borne the weight for long, no foot's fraction is cut at once."""
    for _ in range(2):
        walk.walking.command = AHEAD
        walk.until(lambda tick: tick.steps > 0 and tick.support is Support.SINGLE)
        walk.walking.command = STOP
        walk.until(lambda tick: tick.support is Support.STAND)
        walk.run(0.5)
    contact, limits = walk.series("contact"), walk.series("limits")
    both = contact[1:].all(axis=1) & contact[:-1].all(axis=1)
    assert np.abs(np.diff(limits, axis=0))[both].max() <= 1.01 * DT / walk.tuning.load_transfer_time


def test_a_foot_that_lands_to_stand_takes_on_its_load_smoothly_whatever_came_before(walk: IdealWalk) -> None:
    """Also where the double support before the last step was made longer by a wait."""
    walk.walking.command = VelocityCommand(stepping=True)
    walk.until(lambda tick: tick.steps == 1)
    walk.walking.command = STOP
    walk.until(lambda tick: tick.steps == 2 or tick.support is Support.STAND)
    assert walk.walking.support is Support.DOUBLE
    walk.body.error = walk.inwards(0.04)
    walk.run(walk.tuning.double_support + 0.2)
    assert walk.walking.support is Support.DOUBLE
    walk.body.error = np.zeros(2)
    walk.until_single()
    landed = walk.until(lambda tick: tick.support is not Support.SINGLE)
    assert landed.support is Support.STAND
    assert landed.limits.min() == 0.0


def test_early_ground_ends_the_step(walk: IdealWalk) -> None:
    """Ground 2 cm up under the swinging foot: it lands before its time, and the walk goes on from there."""
    walk.walking.command = AHEAD
    tick = walk.until_single()
    foot, lifted = swinging(tick), tick.t
    walk.run(0.3 * walk.tuning.single_support)
    walk.body.ground[foot] += 0.02
    landed = walk.until_landed()
    assert 0.5 * walk.tuning.single_support <= landed.t - lifted < walk.tuning.single_support - 3 * DT
    assert landed.soles[foot, 2] == pytest.approx(walk.body.ground[foot], abs=2e-3)
    walk.body.ground[:] = walk.body.ground[foot]
    height = walk.reference.com.position[2]
    walk.run(3.0)
    assert walk.walking.steps >= 4
    # the other foot is up there too by now, and the CoM over both
    assert walk.reference.com.position[2] - height == pytest.approx(0.01, abs=2e-3)


def test_a_touch_in_the_first_half_is_no_landing(walk: IdealWalk) -> None:
    """A foot that still scrapes the ground it leaves has not come down."""
    walk.walking.command = AHEAD
    tick = walk.until_single()
    foot, lifted = swinging(tick), tick.t
    walk.body.ground[foot] += 0.5
    landed = walk.until_landed()
    assert landed.t - lifted == pytest.approx(0.5 * walk.tuning.single_support, abs=2 * DT)


def test_late_ground_is_felt_for_at_the_touch_speed(walk: IdealWalk) -> None:
    walk.walking.command = AHEAD
    tick = walk.until_single()
    foot, lifted, tuning = swinging(tick), tick.t, walk.tuning
    walk.body.ground[foot] -= 0.5 * tuning.late_limit * tuning.touch_speed
    walk.until(lambda tick: tick.t - lifted > tuning.single_support + 0.4 * tuning.late_limit)
    assert walk.ticks[-1].rates[foot, 2] == pytest.approx(-tuning.touch_speed, rel=1e-6)
    landed = walk.until_landed()
    assert landed.t - lifted == pytest.approx(tuning.single_support + 0.5 * tuning.late_limit, abs=5 * DT)


def test_without_any_ground_the_step_ends_at_the_late_limit(walk: IdealWalk) -> None:
    walk.walking.command = AHEAD
    tick = walk.until_single()
    walk.body.ground[swinging(tick)] -= 1.0
    landed = walk.until_landed()
    expected = walk.tuning.single_support + walk.tuning.late_limit
    assert landed.t - tick.t == pytest.approx(expected, abs=2 * DT)


def test_without_measured_forces_the_clock_lands_the_foot(walk: IdealWalk) -> None:
    walk.body.measured = False
    walk.walking.command = AHEAD
    tick = walk.until_single()
    landed = walk.until_landed()
    assert landed.t - tick.t == pytest.approx(walk.tuning.single_support, abs=2 * DT)
    walk.run(2.0)
    assert walk.walking.steps >= 3


def test_forces_that_are_not_numbers_land_no_foot_early(walk: IdealWalk) -> None:
    walk.walking.command = AHEAD
    tick = walk.until_single()
    walk.body.force = math.nan
    landed = walk.until_landed()
    assert landed.t - tick.t == pytest.approx(walk.tuning.single_support + walk.tuning.late_limit, abs=2 * DT)
    assert np.isfinite(landed.soles).all() and np.isfinite(landed.dcm).all()


@pytest.mark.parametrize("when", [0.3, 0.9, 1.5, 1.75, 1.9, 2.05, 2.2])
def test_a_stop_at_any_instant_ends_on_both_feet_side_by_side(walk: IdealWalk, when: float) -> None:
    walk.walking.command = VelocityCommand(vx=0.25, wz=0.2)
    walk.run(when)
    walk.walking.stop()
    walk.run(5.0)
    assert_side_by_side(walk)
    ended = walk.ticks[-1]
    np.testing.assert_allclose(ended.dcm, ended.soles[:, :2].mean(axis=0), rtol=0, atol=1e-9)
    np.testing.assert_allclose(ended.zmp, ended.dcm, rtol=0, atol=1e-9)
    # a command after a stop has no effect
    walk.walking.command = AHEAD
    assert walk.walking.command == STOP
    steps = walk.walking.steps
    walk.run(2.0)
    assert walk.walking.steps == steps
    assert_side_by_side(walk)


def test_stepping_on_the_spot_stays_on_the_spot(walk: IdealWalk) -> None:
    soles = walk.body.soles.copy()
    walk.walking.command = VelocityCommand(stepping=True)
    walk.run(4.0)
    assert walk.walking.steps >= 4
    walk.walking.command = STOP
    walk.run(2.0)
    np.testing.assert_allclose(walk.body.soles[:, :2], soles[:, :2], rtol=0, atol=1e-6)
