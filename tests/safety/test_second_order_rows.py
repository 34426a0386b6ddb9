"""Second derivatives of every row against differences of its rate, and what they must not depend on."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from robots.description import RobotDescription
from robots.kinematics import Kinematics
from robots.messages import Array
from safety.barriers.barrier_set import (
    BarrierSet,
    CollisionBodies,
    ObstacleBarrier,
    SelfCollisionBarrier,
    standard_barriers,
)
from safety.barriers.rows import BarrierRows
from safety.geometry.shapes import Obstacle

KINDS = ("sphere", "capsule", "box", "half_space", "box")
STEP = 2e-6
ROUNDING = 1e-6
"""Relative accuracy of a difference of rates with this step."""


@pytest.fixture(scope="module", params=["floating", "planar", "fixed"])
def kin(robot: RobotDescription, request: pytest.FixtureRequest) -> Kinematics:
    return Kinematics(robot, base=request.param)


@pytest.fixture(scope="module")
def barriers(kin: Kinematics) -> BarrierSet:
    return standard_barriers(kin, KINDS)


def random_obstacles(rng: np.random.Generator, centre: Array) -> list[Obstacle]:
    """One of each kind and another box about ``centre``, moving and turning."""
    place, motion = centre + rng.normal(scale=0.6, size=(5, 3)), rng.normal(size=(5, 2, 3))
    turns = [pin.rpy.rpyToMatrix(rng.normal(size=3)) for _ in range(2)]
    return [
        Obstacle.sphere(place[0], 0.1, motion[0, 0]),
        Obstacle.capsule(place[1], place[1] + rng.normal(scale=0.3, size=3), 0.1, *motion[1]),
        Obstacle.box(place[2], turns[0], rng.uniform(0.05, 0.4, 3), *motion[2]),
        Obstacle.half_space(place[3], rng.normal(size=3), *motion[3]),
        Obstacle.box(place[4], turns[1], rng.uniform(0.02, 0.2, 3), *motion[4]),
    ]


def evaluate(barriers: BarrierSet, kin: Kinematics, q: Array, v: Array, obstacles: list[Obstacle]) -> BarrierRows:
    kin.update_motion(q, v)
    kin.update_second_order()
    next(b for b in barriers.barriers if isinstance(b, ObstacleBarrier)).set_obstacles(obstacles)
    rows = barriers.evaluate(kin, second_order=True)
    assert rows.curvature is not None
    return replace(rows, h=rows.h.copy(), jac=rows.jac.copy(), dh_dt=rows.dh_dt.copy(), curvature=rows.curvature.copy())


def random_state(kin: Kinematics, seed: int) -> tuple[Array, Array, list[Obstacle]]:
    rng = np.random.default_rng(seed)
    q = pin.neutral(kin.model)
    base = np.zeros(kin.nv)
    base[: kin.nv_base] = rng.normal(size=kin.nv_base)
    q = kin.integrate(q, base, 1.0)
    q[kin.nq_base :] = rng.uniform(*kin.position_limits)
    kin.update_geometry(q)
    bodies = CollisionBodies(kin)
    bodies.place(kin)
    return q, rng.normal(size=kin.nv), random_obstacles(rng, bodies.origin.mean(axis=0))


def derivative(values: Callable[[float], Array]) -> Array:
    """Derivative at 0 by central differences of fourth order: close pairs of lines have large higher derivatives."""
    near, far = (values(n * STEP) - values(-n * STEP) for n in (1, 2))
    return (8 * near - far) / (12 * STEP)


def assert_rate_and_curvature(
    barriers: BarrierSet, kin: Kinematics, q: Array, v: Array, obstacles: list[Obstacle]
) -> BarrierRows:
    """The rows at a state, whose rate and curvature are those of central differences along the motion."""
    rows = evaluate(barriers, kin, q, v, obstacles)

    def h_and_rate(dt: float) -> Array:
        after = evaluate(barriers, kin, kin.integrate(q, v, dt), v, [o.after(dt) for o in obstacles])
        return np.array([after.h, after.jac @ v + after.dh_dt])

    rate, numeric = derivative(h_and_rate)
    size = 1 + np.abs(rows.curvature)
    np.testing.assert_allclose(rows.jac @ v + rows.dh_dt, rate, rtol=0, atol=1e-6)
    np.testing.assert_allclose(rows.curvature / size, numeric / size, rtol=0, atol=ROUNDING)
    return rows


@pytest.mark.parametrize("seed", range(3))
def test_curvature_and_rate_are_central_differences(kin: Kinematics, barriers: BarrierSet, seed: int) -> None:
    q, v, obstacles = random_state(kin, seed)
    rows = assert_rate_and_curvature(barriers, kin, q, v, obstacles)
    assert not rows.curvature[barriers.slices["joint_limit"]].any()
    # standing still and among obstacles that do, nothing accelerates
    still = evaluate(barriers, kin, q, 0 * v, [o.at_rest() for o in obstacles])
    np.testing.assert_allclose(still.curvature, 0.0, rtol=0, atol=1e-12)


def test_curvature_and_rate_in_a_box_are_central_differences(robot: RobotDescription) -> None:
    """Boxes around bodies of the robot, that move and turn with them in them."""
    kin = Kinematics(robot)
    q, v, _ = random_state(kin, 9)
    rng, bodies, count = np.random.default_rng(9), CollisionBodies(kin), 6
    bodies.place(kin)
    barriers = standard_barriers(kin, ["box"] * count)
    middles = (bodies.origin + rng.uniform(0.1, 0.9, (len(bodies.names), 1)) * bodies.direction)[bodies.is_capsule]
    boxes = [
        Obstacle.box(p, pin.rpy.rpyToMatrix(rng.normal(size=3)), rng.uniform(0.05, 0.15, 3), *rng.normal(size=(2, 3)))
        for p in rng.permutation(middles)[:count]
    ]
    assert_rate_and_curvature(barriers, kin, q, v, boxes)
    contacts = next(b for b in barriers.barriers if isinstance(b, ObstacleBarrier)).contacts
    first = barriers.labels[barriers.slices["obstacle"].start :].index
    inside = [label for label in barriers.labels if ", edge" in label and contacts[first(label.split(",")[0]), 6] < 0]
    own = [label for label in inside if contacts[first(label), 6] > contacts[first(label.split(",")[0]), 6]]
    assert 0 < len(own) < len(inside)


def test_first_order_rows_do_not_change_when_the_second_is_asked_for(kin: Kinematics, barriers: BarrierSet) -> None:
    q, v, obstacles = random_state(kin, 5)
    both = evaluate(barriers, kin, q, v, obstacles)
    first = barriers.evaluate(kin)
    assert first.curvature is None
    for part in ("h", "jac", "dh_dt"):
        np.testing.assert_array_equal(getattr(first, part), getattr(both, part))


def test_acceleration_enters_through_the_gradient(kin: Kinematics, barriers: BarrierSet) -> None:
    """With a constant acceleration u, the rate changes by J u + c."""
    q, v, obstacles = random_state(kin, 6)
    u = np.random.default_rng(7).normal(size=kin.nv)
    rows = evaluate(barriers, kin, q, v, obstacles)

    def rate(dt: float) -> Array:
        moved = kin.integrate(q, v + 0.5 * dt * u, dt)
        after = evaluate(barriers, kin, moved, v + dt * u, [o.after(dt) for o in obstacles])
        return after.jac @ (v + dt * u) + after.dh_dt

    numeric, expected = derivative(rate), rows.jac @ u + rows.curvature
    size = 1 + np.abs(rows.curvature)
    np.testing.assert_allclose(expected / size, numeric / size, rtol=0, atol=ROUNDING)


def test_curvature_does_not_depend_on_the_worlds_frame(robot: RobotDescription) -> None:
    kin = Kinematics(robot)
    barriers = standard_barriers(kin, KINDS)
    motion = pin.SE3(pin.rpy.rpyToMatrix(np.array([0.4, -1.1, 2.3])), np.array([3.0, -2.0, 1.0]))
    turn = motion.rotation
    for seed in range(3):
        q, v, obstacles = random_state(kin, seed)
        rows = evaluate(barriers, kin, q, v, obstacles)
        moved_q = np.concatenate([pin.SE3ToXYZQUAT(motion * pin.XYZQUATToSE3(q[:7])), q[7:]])
        moved = [
            replace(
                o,
                position=motion.act(o.position),
                direction=turn @ o.direction,
                rotation=turn @ o.rotation,
                velocity=turn @ o.velocity,
                angular_velocity=turn @ o.angular_velocity,
            )
            for o in obstacles
        ]
        other = evaluate(barriers, kin, moved_q, v, moved)
        np.testing.assert_allclose(other.curvature, rows.curvature, rtol=1e-8, atol=1e-8)


def test_robot_and_obstacles_turning_as_one_body_have_no_curvature(robot: RobotDescription) -> None:
    """Nothing moves in the frame that turns along; the obstacles' reference points are at its centre, so steady."""
    kin = Kinematics(robot)
    barriers = standard_barriers(kin, KINDS)
    for seed in range(3):
        q, v, obstacles = random_state(kin, seed)
        v[:3], v[6:] = 0.0, 0.0
        angular_velocity = pin.Quaternion(q[3:7]).matrix() @ v[3:6]
        axis = angular_velocity / np.linalg.norm(angular_velocity)
        # every reference point on the axis through the base's origin: it stays, while the obstacle turns about it
        places = [q[:3] + (0.5 + 0.4 * i) * axis for i in range(len(obstacles))]
        along = [
            replace(o, position=p, velocity=np.zeros(3), angular_velocity=angular_velocity)
            for o, p in zip(obstacles, places, strict=True)
        ]
        rows = evaluate(barriers, kin, q, v, along)
        np.testing.assert_allclose(rows.jac @ v + rows.dh_dt, 0.0, rtol=0, atol=1e-10)
        np.testing.assert_allclose(rows.curvature, 0.0, rtol=0, atol=1e-8)


def test_swapping_a_pair_changes_nothing(kin: Kinematics) -> None:
    bodies, pairs = CollisionBodies(kin), kin.robot.self_collision_pairs
    there = BarrierSet(kin, bodies, [SelfCollisionBarrier("self_collision", bodies, pairs)])
    back = BarrierSet(kin, bodies, [SelfCollisionBarrier("self_collision", bodies, [(b, a) for a, b in pairs])])
    q, v, _ = random_state(kin, 8)
    kin.update_motion(q, v)
    kin.update_second_order()
    rows, other = there.evaluate(kin, second_order=True), back.evaluate(kin, second_order=True)
    assert rows.curvature is not None
    assert other.curvature is not None
    swap = [label_of_swapped(label) for label in there.labels]
    pick = [back.labels.index(label) for label in swap]
    np.testing.assert_allclose(other.h[pick], rows.h, rtol=0, atol=1e-14)
    np.testing.assert_allclose(other.jac[pick], rows.jac, rtol=0, atol=1e-10)
    np.testing.assert_allclose(other.curvature[pick], rows.curvature, rtol=1e-9, atol=1e-9)


def label_of_swapped(label: str) -> str:
    """``A - B, start of the first`` is ``B - A, start of the second``."""
    pair, comma, end = label.partition(", ")
    a, b = pair.split(" - ")
    end = end.replace("first", "x").replace("second", "first").replace("x", "second")
    return f"{b} - {a}{comma}{end}"
