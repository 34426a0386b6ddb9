"""The nominal policy reaches its goals, in the order of its levels and within its bounds."""

import numpy as np
import pytest

from controllers.policies.nominal import NominalPolicy, PlanarBaseTask, PointTask, benchmark_limits
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array
from robots.pinocchio_model import upper_body_joints
from sims.kinematic import KinematicPlant
from wbc.tasks import TaskGains

POINTS = (("left_wrist_yaw_link", np.array([0.05, 0.0, 0.0])), ("right_wrist_yaw_link", np.array([0.05, 0.0, 0.0])))
DT = 0.02


def upper_body(base: str) -> Kinematics:
    robot = load_robot("g1")
    kin = Kinematics(robot, base=base, joints=upper_body_joints(robot))
    kin.update_geometry(kin.posture("hands_front"))
    return kin


def policy_for(kin: Kinematics, limits: Array | None = None) -> NominalPolicy:
    return NominalPolicy(kin, POINTS, kin.posture("hands_front")[kin.nq_base :], limits=limits)


def follow(kin: Kinematics, policy: NominalPolicy, ticks: int, order: int = 1) -> KinematicPlant:
    plant = KinematicPlant(kin, kin.q, order)
    for _ in range(ticks):
        kin.update_geometry(plant.q)
        plant.step(policy.velocity(kin) if order == 1 else policy.acceleration(kin, plant.v), DT)
    kin.update_geometry(plant.q)
    return plant


def test_the_point_task_is_the_derivative_of_the_point() -> None:
    kin = upper_body("planar")
    rng = np.random.default_rng(0)
    q = kin.integrate(kin.posture(), rng.normal(size=kin.nv), 0.5)
    task = PointTask(kin.frame_id("left_wrist_yaw_link"), np.array([0.05, -0.02, 0.03]), TaskGains(2.0))
    kin.update_geometry(q)
    jacobian, _ = task.evaluate(kin)
    for v in np.eye(kin.nv):
        ends = []
        for step in (1e-6, -1e-6):
            kin.update_geometry(kin.integrate(q, v, step))
            ends.append(task.place(kin))
        np.testing.assert_allclose(jacobian @ v, (ends[0] - ends[1]) / 2e-6, rtol=0, atol=1e-8)


def test_at_its_goals_in_its_posture_it_rests() -> None:
    kin = upper_body("fixed")
    np.testing.assert_allclose(policy_for(kin).velocity(kin), 0.0, atol=1e-12)


@pytest.mark.parametrize("order", [1, 2])
def test_hands_reach_their_goals(order: int) -> None:
    kin = upper_body("fixed")
    policy = policy_for(kin, benchmark_limits(kin))
    goals = [
        task.position + shift for task, shift in zip(policy.points, np.array([[0.06, 0.02, 0.05]] * 2), strict=True)
    ]
    for task, goal in zip(policy.points, goals, strict=True):
        task.position = goal
    follow(kin, policy, 500, order)
    for task, goal in zip(policy.points, goals, strict=True):
        np.testing.assert_allclose(task.place(kin), goal, rtol=0, atol=1e-4)


def test_base_and_hands_reach_their_goals_together() -> None:
    kin = upper_body("planar")
    policy = policy_for(kin, benchmark_limits(kin))
    assert policy.base is not None
    policy.base.goal = np.array([0.4, -0.3, 2.5])
    c, s = np.cos(2.5), np.sin(2.5)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    goals = [turn @ task.position + [0.4, -0.3, 0.03] for task in policy.points]
    for task, goal in zip(policy.points, goals, strict=True):
        task.position = goal
    plant = follow(kin, policy, 900)
    np.testing.assert_allclose(plant.q[:4], [0.4, -0.3, c, s], rtol=0, atol=1e-3)
    for task, goal in zip(policy.points, goals, strict=True):
        np.testing.assert_allclose(task.place(kin), goal, rtol=0, atol=1e-3)


def test_the_hands_outrank_the_posture() -> None:
    """With a posture far away the commanded velocity of the hands is still met exactly."""
    kin = upper_body("fixed")
    policy = NominalPolicy(kin, POINTS, kin.posture() + 0.4)
    for task in policy.points:
        task.position = task.position + np.array([0.02, 0.0, 0.01])
    v = policy.velocity(kin)
    for task in policy.points:
        jacobian, command = task.evaluate(kin)
        np.testing.assert_allclose(jacobian @ v, command, rtol=0, atol=1e-10)
    assert np.linalg.norm(v) > 0.1


@pytest.mark.parametrize(("yaw", "goal", "sign"), [(3.0, -3.0, 1.0), (-3.0, 3.0, -1.0), (0.2, 0.1, -1.0)])
def test_the_base_turns_the_shorter_way(yaw: float, goal: float, sign: float) -> None:
    kin = upper_body("planar")
    q = kin.posture()
    q[2:4] = np.cos(yaw), np.sin(yaw)
    kin.update_geometry(q)
    task = PlanarBaseTask(kin.nv, TaskGains(1.0))
    task.goal = np.array([0.0, 0.0, goal])
    assert np.sign(task.evaluate(kin)[1][2]) == sign


def test_commands_stay_within_the_limits() -> None:
    kin = upper_body("planar")
    limits = benchmark_limits(kin)
    assert limits.tolist() == [0.3] * 3 + [0.1] * 3 + [1.5] * 14
    np.testing.assert_array_equal(benchmark_limits(kin, 2), 100 * limits)
    policy = policy_for(kin, limits)
    assert policy.base is not None
    policy.base.goal = np.array([5.0, 5.0, 1.0])
    for task in policy.points:
        task.position = task.position + np.array([0.0, 0.0, 2.0])
    v = policy.velocity(kin)
    assert (np.abs(v) <= limits).all()
    assert (np.abs(v) == limits).any()


def test_the_acceleration_is_that_of_the_benchmark_s_law() -> None:
    """u = kp e - kd v, with e the posture's error where there is nothing else to do."""
    kin = upper_body("fixed")
    rest = kin.posture("hands_front") + 0.01
    policy = NominalPolicy(kin, (), rest)
    v = np.random.default_rng(2).normal(size=kin.nv)
    gains = policy.gains
    expected = gains.damping * gains.posture.k * (rest - kin.q) - gains.damping * v
    np.testing.assert_allclose(policy.acceleration(kin, v), expected, rtol=0, atol=1e-12)


def test_bad_input_is_refused_by_name() -> None:
    kin = upper_body("fixed")
    with pytest.raises(ConfigError, match="posture"):
        NominalPolicy(kin, POINTS, np.zeros(3))
    with pytest.raises(ConfigError, match="limits"):
        policy_for(kin, np.zeros(kin.nv))
    with pytest.raises(ConfigError, match="order"):
        benchmark_limits(kin, 3)
    floating = Kinematics(load_robot("g1"))
    floating.update_geometry(floating.posture())
    with pytest.raises(ConfigError, match="base = 'floating'"):
        NominalPolicy(floating, (), np.zeros(29))
