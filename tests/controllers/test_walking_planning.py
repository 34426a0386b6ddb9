"""Where feet go and how fast: commands, their changes, planners of one's own."""

import math

import numpy as np
import pytest

from controllers.gaits.commands import VelocityCommand
from controllers.gaits.footholds import LEFT, RIGHT, Foothold
from controllers.gaits.walking import WalkTuning
from tests.support.ideal_walk import DT, IdealWalk, swinging

AHEAD = VelocityCommand(vx=0.2)
FAST = VelocityCommand(vx=0.41)
"""Fast enough for a step to take longer."""


@pytest.fixture
def walk() -> IdealWalk:
    return IdealWalk()


@pytest.mark.parametrize(
    "command", [AHEAD, FAST, VelocityCommand(vx=-0.15), VelocityCommand(vy=0.08), VelocityCommand(vx=0.1, wz=0.3)]
)
def test_the_feet_go_as_fast_as_the_command(walk: IdealWalk, command: VelocityCommand) -> None:
    """Over four pairs of steps at full speed the left foot moves by Exp of the command, half a width off the body."""
    walk.walking.command = command
    walk.until(lambda tick: tick.steps == 4, 8.0)
    start, counted, at = walk.foothold(LEFT), walk.walking.steps, walk.ticks[-1].t
    walk.until(lambda tick: tick.steps == counted + 8, 10.0)
    seconds = 8 * walk.tuning.timing.period(command.foot_speed(walk.walking.limits.width))
    # lift-off waits for the next tick, touchdown for that and for the force to be seen twice
    assert seconds - DT < walk.ticks[-1].t - at < seconds + 8 * 3 * DT + DT
    half, turn = 0.5 * walk.walking.limits.width, command.wz * seconds
    a, b = (1.0, 0.0) if turn == 0.0 else (math.sin(turn) / turn, (1 - math.cos(turn)) / turn)
    body = seconds * np.array([a * command.vx - b * command.vy, b * command.vx + a * command.vy])
    x, y, yaw = start.relative(walk.foothold(LEFT))
    expected = body + np.array([-half * math.sin(turn), half * math.cos(turn) - half])
    np.testing.assert_allclose([x, y], expected, rtol=0, atol=1e-6)
    assert math.remainder(yaw - turn, math.tau) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("command", "first"),
    [
        (VelocityCommand(vy=0.08), LEFT),
        (VelocityCommand(vy=-0.08), RIGHT),
        (VelocityCommand(wz=0.3), LEFT),
        (VelocityCommand(wz=-0.3), RIGHT),
    ],
)
def test_a_walk_begins_with_the_foot_on_the_side_it_goes_to(
    walk: IdealWalk, command: VelocityCommand, first: int
) -> None:
    walk.walking.command = command
    assert swinging(walk.until_single()) == first


def test_a_command_takes_effect_with_the_next_step(walk: IdealWalk) -> None:
    walk.walking.command = VelocityCommand(stepping=True)
    walk.until_single()
    walk.run(0.1)
    walk.walking.command = VelocityCommand(vx=0.1)
    walk.until(lambda tick: tick.steps == 1)
    assert walk.apart()[0] == pytest.approx(0.0, abs=1e-6)
    walk.until(lambda tick: tick.steps == 2)
    assert abs(walk.apart()[0]) == pytest.approx(0.1 * walk.tuning.timing.period(0.1), abs=1e-6)


@pytest.mark.parametrize(
    "after",
    [VelocityCommand(), VelocityCommand(stepping=True), VelocityCommand(vx=-0.2), VelocityCommand(0.1, 0.0, 0.4)],
)
@pytest.mark.parametrize("before", [FAST, VelocityCommand(0.2, 0.0, 0.4), VelocityCommand(0.2, 0.1, 0.0)])
def test_no_foot_is_sent_faster_than_its_bound_whatever_the_command_turns_into(
    before: VelocityCommand, after: VelocityCommand
) -> None:
    """A low bound, so that every step's time hangs on it; up to speed, from one command to the other, and on."""
    walk = IdealWalk(WalkTuning(swing_acceleration=4.0, forward=1.0, widest=2.5))
    walk.walking.command = before
    walk.until(lambda tick: tick.steps == 5, 12.0)
    walk.walking.command = after
    walk.run(5.0)
    peaks = np.linalg.norm(walk.series("accelerations")[:, :, :2], axis=2)
    assert peaks.max() <= 4.0 * (1.0 + 1e-6)
    assert peaks.max() > 3.5
    standing = walk.series("contact").astype(bool)
    np.testing.assert_array_equal(walk.series("accelerations")[standing], 0.0)


def test_speed_changes_step_by_step() -> None:
    tuning = WalkTuning(speed_change=0.1, turn_change=0.05)
    walk = IdealWalk(tuning)
    walk.walking.command = VelocityCommand(vx=0.25)
    strides = []
    for step in range(1, 5):
        walk.until(lambda tick, step=step: tick.steps == step)
        strides.append(abs(walk.apart()[0]))
    expected = [speed * tuning.timing.period(speed) for speed in (0.1, 0.2, 0.25, 0.25)]
    np.testing.assert_allclose(strides, expected, rtol=0, atol=1e-6)


class Far:
    """A planner that asks for what no leg can do."""

    def __init__(self, x: float) -> None:
        self.x = x

    def next_foothold(self, stance: Foothold, swing: int, command: VelocityCommand) -> Foothold:
        return stance.compose(self.x if command.walks else 0.0, 0.24 if swing == LEFT else -0.24, 0.0)


def test_a_planner_of_ones_own_is_asked() -> None:
    walk = IdealWalk(planner=Far(0.07))
    walk.walking.command = AHEAD
    walk.until(lambda tick: tick.steps == 3)
    np.testing.assert_allclose(np.abs(walk.apart()[:2]), [0.07, 0.24], rtol=0, atol=1e-6)


def test_footholds_of_ones_own_planner_stay_within_reach() -> None:
    walk = IdealWalk(planner=Far(2.0))
    walk.walking.command = AHEAD
    while walk.walking.steps < 2:
        walk.tick()
        assert abs(walk.apart()[0]) <= walk.tuning.forward + 1e-6
        assert np.linalg.norm(walk.ticks[-1].dcm) < 1.0
