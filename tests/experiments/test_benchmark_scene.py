"""Cases of the benchmarks as data, and scenes that a seed gives: those of SPARK, number by number."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from experiments.scenarios.benchmark_case import BenchmarkCase, CaseBook, load_cases
from experiments.scenarios.benchmark_scene import (
    START,
    CrowdedError,
    DrawnScene,
    benchmark_kinematics,
    benchmark_robot,
    draw_scene,
    robot_spheres,
)
from robots.errors import ConfigError, UnknownNameError
from robots.messages import Array

BOOK = load_cases()
ROBOT = benchmark_robot(BOOK.robot)
SPHERES = robot_spheres(BOOK, ROBOT)
HEIGHT = BOOK.robot.base_height

HALF_A_DIGIT = 5.1e-7
"""Figures of the reference are written with six digits after the point [m]."""


def scene(name: str, seed: int = 0, number: int | None = None) -> DrawnScene:
    return draw_scene(BOOK.case(name), seed, SPHERES, HEIGHT, number)


# measured: SPARK v1.0, seed 0, its own code
FIXED = [
    [0.135907, -0.061076, 1.016715],
    [-0.230297, -0.383825, 1.166096],
    [0.339327, -0.030817, 1.124423],
    [0.455735, 0.017479, 0.83173],
    [0.154747, -0.384968, 0.994108],
]
MORE = [
    [0.245456, -0.112394, 0.849626],
    [0.23651, -0.231694, 0.603141],
    [0.050881, 0.390699, 0.581636],
    [-0.097367, -0.026951, 0.69554],
    [-0.189454, -0.242734, 0.79498],
]


@pytest.mark.parametrize("kind", ["D1_AG_SO", "D2_AG_SO", "D1_AG_DO"])
def test_scenes_on_a_fixed_base_are_those_of_spark(kind: str) -> None:
    drawn = scene(f"G1FixedBase_{kind}_v0")
    np.testing.assert_allclose(drawn.obstacles, FIXED, rtol=0.0, atol=HALF_A_DIGIT)
    goals = [[0.309289, 0.118068, 0.20003], [0.301191, -0.336885, 0.038678]]
    np.testing.assert_allclose(drawn.hand_goals, goals, rtol=0.0, atol=HALF_A_DIGIT)
    assert drawn.base_goal is None
    drawn = scene(f"G1FixedBase_{kind}_v1")
    np.testing.assert_allclose(drawn.obstacles, FIXED + MORE, rtol=0.0, atol=HALF_A_DIGIT)
    goals = [[0.393028, 0.281454, 0.221779], [0.111756, -0.315158, 0.036059]]
    np.testing.assert_allclose(drawn.hand_goals, goals, rtol=0.0, atol=HALF_A_DIGIT)


def test_scenes_on_a_mobile_base_are_those_of_spark() -> None:
    drawn = scene("G1MobileBase_D1_WG_SO_v0")
    first = [[0.089766, -0.15269, 1.016715], [-0.233117, 0.58345, 0.923116], [-0.825741, -0.959563, 1.166096]]
    np.testing.assert_allclose(drawn.obstacles[:3], first, rtol=0.0, atol=HALF_A_DIGIT)
    assert drawn.base_goal is not None
    np.testing.assert_allclose(drawn.base_goal, [-0.7373, -0.347509, -1.280889], rtol=0.0, atol=HALF_A_DIGIT)
    goals = [[0.346298, 0.12913, 0.251383], [0.12883, -0.107062, 0.140595]]
    np.testing.assert_allclose(drawn.hand_goals, goals, rtol=0.0, atol=HALF_A_DIGIT)


def test_the_robots_spheres_are_where_spark_has_them() -> None:
    centres, radii = SPHERES
    assert centres.shape == (25, 3) and sorted(radii) == [0.05] * 20 + [0.06] * 2 + [0.08] + [0.1] * 2
    # measured there, with five digits: right elbow, left hand, head; waist pitch, pelvis to the left
    for place in (
        [0.01579, -0.23411, 0.92373],
        [0.24979, 0.24053, 0.91585],
        [-0.00396, 0.0, 1.237],
        [-0.00396, 0.0, 0.837],
        [0.0, 0.15, 0.793],
    ):
        assert np.abs(centres - place).max(axis=1).min() < 1.1e-5, place


def test_obstacles_keep_off_the_robot_and_each_other_and_goals_off_obstacles() -> None:
    for name, case in BOOK.cases.items():
        for seed in (0, 7, 20):
            drawn = draw_scene(case, seed, SPHERES, HEIGHT)
            o, box = case.obstacles, np.array([case.obstacles.low, case.obstacles.high])
            assert len(drawn.obstacles) == o.number, name
            assert ((drawn.obstacles >= box[0]) & (drawn.obstacles <= box[1])).all()
            assert distances(drawn.obstacles, SPHERES[0], SPHERES[1] + o.radius).min() >= o.robot_keep_out
            own = distances(drawn.obstacles, drawn.obstacles, np.full(o.number, 2.0 * o.radius))
            assert own[~np.eye(o.number, dtype=bool)].min() >= o.keep_out
            goals = drawn.hand_goals + np.array([0.0, 0.0, HEIGHT])
            assert distances(goals, drawn.obstacles, np.zeros(o.number)).min() >= case.goals.hand_keep_out


def distances(points: Array, centres: Array, radii: Array) -> Array:
    return np.asarray(np.linalg.norm(points[:, None] - centres, axis=2) - radii)


def test_a_seed_gives_its_scene_and_another_one_another() -> None:
    first, again, other = (scene("G1MobileBase_D1_WG_SO_v1", seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.obstacles, again.obstacles)
    np.testing.assert_array_equal(first.directions, again.directions)
    assert np.abs(first.obstacles - other.obstacles).max() > 0.1


def test_what_finds_no_place_is_said() -> None:
    with pytest.raises(CrowdedError, match=r"G1FixedBase_D1_AG_SO_v0: obstacle \d+ of 900"):
        scene("G1FixedBase_D1_AG_SO_v0", number=900)
    with pytest.raises(ConfigError, match="seed"):
        scene("G1FixedBase_D1_AG_SO_v0", -1)


@pytest.mark.parametrize(
    "name, nv", [("G1RightArm", 7), ("G1FixedBase", 17), ("G1MobileBase", 20), ("G1SportMode", 20)]
)
def test_configurations_have_the_papers_degrees_of_freedom(name: str, nv: int) -> None:
    case = next(case for case in BOOK.cases.values() if case.configuration.name == name)
    kin = benchmark_kinematics(ROBOT, case)
    assert kin.nv == nv
    kin.update_geometry(kin.posture(START))
    names = kin.joint_names
    assert {case.order for case in BOOK.cases.values() if case.configuration.name == name} == {1, 2}
    assert all(joint in case.configuration.joints for joint in names)


def test_cases_of_both_papers_are_there_with_their_numbers() -> None:
    spark = [case for case in BOOK.cases.values() if case.source == "SPARK"]
    assert len(spark) == 18 and {case.margin for case in spark} == {0.1}
    pssa = {name: case for name, case in BOOK.cases.items() if case.source == "p-SSA"}
    # table I: obstacles
    numbers = {"G1FixedBase_SO_V0": 10, "G1FixedBase_DO_V1": 5, "G1WholeBody_SO_V0": 50, "G1WholeBody_DO_V1": 10}
    assert {name: pssa[name].obstacles.number for name in numbers} == numbers
    assert len(pssa) == 8 and {case.margin for case in pssa.values()} == {0.05}


# --- cases of one's own


HEAD = """
[robot]
description = "g1"
collision_model = "g1_spheres"
base_height = 0.793
joints = {}
[joints]
arm = ["left_elbow_joint"]
[[configuration]]
name = "elbow"
base = "fixed"
joints = ["arm"]
[[case]]
name = "first"
configuration = "elbow"
order = 1
obstacles = {number = 2, paper_number = 2, low = [-1.0, -1.0, 0.0], high = [1.0, 1.0, 1.0], keep_out = 0.0}
[case.goals]
left_low = [0.1, 0.1, 0.0]
left_high = [0.4, 0.4, 0.3]
right_low = [0.1, -0.4, 0.0]
right_high = [0.4, -0.1, 0.3]
"""


def written(folder: Path, text: str) -> CaseBook:
    path = folder / "mine.toml"
    path.write_text(HEAD + text, encoding="utf-8")
    return load_cases(path)


def test_a_case_of_ones_own_is_a_few_lines(tmp_path: Path) -> None:
    book = written(tmp_path, '[[case]]\nname = "second"\nlike = "first"\norder = 2\nobstacles = {number = 3}\n')
    first, second = book.case("first"), book.case("second")
    assert second == replace(
        first, name="second", order=2, obstacles=replace(first.obstacles, number=3)
    ) and isinstance(second, BenchmarkCase)


@pytest.mark.parametrize(
    "text, message",
    [
        ('[[case]]\nname = "x"\nlike = "none"\n', r"case x.like = .*none.*must be one of the cases above: first"),
        ('[[case]]\nname = "first"\n', "case = .*first.*must be in the file once"),
        ('[[case]]\nname = "x"\nlike = "first"\nordre = 2\n', r"case x.ordre = 2: must be absent"),
        ('[[case]]\nname = "x"\nlike = "first"\norder = 3\n', r"case x: order = 3: must be"),
        ('[[case]]\nname = "x"\nlike = "first"\nobstacles = {number = -1}\n', r"case x: number = -1: must be"),
        (
            '[[case]]\nname = "x"\nlike = "first"\nobstacles = {motion = "fly"}\n',
            r"case x: motion = .*fly.*must be one of still",
        ),
        ('[[case]]\nname = "x"\nlike = "first"\nobstacles = {low = [2.0, 0.0, 0.0]}\n', "case x: box of obstacles"),
        (
            '[[case]]\nname = "x"\nlike = "first"\nconfiguration = "leg"\n',
            r"case x.configuration = .*leg.*must be one of elbow",
        ),
        ('[[case]]\nname = "x"\nlike = "first"\ngoals = {base_low = [0.0, 0.0]}\n', "base_low and base_high"),
        ("[other]\n", "cases: other = .*must be absent"),
        ("[[case]\n", "a TOML file"),
    ],
)
def test_what_is_wrong_in_a_file_is_named(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        written(tmp_path, text)


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"missing.toml"):
        load_cases(tmp_path / "missing.toml")
    with pytest.raises(UnknownNameError, match="G1FixedBase_SO_V2"):
        BOOK.case("G1FixedBase_SO_V2")
