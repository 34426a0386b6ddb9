"""Every folder that any command leaves can be loaded and replayed, from any working directory."""

import json
import shutil
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from experiments.cli import main as cli
from experiments.recording.recording import load_recording
from experiments.scenarios.options import PlantOptions
from experiments.scenarios.registry import SCENARIOS
from experiments.scenarios.scenario import Scenario
from experiments.scenarios.stand import Stand
from experiments.studies import pushes, results_tables
from experiments.studies.backends import LocalBackend
from experiments.studies.case import Case, Study
from experiments.studies.engine import carry_out
from experiments.studies.locomotion_tables import chosen_tables
from experiments.studies.random_walks import random_walk_cases
from experiments.studies.runs import Run
from experiments.studies.speed import FastestWalk
from experiments.studies.study_options import LocomotionTableOptions, RandomWalksOptions

ROOT = Path(__file__).resolve().parents[2]
QUIET = ("--no-video", "--no-report")
RUNS = {
    "stand": ("--duration", "0.1", "--robot", "tocabi"),
    "hand-tracking": ("--duration", "0.1", "--obstacle", "--motion", "hold"),
    "taichi": ("--duration", "0.2", "--push", "20,left,0.05"),
    "lateral-steps": (
        "--duration",
        "0.1",
    ),
    "walk": ("--duration", "4.1", "--script", "walk.txt", "--push", "20,left,0.5"),
    "random-walk": ("--duration", "6.0", "--seed", "2"),
    "pushed": ("--duration", "0.3", "--push", "30,forward,0.1", "--activity", "walking"),
}


def call(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["safewbc", *arguments])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    assert isinstance(caught.value.code, int)
    return caught.value.code


def assert_replayed(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    """Every run below a folder, found by its configuration, after the folder was moved, from another directory."""
    moved, elsewhere = tmp_path / "moved", tmp_path / "elsewhere"
    shutil.move(folder, moved)
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    found = sorted(path.parent for path in moved.rglob("config.json"))
    assert len(found) == count
    for run in found:
        assert load_recording(run).summary["scenario"]
        assert call(monkeypatch, "replay", str(run)) == 0


@pytest.mark.parametrize("name", RUNS)
def test_a_run_is_made_again(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "walk.txt").write_text("0 0.1 0 0\n", encoding="utf-8")
    assert call(monkeypatch, "run", name, *RUNS[name], *QUIET, "--out", "run") == 0
    assert_replayed(tmp_path / "run", tmp_path, monkeypatch, 1)


def test_every_scenario_of_the_command_line_is_among_them() -> None:
    assert set(RUNS) == {scenario.name for scenario in SCENARIOS}


def test_a_robot_of_ones_own_is_found_again_and_a_changed_one_is_the_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    text = (ROOT / "robots" / "data" / "g1.toml").read_text(encoding="utf-8")
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
    assert call(monkeypatch, "run", "stand", "--robot", "mine.toml", "--duration", "0.1", *QUIET, "--out", "run") == 0
    (tmp_path / "away").mkdir()
    monkeypatch.chdir(tmp_path / "away")
    assert call(monkeypatch, "replay", "../run") == 0
    changed = text.replace("base_height = 0.7566", "base_height = 0.7560")
    assert changed != text
    (tmp_path / "mine.toml").write_text(changed, encoding="utf-8")
    capsys.readouterr()
    assert call(monkeypatch, "replay", "../run") == 1
    assert f"the robot's description has changed since the run: {tmp_path / 'mine.toml'}" in capsys.readouterr().out


def test_the_demo(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert call(monkeypatch, "demo", "--duration", "0.1", *QUIET, "--out", str(tmp_path / "demo")) == 0
    assert_replayed(tmp_path / "demo", tmp_path, monkeypatch, 2)


def test_the_corridor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = ("--out", str(tmp_path / "corridor"))
    assert call(monkeypatch, "run", "corridor", "--duration", "0.2", "--seed", "3", "--no-report", *out) == 0
    assert_replayed(tmp_path / "corridor", tmp_path, monkeypatch, 6)


def carried_out(cases: Sequence[Case], folder: Path) -> None:
    rows = carry_out(Study("a study", cases), folder, LocalBackend(1))
    assert [row.error for row in rows] == [None] * len(cases)


def test_random_walks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Their arrays are not saved: what is compared is their summaries."""
    options = RandomWalksOptions(runs=1, duration=6.0)
    carried_out(random_walk_cases(options), tmp_path / "walks")
    assert load_recording(tmp_path / "walks" / "random-walk-0").series == {}
    assert_replayed(tmp_path / "walks", tmp_path, monkeypatch, 1)


@pytest.mark.parametrize("stance", ["standing", "walking", "one-leg"])
def test_pushes(stance: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    case = pushes.PushCase("g1", stance, "left", 0.1, 1.1)
    search = pushes.PushSearch("g1", stance, "sideways", 1.1, resolution=0.1, largest=0.1, below="")
    monkeypatch.setattr(pushes, "AFTER", 0.2)
    carried_out([search.run(case, 1)], tmp_path / "pushes")
    assert_replayed(tmp_path / "pushes", tmp_path, monkeypatch, 1)


def test_a_walk_of_the_speed_search(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    carried_out([FastestWalk("g1", 1.0, 4.2, "").walk(2)], tmp_path / "speed")
    assert_replayed(tmp_path / "speed", tmp_path, monkeypatch, 1)


@pytest.mark.parametrize("section", ["taichi", "lateral-steps", "walks"])
def test_a_section_of_the_locomotion_table(section: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    options = LocomotionTableOptions(only=(section,), quick=True)
    case = next(case for part in chosen_tables(options) for case in part.cases)
    assert isinstance(case.evaluate, Run)
    scenario = case.evaluate.scenario
    assert isinstance(scenario, Scenario)
    short = replace(case.evaluate, scenario=replace(scenario, duration=4.1))
    carried_out([replace(case, evaluate=short)], tmp_path / "table")
    assert_replayed(tmp_path / "table", tmp_path, monkeypatch, 1)


def test_a_sweep(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    arguments = ("sweep", "stand", "--duration", "0.1", "--mass-scale", "1.0,1.1", "--jobs", "1")
    assert call(monkeypatch, *arguments, "--out", str(tmp_path / "sweep")) == 0
    assert_replayed(tmp_path / "sweep", tmp_path, monkeypatch, 2)


def test_a_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    group = [Stand(duration=0.1, plant=PlantOptions(mass_scale=1.1))]
    monkeypatch.setitem(results_tables.PAGES, "results", lambda: {"Short": (group, results_tables.STAND_COLUMNS)})
    assert call(monkeypatch, "table", "--jobs", "1", "--out", str(tmp_path / "table")) == 0
    assert_replayed(tmp_path / "table", tmp_path, monkeypatch, 1)


def test_a_damaged_summary_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    carried_out(random_walk_cases(RandomWalksOptions(runs=1, duration=6.0)), tmp_path / "walks")
    path = tmp_path / "walks" / "random-walk-0" / "summary.json"
    summary = json.loads(path.read_text())
    path.write_text(json.dumps(summary | {"steps": summary["steps"] + 1}))
    assert call(monkeypatch, "replay", str(path.parent)) == 1
