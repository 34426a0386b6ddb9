"""The sphere model of the G1 against the published places, and what a collision model leaves alone."""

import dataclasses

import numpy as np
import pytest

from robots.collision_models import COLLISION_MODELS, with_collision_model
from robots.description import RobotDescription
from robots.errors import DescriptionError, UnknownNameError
from robots.kinematics import Kinematics
from robots.loader import load_robot

PELVIS_HEIGHT = 0.793
HALF_DIGIT = 5e-6
"""The published places are rounded to 1e-5 m."""

# Centre in the world [m] and radius [m]; source: SPARK v1.0, arms down, shoulder roll +-0.5 rad, pelvis at 0.793 m.
PUBLISHED = {
    "left_shoulder_pitch": ((-0.00001, 0.10022, 1.08478), 0.05),
    "left_shoulder_roll": ((0.0, 0.14056, 1.08196), 0.06),
    "left_shoulder_yaw": ((0.00001, 0.19552, 0.99439), 0.05),
    "left_elbow": ((0.01579, 0.23412, 0.92373), 0.05),
    "left_wrist_roll": ((0.11579, 0.24055, 0.91585), 0.05),
    "left_wrist_pitch": ((0.15379, 0.24055, 0.91585), 0.05),
    "left_wrist_yaw": ((0.19979, 0.24054, 0.91585), 0.05),
    "right_shoulder_pitch": ((-0.00001, -0.10021, 1.08478), 0.05),
    "right_shoulder_roll": ((0.0, -0.14055, 1.08196), 0.06),
    "right_shoulder_yaw": ((0.00001, -0.19551, 0.99439), 0.05),
    "right_elbow": ((0.01579, -0.23411, 0.92373), 0.05),
    "right_wrist_roll": ((0.11579, -0.24054, 0.91585), 0.05),
    "right_wrist_pitch": ((0.15379, -0.24054, 0.91585), 0.05),
    "right_wrist_yaw": ((0.19979, -0.24053, 0.91585), 0.05),
    "left_hand": ((0.24979, 0.24053, 0.91585), 0.05),
    "right_hand": ((0.24979, -0.24052, 0.91585), 0.05),
    "torso_low": ((-0.00396, 0.0, 0.937), 0.10),
    "torso_high": ((-0.00396, 0.0, 1.037), 0.10),
    "head": ((-0.00396, 0.0, 1.237), 0.08),
}


@pytest.fixture(scope="module")
def robot() -> RobotDescription:
    return with_collision_model(load_robot("g1"), "g1_spheres")


def test_spheres_are_where_they_were_published(robot: RobotDescription) -> None:
    kin = Kinematics(robot, base="fixed")
    q = np.zeros(kin.nq)
    q[kin.joint_names.index("left_shoulder_roll_joint")] = 0.5
    q[kin.joint_names.index("right_shoulder_roll_joint")] = -0.5
    kin.update_geometry(q)
    lift = np.array([0.0, 0.0, PELVIS_HEIGHT - robot.posture("standing").base_height])
    assert [s.name for s in robot.collisions] == list(PUBLISHED)
    for sphere in robot.collisions:
        centre, radius = PUBLISHED[sphere.name]
        rotation, position = kin.frame_placement(kin.frame_id(sphere.body))
        assert sphere.is_sphere
        assert sphere.radius == radius
        np.testing.assert_allclose(rotation @ sphere.start + position + lift, centre, rtol=0, atol=HALF_DIGIT)


def test_pairs_are_the_published_rule(robot: RobotDescription) -> None:
    """All pairs of shoulder rolls, elbows, hands and torso, but torso with itself and with a shoulder it touches."""
    arms = {f"{side}_{part}" for side in ("left", "right") for part in ("shoulder_roll", "elbow", "hand")}
    torso = {"torso_low", "torso_high", "head"}
    names = sorted(arms | torso)
    expected = {frozenset((a, b)) for a in names for b in names if a < b}
    expected -= {frozenset((a, b)) for a in torso for b in torso}
    for side in ("left", "right"):
        expected -= {frozenset((f"{side}_shoulder_roll", part)) for part in ("torso_low", "torso_high")}
    assert {frozenset(pair) for pair in robot.self_collision_pairs} == expected
    assert len(robot.self_collision_pairs) == len(expected) == 29
    assert robot.leg_pairs == ()


def test_everything_else_stays(robot: RobotDescription) -> None:
    original = load_robot("g1")
    changed = {"collisions", "self_collision_pairs", "leg_pairs"}
    kept = [f.name for f in dataclasses.fields(robot) if f.name not in changed]
    again = with_collision_model(original, "g1_spheres")
    for name in kept:
        assert getattr(again, name) is getattr(original, name)
    assert len(original.leg_pairs) == 5


def test_unknown_model_names_the_known_ones() -> None:
    with pytest.raises(UnknownNameError, match=r"unknown collision model 'boxes': known are g1_spheres"):
        with_collision_model(load_robot("g1"), "boxes")


@pytest.mark.parametrize("name", COLLISION_MODELS)
def test_a_robot_without_the_bodies_is_refused(name: str) -> None:
    message = rf"{name}\.toml: collision '.*': body = '.*': must be the name of a body of the robot 'tocabi'"
    with pytest.raises(DescriptionError, match=message):
        with_collision_model(load_robot("tocabi"), name)
