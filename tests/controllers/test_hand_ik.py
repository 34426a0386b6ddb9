"""Inverse kinematics of the benchmarks: against pinocchio, at goals within reach, and optimal where there are none."""

import numpy as np
import pinocchio as pin
import pytest

from controllers.policies.hand_ik import MOST_STEPS, TOLERANCE, HandIk
from robots.errors import ConfigError, UnknownNameError
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array
from robots.pinocchio_model import upper_body_joints

ROBOT = load_robot("g1")
JOINTS = upper_body_joints(ROBOT)
OFFSET = np.array([0.05, 0.0, 0.0])
POINTS = [(ROBOT.roles[hand], OFFSET) for hand in ("left_hand", "right_hand")]
HEIGHT = np.array([0.0, 0.0, ROBOT.posture("standing").base_height])
SEEDS = range(25)


@pytest.fixture(scope="module")
def ik() -> HandIk:
    return HandIk(ROBOT, JOINTS, POINTS)


def drawn(ik: HandIk, seed: int) -> tuple[Array, Array]:
    """Two postures within limits."""
    lower, upper = ik.limits
    rng = np.random.default_rng(seed)
    return rng.uniform(lower, upper), rng.uniform(lower, upper)


def kinematics(q: Array) -> tuple[Kinematics, Array, Array]:
    """Kinematics, places (2, 3) of the points in the base's axes and their Jacobian (6, n), by pinocchio."""
    kin = Kinematics(ROBOT, base="fixed", joints=JOINTS)
    kin.update_geometry(q)
    places, rows = [], []
    for name, offset in POINTS:
        rotation, origin = kin.frame_placement(kin.frame_id(name))
        jacobian = kin.frame_jacobian(kin.frame_id(name))
        places.append(origin + rotation @ offset - HEIGHT)
        rows.append(jacobian[:3] - pin.skew(rotation @ offset) @ jacobian[3:])
    return kin, np.array(places), np.vstack(rows)


@pytest.mark.parametrize("seed", SEEDS)
def test_places_are_pinocchios(ik: HandIk, seed: int) -> None:
    q, _ = drawn(ik, seed)
    np.testing.assert_allclose(ik.places(q), kinematics(q)[1], rtol=0.0, atol=1e-13)


def test_goals_within_reach_are_reached_within_limits(ik: HandIk) -> None:
    """Goals of the benchmark, from its first posture: all but a few in 20 steps, none beyond a limit."""
    lower, upper = ik.limits
    start = np.zeros(len(JOINTS))
    start[[JOINTS.index("left_shoulder_roll_joint"), JOINTS.index("right_shoulder_roll_joint")]] = 0.5, -0.5
    missed = 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        left = rng.uniform([0.1, 0.1, 0.0], [0.4, 0.4, 0.3])
        right = rng.uniform([0.1, -0.4, 0.0], [0.4, -0.1, 0.3])
        q = ik.solve(start, np.array([left, right]))
        assert ((q >= lower) & (q <= upper)).all() and ik.steps <= MOST_STEPS
        missed += np.abs(ik.places(q) - [left, right]).max() > TOLERANCE
    assert missed <= 4


@pytest.mark.parametrize("seed", SEEDS)
def test_where_it_ends_no_step_within_limits_leads_nearer(ik: HandIk, seed: int) -> None:
    """Goals far outside: the projected gradient of the sum of squares vanishes (KKT)."""
    q, _ = drawn(ik, seed)
    rng = np.random.default_rng(1000 + seed)
    goals = rng.normal(size=(2, 3))
    goals *= 2.0 / np.linalg.norm(goals, axis=1, keepdims=True)
    for _ in range(60):
        q = ik.solve(q, goals)
    _, places, jacobian = kinematics(q)
    gradient = jacobian.T @ (goals - places).ravel()
    lower, upper = ik.limits
    free = (q > lower) & (q < upper)
    assert np.abs(gradient[free]).max(initial=0.0) < 2e-3
    assert (gradient[q <= lower] < 2e-3).all() and (gradient[q >= upper] > -2e-3).all()


def test_the_first_step_is_the_shortest_of_the_linearised_problem(ik: HandIk) -> None:
    """So what is found stays near the start: compared with the pseudo-inverse, for goals a little way off."""
    q = np.clip(np.full(len(JOINTS), 0.1), *ik.limits)
    _, places, jacobian = kinematics(q)
    for seed in SEEDS:
        way = 1e-3 * np.random.default_rng(seed).normal(size=(2, 3))
        moved = ik.solve(q, places + way) - q
        shortest = np.linalg.pinv(jacobian) @ way.ravel()
        assert np.linalg.norm(moved - shortest) < 0.02 * np.linalg.norm(shortest) + 1e-6


def test_one_arm_alone() -> None:
    arm = [name for name in JOINTS if name.startswith("right_")]
    ik = HandIk(ROBOT, arm, POINTS[1:])
    goal = np.array([[0.3, -0.2, 0.1]])
    q = ik.solve(np.zeros(7), goal)
    np.testing.assert_allclose(ik.places(q), goal, rtol=0.0, atol=2.0 * TOLERANCE)
    with pytest.raises(ConfigError, match="left_"):
        HandIk(ROBOT, arm, POINTS)


def test_what_is_wrong_is_named(ik: HandIk) -> None:
    with pytest.raises(ConfigError, match="goals"):
        ik.solve(np.zeros(17), np.full((2, 3), np.nan))
    with pytest.raises(ConfigError, match="q"):
        ik.solve(np.zeros(3), np.zeros((2, 3)))
    with pytest.raises(UnknownNameError, match="elbow"):
        HandIk(ROBOT, ["elbow"], POINTS)
