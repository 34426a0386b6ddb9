"""Which runs stand behind the tables of which page, and that their columns say something of them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from experiments.reports.metric_tables import rows_table
from experiments.scenarios.hand_tracking import HandTracking
from experiments.scenarios.scenario import Scenario
from experiments.studies import results_tables as tables
from experiments.studies.runs import Run
from experiments.studies.safety_tables import safety_runs
from safety.filters.safety_filter import FILTERS

DOCS = Path(__file__).parents[2] / "docs"


def rows_of(page: str) -> list[str]:
    return [line for line in (DOCS / page).read_text(encoding="utf-8").splitlines() if line.startswith("| ")]


def options_of(groups: Mapping[str, tuple[list[Scenario], Any]]) -> list[Scenario]:
    return [options for group, _ in groups.values() for options in group]


PAGES = [
    ("results", "results.md"),
    ("safety", "safety.md"),
    ("friction", "safety.md"),
    ("estimation", "estimation.md"),
]


@pytest.mark.parametrize(("what", "page"), PAGES)
def test_each_page_has_the_tables_of_its_own(what: str, page: str) -> None:
    """Every table that the command prints stands on the page, with the same columns."""
    made = tables.sections(what)
    heads = [rows_table([], section.columns).markdown().splitlines()[0] for section in made]
    assert heads
    assert set(heads) <= set(rows_of(page))
    asked = [case.evaluate.scenario for section in made for case in section.cases if isinstance(case.evaluate, Run)]
    assert asked == options_of(tables.PAGES[what]())
    assert set(tables.PAGES) == {name for name, _ in PAGES}


def test_every_filter_is_run_on_both_robots() -> None:
    circles = {(o.robot, o.safety.filter) for o in options_of(safety_runs()) if o.plant.mass_scale == 1.2}
    assert circles >= {(robot, name) for robot in ("g1", "tocabi") for name in FILTERS}


def test_runs_that_differ_have_folders_that_differ() -> None:
    """The same run may stand in two tables."""
    for groups in (make() for make in tables.PAGES.values()):
        folders: dict[str, Scenario] = {}
        for options in options_of(groups):
            assert folders.setdefault(tables.run_folder(options), options) == options
    told = [o.obstacle_velocity for o in options_of(safety_runs()) if isinstance(o, HandTracking) and o.obstacle]
    assert set(told) == {"zero", "estimated", "true"}
