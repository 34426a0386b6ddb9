"""Pushes: footholds and times that follow the DCM, steps that catch, lifts that wait."""

import numpy as np
import pytest

from controllers.gaits.commands import VelocityCommand
from controllers.gaits.footholds import LEFT, RIGHT
from controllers.gaits.walking import Support
from robots.messages import Array
from tests.support.ideal_walk import DT, IdealWalk, assert_side_by_side, swinging


@pytest.fixture
def walk() -> IdealWalk:
    return IdealWalk()


def test_a_last_step_that_a_push_sends_elsewhere_is_not_the_last(walk: IdealWalk) -> None:
    """The feet are side by side when the robot stands, also where a push came in the step that should close them."""
    walk.walking.command = VelocityCommand(stepping=True)
    walk.until(lambda tick: tick.steps == 2)
    walk.walking.stop()
    walk.until_single()
    walk.run(0.1)
    walk.body.error = np.array([0.08, 0.0])
    walk.run(walk.tuning.single_support - 0.1 - 0.5 * walk.tuning.frozen_time)
    walk.body.error = np.zeros(2)
    walk.run(5.0)
    assert_side_by_side(walk)


@pytest.mark.parametrize("push", [np.array([0.05, 0.0]), np.array([-0.05, 0.0])])
def test_the_foot_goes_where_the_push_goes(walk: IdealWalk, push: Array) -> None:
    walk.walking.command = VelocityCommand(stepping=True)
    foot = swinging(walk.until_single())
    before = walk.foothold(1 - foot)
    walk.run(0.1)
    walk.body.error = push
    walk.run(0.04)
    walk.body.error = np.zeros(2)
    walk.until_landed()
    moved = walk.foothold(foot).x - before.x
    assert np.sign(moved) == np.sign(push[0])
    assert abs(moved) > 0.02
    # and the plan knew of it: made anew at touchdown it goes on where it was, but for the two ticks that this takes
    jump, speed = (np.linalg.norm(np.subtract(*(walk.ticks[i].dcm for i in pair))) for pair in ((-1, -2), (-2, -3)))
    assert jump < 3.0 * speed < 0.25 * abs(moved)


def test_a_push_too_strong_for_the_longest_step_makes_it_shorter_in_time(walk: IdealWalk) -> None:
    walk.walking.command = VelocityCommand(stepping=True)
    lifted = walk.until_single()
    walk.run(0.05)
    walk.body.error = np.array([0.12, 0.0])
    walk.run(0.02)
    walk.body.error = np.zeros(2)
    landed = walk.until_landed()
    assert walk.tuning.shortest_step - DT <= landed.t - lifted.t < walk.tuning.single_support - 0.03
    assert walk.foothold(swinging(lifted)).x - lifted.soles[0, 0] <= walk.tuning.forward + 1e-6


def test_no_foothold_changes_just_before_it_is_reached(walk: IdealWalk) -> None:
    walk.walking.command = VelocityCommand(stepping=True)
    lifted = walk.until_single()
    walk.run(walk.tuning.single_support - walk.tuning.frozen_time + 2 * DT)
    walk.body.error = np.array([0.1, 0.0])
    walk.until_landed()
    np.testing.assert_allclose(walk.body.soles[:, 0], lifted.soles[:, 0], rtol=0, atol=1e-6)


@pytest.mark.parametrize(("side", "lifts"), [(1.0, RIGHT), (-1.0, LEFT)])
def test_pushed_in_standing_it_steps_at_once_with_the_foot_that_is_not_loaded(
    walk: IdealWalk, side: float, lifts: int
) -> None:
    walk.run(0.1)
    walk.body.error = np.array([0.0, 0.25 * side])
    pushed = walk.tick().t
    tick = walk.until_single()
    assert swinging(tick) == lifts
    assert tick.t - pushed <= walk.tuning.catch_time + 3 * DT


def test_small_errors_in_standing_make_no_step(walk: IdealWalk) -> None:
    walk.run(0.1)
    for error in ([0.02, 0.0], [0.0, 0.05], [-0.02, 0.04]):
        walk.body.error = np.array(error)
        walk.run(0.3)
    assert all(tick.support is Support.STAND for tick in walk.ticks)


def test_a_foot_waits_to_lift_while_an_error_would_send_it_elsewhere(walk: IdealWalk) -> None:
    """At most for the wait's limit, its load not given up; and it goes as soon as the error has gone."""
    times, tuning = [], walk.tuning
    for error, lasts in ((0.0, 0.0), (0.04, 9.0), (0.04, 0.3)):
        walk.walking.command = VelocityCommand(stepping=True)
        began = walk.until(lambda tick: tick.support is Support.DOUBLE and tick.steps > 0)
        walk.body.error = walk.inwards(error)
        limits = []
        while walk.walking.support is Support.DOUBLE:
            tick = walk.tick()
            if tick.t - began.t > lasts:
                walk.body.error = np.zeros(2)
            limits.append(tick.limits)
            if lasts == 9.0 and tuning.double_support < tick.t - began.t < tuning.wait_limit:
                # it stands still meanwhile
                np.testing.assert_array_equal(tick.zmp, tick.dcm)
        times.append(walk.ticks[-1].t - began.t)
        walk.body.error = np.zeros(2)
        assert (np.sum(limits, axis=1) >= 1.0 - 1e-9).all()
        walk.until_landed()
        walk.until_single()
    assert times[0] == pytest.approx(tuning.double_support, abs=2 * DT)
    assert times[1] == pytest.approx(tuning.double_support + tuning.wait_limit, abs=4 * DT)
    assert times[2] == pytest.approx(0.3 + tuning.load_transfer_time, abs=6 * DT)


def test_who_falls_as_the_last_step_lands_makes_another_one(walk: IdealWalk) -> None:
    walk.walking.command = VelocityCommand(stepping=True)
    walk.until(lambda tick: tick.steps == 1)
    walk.walking.stop()
    lifted = walk.until(lambda tick: tick.support is Support.SINGLE and tick.steps == 2)
    walk.until(lambda tick: tick.t - lifted.t > walk.tuning.single_support - 0.5 * walk.tuning.frozen_time)
    walk.body.error = np.array([0.2, 0.0])
    landed = walk.until(lambda tick: tick.steps == 3)
    assert landed.support is Support.DOUBLE
    walk.body.error = np.zeros(2)
    walk.run(5.0)
    assert_side_by_side(walk)
