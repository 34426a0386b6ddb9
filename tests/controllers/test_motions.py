"""Motions: each velocity and acceleration is the derivative it claims to be, and starts are smooth."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controllers.motions.hands import (
    MIRROR,
    CenterOfMassShift,
    CircleSettings,
    HandCircles,
    HandsToTargets,
    Motion,
    circle_settings,
)
from controllers.motions.quintic import quintic
from controllers.reference import PointReference, WholeBodyReference, reference_here
from robots.description import RobotDescription
from robots.errors import ConfigError, DescriptionError
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array
from robots.pinocchio_model import standing_configuration

LEFT, RIGHT = np.array([0.3, 0.2, 0.9]), np.array([0.3, -0.2, 0.9])
STEP = 1e-4


@pytest.fixture
def reference() -> WholeBodyReference:
    kin = Kinematics(load_robot("g1"))
    kin.update(standing_configuration(kin.robot), np.zeros(kin.nv))
    return reference_here(kin, with_hands=True)


def circles(**changes: Any) -> HandCircles:
    settings = CircleSettings(0.1, np.array([-1.0, -0.3, 0.1]), np.array([0.0, 0.2, 1.0]), 5.0)
    return HandCircles(replace(settings, **changes), (LEFT, RIGHT))


def left_hand(reference: WholeBodyReference) -> PointReference:
    assert reference.hands is not None
    return reference.hands[0]


def right_hand(reference: WholeBodyReference) -> PointReference:
    assert reference.hands is not None
    return reference.hands[1]


def com(reference: WholeBodyReference) -> PointReference:
    return reference.com


MOTIONS: list[tuple[str, Motion, Callable[[WholeBodyReference], PointReference]]] = [
    ("circle, left", circles(), left_hand),
    ("circle, right", circles(), right_hand),
    ("CoM", CenterOfMassShift(LEFT, RIGHT, 1.5), com),
    ("target, left", HandsToTargets((LEFT, RIGHT), (LEFT + 1.0, RIGHT - 1.0), 2.0), left_hand),
    ("target, right", HandsToTargets((LEFT, RIGHT), (LEFT + 1.0, RIGHT - 1.0), 2.0), right_hand),
]
EACH = pytest.mark.parametrize(("motion", "pick"), [m[1:] for m in MOTIONS], ids=[m[0] for m in MOTIONS])


def at(
    motion: Motion, pick: Callable[[WholeBodyReference], PointReference], r: WholeBodyReference, t: float
) -> PointReference:
    motion.apply(r, t)
    return pick(r)


@EACH
def test_velocity_and_acceleration_are_derivatives(motion: Motion, pick: Any, reference: WholeBodyReference) -> None:
    """Central differences; their error is STEP^2 times a third derivative of order 1 to 100 m/s^3."""
    for t in np.linspace(0.01, 6.9, 47):
        before, now, after = (at(motion, pick, reference, t + k * STEP) for k in (-1, 0, 1))
        np.testing.assert_allclose((after.position - before.position) / (2 * STEP), now.velocity, atol=1e-6)
        np.testing.assert_allclose((after.velocity - before.velocity) / (2 * STEP), now.acceleration, atol=1e-5)


@EACH
def test_motions_start_at_rest_and_without_a_jump(motion: Motion, pick: Any, reference: WholeBodyReference) -> None:
    start = at(motion, pick, reference, 0.0)
    np.testing.assert_allclose(start.velocity, 0, atol=1e-12)
    np.testing.assert_allclose(start.acceleration, 0, atol=1e-12)
    right = pick in (right_hand,)
    np.testing.assert_allclose(start.position, RIGHT if right else LEFT, atol=1e-15)


@pytest.mark.parametrize("t", [0.3, 1.0, 2.2, 3.0, 5.5])
def test_the_right_hand_mirrors_the_left(reference: WholeBodyReference, t: float) -> None:
    motion = circles()
    left, right = (at(motion, pick, reference, t) for pick in (left_hand, right_hand))
    np.testing.assert_allclose(right.position, MIRROR * left.position, atol=1e-15)
    np.testing.assert_allclose(right.velocity, MIRROR * left.velocity, atol=1e-15)
    np.testing.assert_allclose(right.acceleration, MIRROR * left.acceleration, atol=1e-15)


def test_circles_are_circles_of_the_radius_and_period_asked_for(reference: WholeBodyReference) -> None:
    """About p0 + r u, at speed 2 pi r / T once under way; half a turn leads to p0 + 2 r u."""
    motion, u = circles(), np.array([-1.0, -0.3, 0.1])
    u /= np.linalg.norm(u)
    centre = LEFT + 0.1 * u
    for t in np.linspace(0, 9, 40):
        point = at(motion, left_hand, reference, float(t))
        assert np.linalg.norm(point.position - centre) == pytest.approx(0.1, abs=1e-12)
        if t >= 1.0:
            assert np.linalg.norm(point.velocity) == pytest.approx(2 * np.pi * 0.1 / 5.0, rel=1e-12)
            again = at(motion, left_hand, reference, float(t) + 5.0)
            np.testing.assert_allclose(again.position, point.position, atol=1e-12)
    # the start costs half its duration
    deepest = at(motion, left_hand, reference, 2.5 + 0.5)
    np.testing.assert_allclose(deepest.position, LEFT + 0.2 * u, atol=1e-12)


def test_the_circle_starts_upward(reference: WholeBodyReference) -> None:
    point = at(circles(), left_hand, reference, 0.3)
    assert point.velocity @ np.array([0.0, 0.2, 1.0]) > 0


def test_shifts_and_targets_arrive_and_stay(reference: WholeBodyReference) -> None:
    for t in (1.5, 1.6, 100.0):
        point = at(CenterOfMassShift(LEFT, RIGHT, 1.5), com, reference, t)
        np.testing.assert_allclose(point.position, RIGHT, atol=1e-15)
        np.testing.assert_array_equal(point.velocity, 0)
        np.testing.assert_array_equal(point.acceleration, 0)


@given(t=st.floats(-1, 3), duration=st.floats(0.01, 10))
def test_quintic_is_monotone_between_its_ends_and_symmetric(t: float, duration: float) -> None:
    value, rate, _ = quintic(t, duration)
    mirrored, same_rate, _ = quintic(duration - t, duration)
    assert -1e-12 <= value <= 1 + 1e-12
    assert rate >= 0
    assert value + mirrored == pytest.approx(1.0, abs=1e-9)
    assert same_rate == pytest.approx(rate, rel=1e-6, abs=1e-6 / duration)


def test_quintic_does_not_move_before_and_after() -> None:
    assert quintic(-1.0, 2.0) == (0.0, 0.0, 0.0)
    assert quintic(3.0, 2.0) == (1.0, 0.0, 0.0)


@pytest.mark.parametrize("name", ["radius", "period", "start"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan")])
def test_bad_circles_are_refused_by_name(name: str, value: float) -> None:
    with pytest.raises(ConfigError, match=f"circle {name}"):
        circles(**{name: value})


@pytest.mark.parametrize(
    "direction", [np.array([np.nan, 0, 0]), np.array([1.0, 0]), np.array([np.inf, 0, 0]), np.eye(3)]
)
@pytest.mark.parametrize("name", ["inward", "upward"])
def test_bad_directions_are_refused_by_name(name: str, direction: Array) -> None:
    with pytest.raises(ConfigError, match=f"circle {name}"):
        circles(**{name: direction})


def test_parallel_directions_are_refused() -> None:
    with pytest.raises(ConfigError, match="two different directions"):
        circles(inward=np.array([0.0, 0.2, 1.0]))


@pytest.mark.parametrize(
    ("table", "named"),
    [
        ({}, "missing"),
        ({"radius": 0.1, "inward": [1, 0, 0], "upward": [0, 0, 1]}, "period"),
        ({"radius": 0.1, "inward": "x", "upward": [0, 0, 1], "period": 5.0}, "inward"),
        ({"radius": 0.1, "inward": [1, 0], "upward": [0, 0, 1], "period": 5.0}, "inward"),
        ({"radius": "wide", "inward": [1, 0, 0], "upward": [0, 0, 1], "period": 5.0}, "radius"),
        ({"radius": 0.1, "inward": [1, 0, 0], "upward": [0, 0, 1], "period": [5.0]}, "period"),
    ],
)
def test_a_table_that_is_no_circle_is_refused(table: dict[str, Any], named: str) -> None:
    robot = replace(load_robot("g1"), tuning={"hand_tracking": table})
    with pytest.raises((ConfigError, DescriptionError), match=named):
        circle_settings(robot)


@pytest.mark.parametrize("duration", [0.0, -1.0, float("nan")])
def test_motions_that_take_no_time_are_refused(duration: float) -> None:
    with pytest.raises(ConfigError, match="CoM shift"):
        CenterOfMassShift(LEFT, RIGHT, duration)
    with pytest.raises(ConfigError, match="hand motion"):
        HandsToTargets((LEFT, RIGHT), (LEFT, RIGHT), duration)


def test_reference_here_keeps_the_robot_where_it_is(robot: RobotDescription) -> None:
    kin = Kinematics(robot)
    kin.update(standing_configuration(robot), np.zeros(kin.nv))
    reference = reference_here(kin, with_hands=True)
    kin.update(np.concatenate([[9.0, 9, 9], kin.q[3:]]), np.zeros(kin.nv))
    soles = [kin.frame_placement(kin.frame_id(s.frame)) for s in robot.soles]
    for point, axes, (rotation, position) in zip(reference.soles, reference.sole_rotations, soles, strict=True):
        # copies, not views: the robot has moved by 9 m since
        assert np.linalg.norm(point.position - position) > 10
        np.testing.assert_allclose(axes, rotation, atol=1e-12)
    middle = 0.5 * (reference.soles[0].position + reference.soles[1].position)
    np.testing.assert_allclose(reference.com.position[:2], middle[:2], atol=1e-15)
    assert reference.in_contact.all()
    assert reference_here(kin, with_hands=False).hands is None
