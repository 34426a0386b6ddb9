"""Which runs stand behind the tables of which page, and that their columns say something of them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from experiments.recording.recording import RunResult
from experiments.scenarios.hand_tracking import HandTracking
from experiments.scenarios.options import TableOptions
from experiments.scenarios.scenario import Scenario
from experiments.studies import results_tables as tables
from experiments.studies.safety_tables import friction_runs, safety_runs
from robots.loader import load_robot
from safety.filters.safety_filter import FILTERS

DOCS = Path(__file__).parents[2] / "docs"


def rows_of(page: str) -> list[str]:
    return [line for line in (DOCS / page).read_text(encoding="utf-8").splitlines() if line.startswith("| ")]


def options_of(groups: Mapping[str, tuple[list[Scenario], Any]]) -> list[Scenario]:
    return [options for group, _ in groups.values() for options in group]


PAGES = [("results", "results.md"), ("safety", "safety.md"), ("friction", "safety.md")]


@pytest.mark.parametrize(("what", "page"), PAGES)
def test_each_page_has_the_runs_of_its_own(
    what: str, page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Every table that the command prints stands on the page, with the same columns and as many rows."""
    asked: list[Scenario] = []

    def pretended(tasks: list[Scenario], jobs: int, console: Console) -> Any:
        asked.extend(tasks)
        return (RunResult(load_robot(o.robot), {}, {"robot": o.robot, "filter": o.safety.filter}, {}) for o in tasks)

    monkeypatch.setattr(tables, "_run_all", pretended)
    monkeypatch.setattr(tables, "save_result", lambda result, folder: None)
    assert tables.table(TableOptions(what=what, out=tmp_path / "runs")) == 0  # type: ignore[arg-type]
    printed = [line for line in capsys.readouterr().out.splitlines() if line.startswith("| ")]
    heads = [line for line in printed if "[" in line]
    assert heads
    assert set(heads) <= set(rows_of(page))
    assert asked == options_of({"safety": safety_runs, "friction": friction_runs, "results": tables.runs}[what]())


def test_every_filter_is_run_on_both_robots() -> None:
    circles = {(o.robot, o.safety.filter) for o in options_of(safety_runs()) if o.plant.mass_scale == 1.2}
    assert circles >= {(robot, name) for robot in ("g1", "tocabi") for name in FILTERS}


def test_runs_that_differ_have_folders_that_differ() -> None:
    """The same run may stand in two tables."""
    for groups in (safety_runs(), friction_runs(), tables.runs()):
        folders: dict[str, Scenario] = {}
        for options in options_of(groups):
            assert folders.setdefault(tables.run_folder(options), options) == options
    told = [o.obstacle_velocity for o in options_of(safety_runs()) if isinstance(o, HandTracking) and o.obstacle]
    assert set(told) == {"zero", "estimated", "true"}
