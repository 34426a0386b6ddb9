"""The filter's velocity is the best one: against a second solver, by optimality conditions, and for stance feet."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import Bounds, minimize, nnls

from robots.description import RobotDescription
from robots.kinematics import Kinematics
from robots.messages import Array
from robots.pinocchio_model import standing_configuration
from safety.barriers.barrier_set import BarrierSet, CollisionBodies, ObstacleBarrier, standard_barriers
from safety.barriers.rows import BarrierRows, HalfSpaces
from safety.filters.conditions import BarrierParameters, FamilyParameters
from safety.filters.safety_filter import KINDS, FilterStatus, MetricWeights, SafetyFilter
from safety.geometry.shapes import Obstacle
from tests.support.rows import copied
from wbc.qp import UNBOUNDED, make_solver

PARAMETERS = BarrierParameters(
    joint_limit=FamilyParameters(10.0, 10.0),
    self_collision=FamilyParameters(5.0, 2.0),
    leg_collision=FamilyParameters(5.0, 10.0),
    obstacle=FamilyParameters(5.0, 5.0),
    workspace=FamilyParameters(5.0, 5.0),
)
NAMES = ("cbf", "issf")


@pytest.fixture(scope="module")
def barriers(kin: Kinematics) -> BarrierSet:
    return standard_barriers(kin, ("sphere",))


@pytest.fixture(scope="module")
def v_max(robot: RobotDescription) -> Array:
    return np.concatenate([np.full(3, 2.0), np.full(3, 4.0), 0.5 * robot.joint_array("velocity")])


def rows_with(kin: Kinematics, barriers: BarrierSet, q: Array, obstacle: Obstacle) -> BarrierRows:
    kin.update_geometry(q)
    next(b for b in barriers.barriers if isinstance(b, ObstacleBarrier)).set_obstacles([obstacle])
    return copied(barriers.evaluate(kin))


def conditions_of(name: str, rows: BarrierRows) -> HalfSpaces:
    condition = KINDS[name].condition
    assert condition is not None
    return condition(rows, PARAMETERS.of_rows(rows.family, KINDS[name].margins))


def random_case(kin: Kinematics, barriers: BarrierSet, rng: np.random.Generator) -> tuple[BarrierRows, Array]:
    """Hands in front, a moving obstacle about there, and a nominal velocity that needs filtering."""
    q = standing_configuration(kin.robot, "hands_front")
    lower, upper = kin.robot.position_limits
    q[7:] = np.clip(q[7:] + rng.normal(scale=0.1, size=q.size - 7), lower, upper)
    place = np.array([0.6, 0.0, 1.1 * q[2]]) + rng.normal(scale=0.1, size=3)
    obstacle = Obstacle.sphere(place, 0.05, rng.normal(scale=0.3, size=3))
    return rows_with(kin, barriers, q, obstacle), 3 * rng.normal(size=kin.nv)


def foot_jacobian(kin: Kinematics) -> Array:
    return np.vstack([kin.frame_jacobian(kin.frame_id(s.frame)) for s in kin.robot.soles])


def cost(v: Array, v_des: Array, feet: Array, weight: float) -> float:
    """The filter's objective."""
    off = v - v_des
    return float(off @ off + weight * np.sum((feet @ off) ** 2))


def second_opinion(spaces: HalfSpaces, v_des: Array, feet: Array, weight: float, v_max: Array) -> Array:
    """The same problem in coordinates u = L^T (v - v_des), where its Hessian is the identity, by ProxQP."""
    n, m = spaces.A.shape[1], spaces.b.size
    factor = np.linalg.cholesky(np.eye(n) + weight * feet.T @ feet)
    back = np.linalg.inv(factor.T)
    rows = np.vstack([spaces.A, np.eye(n)]) @ back
    lower = np.concatenate([spaces.b - spaces.A @ v_des, -v_max - v_des])
    upper = np.concatenate([np.full(m, UNBOUNDED), v_max - v_des])
    free = np.full(n, UNBOUNDED)
    solver = make_solver("proxqp", n, m + n)
    solution = solver.solve(np.eye(n), np.zeros(n), rows, np.append(-free, lower), np.append(free, upper))
    assert solution.status == "optimal"
    return v_des + back @ solution.x


@pytest.mark.parametrize("weight", [0.0, 1.0, 1e3])
@pytest.mark.parametrize("name", NAMES)
def test_the_velocity_is_a_second_solvers(
    name: str, weight: float, kin: Kinematics, barriers: BarrierSet, v_max: Array
) -> None:
    rng = np.random.default_rng(1)
    safety_filter = SafetyFilter(name, barriers.size, PARAMETERS, v_max, MetricWeights(weight))
    compared = 0
    for _ in range(8):
        rows, v_des = random_case(kin, barriers, rng)
        feet = foot_jacobian(kin)
        result = safety_filter.apply(rows, v_des, feet)
        if result.status != FilterStatus.FILTERED:
            continue
        other = second_opinion(conditions_of(name, rows), v_des, feet, weight, v_max)
        np.testing.assert_allclose(result.v, other, rtol=0, atol=1e-6)
        assert cost(result.v, v_des, feet, weight) == pytest.approx(cost(other, v_des, feet, weight), rel=1e-6)
        compared += 1
    assert compared >= 5


@pytest.mark.parametrize("name", NAMES)
def test_one_row_alone_has_the_closed_form(name: str) -> None:
    rng = np.random.default_rng(2)
    feet = rng.normal(size=(4, 6))
    for weight in (0.0, 10.0):
        one = SafetyFilter(name, 1, PARAMETERS, np.full(6, 1e3), MetricWeights(weight))
        rows = BarrierRows(np.array([0.01]), rng.normal(size=(1, 6)), np.zeros(1), np.full(1, 3, dtype=np.intp))
        spaces = conditions_of(name, rows)
        a, b = spaces.A[0], spaces.b[0]
        v_des = rng.normal(size=6) - 2 * a
        step = np.linalg.solve(np.eye(6) + weight * feet.T @ feet, a)
        expected = v_des + step * (b - a @ v_des) / (a @ step)
        np.testing.assert_allclose(one.apply(rows, v_des, feet).v, expected, rtol=0, atol=1e-8)


@pytest.mark.parametrize("name", NAMES)
def test_no_feet_and_no_weight_are_the_same_problem(
    name: str, kin: Kinematics, barriers: BarrierSet, v_max: Array
) -> None:
    rows, v_des = random_case(kin, barriers, np.random.default_rng(3))
    without = SafetyFilter(name, barriers.size, PARAMETERS, v_max, MetricWeights(0.0))
    weighted = SafetyFilter(name, barriers.size, PARAMETERS, v_max, MetricWeights(1e3))
    expected = without.apply(rows, v_des).v
    for result in (without.apply(rows, v_des, foot_jacobian(kin)), weighted.apply(rows, v_des)):
        np.testing.assert_allclose(result.v, expected, rtol=0, atol=1e-8)


@pytest.mark.parametrize("name", NAMES)
def test_feet_and_balance_are_two_weights_of_one_objective(
    name: str, kin: Kinematics, barriers: BarrierSet, v_max: Array
) -> None:
    rows, v_des = random_case(kin, barriers, np.random.default_rng(7))
    feet, balance = foot_jacobian(kin), np.random.default_rng(8).normal(scale=0.3, size=(6, kin.nv))
    both = SafetyFilter(name, barriers.size, PARAMETERS, v_max, MetricWeights(40.0, 90.0))
    one = SafetyFilter(name, barriers.size, PARAMETERS, v_max, MetricWeights(1.0))
    expected = one.apply(rows, v_des, np.vstack([np.sqrt(40.0) * feet, np.sqrt(90.0) * balance]))
    result = both.apply(rows, v_des, feet, balance)
    assert result.status == expected.status == FilterStatus.FILTERED
    np.testing.assert_allclose(result.v, expected.v, rtol=0, atol=1e-8)


def overly_tight(kin: Kinematics, rows: BarrierRows, rng: np.random.Generator) -> BarrierRows:
    """Several joints beyond both limits and all bodies deep in each other: many rows in conflict."""
    nj, h = kin.nv - 6, rows.h.copy()
    joints = rng.choice(nj, 5, replace=False)
    h[joints] -= 4.0
    h[joints + nj] -= 4.0
    h[2 * nj :] -= rng.uniform(0.0, 0.3, h.size - 2 * nj)
    return replace(rows, h=h)


def violation(spaces: HalfSpaces, v: Array) -> Array:
    return np.maximum(0.0, spaces.b - spaces.A @ v)


@pytest.mark.parametrize("name", NAMES)
def test_relaxed_velocities_have_the_least_sum_of_squared_violations(
    name: str, kin: Kinematics, barriers: BarrierSet, v_max: Array
) -> None:
    rng = np.random.default_rng(4)
    safety_filter = SafetyFilter(name, barriers.size, PARAMETERS, v_max)
    for _ in range(6):
        rows, v_des = random_case(kin, barriers, rng)
        rows = overly_tight(kin, rows, rng)
        result = safety_filter.apply(rows, v_des)
        assert result.status == FilterStatus.RELAXED
        spaces = conditions_of(name, rows)
        slack = violation(spaces, result.v)
        assert result.slack == pytest.approx(slack.max(), abs=1e-12)
        assert slack @ slack <= least_squared_violation(spaces, v_max) * (1 + 1e-6) + 1e-6
        assert slack @ slack <= 2 * dual_bound(spaces, slack, v_max) * (1 + 1e-6) + 1e-6


def least_squared_violation(spaces: HalfSpaces, v_max: Array) -> float:
    """The least sum of squared violations of a velocity between bounds, by scipy, from zero velocity."""

    def half(v: Array) -> tuple[float, Array]:
        slack = violation(spaces, v)
        return 0.5 * float(slack @ slack), -spaces.A.T @ slack

    options = {"maxiter": 20000, "maxfun": 20000, "ftol": 1e-15, "gtol": 1e-10}
    bounds = Bounds(-v_max, v_max)
    return 2 * float(minimize(half, 0 * v_max, jac=True, method="L-BFGS-B", bounds=bounds, options=options).fun)


def dual_bound(spaces: HalfSpaces, multipliers: Array, v_max: Array) -> float:
    """What half the sum of squared violations cannot be below, by weak duality, for any multipliers >= 0."""
    box = v_max @ np.abs(spaces.A.T @ multipliers)
    return float(spaces.b @ multipliers - 0.5 * multipliers @ multipliers - box)


@pytest.mark.parametrize("name", NAMES)
def test_among_least_violations_the_velocity_nearest_to_the_nominal_is_taken(
    name: str, kin: Kinematics, barriers: BarrierSet, v_max: Array
) -> None:
    rng = np.random.default_rng(5)
    rows, v_des = random_case(kin, barriers, rng)
    rows, feet = overly_tight(kin, rows, rng), foot_jacobian(kin)
    result = SafetyFilter(name, barriers.size, PARAMETERS, v_max, MetricWeights(10.0)).apply(rows, v_des, feet)
    assert result.status == FilterStatus.RELAXED
    spaces = conditions_of(name, rows)
    # nearest under the rows relaxed by that: the cost's gradient is a non-negative sum of sides at their limit
    eye = np.eye(kin.nv)
    at_limit = (spaces.A @ result.v - spaces.b + violation(spaces, result.v)) < 1e-7
    sides = np.vstack([spaces.A[at_limit], eye[result.v <= -v_max + 1e-9], -eye[result.v >= v_max - 1e-9]])
    gradient = (eye + 10.0 * feet.T @ feet) @ (result.v - v_des)
    assert nnls(sides.T, gradient, maxiter=10000)[1] < 1e-8 * np.linalg.norm(gradient)
    assert at_limit.sum() < kin.nv


def obstacle_before_the_torso(kin: Kinematics) -> Obstacle:
    """A sphere that comes from the front at 0.2 m/s, 2 cm before the upper torso."""
    kin.update_geometry(standing_configuration(kin.robot))
    bodies = CollisionBodies(kin)
    bodies.place(kin)
    i = bodies.names.index("torso_high")
    middle = bodies.origin[i] + 0.5 * bodies.direction[i]
    middle[0] += 0.1 + bodies.radius[i] + 0.02
    return Obstacle.sphere(middle, 0.1, np.array([-0.2, 0, 0]))


@pytest.mark.parametrize("name", NAMES)
def test_stance_feet_stay_where_an_obstacle_pushes_the_torso(
    name: str, kin: Kinematics, barriers: BarrierSet, v_max: Array
) -> None:
    rows = rows_with(kin, barriers, standing_configuration(kin.robot), obstacle_before_the_torso(kin))
    feet, still, speed = foot_jacobian(kin), np.zeros(kin.nv), []
    for weight in (0.0, 1.0, 1e1, 1e2, 1e3, 1e4):
        result = SafetyFilter(name, barriers.size, PARAMETERS, v_max, MetricWeights(weight)).apply(rows, still, feet)
        assert result.status == FilterStatus.FILTERED
        assert result.slack <= 1e-8
        # the torso gives way all the same
        assert np.linalg.norm(result.v[:3]) > 0.03
        speed.append(np.linalg.norm(feet @ result.v))
    # over one set of velocities, more weight never means more foot velocity; far enough it falls as its inverse
    assert all(b <= a * (1 + 1e-9) for a, b in pairwise(speed))
    assert speed[0] > 0.1
    assert speed[4] < 0.01 * speed[0]
    assert speed[5] == pytest.approx(0.1 * speed[4], rel=0.1)


@pytest.mark.parametrize("name", NAMES)
def test_stance_feet_leave_a_velocity_where_leg_rows_and_joint_limits_bind(
    name: str, kin: Kinematics, barriers: BarrierSet, v_max: Array
) -> None:
    rows = rows_with(kin, barriers, standing_configuration(kin.robot), obstacle_before_the_torso(kin))
    h, cut, nj = rows.h.copy(), barriers.slices["leg_collision"], kin.nv - 6
    legs = [i for i, n in enumerate(kin.robot.joint_names) if "hip" in n.lower() or "knee" in n.lower()]
    assert len(legs) == 8
    h[cut] = -0.01
    h[legs[:4]] = h[[nj + i for i in legs[4:]]] = 0.0
    tight = replace(rows, h=h)
    rng = np.random.default_rng(6)
    for _ in range(5):
        v_des = rng.normal(size=kin.nv)
        result = SafetyFilter(name, barriers.size, PARAMETERS, v_max).apply(tight, v_des, foot_jacobian(kin))
        assert result.status == FilterStatus.FILTERED
        assert result.slack <= 1e-8
        assert result.active >= 4
