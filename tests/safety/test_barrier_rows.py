"""Barrier rows of both robots: gradients and dh_dt against differences, the paper's formulas, symmetries, order."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array
from robots.pinocchio_model import standing_configuration
from safety.barriers.barrier_set import (
    Barrier,
    BarrierSet,
    CollisionBodies,
    JointLimitBarrier,
    ObstacleBarrier,
    SelfCollisionBarrier,
    standard_barriers,
)
from safety.barriers.rows import FAMILIES, BarrierRows
from safety.geometry.shapes import Obstacle
from tests.support.rows import copied

STEP = 1e-6
OBSTACLE_KINDS = ("capsule", "sphere", "box", "capsule", "half_space")
OBSTACLES = len(OBSTACLE_KINDS)
SEEDS = range(4)


@pytest.fixture(scope="module")
def barriers(kin: Kinematics) -> BarrierSet:
    return standard_barriers(kin, OBSTACLE_KINDS)


def obstacle_barrier(barriers: BarrierSet) -> ObstacleBarrier:
    return next(b for b in barriers.barriers if isinstance(b, ObstacleBarrier))


def random_configuration(kin: Kinematics, rng: np.random.Generator) -> Array:
    quaternion = rng.normal(size=4)
    joints = rng.uniform(*kin.robot.position_limits)
    return np.concatenate([rng.normal(size=3), quaternion / np.linalg.norm(quaternion), joints])


def random_obstacles(rng: np.random.Generator, center: Array) -> list[Obstacle]:
    """One of each kind and one capsule more about ``center`` (3,), that move and turn."""
    places = center + rng.normal(scale=0.5, size=(OBSTACLES, 2, 3))
    sizes, motion = rng.uniform(0.05, 0.3, OBSTACLES), rng.normal(size=(OBSTACLES, 2, 3))
    turn = pin.rpy.rpyToMatrix(rng.normal(size=3))
    return [
        Obstacle.capsule(places[0, 0], places[0, 1], sizes[0], motion[0, 0], motion[0, 1]),
        Obstacle.sphere(places[1, 0], sizes[1], motion[1, 0]),
        Obstacle.box(places[2, 0], turn, sizes[[0, 2, 4]], *motion[2]),
        Obstacle.capsule(places[3, 0], places[3, 1], sizes[3], motion[3, 0], motion[3, 1]),
        Obstacle.half_space(places[4, 0], places[4, 1] - places[4, 0], *motion[4]),
    ]


def rows_at(barriers: BarrierSet, kin: Kinematics, q: Array, obstacles: list[Obstacle]) -> BarrierRows:
    kin.update_geometry(q)
    obstacle_barrier(barriers).set_obstacles(obstacles)
    return copied(barriers.evaluate(kin))


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
    dh_dt = rows_at(barriers, kin, q, obstacles).dh_dt
    ahead = rows_at(barriers, kin, q, [o.after(STEP) for o in obstacles]).h
    behind = rows_at(barriers, kin, q, [o.after(-STEP) for o in obstacles]).h
    np.testing.assert_allclose(dh_dt, (ahead - behind) / (2 * STEP), rtol=0, atol=1e-6)
    cut = barriers.slices["obstacle"]
    assert (np.abs(dh_dt[cut]) > 0).all()
    assert not np.delete(dh_dt, np.arange(cut.start, cut.stop)).any()


def test_robot_and_obstacles_moving_together_change_nothing(
    kin: Kinematics, barriers: BarrierSet, state: State
) -> None:
    q, obstacles = state
    rng = np.random.default_rng(0)
    linear, angular = rng.normal(size=(2, 3))
    together = [
        replace(o, velocity=linear + np.cross(angular, o.position), angular_velocity=angular) for o in obstacles
    ]
    rows = rows_at(barriers, kin, q, together)
    rotation = pin.Quaternion(q[3:7]).matrix()
    v = np.zeros(kin.nv)
    v[:3], v[3:6] = rotation.T @ (linear + np.cross(angular, q[:3])), rotation.T @ angular
    np.testing.assert_allclose(rows.jac @ v + rows.dh_dt, 0.0, rtol=0, atol=1e-11)


def moved_with_the_world(o: Obstacle, motion: pin.SE3) -> Obstacle:
    turn = motion.rotation
    linear, angular = turn @ o.velocity, turn @ o.angular_velocity
    place = {
        "direction": turn @ o.direction,
        "rotation": turn @ o.rotation,
        "velocity": linear,
        "angular_velocity": angular,
    }
    return replace(o, position=motion.act(o.position), **place)


def test_rows_do_not_depend_on_the_worlds_frame(kin: Kinematics, barriers: BarrierSet, state: State) -> None:
    q, obstacles = state
    rows = rows_at(barriers, kin, q, obstacles)
    motion = pin.SE3(pin.rpy.rpyToMatrix(np.array([0.4, -1.1, 2.3])), np.array([3.0, -2.0, 1.0]))
    base = pin.XYZQUATToSE3(q[:7])
    moved_q = np.concatenate([pin.SE3ToXYZQUAT(motion * base), q[7:]])
    moved = [moved_with_the_world(o, motion) for o in obstacles]
    other = rows_at(barriers, kin, moved_q, moved)
    np.testing.assert_allclose(other.h, rows.h, rtol=0, atol=1e-12)
    np.testing.assert_allclose(other.jac, rows.jac, rtol=0, atol=1e-10)
    np.testing.assert_allclose(other.dh_dt, rows.dh_dt, rtol=0, atol=1e-10)


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
    distances = [*barriers.representative["self_collision"], *barriers.representative["leg_collision"]]
    for i, pair in zip(distances, kin.robot.self_collision_pairs, strict=True):
        p_a, p_b = closest_samples(kin, pair)
        (body_a, radius_a, _), (body_b, radius_b, _) = (segment_points(kin, n, np.zeros(1)) for n in pair)
        distance = np.linalg.norm(p_a - p_b)
        assert rows.h[i] == pytest.approx(distance - radius_a - radius_b, abs=1e-9)
        n = (p_a - p_b) / distance
        surface_a, surface_b = p_a - radius_a * n, p_b + radius_b * n
        expected = n @ (shape_point_jacobian(kin, body_a, surface_a) - shape_point_jacobian(kin, body_b, surface_b))
        # a search by value finds a point to the square root of rounding, 1e-8 m, and its direction to that over d
        np.testing.assert_allclose(rows.jac[i], expected, rtol=0, atol=1e-7 / min(distance, 1))


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
    distances = [*barriers.representative["self_collision"], *barriers.representative["leg_collision"]]
    assert [barriers.labels[i] for i in distances] == [f"{a} - {b}" for a, b in robot.self_collision_pairs]
    legs = [f"{a} - {b}" for a, b in robot.leg_pairs]
    assert [barriers.labels[i] for i in barriers.representative["leg_collision"]] == legs
    names = [c.name for c in robot.collisions]
    expected = tuple(f"{n} - obstacle {i}" for n in names for i in range(OBSTACLES))
    first = cut["obstacle"].start
    assert barriers.labels[first : first + len(expected)] == expected
    assert len(set(barriers.labels)) == barriers.size
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
    along = Obstacle.capsule(ends[0], ends[2], 0.1)
    crossing = Obstacle.capsule(ends[1] - [0.2, 0.1, 0], ends[1] + [0.2, 0.1, 0], 0.1)
    centred = Obstacle.sphere(ends[1], 0.1)
    box = Obstacle.box(ends[1], np.eye(3), np.full(3, 0.3))
    rows = rows_at(barriers, kin, q, [crossing, centred, box, along, Obstacle.half_space(ends[0], np.ones(3))])
    cut = barriers.slices["obstacle"]
    np.testing.assert_allclose(rows.h[cut][:OBSTACLES][[0, 1, 3]], -(radius + 0.1), rtol=0, atol=1e-8)
    assert rows.h[cut][2] < -radius - 0.1
    assert rows.h[cut][4] == pytest.approx(-radius, abs=1e-12)
    assert np.isfinite(rows.jac).all()
    np.testing.assert_allclose(np.linalg.norm(rows.jac[cut, :3], axis=1), 1.0, rtol=0, atol=1e-12)


def test_obstacles_may_concern_some_bodies_only(kin: Kinematics, barriers: BarrierSet, state: State) -> None:
    q, obstacles = state
    everything = rows_at(barriers, kin, q, obstacles)
    bodies, chosen = CollisionBodies(kin), (kin.robot.collisions[5].name, kin.robot.collisions[2].name)
    some = ObstacleBarrier(bodies, OBSTACLE_KINDS, chosen)
    some.set_obstacles(obstacles)
    few = BarrierSet(kin, bodies, [some])
    rows = few.evaluate(kin)
    pick = [barriers.labels.index(label) for label in few.labels]
    assert few.size == sum(n.startswith(tuple(f"{c} - obstacle" for c in chosen)) for n in barriers.labels)
    for part in ("h", "jac", "dh_dt"):
        np.testing.assert_array_equal(getattr(rows, part), getattr(everything, part)[pick])


def test_obstacles_that_were_never_set_are_not_mistaken_for_distances(kin: Kinematics) -> None:
    fresh = standard_barriers(kin, ("sphere",))
    assert np.isnan(fresh.evaluate(kin).h[fresh.slices["obstacle"]]).all()
    with pytest.raises(ValueError, match=r"2 obstacles given, 1 announced"):
        obstacle_barrier(fresh).set_obstacles([Obstacle.sphere(np.zeros(3), 0.1)] * 2)
    with pytest.raises(ValueError, match=r"obstacle 0 is a capsule, announced was a sphere"):
        obstacle_barrier(fresh).set_obstacles([Obstacle.capsule(np.zeros(3), np.ones(3), 0.1)])
    with pytest.raises(ConfigError, match=r"obstacle kind = 'cone': must be one of sphere"):
        standard_barriers(kin, ("cone",))


def test_two_barriers_of_one_family_share_a_slice_if_they_follow_each_other(kin: Kinematics) -> None:
    bodies, pairs = CollisionBodies(kin), kin.robot.self_collision_pairs
    halves: list[Barrier] = [SelfCollisionBarrier("self_collision", bodies, p) for p in (pairs[:4], pairs[4:])]
    both = BarrierSet(kin, bodies, halves)
    assert both.slices == {"self_collision": slice(0, both.size)}
    assert [both.labels[i] for i in both.representative["self_collision"]] == [f"{a} - {b}" for a, b in pairs]
    with pytest.raises(ConfigError, match="barriers"):
        BarrierSet(kin, bodies, [halves[0], JointLimitBarrier(kin), halves[1]])


def test_unknown_family_is_refused_by_name(kin: Kinematics) -> None:
    bodies = CollisionBodies(kin)
    with pytest.raises(ConfigError, match=r"barrier family = 'walls': must be one of joint_limit"):
        BarrierSet(kin, bodies, [SelfCollisionBarrier("walls", bodies, ())])


class FloorOfTheBase(Barrier):
    """A barrier of one's own: height of the base [m]."""

    family, size = "custom", 1

    def write(self, kin: Kinematics, h: Array, jac: Array, dh_dt: Array) -> None:
        h[0], dh_dt[0] = kin.q[2], 0.0
        jac[0] = 0.0
        jac[0, :3] = kin.frame_placement(kin.frame_id(kin.robot.roles["base"]))[0][2]

    def labels(self) -> tuple[str, ...]:
        return ("height",)


def test_barriers_of_ones_own_are_sorted_into_place(kin: Kinematics) -> None:
    bodies, pair = CollisionBodies(kin), kin.robot.self_collision_pairs[:1]
    own = SelfCollisionBarrier("leg_collision", bodies, pair)
    both = standard_barriers(kin, (), (FloorOfTheBase(), own))
    assert tuple(both.slices) == ("joint_limit", "self_collision", "leg_collision", "workspace", "custom")
    assert both.labels[-1] == "height"
    kin.update_geometry(standing_configuration(kin.robot))
    rows = both.evaluate(kin)
    # its bodies are placed like all others
    assert rows.h[both.labels.index(f"{pair[0][0]} - {pair[0][1]}")] in rows.h[both.slices["leg_collision"]]
    jac, direction = both.cartesian(both.size - 1)
    np.testing.assert_array_equal(jac, rows.jac[-1:])
    np.testing.assert_array_equal(direction, [1.0])
    with pytest.raises(NotImplementedError, match="FloorOfTheBase has no write_curvature"):
        both.evaluate(kin, second_order=True)
    with pytest.raises(ConfigError, match="barrier family = 'walls'"):
        wrong = SelfCollisionBarrier("walls", bodies, pair)
        standard_barriers(kin, (), (wrong,))


def test_every_row_has_its_point_and_direction(kin: Kinematics, barriers: BarrierSet, state: State) -> None:
    q, obstacles = state
    kin.update_geometry(q)
    obstacle_barrier(barriers).set_obstacles(obstacles)
    rows = barriers.evaluate(kin)
    assert rows.cartesian is not None
    for i in range(barriers.size):
        jac, direction = rows.cartesian(i)
        assert np.linalg.norm(direction) == pytest.approx(1.0, abs=1e-12)
        assert jac.shape == (1 if i < barriers.slices["joint_limit"].stop else 3, kin.nv)
        np.testing.assert_allclose(direction @ jac, rows.jac[i], rtol=0, atol=1e-11)
    with pytest.raises(IndexError, match=f"row {barriers.size} of"):
        rows.cartesian(barriers.size)


def test_permuting_obstacles_permutes_rows(kin: Kinematics, state: State) -> None:
    q, obstacles = state
    order = [3, 0, 4, 2, 1]
    other = standard_barriers(kin, [obstacles[i].kind for i in order])
    first = standard_barriers(kin, OBSTACLE_KINDS)
    rows = rows_at(first, kin, q, obstacles)
    permuted = rows_at(other, kin, q, [obstacles[i] for i in order])
    renamed = []
    for label in other.labels:
        head, mark, tail = label.partition("obstacle ")
        renamed.append(f"{head}{mark}{order[int(tail[0])]}{tail[1:]}" if mark else label)
    pick = [first.labels.index(label) for label in renamed]
    for part in ("h", "jac", "dh_dt", "family"):
        np.testing.assert_array_equal(getattr(permuted, part), getattr(rows, part)[pick])


def test_rows_beside_a_distance_are_never_smaller(kin: Kinematics, barriers: BarrierSet, state: State) -> None:
    h = rows_at(barriers, kin, *state).h
    distance = {barriers.labels[i]: h[i] for rows in barriers.representative.values() for i in rows}
    for label, value in zip(barriers.labels, h, strict=True):
        assert value >= distance.get(label, distance[label.split(",")[0]]) - 1e-12


def test_pairs_that_nothing_separates_are_left_out_unless_asked_for() -> None:
    robot = load_robot("g1")
    kin = Kinematics(robot, base="fixed")
    assert not any("pelvis - obstacle" in n for n in standard_barriers(kin, ("sphere",)).labels)
    kept = standard_barriers(kin, ("sphere",), keep_fixed=True)
    assert "pelvis - obstacle 0" in kept.labels
    pairs = [f"{a} - {b}" for a, b in robot.self_collision_pairs]
    rows = [*kept.representative["self_collision"], *kept.representative["leg_collision"]]
    assert [kept.labels[i] for i in rows] == pairs
    left = Kinematics(robot, base="fixed", joints=[n for n in robot.joint_names if n.startswith("left_shoulder")])
    moving = standard_barriers(left)
    assert "left_hand - torso_low" in moving.labels
    assert "right_hand - torso_low" not in moving.labels
    assert "left_thigh - right_thigh" not in moving.labels
    assert len(moving.representative["joint_limit"]) == 2 * len(left.joint_names)
    left.update_geometry(left.posture())
    h, jac = moving.evaluate(left).h, moving.evaluate(left).jac
    assert np.isfinite(h).all()
    # nothing is left that no joint changes
    assert (np.abs(jac[moving.slices["self_collision"]]).max(axis=1) > 1e-9).all()
