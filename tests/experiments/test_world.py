"""The world of a scenario: what is seen, known and true of it; whether it can be touched; when a robot has fallen."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from experiments.metrics.falls import has_fallen
from experiments.running.run import prepare, run
from experiments.running.world import World
from experiments.scenarios.stand import Stand
from experiments.scenarios.world import (
    BackAndForth,
    Box,
    Capsule,
    HalfSpace,
    Sensor,
    Sphere,
    Straight,
    Wandering,
    Waypoints,
    WorldObject,
)
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.loader import load_robot
from robots.pinocchio_model import standing_configuration
from sims.plant import MujocoPlant

ROOT = Path(__file__).resolve().parents[2]
SEEN = WorldObject("ball", Sphere(0.1), Straight((1.0, 0.2, 1.0), (-0.2, 0.0, 0.0)), Sensor(noise=0.0, lost_at=0.5))
KNOWN = WorldObject("bar", Capsule(0.05, (0.0, 0.0, 1.0)), BackAndForth((2.0, 0.0, 0.5), (0.1, 0.0, 0.0), 2.0))


def test_a_sensor_reports_what_is_due_and_what_is_known_needs_none() -> None:
    world = World((SEEN, KNOWN), seed=0)
    assert world.kinds == ("sphere", "capsule")
    reports = [d for t in np.arange(0.0, 1.0, 0.002) for d in world.detections(float(t))]
    assert {d.name for d in reports} == {"ball"}
    assert len(reports) == 30
    assert all(d.seen for d in reports)
    for detection in reports:
        np.testing.assert_allclose(detection.shape.position, [1.0 - 0.2 * detection.stamp, 0.2, 1.0])
    assert list(world.known(0.3)) == ["bar"]
    assert [o.kind for o in world.true(0.3)] == ["sphere", "capsule"]
    np.testing.assert_array_equal(world.known(0.3)["bar"].position, world.true(0.3)[1].position)


def test_each_sensor_has_random_numbers_of_its_own() -> None:
    sensor = Sensor(noise=0.01)
    bodies = [WorldObject(name, Sphere(0.1), Straight((1.0, 0.0, 1.0)), sensor) for name in ("a", "b")]
    a, b = World(bodies, seed=4).detections(0.0)
    assert not np.array_equal(a.shape.position, b.shape.position)
    (alone,) = World(bodies[:1], seed=4).detections(0.0)
    np.testing.assert_array_equal(alone.shape.position, a.shape.position)


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: Capsule(0.1, (0.0, 0.0, 0.0)), "capsule axis = (0.0, 0.0, 0.0)"),
        (lambda: Capsule(0.1, (0.0, 1.0)), "capsule axis = (0.0, 1.0)"),
        (lambda: Straight((0.0, 0.0)), "straight motion start = (0.0, 0.0)"),
        (lambda: Straight((0.0, 0.0, 1.0), (1.0,)), "straight motion velocity = (1.0,)"),
        (lambda: Box((0.1, 0.1)), "box half sizes = (0.1, 0.1)"),
        (lambda: HalfSpace((0.0, 1.0)), "half space normal = (0.0, 1.0)"),
        (lambda: Waypoints((0.0, 1.0), ((0.0, 1.0), (2.0, 3.0), (4.0, 5.0))), "waypoint = (0.0, 1.0)"),
    ],
)
def test_vectors_have_three_numbers_and_axes_a_length(make: Callable[[], object], told: str) -> None:
    with pytest.raises(ConfigError) as caught:
        make()
    assert str(caught.value).startswith(told)


def test_names_are_unique() -> None:
    with pytest.raises(ConfigError, match="all different"):
        World((SEEN, SEEN), seed=0)


def test_the_filter_keeps_away_from_bodies_of_every_kind_seen_and_known() -> None:
    """Each comes towards a hand or the torso of a robot that stands, and the barrier of each is recorded."""
    wander = Wandering((1.5, -0.1, 0.9), (1.7, 0.1, 1.1), 0.1, 0.5)
    world = (
        SEEN,
        KNOWN,
        WorldObject("shelf", Box((0.1, 0.3, 0.02), (0.1, 0.0, 0.2)), Straight((0.7, 0.0, 0.6))),
        WorldObject("wall", HalfSpace((-1.0, 0.0, 0.0)), Straight((0.8, 0.0, 0.0))),
        WorldObject("fly", Sphere(0.02), wander, Sensor()),
    )
    result = run(Stand(duration=0.3, world=world))
    assert result.series["obstacles"].shape == (150, 5, 3)
    np.testing.assert_allclose(result.series["obstacles"][:, 3], [[0.8, 0.0, 0.0]] * 150)
    assert not result.summary["fell"]
    assert 0.1 < result.summary["min_h_obstacle_m"] < 0.8


@dataclass(frozen=True)
class Struck(Stand):
    """A heavy ball flies at the torso."""

    name: ClassVar[str] = "struck"


def ball(physical: bool) -> WorldObject:
    return WorldObject("ball", Sphere(0.15), Straight((0.6, 0.0, 0.95), (-1.0, 0.0, 0.0)), None, physical)


def test_a_physical_body_strikes_the_robot_and_one_that_is_only_measured_does_not() -> None:
    touched, passed = (run(Struck(duration=1.0, world=(ball(physical),))) for physical in (True, False))
    assert np.abs(touched.series["com"][-1, 0] - touched.series["com"][0, 0]) > 0.05
    assert touched.series["com"][:, 0].min() < passed.series["com"][:, 0].min() - 0.05
    # what passes through is in the robot, what pushes is not, but for what its contact gives way
    assert passed.summary["min_h_obstacle_m"] < touched.summary["min_h_obstacle_m"] - 0.05


@pytest.mark.parametrize(
    "shape", [Sphere(0.1), Capsule(0.1, (0.0, 0.3, 0.1)), Box((0.1, 0.2, 0.1)), HalfSpace((0, 0, 1.0))]
)
def test_bodies_are_in_the_simulator_where_they_are(robot: RobotDescription, shape: Sphere | Capsule | Box) -> None:
    """A body far from the robot changes nothing of its motion."""
    place = Straight((5.0, 0.0, -30.0), (0.0, 1.0, 0.0))
    given = prepare(Stand(robot=robot.name, world=(WorldObject("far", shape, place, physical=True),)))
    plants = [MujocoPlant(robot, given.plant, bodies=bodies) for bodies in ((), given.world.physical(0.0))]
    for plant in plants:
        plant.reset(standing_configuration(robot))
    plants[1].place_bodies(given.world.physical(2.0))
    for _ in range(50):
        for plant in plants:
            plant.step()
    np.testing.assert_array_equal(plants[0].data.qpos, plants[1].data.qpos)
    assert plants[1].data.mocap_pos[0, 1] == pytest.approx(given.world.physical(2.0)[0].center[1])


# --- falls


def corners(height: float, other: float = 0.0) -> np.ndarray:
    return np.stack([np.tile([0.0, 0.1, height], (4, 1)), np.tile([0.0, -0.1, other], (4, 1))])


@pytest.mark.parametrize(
    ("height", "tilt", "soles", "fallen"),
    [
        (0.8, 0.0, (0.0, 0.0), False),
        (0.8, 0.5, (0.0, 0.3), False),
        (0.8, 1.1, (0.0, 0.0), True),
        (0.4, 0.0, (0.0, 0.0), True),
        (0.6, 0.0, (-0.2, -0.2), True),
        (1.0, 0.0, (0.2, 0.2), True),
        (0.8, 0.0, (-0.01, -0.01), False),
    ],
)
def test_what_counts_as_fallen(height: float, tilt: float, soles: tuple[float, float], fallen: bool) -> None:
    q = np.zeros(8)
    q[2], q[4], q[6] = height, np.sin(0.5 * tilt), np.cos(0.5 * tilt)
    assert has_fallen(q, corners(*soles), 0.8) is fallen


@pytest.mark.parametrize("error", [-0.2, 0.2])
def test_a_wrong_base_height_is_a_fall(error: float, tmp_path: Path) -> None:
    source = load_robot("g1").posture("standing").base_height
    data = (ROOT / "robots" / "data" / "g1.toml").read_text(encoding="utf-8")
    changed = data.replace(f"base_height = {source}", f"base_height = {source + error}")
    assert changed != data
    (tmp_path / "off.toml").write_text(changed, encoding="utf-8")
    result = run(replace(Stand(duration=0.3), robot=str(tmp_path / "off.toml")))
    assert result.summary["fell"]
