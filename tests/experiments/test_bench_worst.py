"""The benchmark of the worst case: adversaries do what they are said to do, and what is counted is what happened."""

import gc
import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from controllers.reference import reference_here
from experiments.benchmarks import worst as bench_worst_module
from experiments.benchmarks.rows import LOCKED, SIZES, cases, with_fewer_joints, with_spheres
from experiments.benchmarks.worst import STATUSES, Collections, Log, Times, bench_worst, longest_run, play
from experiments.benchmarks.worst_course import Course, Start, nearest_bodies
from experiments.benchmarks.worst_scenes import SCENES, TARGET_JUMP, TARGET_TICKS, Adversary, Scene
from experiments.scenarios.options import BenchOptions
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array
from robots.pinocchio_model import standing_configuration
from safety.barriers.barrier_set import CollisionBodies
from safety.geometry.shapes import Obstacle

DT = 0.002
SPOTS = np.array([[0.3, 0.2, 0.9], [0.3, -0.2, 0.9], [0.0, 0.0, 1.2]])
UNFILTERED = BenchOptions("worst", ("g1",), filter="none")
BY_NAME = {s.name: s for s in SCENES}


@pytest.fixture(scope="module")
def g1() -> RobotDescription:
    return load_robot("g1")


def played(scene: Scene, ticks: int, seed: int = 0) -> list[list[Obstacle]]:
    adversary = Adversary(scene, DT, np.random.default_rng(seed))
    return [list(adversary.obstacles(SPOTS)) for _ in range(ticks)]


# --- scenes


@pytest.mark.parametrize("scene", SCENES, ids=lambda s: s.name)
def test_a_scene_keeps_to_its_kinds_speeds_and_spins_and_to_its_seed(scene: Scene) -> None:
    low, high = scene.speed
    for obstacles in played(scene, 30):
        assert tuple(o.kind for o in obstacles) == scene.kinds
        for o in obstacles:
            assert low * (1 - 1e-12) <= np.linalg.norm(o.velocity) <= high * (1 + 1e-12)
            if o.kind != "sphere":
                assert np.linalg.norm(o.angular_velocity) == pytest.approx(scene.angular_velocity)
    again = played(scene, 30)
    for a, b in zip(played(scene, 30), again, strict=True):
        assert all(np.array_equal(x.packed, y.packed) for x, y in zip(a, b, strict=True))


@pytest.mark.parametrize("scene", [s for s in SCENES if s.kinds], ids=lambda s: s.name)
def test_between_two_draws_obstacles_move_as_they_say(scene: Scene) -> None:
    kept = drawn = 0
    for before, now in pairwise(played(scene, 3 * scene.every)):
        for a, b in zip(before, now, strict=True):
            if np.array_equal(a.velocity, b.velocity) and np.array_equal(a.half_sizes, b.half_sizes):
                expected = a.after(DT) if scene.speed[1] or scene.angular_velocity else a
                same = np.allclose(b.packed, expected.packed, rtol=1e-9, atol=1e-9)
                kept += same
                drawn += not same
            else:
                drawn += 1
    # each is drawn anew once in every `every` ticks
    fraction = drawn / (kept + drawn)
    assert fraction == pytest.approx(1 / scene.every, rel=0.5)


def test_boxes_turn_at_twenty_radians_a_second() -> None:
    scene = BY_NAME["boxes turn at 20 rad/s"]
    first, second = played(scene, 2)
    turned = 0
    for a, b in zip(first, second, strict=True):
        angle = np.arccos(np.clip((np.trace(a.rotation.T @ b.rotation) - 1) / 2, -1, 1))
        turned += bool(abs(angle - 20 * DT) < 1e-6)
    assert turned >= len(first) - 1


def test_spheres_are_round_the_hand_and_facing_half_spaces_face_each_other() -> None:
    scene = BY_NAME["200 spheres round a hand"]
    (spheres,) = played(scene, 1)
    np.testing.assert_allclose([np.linalg.norm(o.position - SPOTS[0]) for o in spheres], scene.spread)
    (facing,) = played(BY_NAME["rows in conflict"], 1)
    for a, b in zip(facing[:6:2], facing[1:6:2], strict=True):
        np.testing.assert_allclose(a.direction, -b.direction)


def test_rows_of_a_cluster_are_nearly_dependent(g1: RobotDescription) -> None:
    course = Course(g1, UNFILTERED, BY_NAME["rows nearly dependent"])
    course.supervisor.tick(*course.prepare())
    controller = course.controller
    rows = controller.barriers.evaluate(controller.kin)
    jac = rows.jac[controller.barriers.slices["obstacle"]]
    jac = jac[np.linalg.norm(jac, axis=1) > 1e-6]
    unit = jac / np.linalg.norm(jac, axis=1)[:, None]
    cosines = (unit @ unit.T)[np.triu_indices(len(unit), 1)]
    sines = np.sqrt(np.maximum(0.0, 1 - cosines**2))
    assert (sines < 1e-6).sum() > 100
    assert sines.max() > 0.5


def test_no_scene_has_more_than_a_thousand_rows_on_the_g1(g1: RobotDescription) -> None:
    sizes = [Course(g1, UNFILTERED, scene).controller.barriers.size for scene in SCENES]
    assert max(sizes) <= 1000
    assert sorted(sizes)[len(sizes) // 2] >= 850


def test_targets_jump_by_metres_and_only_when_they_are_to(g1: RobotDescription) -> None:
    kin = Kinematics(g1)
    kin.update(standing_configuration(g1), np.zeros(kin.nv))
    adversary = Adversary(BY_NAME["targets jump by metres"], DT, np.random.default_rng(0))
    home = reference_here(kin, with_hands=True)
    assert home.hands is not None
    seen: list[Array] = []
    for _ in range(3 * TARGET_TICKS):
        reference = reference_here(kin, with_hands=True)
        adversary.retarget(reference)
        assert reference.hands is not None
        left, right = (hand.position for hand in reference.hands)
        jumps = (left - home.hands[0].position, right - home.hands[1].position)
        seen.append(np.array([*jumps, reference.com.position - home.com.position]))
    steps = np.abs(np.diff(seen, axis=0)).max(axis=(1, 2))
    np.testing.assert_array_equal(np.flatnonzero(steps > 1e-12) + 1, [TARGET_TICKS, 2 * TARGET_TICKS])
    assert np.abs(seen).max() <= TARGET_JUMP
    assert np.linalg.norm(seen, axis=2).max() > 0.8


# --- courses


def test_the_robot_follows_its_filtered_velocity(g1: RobotDescription) -> None:
    course = Course(g1, UNFILTERED, BY_NAME["targets jump by metres"])
    state, reference, obstacles = course.prepare()
    result = course.supervisor.tick(state, reference, obstacles)[1]
    assert result is not None
    course.follow(result)
    after = course.prepare()[0]
    np.testing.assert_array_equal(after.v, result.safety.v)
    np.testing.assert_allclose(after.q[7:], state.q[7:] + DT * result.safety.v[6:], atol=1e-15)
    assert after.stamp == pytest.approx(DT)


def test_a_restart_is_from_one_of_the_states_and_time_goes_on(g1: RobotDescription) -> None:
    q = standing_configuration(g1)
    other = q.copy()
    other[10] += 0.1
    course = Course(g1, UNFILTERED, Scene("alone", ()), (Start(q, 0.0), Start(other, 1.0)))
    stamps, phases = [], set()
    for _ in range(20):
        result = course.supervisor.tick(*course.prepare())[1]
        assert result is not None
        stamps.append(course.stamp)
        course.follow(result)
        course.restart()
        phases.add(course.phase)
        np.testing.assert_array_equal(course.plant.q, other if course.phase else q)
        np.testing.assert_array_equal(course.plant.v, 0.0)
    assert phases == {0.0, 1.0}
    assert (np.diff(stamps) > 0).all()


def test_the_bodies_nearest_to_the_hand_heed_the_spheres_round_it(g1: RobotDescription) -> None:
    scene = BY_NAME["200 spheres round a hand"]
    course = Course(g1, UNFILTERED, scene)
    labels = course.controller.barriers.labels[course.controller.barriers.slices["obstacle"]]
    assert {label.split(" - ")[0] for label in labels} == {"left_hand", "left_wrist", "left_forearm"}
    assert len(labels) == 3 * 200
    # and the rows are about the spheres of this tick
    state, reference, obstacles = course.prepare()
    assert course.supervisor.tick(state, reference, obstacles)[1] is not None
    bodies = CollisionBodies(course.controller.kin)
    bodies.place(course.controller.kin)
    h = course.controller.barriers.evaluate(course.controller.kin).h
    for row, label in enumerate(course.controller.barriers.labels):
        if label.startswith("left_hand - obstacle"):
            i = bodies.names.index("left_hand")
            p, d = bodies.origin[i], bodies.direction[i]
            sphere = obstacles[int(label.split()[-1])]
            s = np.clip((sphere.position - p) @ d / (d @ d), 0.0, 1.0)
            distance = np.linalg.norm(p + s * d - sphere.position) - bodies.radius[i] - sphere.radius
            assert h[row] == pytest.approx(distance, abs=1e-12)


def test_bodies_are_ordered_by_distance_and_those_that_stand_still_are_last(g1: RobotDescription) -> None:
    kin = Kinematics(g1)
    kin.update(standing_configuration(g1), np.zeros(kin.nv))
    bodies = CollisionBodies(kin)
    bodies.place(kin)
    bodies.is_movable = np.arange(len(bodies.names)) != 3
    order = nearest_bodies(bodies, np.zeros(3))
    assert order[-1] == 3
    assert (np.diff(np.linalg.norm(bodies.origin[order[:-1]], axis=1)) >= 0).all()


# --- figures


def test_the_longest_run_of_late_ticks() -> None:
    rng = np.random.default_rng(0)
    for n in (0, 1, 5, 50):
        for _ in range(50):
            late = rng.random(n) < 0.6
            words = "".join("x" if x else " " for x in late).split()
            assert longest_run(late) == max(map(len, words), default=0)


def test_times_are_those_of_the_ticks() -> None:
    seconds = np.full(1000, 1e-3)
    seconds[[10, 11, 12, 500]] = 3e-3, 3e-3, 3e-3, 9e-3
    times = Times.of(seconds)
    assert (times.median_ms, times.max_ms) == pytest.approx((1.0, 9.0))
    assert (times.late, times.in_a_row) == (4, 3)
    assert times.p99_ms == pytest.approx(1.0)
    assert times.p999_ms == pytest.approx(3.0, abs=0.01)


def test_collections_are_counted_only_within_ticks() -> None:
    with Collections() as collections:
        gc.collect()
        collections.counting = True
        gc.collect()
        gc.collect()
        collections.counting = False
        gc.collect()
    collections.counting = True
    gc.collect()
    assert collections.count == 2


def test_every_tick_is_counted_once_and_memory_stays(g1: RobotDescription) -> None:
    course = Course(g1, UNFILTERED, BY_NAME["200 spheres round a hand"])
    figures = play([course], 400)
    assert sum(figures.statuses.values()) == figures.ticks == 400
    assert figures.rows == course.controller.barriers.size
    assert figures.stops == 0
    # the obstacles that are there at the end are others than at the start, as many
    assert figures.heap_blocks < 100
    assert figures.cpu.max_ms > 0
    assert set(figures.stages_ms) >= {"rows", "safety_qp", "supervisor"}


def test_of_each_tick_the_shorter_one_of_its_plays_is_its_own(
    g1: RobotDescription, monkeypatch: pytest.MonkeyPatch
) -> None:
    plays = [np.array([1.0, 5.0, 3.0]), np.array([2.0, 4.0, 3.5])]

    def played_in(course: Course, ticks: int) -> tuple[Log, float, int, int]:
        log = Log(ticks)
        log.cpu, log.kept = 1e-3 * plays.pop(0), np.zeros(ticks)
        return log, 0.0, 0, 0

    scene = BY_NAME["boxes jump"]
    courses = [Course(g1, UNFILTERED, scene) for _ in range(2)]
    with monkeypatch.context() as patched:
        patched.setattr(bench_worst_module, "play_once", played_in)
        figures = play(courses, 3)
    assert (figures.cpu.max_ms, figures.cpu.median_ms, figures.cpu.late) == (5.0, 3.0, 2)
    assert (figures.own.max_ms, figures.own.median_ms, figures.own.late) == (4.0, 3.0, 2)
    with pytest.raises(RuntimeError, match="boxes jump"):
        play([Course(g1, replace(UNFILTERED, filter=name), scene) for name in ("none", "issf")], 60)


def test_what_is_there_before_the_ticks_is_out_of_the_collectors_sight_until_they_end() -> None:
    assert gc.get_freeze_count() == 0
    with Collections():
        assert gc.get_freeze_count() > 1000
    assert gc.get_freeze_count() == 0


def test_a_stopped_robot_is_put_back(g1: RobotDescription) -> None:
    course = Course(g1, UNFILTERED, Scene("nowhere", ()))
    obstacles = course.adversary.obstacles
    course.adversary.obstacles = lambda spots: [*obstacles(spots), Obstacle.sphere(np.zeros(3), 0.1)]
    figures = play([course], 20)
    assert figures.stops == 20
    assert sum(figures.statuses.values()) == 0
    assert course.supervisor.cause is None


def test_the_tables_are_printed_and_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "w.json"
    assert bench_worst(replace(UNFILTERED, ticks=100, out=out)) == 0
    said = capsys.readouterr().out
    figures = json.loads(out.read_text())["g1"]
    assert [f["sequence"] for f in figures] == list(BY_NAME)
    for f in figures:
        assert f["sequence"] in said
        assert f["ticks"] == 100 // len(SCENES)
        assert set(f["statuses"]) >= set(STATUSES)


def test_a_filter_or_robots_that_are_not_there_are_refused() -> None:
    for bad in (replace(UNFILTERED, robots=()), replace(UNFILTERED, filter="foo"), replace(UNFILTERED, ticks=10)):
        with pytest.raises(ConfigError):
            bench_worst(bad)


# --- rows and joints


def test_locked_joints_leave_the_robot_where_it_is(g1: RobotDescription) -> None:
    fewer, same = with_fewer_joints(g1)
    assert same is g1
    assert len(fewer.joints) == 23
    assert not any(part in name for part in LOCKED for name in fewer.joint_names)
    assert fewer.total_mass == g1.total_mass
    placed = []
    for robot in (fewer, g1):
        kin = Kinematics(robot)
        kin.update(standing_configuration(robot, "hands_front"), np.zeros(kin.nv))
        bodies = CollisionBodies(kin)
        bodies.place(kin)
        placed.append(np.concatenate([bodies.origin, bodies.direction, kin.com[None]]))
    np.testing.assert_allclose(placed[0], placed[1], atol=1e-12)
    tocabi = load_robot("tocabi")
    assert with_fewer_joints(tocabi) == [tocabi]


def test_sizes_are_reached_with_as_few_spheres_as_possible(g1: RobotDescription) -> None:
    sizes = [Course(r, UNFILTERED, scene).controller.barriers.size for r, scene in cases(g1)]
    pairs, bounds = len(g1.self_collision_pairs), len(g1.workspace)
    assert sizes[0] == 2 * len(g1.joints) + pairs + bounds
    bodies = len(g1.collisions)
    for size, wanted in zip(sizes[2:], SIZES, strict=True):
        assert wanted <= size < wanted + bodies


def test_spheres_sit_in_the_middle_of_capsules(g1: RobotDescription) -> None:
    for before, now in zip(g1.collisions, with_spheres(g1).collisions, strict=True):
        assert now.is_sphere
        np.testing.assert_allclose(now.start, 0.5 * (before.start + before.end))
        assert (now.name, now.body, now.radius) == (before.name, before.body, before.radius)
