"""Side steps: where each foot is sent, that the feet would collide there, and how the steps follow each other."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controllers.gaits.commands import VelocityCommand
from controllers.gaits.foot_state import Feet
from controllers.gaits.footholds import LEFT, RIGHT, Foothold
from controllers.gaits.lateral_steps import (
    LateralSteps,
    LateralStepTuning,
    SideSteps,
    lateral_step_tuning,
)
from controllers.gaits.walking import walk_tuning
from controllers.reference import reference_here
from robots.description import RobotDescription
from robots.errors import ConfigError, DescriptionError
from robots.loader import load_robot
from robots.messages import RobotState
from robots.pinocchio_model import standing_configuration
from tests.support.states import kinematics_of

APART, STRIDE, WIDTH = 0.1, 0.3, 0.2
PLANNER = SideSteps(APART, STRIDE, WIDTH)

stances = st.builds(Foothold, st.floats(-3, 3), st.floats(-3, 3), st.floats(-math.pi, math.pi))
rates = st.floats(-1, 1)
feet = st.sampled_from([LEFT, RIGHT])


def standing(robot: RobotDescription) -> RobotState:
    q = standing_configuration(robot)
    weight = 9.81 * robot.total_mass
    nj = len(robot.joints)
    return RobotState(q, np.zeros(6 + nj), np.zeros(nj), 0.0, np.array([0.5, 0.5]) * weight)


def gait_of(robot: RobotDescription) -> LateralSteps:
    return LateralSteps(kinematics_of(robot, standing(robot)), lateral_step_tuning(robot), walk_tuning(robot))


@given(stances, feet, rates, rates, rates)
def test_a_foot_goes_straight_to_its_own_side(stance: Foothold, swing: int, vx: float, vy: float, wz: float) -> None:
    """At the distance of its part: leading, trailing or closing; only the sign of vy says which."""
    foothold = PLANNER.next_foothold(stance, swing, VelocityCommand(vx, vy, wz))
    x, y, yaw = stance.relative(foothold)
    side = 1 if swing == LEFT else -1
    leads = vy * side > 0
    assert side * y == pytest.approx(WIDTH if vy == 0 else STRIDE if leads else APART, abs=1e-12)
    assert (x, yaw) == pytest.approx((0, 0), abs=1e-12)


@given(stances, st.integers(1, 5))
def test_steps_there_and_back_end_where_they_began(stance: Foothold, pairs: int) -> None:
    """Two steps carry both feet sideways by stride less apart; as many back undo it."""
    positions = [stance.compose(0.0, APART, 0.0), stance]
    began = [positions[LEFT].point, positions[RIGHT].point]
    for direction, order in ((1.0, (LEFT, RIGHT)), (-1.0, (RIGHT, LEFT))):
        for swing in order * pairs:
            command = VelocityCommand(vy=direction)
            positions[swing] = PLANNER.next_foothold(positions[1 - swing], swing, command)
        moved = stance.axes.T @ (positions[RIGHT].point - began[RIGHT])
        expected = pairs * (STRIDE - APART) if direction > 0 else 0.0
        np.testing.assert_allclose(moved, [0.0, expected], atol=1e-9)
    np.testing.assert_allclose(positions[LEFT].point, began[LEFT], atol=1e-9)


def test_the_trailing_foot_is_sent_into_the_other_one(robot: RobotDescription) -> None:
    """Flat beside each other the feet's capsules are parallel, each in the plane of its sole's centre line."""
    bodies = {shape.name: shape for shape in robot.collisions}
    left, right = bodies["left_foot"], bodies["right_foot"]
    apart = lateral_step_tuning(robot).apart
    assert left.start[1] == left.end[1] == right.start[1] == right.end[1] == 0
    assert left.radius + right.radius - apart > {"g1": 0.03, "tocabi": 0.035}[robot.name]


def test_walking_does_not_take_the_footholds_apart(robot: RobotDescription) -> None:
    """Its bounds contain them, on either side and in either part."""
    gait, tuning = gait_of(robot), lateral_step_tuning(robot)
    stance = Foothold(0.3, -0.2, 0.4)
    for swing, side in ((LEFT, 1.0), (RIGHT, -1.0)):
        for distance in (tuning.apart, tuning.stride):
            foothold = stance.compose(0.0, side * distance, 0.0)
            kept = gait.walking.limits.clamp(stance, foothold, swing)
            assert (kept.x, kept.y, kept.yaw) == pytest.approx((foothold.x, foothold.y, foothold.yaw), abs=1e-12)


def test_steps_to_the_left_then_to_the_right_then_rest(robot: RobotDescription) -> None:
    gait, state, n = gait_of(robot), standing(robot), lateral_step_tuning(robot).steps
    kin = kinematics_of(robot, state)
    reference, directions = reference_here(kin, with_hands=False), []
    for done in range(2 * n + 2):
        gait.walking.steps = done
        gait.apply(reference, 0.0, state, kin)
        directions.append(np.sign(gait.walking.command.vy))
        assert gait.walking.command.vx == gait.walking.command.wz == 0
    assert directions == [1.0] * n + [-1.0] * n + [0.0, 0.0]
    gait.stop()
    gait.walking.steps = 0
    gait.apply(reference, 0.0, state, kin)
    assert not gait.walking.command.walks


def test_the_distance_of_the_feet_does_not_depend_on_where_the_robot_stands(robot: RobotDescription) -> None:
    state = standing(robot)
    turned = state.q.copy()
    turned[:2] += (2.0, -1.0)
    turned[3:7] = (0.0, 0.0, math.sin(0.6), math.cos(0.6))
    moved = dataclasses.replace(state, q=turned)
    kin = kinematics_of(robot, state)
    left, right = (kin.frame_placement(kin.frame_id(robot.roles[r]))[1] for r in ("left_sole", "right_sole"))
    assert Feet(kin).width == pytest.approx(np.linalg.norm(left - right), abs=1e-9)
    assert Feet(kinematics_of(robot, moved)).width == pytest.approx(Feet(kin).width, abs=1e-9)


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"apart": 0.0}, "apart"),
        ({"apart": math.nan}, "apart"),
        ({"stride": 0.1}, "stride"),
        ({"stride": -0.3}, "stride"),
        ({"steps": 0}, "steps"),
        ({"steps": 2.5}, "steps"),
        ({"single_support": 0}, "single_support"),
        ({"double_support": -1.0}, "double_support"),
    ],
)
def test_settings_that_are_none_are_refused_by_name(change: dict[str, Any], name: str) -> None:
    with pytest.raises(ConfigError, match=f"lateral_steps {name}"):
        LateralStepTuning(**{"apart": APART, "stride": STRIDE, **change})


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({}, "apart.*stride"),
        ({"apart": 0.1}, "missing.*stride"),
        ({"apart": 0.1, "stride": 0.3, "stepps": 4}, "stepps.*among apart, stride, steps"),
        ([0.1, 0.3], "a table"),
    ],
)
def test_a_description_without_side_steps_is_told_what_is_missing(table: Any, words: str) -> None:
    robot = load_robot("g1")
    other = dataclasses.replace(robot, tuning={**robot.tuning, "lateral_steps": table})
    with pytest.raises(DescriptionError, match=words):
        lateral_step_tuning(other)
