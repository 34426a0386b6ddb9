"""The study of parameters on robots that they were not tuned with: what is drawn, what is counted."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from controllers.whole_body.tuning_file import read_tuning
from experiments.recording.recording import Recording
from experiments.running.run import prepare, run
from experiments.scenarios.hand_tracking import HandTracking
from experiments.scenarios.lateral_steps import LateralSteps
from experiments.scenarios.options import FilterOptions, PlantOptions
from experiments.scenarios.passing_sphere import AHEAD, DISTANCE, Passage
from experiments.scenarios.scenario import Scenario
from experiments.scenarios.walk import Walk
from experiments.studies import robustness as study
from experiments.studies.drawn_hands import DrawnHands
from experiments.studies.index import read_study
from experiments.studies.robustness import (
    BARRIERS,
    BEFORE,
    SCENARIOS,
    check_robustness,
    draw,
    filter_options,
    robustness,
    robustness_cases,
    robustness_row,
    summed,
)
from experiments.studies.runs import Run
from experiments.studies.study_options import RobustnessOptions, TuneOptions
from experiments.studies.tuning_scenarios import tuning_runs
from experiments.studies.work import WorkOptions
from robots.errors import ConfigError, SafeWbcError
from robots.loader import load_robot
from safety.barriers.rows import FAMILIES


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_every_draw_is_allowed_within_its_ranges_and_made_again_by_its_seed(robot_name: str, scenario: str) -> None:
    robot = load_robot(robot_name)
    plants = []
    for seed in range(40):
        drawn = draw(robot, robot_name, scenario, seed)
        assert drawn == draw(robot, robot_name, scenario, seed)
        prepare(drawn)
        plants.append(drawn.plant)
    body = {b.name: b.mass for b in robot.bodies}
    low, high = study.STEP_MASS if scenario == "steps" else study.MASS
    for plant in plants:
        assert low <= plant.mass_scale <= high
        assert 0.0 <= plant.joint_friction_scale <= 2.0
        assert plant.actuator_delay in {0.0, 0.001, 0.002, 0.003, 0.004}
        for hand, factor in plant.link_mass.items():
            assert 0.0 <= (factor - 1.0) * body[hand] * plant.mass_scale <= 1.0 + 1e-12
    # all of a range is drawn from, and other robots than those that parameters are tuned with
    assert np.ptp([p.mass_scale for p in plants]) > 0.8 * (high - low)
    tuned = [run.options.plant for run in tuning_runs(robot, TuneOptions(robot=robot_name))]
    assert not [p for p in plants if p in tuned]


def test_walks_and_side_steps_are_both_drawn() -> None:
    kinds = {type(draw(load_robot("g1"), "g1", "steps", seed)) for seed in range(20)}
    assert kinds == {LateralSteps, Walk}


def test_the_hands_of_a_draw_are_those_that_run() -> None:
    robot = load_robot("g1")
    drawn = draw(robot, "g1", "circles", 3)
    short = dataclasses.replace(drawn, duration=1.0, safety=FilterOptions(filter="none"))
    asked = run(short).series["left_hand_ref"]
    usual = run(HandTracking(duration=1.0, plant=drawn.plant, safety=short.safety)).series["left_hand_ref"]
    np.testing.assert_allclose(asked[0], usual[0], atol=1e-9)
    assert np.abs(asked - usual).max() > 1e-3


def test_seeds_are_not_those_of_tuning(tmp_path: Path) -> None:
    tuned = {run.options.seed for run in tuning_runs(load_robot("g1"), TuneOptions())}
    assert not tuned & {
        case.labels["seed"] for case in robustness_cases(RobustnessOptions(parameters=("own",)), tmp_path)
    }


def test_spheres_are_drawn_and_pass_the_hand_that_they_come_to(robot_name: str) -> None:
    robot = load_robot(robot_name)
    draws = [draw(robot, robot_name, "obstacle", seed) for seed in range(40)]
    passages = [d.passage() for d in draws if isinstance(d, DrawnHands) and d.obstacle]
    assert len(passages) == 40
    assert {p.from_left for p in passages} == {True, False}
    for values, (low, high) in (
        ([p.radius for p in passages], study.RADIUS),
        ([p.speed for p in passages], study.SPEED),
        ([p.height for p in passages], study.HEIGHT),
    ):
        assert low <= min(values) < max(values) <= high
        assert np.ptp(values) > 0.8 * (high - low)
    # closer than the radius, so the hand is in the way, and within the run
    assert all(np.hypot(AHEAD, p.height) < p.radius for p in passages)
    assert all(p.speed * draws[0].duration > DISTANCE + 2.0 * p.radius for p in passages)
    assert not draw(robot, robot_name, "target", 1).objects(robot)


def test_the_sphere_of_a_draw_is_the_one_that_runs() -> None:
    robot = load_robot("g1")
    drawn = draw(robot, "g1", "obstacle", 3)
    assert isinstance(drawn, DrawnHands)
    spheres = {}
    for from_left in (True, False):
        passage = Passage(0.07, 0.3, 0.02, from_left)
        series = run(dataclasses.replace(drawn, duration=0.1, sphere=passage)).series
        spheres[from_left] = series["obstacle"]
        hand = series["left_hand_ref" if from_left else "right_hand_ref"][0]
        side = 1.0 if from_left else -1.0
        elapsed = series["time"][-1] - series["time"][0]
        np.testing.assert_allclose(series["obstacle"][0, :3] - hand, [AHEAD, side * DISTANCE, 0.02], atol=1e-3)
        moved = series["obstacle"][-1] - series["obstacle"][0]
        np.testing.assert_allclose(moved, [0.0, -side * 0.3 * elapsed, 0.0, 0.0], atol=1e-9)
        assert (series["obstacle"][:, 3] == 0.07).all()


@pytest.mark.parametrize("change", [{"radius": 0.0}, {"speed": -0.1}, {"height": 0.2}, {"height": np.nan}])
def test_a_passage_that_cannot_be_is_refused(change: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match=f"passing sphere {next(iter(change))}"):
        Passage(**change)


def test_sets_of_parameters_are_compared_on_the_same_draws(tmp_path: Path) -> None:
    options = RobustnessOptions(robots=("tocabi",), parameters=("before", "own", "adaptive", "own-adaptive"), seeds=2)
    check_robustness(options)
    cases = robustness_cases(options, tmp_path)
    assert len(cases) == 4 * 2 * len(options.scenarios)
    assert len({case.key for case in cases}) == len(cases)
    for group in zip(*(cases[i::4] for i in range(4)), strict=True):
        assert len({(case.labels["scenario"], case.labels["seed"]) for case in group}) == 1
        names = [case.labels["parameters"] for case in group]
        assert names == ["before", "own", "before, adaptive", "own, adaptive"]
        runs = [case.evaluate.scenario for case in group if isinstance(case.evaluate, Run)]
        a, b, c, d = (r for r in runs if isinstance(r, Scenario))
        assert {dataclasses.replace(r, safety=FilterOptions()).key() for r in (a, b, c, d)} == {b.key()}
        assert d.safety == FilterOptions(adaptive=True)
        assert a.safety.tuning == c.safety.tuning
        assert (a.safety.adaptive, c.safety.adaptive) == (False, True)
        assert b.safety == FilterOptions()
        assert read_tuning(a.safety.tuning, "tocabi").families == BEFORE["tocabi"]


def test_before_names_every_family_that_is_tuned(tmp_path: Path) -> None:
    for robot, families in BEFORE.items():
        assert set(families) == set(FAMILIES) - {"custom"}
        filter_options(load_robot(robot), "before", tmp_path)


@pytest.mark.parametrize("barrier", BARRIERS)
@pytest.mark.parametrize(("least", "below"), [(1e-9, False), (0.0, False), (-1e-9, True)])
def test_a_run_counts_as_below_where_any_barrier_was(barrier: str, least: float, below: bool) -> None:
    heights = {f"min_h_{key}": None if key == "obstacle_m" else 0.02 for key in BARRIERS} | {f"min_h_{barrier}": least}
    ended = {"fell": False, "stop_cause": None, "hand_rmse_m": 0.01, "hand_rmse_outside_conflict_m": 0.01}
    config = {"scenario": Walk().to_json()}
    line = robustness_row(Recording(load_robot("g1"), config, heights | ended, {}))
    assert line["below"] is below
    assert line[f"min_h_{barrier}"] == least


def row(**changes: Any) -> dict[str, Any]:
    usual = {
        "robot": "g1",
        "scenario": "target",
        "parameters": "own",
        "below": False,
        "min_h_self_collision_m": 0.004,
        "min_h_joint_limit_rad": 0.2,
        "min_h_obstacle_m": None,
        "min_h_workspace_m": 0.1,
        "fell": False,
        "stop_cause": None,
        "hand_rmse_m": 0.02,
        "hand_rmse_outside_conflict_m": None,
    }
    return usual | changes


def test_lines_of_the_table_are_shares_and_least_values() -> None:
    rows = [
        row(),
        row(below=True, min_h_self_collision_m=-0.001, hand_rmse_m=0.04, hand_rmse_outside_conflict_m=0.01),
        row(stop_cause="lost", min_h_joint_limit_rad=0.1),
        row(fell=True),
        row(parameters="before", min_h_obstacle_m=0.0005),
    ]
    own, before = summed(rows)
    assert (own["parameters"], own["runs"], own["below"], own["ended"]) == ("own", 4, 0.25, 0.5)
    assert (own["least_m"], own["least_rad"]) == (-0.001, 0.1)
    assert own["rmse"] == pytest.approx(0.025)
    assert own["rmse_outside"] == 0.01
    assert (before["runs"], before["least_m"], before["rmse_outside"]) == (1, 0.0005, None)


def test_a_study_writes_its_lines(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    short = HandTracking(motion="target", duration=0.3, plant=PlantOptions(mass_scale=1.1))
    prepare(short)
    monkeypatch.setattr(study, "draw", lambda *args: short)
    options = RobustnessOptions(
        robots=("g1",),
        scenarios=("target",),
        seeds=1,
        parameters=("before", "own"),
        work=WorkOptions(jobs=1, out=tmp_path / "study"),
    )
    assert robustness(options) == 0
    rows = read_study(tmp_path / "study").rows()
    assert [row.labels["parameters"] for row in rows] == ["before", "own"]
    assert all(row.metrics["drawn"]["mass_scale"] == 1.1 for row in rows)
    assert capsys.readouterr().out.count("| g1 | target |") == 2


@pytest.mark.parametrize(
    "change",
    [
        {"seeds": 0},
        {"first_seed": -1},
        {"work": WorkOptions(jobs=0)},
        {"scenarios": ("dance",)},
        {"scenarios": ()},
        {"robots": ()},
        {"parameters": ("missing.toml",)},
    ],
)
def test_options_that_are_not_allowed_are_refused(change: dict[str, Any]) -> None:
    with pytest.raises(SafeWbcError):
        check_robustness(RobustnessOptions(**change))


def test_what_was_before_is_known_of_two_robots_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    other = dataclasses.replace(load_robot("g1"), name="mine")
    monkeypatch.setattr(study, "load_robot", lambda name: other)
    with pytest.raises(ConfigError, match="before"):
        check_robustness(RobustnessOptions(robots=("mine.toml",)))
    check_robustness(RobustnessOptions(robots=("mine.toml",), parameters=("own",)))
