"""Random walks: what is drawn lies within its bounds and belongs to the seed; a run can be made again, bit by bit."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from experiments.running.run import run
from experiments.scenarios.options import PlantOptions
from experiments.scenarios.pushes import PUSH_TIME
from experiments.scenarios.random_draw import draw_walk, true_mass
from experiments.scenarios.random_walk import RandomWalk
from experiments.studies import random_walks as study
from experiments.studies.random_walks import falls
from experiments.studies.study_options import RandomWalksOptions
from experiments.studies.work import WorkOptions
from robots.errors import SafeWbcError
from robots.loader import load_robot
from robots.mujoco_spec import PhysicalChanges, build_mujoco_spec

SEEDS = range(300)
DURATION = 20.0


def test_what_is_drawn_lies_within_its_bounds() -> None:
    robot = load_robot("g1")
    for seed in SEEDS:
        drawn = draw_walk(robot, seed, DURATION)
        plant = drawn.plant
        assert 0.85 <= plant.mass_scale <= 1.25
        assert set(plant.link_mass) == {body.name for body in robot.bodies}
        assert all(0.9 <= scale <= 1.1 for scale in plant.link_mass.values())
        assert 0.5 <= plant.friction <= 1.0
        assert 0.5 <= plant.noise_scale <= 1.0
        assert round(1e3 * plant.actuator_delay, 9) in (2, 3, 4)
        for command in drawn.script.commands:
            assert abs(command.vx) <= 0.3
            assert abs(command.vy) <= 0.1
            assert abs(command.wz) <= 0.3
        gaps = np.diff(drawn.script.times)
        assert ((gaps >= 2.0) & (gaps <= 5.0)).all()
        assert DURATION - drawn.script.times[-1] <= 5.0
        assert 1 <= len(drawn.pushes) <= 3


@pytest.mark.parametrize("duration", [6.0, DURATION])
def test_impulses_are_those_of_the_pushes_which_never_overlap(duration: float) -> None:
    robot = load_robot("g1")
    for seed in SEEDS:
        drawn = draw_walk(robot, seed, duration)
        mass = true_mass(robot, drawn.plant)
        steps = np.arange(0.0, duration, 1e-3)
        force = np.array([[push.at(t) for push in drawn.pushes] for t in steps[::10]])
        assert (np.count_nonzero(force.any(axis=2), axis=1) <= 1).all()
        for push, impulse in zip(drawn.pushes, drawn.impulses, strict=True):
            assert push.force * PUSH_TIME / mass == pytest.approx(impulse)
            assert 0.0 < impulse <= 0.1
            assert push.time + PUSH_TIME <= duration


def test_everything_is_spread_over_its_range_and_all_kinds_of_commands_occur() -> None:
    robot = load_robot("g1")
    walks = [draw_walk(robot, seed, DURATION) for seed in SEEDS]
    for values, low, high in (
        ([w.plant.mass_scale for w in walks], 0.85, 1.25),
        ([w.plant.friction for w in walks], 0.5, 1.0),
        ([w.plant.noise_scale for w in walks], 0.5, 1.0),
        ([p.direction for w in walks for p in w.pushes], 0.0, 360.0),
        ([s for w in walks for s in w.plant.link_mass.values()], 0.9, 1.1),
    ):
        # the mean of n uniform numbers lies within five of its standard deviations
        spread = (high - low) / np.sqrt(12 * len(values))
        assert abs(np.mean(values) - 0.5 * (low + high)) < 5 * spread
    commands = [c for w in walks for c in w.script.commands]
    stopped = np.mean([not c.walks for c in commands])
    stepping = np.mean([c.stepping for c in commands])
    assert 0.1 < stopped < 0.2
    assert 0.1 < stepping < 0.2
    assert {len(w.pushes) for w in walks} == {1, 2, 3}


def test_a_seed_gives_one_walk_and_another_seed_another() -> None:
    robot = load_robot("g1")
    first, again, other = (draw_walk(robot, seed, DURATION) for seed in (4, 4, 5))
    assert first.plant == again.plant
    assert first.pushes == again.pushes
    assert (first.script.times, first.script.commands) == (again.script.times, again.script.commands)
    assert other.plant.mass_scale != first.plant.mass_scale
    assert other.pushes != first.pushes


def test_mass_of_the_simulated_robot() -> None:
    robot = load_robot("g1")
    plant = draw_walk(robot, 3, DURATION).plant
    changes = PhysicalChanges(mass_scale=plant.mass_scale, link_mass_scale=plant.link_mass)
    assert true_mass(robot, plant) == pytest.approx(build_mujoco_spec(robot, changes).compile().body_mass.sum())


def test_the_study_makes_the_runs_that_each_seed_makes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """In a process of its own: the figures that are saved are, bit by bit, those of a run made here."""
    options = RandomWalksOptions(runs=1, first_seed=8, duration=6.0, work=WorkOptions(out=tmp_path / "runs"))
    assert study.random_walks(options) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("| ")]
    assert [line.split(" | ")[0] for line in lines[2:]] == ["| 8"]
    saved = json.loads((tmp_path / "runs" / "random-walk-8" / "summary.json").read_text(encoding="utf-8"))
    here = run(RandomWalk(seed=8, duration=6.0))
    timed = {name for name in saved if name.startswith("tick_ms")}
    assert {k: v for k, v in saved.items() if k not in timed} == {
        k: v for k, v in here.summary.items() if k not in timed
    }
    assert here.config["scenario"] == RandomWalk(seed=8, duration=6.0).to_json()
    assert here.config["plant"]["changes"]["mass_scale"] == draw_walk(here.robot, 8, 6.0).plant.mass_scale


def test_falls_are_counted_and_named() -> None:
    rows = [{"seed": 3, "ended": "no"}, {"seed": 4, "ended": "at 2.5 s"}, {"seed": 9, "ended": "stopped at 1.0 s"}]
    assert falls(rows) == "2 of 3 fell or were stopped (66.7 %): seed 4 (at 2.5 s), 9 (stopped at 1.0 s)."
    assert falls(rows[:1]) == "0 of 1 fell or were stopped (0 %)."


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"runs": 0}, "runs"),
        ({"duration": 3.0}, "duration"),
        ({"robot": "nobody"}, "nobody"),
        ({"work": WorkOptions(jobs=0)}, "jobs"),
    ],
)
def test_wrong_options_are_refused_before_any_run(change: dict[str, object], named: str, tmp_path: Path) -> None:
    options = dataclasses.replace(RandomWalksOptions(), **change)
    options = dataclasses.replace(options, work=dataclasses.replace(options.work, out=tmp_path / "runs"))
    with pytest.raises(SafeWbcError, match=named):
        study.random_walks(options)
    assert not (tmp_path / "runs").exists()


def test_what_the_seed_draws_is_no_option() -> None:
    with pytest.raises(SafeWbcError, match="drawn from the seed"):
        run(RandomWalk(plant=PlantOptions(mass_scale=1.1)))
