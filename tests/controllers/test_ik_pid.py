"""Nominal policy of SPARK's benchmark: its law, its bounds, and the base's own axes."""

import numpy as np
import pytest

from controllers.policies.hand_ik import HandIk
from controllers.policies.ik_pid import DAMPING, STIFFNESS, IkPidPolicy
from controllers.policies.nominal import benchmark_limits
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.pinocchio_model import upper_body_joints

ROBOT = load_robot("g1")
JOINTS = upper_body_joints(ROBOT)
POINTS = [(ROBOT.roles[hand], np.zeros(3)) for hand in ("left_hand", "right_hand")]
IK = HandIk(ROBOT, JOINTS, POINTS)


def made(base: str, limit: float | None = None) -> tuple[Kinematics, IkPidPolicy]:
    kin = Kinematics(ROBOT, base=base, joints=JOINTS)
    kin.update_geometry(kin.posture("standing"))
    limits = benchmark_limits(kin) if limit is None else np.full(kin.nv, limit)
    return kin, IkPidPolicy(kin, IK, limits)


def test_hands_where_they_are_stay_there() -> None:
    kin, policy = made("fixed")
    np.testing.assert_allclose(policy.velocity(kin), 0.0, atol=1e-4)
    v = np.random.default_rng(0).normal(size=kin.nv)
    _, free = made("fixed", 1e3)
    np.testing.assert_allclose(free.acceleration(kin, v), -DAMPING * v, atol=1e-3)


def test_it_goes_to_what_inverse_kinematics_finds_within_its_bounds() -> None:
    kin, policy = made("fixed")
    policy.hand_goals = np.array([[0.35, 0.3, 0.25], [0.3, -0.2, 0.1]])
    way = IK.solve(kin.q, policy.hand_goals) - kin.q
    assert np.abs(way).max() > 0.3
    limits = benchmark_limits(kin)
    np.testing.assert_allclose(policy.velocity(kin), np.clip(way, -limits, limits), atol=1e-12)
    _, free = made("fixed", 1e3)
    free.hand_goals = policy.hand_goals
    np.testing.assert_allclose(free.acceleration(kin, np.zeros(17)), STIFFNESS * way, atol=1e-12)


@pytest.mark.parametrize("goal", [(0.3, -0.2, 1.0), (-0.5, 0.1, -3.0), (0.0, 0.0, 3.1)])
def test_the_base_gets_there_by_velocities_in_its_own_axes_and_turns_the_shorter_way(
    goal: tuple[float, float, float],
) -> None:
    kin, policy = made("planar", 1e3)
    policy.base_goal = np.array(goal)
    q, turned = kin.posture("standing"), 0.0
    q[:4] = 0.1, 0.2, np.cos(2.0), np.sin(2.0)
    for _ in range(1500):
        kin.update_geometry(q)
        v = policy.velocity(kin)
        turned += 0.01 * v[2]
        q = kin.integrate(q, v, 0.01)
    np.testing.assert_allclose(q[:2], goal[:2], atol=1e-4)
    np.testing.assert_allclose(q[2:4], [np.cos(goal[2]), np.sin(goal[2])], atol=1e-4)
    assert abs(turned) <= np.pi


def test_what_is_not_allowed_is_named() -> None:
    kin, _ = made("fixed")
    with pytest.raises(ConfigError, match="limits"):
        IkPidPolicy(kin, IK, np.zeros(17))
    with pytest.raises(ConfigError, match="joints"):
        IkPidPolicy(kin, HandIk(ROBOT, [n for n in JOINTS if n.startswith("right")], POINTS[1:]), np.ones(17))
    floating = Kinematics(ROBOT)
    with pytest.raises(ConfigError, match="floating"):
        IkPidPolicy(floating, IK, np.ones(floating.nv))
