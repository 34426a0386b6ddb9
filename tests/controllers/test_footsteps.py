"""Footholds under a body that moves at the commanded velocity."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.gaits.commands import VelocityCommand
from controllers.gaits.footholds import LEFT, RIGHT, Foothold
from controllers.gaits.walking import StepLimits, VelocityFootsteps
from controllers.gaits.walking.timing import StepTiming
from robots.errors import ConfigError

WIDE = StepLimits(width=0.24, forward=5.0, narrowest=0.01, widest=5.0, turn=3.0)
PERIOD = 0.8
EVEN = StepTiming(0.6, 0.2, 1e6)
"""Steps that take PERIOD at any speed."""


def walk(command: VelocityCommand, steps: int, limits: StepLimits = WIDE) -> list[Foothold]:
    """Footholds of a walk from a stand at the origin, left foot first."""
    planner = VelocityFootsteps(limits, EVEN)
    feet = [Foothold(0.0, 0.12, 0.0), Foothold(0.0, -0.12, 0.0)]
    out, swing = [], LEFT
    for _ in range(steps):
        feet[swing] = planner.next_foothold(feet[1 - swing], swing, command)
        out.append(feet[swing])
        swing = 1 - swing
    return out


@settings(max_examples=50, deadline=None)
@given(st.floats(-0.4, 0.4), st.floats(-0.2, 0.2), st.floats(-0.5, 0.5))
def test_the_body_moves_as_commanded(vx: float, vy: float, wz: float) -> None:
    """Each step takes the middle of the body by exp(v T): two feet of one body lie on one circle about its centre."""
    feet = walk(VelocityCommand(vx, vy, wz), 6)
    middles = [f.compose(0.0, -0.12 if i % 2 == 0 else 0.12, 0.0) for i, f in enumerate(feet)]
    twist = np.array([[0.0, -wz, vx], [wz, 0.0, vy], [0.0, 0.0, 0.0]]) * PERIOD
    step = np.eye(3) + sum(np.linalg.matrix_power(twist, k) / math.factorial(k) for k in range(1, 20))
    for a, b in pairwise(middles):
        x, y, yaw = a.relative(b)
        assert [x, y] == pytest.approx(step[:2, 2], abs=1e-12)
        assert yaw == pytest.approx(math.remainder(wz * PERIOD, math.tau), abs=1e-12)


@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3))
def test_two_steps_go_as_far_to_the_side_as_commanded_where_the_feet_may_not_come_close(vx: float, vy: float) -> None:
    """The trailing foot stops at the bound; the pair of steps makes the way all the same."""
    limits = StepLimits(width=0.24, forward=5.0, narrowest=0.2, widest=5.0, turn=3.0)
    feet = walk(VelocityCommand(vx, vy, 0.0), 8, limits)
    for before, after in zip(feet[1:-2], feet[3:], strict=True):
        x, y, _ = before.relative(after)
        assert (x, y) == pytest.approx((2 * vx * PERIOD, 2 * vy * PERIOD), abs=1e-9)
    for a, b in pairwise(feet):
        assert abs(a.relative(b)[1]) >= 0.2 - 1e-9


def test_stepping_on_the_spot_brings_the_feet_side_by_side() -> None:
    planner = VelocityFootsteps(WIDE, EVEN)
    stance = Foothold(1.0, 2.0, 0.7)
    x, y, yaw = stance.relative(planner.next_foothold(stance, RIGHT, VelocityCommand(stepping=True)))
    assert (x, y, yaw) == pytest.approx((0.0, -0.24, 0.0), abs=1e-12)


@settings(max_examples=50, deadline=None)
@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(-3, 3), st.sampled_from((LEFT, RIGHT)), st.floats(-7, 7))
def test_no_foothold_leaves_its_bounds(vx: float, vy: float, wz: float, swing: int, yaw: float) -> None:
    limits = StepLimits(width=0.24, forward=0.3, narrowest=0.1, widest=0.4, turn=0.4)
    stance = Foothold(0.3, -0.2, yaw)
    x, y, turn = stance.relative(
        VelocityFootsteps(limits, EVEN).next_foothold(stance, swing, VelocityCommand(vx, vy, wz))
    )
    side = 1.0 if swing == LEFT else -1.0
    tiny = 1e-9
    assert abs(x) <= 0.3 + tiny
    assert 0.1 - tiny <= side * y <= 0.4 + tiny
    assert abs(turn) <= 0.4 + tiny


@given(*(st.floats(-3, 3) for _ in range(6)))
def test_relative_undoes_compose(x: float, y: float, yaw: float, dx: float, dy: float, turn: float) -> None:
    here = Foothold(x, y, yaw)
    assert here.relative(here.compose(dx, dy, turn)) == pytest.approx((dx, dy, turn), abs=1e-9)


def test_a_command_says_whether_it_walks() -> None:
    assert not VelocityCommand().walks
    assert VelocityCommand(stepping=True).walks
    assert VelocityCommand(wz=-0.1).walks


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(ConfigError, match="vx"):
        VelocityCommand(vx=math.nan)
    with pytest.raises(ConfigError, match="width"):
        StepLimits(width=0.5, forward=0.3, narrowest=0.1, widest=0.4, turn=0.4)
    with pytest.raises(ConfigError, match="forward"):
        StepLimits(width=0.2, forward=-0.3, narrowest=0.1, widest=0.4, turn=0.4)
