"""Barrier rows of both robots: gradients and drift against differences, the paper's formulas, symmetries, order."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.messages import Array
from robots.pinocchio_model import standing_configuration
from robots.rotation import rotation_from_rpy
from safety.barriers import (
    Barrier,
    BarrierSet,
    CollisionBodies,
    JointLimitBarrier,
    ObstacleBarrier,
    SelfCollisionBarrier,
    standard_barriers,
)
from safety.obstacles import Obstacle
from safety.rows import FAMILIES, BarrierRows

STEP = 1e-6
OBSTACLES = 4
SEEDS = range(4)


@pytest.fixture(scope="module")
def kin(robot: RobotDescription) -> Kinematics:
    return Kinematics(robot)


@pytest.fixture(scope="module")
def barriers(kin: Kinematics) -> BarrierSet:
    return standard_barriers(kin, OBSTACLES)


def obstacle_barrier(barriers: BarrierSet) -> ObstacleBarrier:
    return next(b for b in barriers.barriers if isinstance(b, ObstacleBarrier))


def random_configuration(kin: Kinematics, rng: np.random.Generator) -> Array:
    quaternion = rng.normal(size=4)
    joints = rng.uniform(*kin.robot.position_limits)
    return np.concatenate([rng.normal(size=3), quaternion / np.linalg.norm(quaternion), joints])


def random_obstacles(rng: np.random.Generator, center: Array) -> list[Obstacle]:
    """Capsules that move and turn, and one sphere, about ``center`` (3,)."""
    places = center + rng.normal(scale=0.5, size=(OBSTACLES, 2, 3))
    sizes, motion = rng.uniform(0.05, 0.3, OBSTACLES), rng.normal(size=(OBSTACLES, 2, 3))
    capsules = [Obstacle(*p, r, *m) for p, r, m in zip(places, sizes, motion, strict=True)]
    return [*capsules[:-1], Obstacle.sphere(places[-1, 0], sizes[-1], motion[-1, 0])]


def advanced(obstacle: Obstacle, dt: float) -> Obstacle:
    """The obstacle after ``dt`` at its constant velocity and spin."""
    start = obstacle.start + dt * obstacle.velocity
    end = start + pin.exp3(obstacle.spin * dt) @ (obstacle.end - obstacle.start)
    return replace(obstacle, start=start, end=end)


def rows_at(barriers: BarrierSet, kin: Kinematics, q: Array, obstacles: list[Obstacle]) -> BarrierRows:
    """Rows that later evaluations do not overwrite."""
    kin.update_geometry(q)
    obstacle_barrier(barriers).set_obstacles(obstacles)
    rows = barriers.evaluate(kin)
    return BarrierRows(rows.h.copy(), rows.jac.copy(), rows.drift.copy(), rows.family)


@pytest.fixture(params=SEEDS)
def state(request: pytest.FixtureRequest, kin: Kinematics) -> tuple[Array, list[Obstacle]]:
    rng = np.random.default_rng(request.param)
    q = random_configuration(kin, rng)
    return q, random_obstacles(rng, q[:3])


State = tuple[Array, list[Obstacle]]


def test_every_gradient_is_the_central_difference(kin: Kinematics, barriers: BarrierSet, state: State) -> None:
    q, obstacles = state
    rows = rows_at(barriers, kin, q, obstacles)
    numeric = np.zeros_like(rows.jac)
    for k in range(kin.nv):
        direction = np.zeros(kin.nv)
        direction[k] = 1.0
        ahead = rows_at(barriers, kin, kin.integrate(q, direction, STEP), obstacles).h
        behind = rows_at(barriers, kin, kin.integrate(q, direction, -STEP), obstacles).h
        numeric[:, k] = (ahead - behind) / (2 * STEP)
    size = np.maximum(1.0, np.linalg.norm(rows.jac, axis=1, keepdims=True))
    np.testing.assert_allclose(rows.jac / size, numeric / size, rtol=0, atol=1e-6)


def test_drift_is_the_rate_of_h_with_the_robot_frozen(kin: Kinematics, barriers: BarrierSet, state: State) -> None:
    q, obstacles = state
    drift = rows_at(barriers, kin, q, obstacles).drift
    ahead = rows_at(barriers, kin, q, [advanced(o, STEP) for o in obstacles]).h
    behind = rows_at(barriers, kin, q, [advanced(o, -STEP) for o in obstacles]).h
    np.testing.assert_allclose(drift, (ahead - behind) / (2 * STEP), rtol=0, atol=1e-6)
    cut = barriers.slices["obstacle"]
    assert (np.abs(drift[cut]) > 0).all()
    assert not np.delete(drift, np.arange(cut.start, cut.stop)).any()


def test_robot_and_obstacles_moving_together_change_nothing(
    kin: Kinematics, barriers: BarrierSet, state: State
) -> None:
    q, obstacles = state
    rng = np.random.default_rng(0)
    linear, angular = rng.normal(size=(2, 3))
    together = [replace(o, velocity=linear + np.cross(angular, o.start), spin=angular) for o in obstacles]
    rows = rows_at(barriers, kin, q, together)
    rotation = pin.Quaternion(q[3:7]).matrix()
    v = np.zeros(kin.nv)
    v[:3], v[3:6] = rotation.T @ (linear + np.cross(angular, q[:3])), rotation.T @ angular
    np.testing.assert_allclose(rows.jac @ v + rows.drift, 0.0, rtol=0, atol=1e-11)


def test_rows_do_not_depend_on_the_worlds_frame(kin: Kinematics, barriers: BarrierSet, state: State) -> None:
    q, obstacles = state
    rows = rows_at(barriers, kin, q, obstacles)
    motion = pin.SE3(rotation_from_rpy(np.array([0.4, -1.1, 2.3])), np.array([3.0, -2.0, 1.0]))
    base = pin.XYZQUATToSE3(q[:7])
    moved_q = np.concatenate([pin.SE3ToXYZQUAT(motion * base), q[7:]])
    turn = motion.rotation
    moved = [
        Obstacle(motion.act(o.start), motion.act(o.end), o.radius, turn @ o.velocity, turn @ o.spin) for o in obstacles
    ]
    other = rows_at(barriers, kin, moved_q, moved)
    np.testing.assert_allclose(other.h, rows.h, rtol=0, atol=1e-12)
    np.testing.assert_allclose(other.jac, rows.jac, rtol=0, atol=1e-10)
    np.testing.assert_allclose(other.drift, rows.drift, rtol=0, atol=1e-10)


def test_the_base_moves_no_family_but_obstacles(kin: Kinematics, barriers: BarrierSet, state: State) -> None:
    rows = rows_at(barriers, kin, *state)
    for family, cut in barriers.slices.items():
        if family == "obstacle":
            # the base carries everything: a unit normal, seen from its frame
            np.testing.assert_allclose(np.linalg.norm(rows.jac[cut, :3], axis=1), 1.0, rtol=0, atol=1e-12)
        else:
            assert not rows.jac[cut, :6].any()


def shape_point_jacobian(kin: Kinematics, body: str, point: Array) -> Array:
    """Jacobian (3, nv) of the point of ``body`` that is at ``point`` (3,), by pinocchio."""
    joint = kin.model.frames[kin.frame_id(body)].parentJoint
    jacobian = pin.getJointJacobian(kin.model, kin.data, joint, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    return jacobian[:3] - pin.skew(point - kin.data.oMi[joint].translation) @ jacobian[3:]


def segment_points(kin: Kinematics, name: str, samples: Array) -> tuple[str, float, Array]:
    """Body, radius and points (n, 3) of a collision body's centre line in the world, by frame placements."""
    shape = next(s for s in kin.robot.collisions if s.name == name)
    rotation, position = kin.frame_placement(kin.frame_id(shape.body))
    local = shape.start + samples[:, None] * (shape.end - shape.start)
    return shape.body, shape.radius, local @ rotation.T + position


def closest_samples(kin: Kinematics, pair: tuple[str, str]) -> tuple[Array, Array]:
    """Closest points of two centre lines by a grid that is refined about its best cell: no formula of the kernel."""
    low, high = np.zeros(2), np.ones(2)
    for _ in range(40):
        s = [np.linspace(low[i], high[i], 9) for i in range(2)]
        p, q = (segment_points(kin, name, s[i])[2] for i, name in enumerate(pair))
        best = np.array(np.unravel_index(np.linalg.norm(p[:, None] - q[None], axis=2).argmin(), (9, 9)))
        middle, half = np.array([s[0][best[0]], s[1][best[1]]]), 0.3 * (high - low)
        low, high = np.clip(middle - half, 0, 1), np.clip(middle + half, 0, 1)
    return p[best[0]], q[best[1]]


@pytest.mark.parametrize("seed", [0, 1])
def test_self_collision_rows_are_equations_41_to_44(kin: Kinematics, barriers: BarrierSet, seed: int) -> None:
    rng = np.random.default_rng(seed)
    q = random_configuration(kin, rng)
    rows = rows_at(barriers, kin, q, random_obstacles(rng, q[:3]))
    start = barriers.slices["self_collision"].start
    for i, pair in enumerate(kin.robot.self_collision_pairs):
        p_a, p_b = closest_samples(kin, pair)
        (body_a, radius_a, _), (body_b, radius_b, _) = (segment_points(kin, n, np.zeros(1)) for n in pair)
        distance = np.linalg.norm(p_a - p_b)
        assert rows.h[start + i] == pytest.approx(distance - radius_a - radius_b, abs=1e-9)
        n = (p_a - p_b) / distance
        surface_a, surface_b = p_a - radius_a * n, p_b + radius_b * n
        expected = n @ (shape_point_jacobian(kin, body_a, surface_a) - shape_point_jacobian(kin, body_b, surface_b))
        # a search by value finds a point to the square root of rounding, 1e-8 m, and its direction to that over d
        np.testing.assert_allclose(rows.jac[start + i], expected, rtol=0, atol=1e-7 / min(distance, 1))


def test_joint_limit_and_workspace_values_are_equations_38_and_50(
    kin: Kinematics, barriers: BarrierSet, state: State
) -> None:
    q, obstacles = state
    h = rows_at(barriers, kin, q, obstacles).h
    lower, upper = kin.robot.position_limits
    np.testing.assert_array_equal(h[barriers.slices["joint_limit"]], np.concatenate([q[7:] - lower, upper - q[7:]]))
    for value, bound in zip(h[barriers.slices["workspace"]], kin.robot.workspace, strict=True):
        p_a, p_b = (kin.frame_placement(kin.frame_id(f))[1] for f in (bound.frame_a, bound.frame_b))
        assert value == pytest.approx(bound.d_max - np.linalg.norm(p_a - p_b), abs=1e-14)


def test_order_families_and_labels_are_what_the_recorders_rely_on(kin: Kinematics, barriers: BarrierSet) -> None:
    robot, cut = kin.robot, barriers.slices
    assert tuple(cut) == FAMILIES[:-1]
    assert [c.start for c in cut.values()] == [0, *(c.stop for c in list(cut.values())[:-1])]
    assert cut["workspace"].stop == barriers.size == len(barriers.labels)
    both = slice(cut["self_collision"].start, cut["leg_collision"].stop)
    assert barriers.labels[both] == tuple(f"{a} - {b}" for a, b in robot.self_collision_pairs)
    assert barriers.labels[cut["leg_collision"]] == tuple(f"{a} - {b}" for a, b in robot.leg_pairs)
    names = [c.name for c in robot.collisions]
    expected = tuple(f"{n} - obstacle {i}" for n in names for i in range(OBSTACLES))
    assert barriers.labels[cut["obstacle"]] == expected
    assert barriers.labels[cut["workspace"]] == tuple(b.name for b in robot.workspace)
    limits = [f"{n} {side}" for side in ("min", "max") for n in robot.joint_names]
    assert barriers.labels[cut["joint_limit"]] == tuple(limits)


def test_family_indices_agree_with_the_slices(kin: Kinematics, barriers: BarrierSet, state: State) -> None:
    family = rows_at(barriers, kin, *state).family
    for name, cut in barriers.slices.items():
        assert (family[cut] == FAMILIES.index(name)).all()


def test_values_do_not_depend_on_the_obstacle_count(kin: Kinematics, barriers: BarrierSet, state: State) -> None:
    q, obstacles = state
    h = rows_at(barriers, kin, q, obstacles).h
    without = standard_barriers(kin)
    assert "obstacle" not in without.slices
    cut = barriers.slices["obstacle"]
    np.testing.assert_array_equal(without.evaluate(kin).h, np.delete(h, np.arange(cut.start, cut.stop)))


def test_an_obstacle_in_a_link_has_finite_rows_and_a_unit_normal(kin: Kinematics, barriers: BarrierSet) -> None:
    q = standing_configuration(kin.robot)
    kin.update_geometry(q)
    name = kin.robot.collisions[0].name
    _, radius, ends = segment_points(kin, name, np.array([0.0, 0.5, 1.0]))
    along = Obstacle(ends[0], ends[2], 0.1)
    crossing = Obstacle(ends[1] - [0.2, 0.1, 0], ends[1] + [0.2, 0.1, 0], 0.1)
    centred = Obstacle.sphere(ends[1], 0.1)
    rows = rows_at(barriers, kin, q, [centred, crossing, along, Obstacle.sphere(ends[0], 0.1)])
    cut = barriers.slices["obstacle"]
    np.testing.assert_allclose(rows.h[cut][:OBSTACLES], -(radius + 0.1), rtol=0, atol=1e-8)
    assert np.isfinite(rows.jac).all()
    np.testing.assert_allclose(np.linalg.norm(rows.jac[cut, :3], axis=1), 1.0, rtol=0, atol=1e-12)


def test_obstacles_may_concern_some_bodies_only(kin: Kinematics, barriers: BarrierSet, state: State) -> None:
    q, obstacles = state
    everything = rows_at(barriers, kin, q, obstacles)
    bodies, chosen = CollisionBodies(kin), (kin.robot.collisions[5].name, kin.robot.collisions[2].name)
    some = ObstacleBarrier(bodies, OBSTACLES, chosen)
    some.set_obstacles(obstacles)
    rows = BarrierSet(kin, bodies, [some]).evaluate(kin)
    start = barriers.slices["obstacle"].start
    pick = np.concatenate([start + OBSTACLES * i + np.arange(OBSTACLES) for i in (5, 2)])
    for part in ("h", "jac", "drift"):
        np.testing.assert_array_equal(getattr(rows, part), getattr(everything, part)[pick])


def test_obstacles_that_were_never_set_are_not_mistaken_for_distances(kin: Kinematics) -> None:
    fresh = standard_barriers(kin, 1)
    assert np.isnan(fresh.evaluate(kin).h[fresh.slices["obstacle"]]).all()
    with pytest.raises(ValueError, match=r"2 obstacles given, 1 announced"):
        obstacle_barrier(fresh).set_obstacles([Obstacle.sphere(np.zeros(3), 0.1)] * 2)


def test_two_barriers_of_one_family_share_a_slice_if_they_follow_each_other(kin: Kinematics) -> None:
    bodies, pairs = CollisionBodies(kin), kin.robot.self_collision_pairs
    halves: list[Barrier] = [SelfCollisionBarrier("self_collision", bodies, p) for p in (pairs[:4], pairs[4:])]
    assert BarrierSet(kin, bodies, halves).slices == {"self_collision": slice(0, len(pairs))}
    with pytest.raises(ConfigError, match="barriers"):
        BarrierSet(kin, bodies, [halves[0], JointLimitBarrier(kin.robot), halves[1]])


def test_unknown_family_is_refused_by_name(kin: Kinematics) -> None:
    bodies = CollisionBodies(kin)
    with pytest.raises(ConfigError, match=r"barrier family = 'walls': must be one of joint_limit"):
        BarrierSet(kin, bodies, [SelfCollisionBarrier("walls", bodies, ())])
