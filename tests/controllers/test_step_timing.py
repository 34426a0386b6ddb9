"""Times of steps: the acceleration of the path that a foot is then given, and the speeds they belong to."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controllers.gaits.commands import VelocityCommand
from controllers.gaits.footholds import LEFT, RIGHT, Foothold
from controllers.gaits.walking import StepLimits, VelocityFootsteps
from controllers.gaits.walking.swing_path import SwingPath
from controllers.gaits.walking.timing import StepTiming
from robots.errors import ConfigError

WIDE = StepLimits(width=0.24, forward=5.0, narrowest=0.01, widest=5.0, turn=3.0)
timings = st.builds(StepTiming, st.floats(0.3, 0.8), st.floats(0.05, 0.3), st.floats(3.0, 30.0))


def peak_acceleration(timing: StepTiming, command: VelocityCommand) -> float:
    """Of the path from one foothold to the next in steady walking, horizontal, by its own numbers."""
    planner, single = VelocityFootsteps(WIDE, timing), timing.single(command.foot_speed(WIDE.width))
    start = Foothold(0.0, 0.12, 0.0)
    stance = planner.next_foothold(start, RIGHT, command)
    end = planner.next_foothold(stance, LEFT, command)
    path = SwingPath(np.array([start.x, start.y, 0.0, 0.0]), np.array([end.x, end.y, 0.0, 0.0]), 0.06, single)
    return max(float(np.linalg.norm(path.evaluate(t).acceleration[:2])) for t in np.linspace(0.0, single, 2001))


@given(timings, st.floats(0.05, 0.8), st.floats(-math.pi, math.pi), st.sampled_from((0.0, 0.0, 0.3, -0.7)))
def test_the_planned_path_of_a_foot_keeps_to_the_bound(timing: StepTiming, speed: float, way: float, wz: float) -> None:
    """And, straight on, meets it wherever a step takes longer than in slow walking: no slower than need be."""
    command = VelocityCommand(speed * math.cos(way), 0.1 * speed * math.sin(way), wz)
    peak = peak_acceleration(timing, command)
    assert peak <= timing.swing_acceleration * (1.0 + 1e-6)
    if wz == 0.0 and timing.single(command.foot_speed(WIDE.width)) > timing.single_support:
        assert peak == pytest.approx(timing.swing_acceleration, rel=1e-3)


@given(timings, st.floats(0.0, 1.0))
def test_speed_and_length_of_a_step_belong_together(timing: StepTiming, speed: float) -> None:
    assert timing.speed(speed * timing.period(speed)) == pytest.approx(speed, abs=1e-9)


@given(timings, st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_slow_steps_take_the_usual_time_and_faster_ones_no_less(timing: StepTiming, one: float, other: float) -> None:
    slow, fast = sorted((one, other))
    assert timing.single(0.0) == timing.single_support
    assert timing.single(slow) <= timing.single(fast)
    assert timing.period(fast) == timing.single(fast) + timing.double_support


@pytest.mark.parametrize("name", ["single_support", "double_support", "swing_acceleration"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan])
def test_what_is_no_time_is_refused(name: str, value: float) -> None:
    given_values = {"single_support": 0.5, "double_support": 0.1, "swing_acceleration": 10.0} | {name: value}
    with pytest.raises(ConfigError, match=name):
        StepTiming(**given_values)
