"""The tables on locomotion: which runs stand in them, that each is allowed, and what the searches find."""

import dataclasses
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controllers.gaits.footholds import LEFT
from experiments.metrics.metric import Metric
from experiments.reports.metric_tables import rows_table
from experiments.running.run import prepare
from experiments.running.run_rows import ending, tick_figures
from experiments.scenarios.lateral_steps import LateralSteps
from experiments.scenarios.scenario import Scenario
from experiments.scenarios.stand import Stand
from experiments.scenarios.taichi import Taichi
from experiments.scenarios.walk import Walk
from experiments.studies import locomotion_table
from experiments.studies import locomotion_tables as locomotion_sections
from experiments.studies.backends import LocalBackend
from experiments.studies.case import Case, Row, Study
from experiments.studies.engine import carry_out
from experiments.studies.locomotion_table import scenarios_of
from experiments.studies.locomotion_tables import chosen_tables
from experiments.studies.runs import run_case
from experiments.studies.sections import Entries, Section, print_sections
from experiments.studies.speed import STEP, FastestWalk, achieved_speed, climb
from experiments.studies.store import RowStore
from experiments.studies.study_options import SECTIONS, LocomotionTableOptions
from experiments.studies.work import WorkOptions
from robots.errors import SafeWbcError

PAGE = Path(__file__).parents[2] / "docs" / "locomotion.md"


def tables(**options: Any) -> dict[str, Section]:
    """Each section's table."""
    made = {}
    for name in SECTIONS:
        (made[name],) = chosen_tables(LocomotionTableOptions(only=(name,), **options))
    return made


def runs_of(table: Section) -> list[Scenario]:
    return list(scenarios_of([table]))


@pytest.mark.parametrize("quick", [False, True])
def test_every_run_is_allowed_and_has_a_folder_of_its_own(quick: bool) -> None:
    made = tables(quick=quick)
    folders = [case.folder for table in made.values() for case in table.cases if case.folder is not None]
    assert len(set(folders)) == len(folders)
    for scenario in scenarios_of(list(made.values())):
        prepare(scenario)


def test_robots_masses_grounds_and_filters_of_the_runs() -> None:
    made = tables()
    taichi = [o for o in runs_of(made["taichi"]) if isinstance(o, Taichi)]
    issf = {
        (o.robot, o.plant.mass_scale, o.plant.friction)
        for o in taichi
        if o.safety.filter == "issf" and o.torque == "full"
    }
    assert issf == {(r, m, mu) for r in ("g1", "tocabi") for m in (0.9, 1.0, 1.2) for mu in (0.5, 1.0)}
    assert {(o.robot, o.torque) for o in taichi} >= {(r, t) for r in ("g1", "tocabi") for t in ("pd-only", "gravity")}
    assert {o.plant.mass_scale for o in taichi if o.safety.filter == "none"} == {1.0, 1.2}
    lateral = [o for o in runs_of(made["lateral-steps"]) if isinstance(o, LateralSteps)]
    assert {o.safety.filter for o in lateral} == {"issf", "cbf", "none"}
    walks = [o for o in runs_of(made["walks"]) if isinstance(o, Walk)]
    assert len(walks) == 20
    assert all(o.duration == 60.0 for o in walks)
    spheres = [o for o in runs_of(made["obstacle"]) if isinstance(o, Walk)]
    assert {(o.robot, o.obstacle, o.safety.filter) for o in spheres} == {
        (r, k, f) for r in ("g1", "tocabi") for k in ("static", "moving") for f in ("issf", "none")
    }
    assert len(made["random-walks"].cases) == 50
    assert [name for name, t in made.items() if any(case.alone for case in t.cases)] == ["ticks"]
    assert all(case.alone for case in made["ticks"].cases)


def test_the_page_has_the_columns_that_the_command_prints() -> None:
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    for table in tables().values():
        assert f"### {table.title}" in lines
        head = rows_table([], table.columns).markdown().splitlines()[0]
        assert head in lines, table.title


@dataclass(frozen=True)
class Pretended:
    """Tells its name."""

    name: str

    def __call__(self, store: RowStore) -> Entries:
        return {"robot": self.name, "ended": "no", "cpu_s": 1.0, "process": os.getpid()}


def test_lines_stand_under_the_title_they_belong_to(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Sections are printed in order and as many lines as cases; those measured alone are made last, by one process."""
    columns = (Metric("robot", "robot"), Metric("ended", "fell"))
    made = [
        Section(name, [Case(f"{name}-{i}", {}, Pretended(f"{name}-{i}"), alone=name == "b") for i in range(3)], columns)
        for name in ("a", "b")
    ]
    work = WorkOptions(jobs=1)
    assert print_sections(made, "title", "g1", work, tmp_path / "study", "safewbc") == 0
    parts = capsys.readouterr().out.split("### ")[1:]
    assert [part.splitlines()[0] for part in parts] == ["a", "b"]
    for part, name in zip(parts, ("a", "b"), strict=True):
        lines = [line for line in part.splitlines() if line.startswith("| ")][2:]
        assert lines == [f"| {name}-{i} | no |" for i in range(3)]
    # every case again, from what is stored
    assert print_sections(made, "title", "g1", work, tmp_path / "study", "safewbc") == 0


def test_each_line_is_a_run_that_was_saved(tmp_path: Path) -> None:
    """Made in processes of their own, in the order of the cases."""
    cases = [run_case(Stand(duration=0.2 + 0.1 * i), {"case": i}, str(i), series=i == 0) for i in range(3)]
    lines = [row.entries() for row in carry_out(Study("stand", cases), tmp_path, LocalBackend(2))]
    assert [(line["case"], line["duration_s"]) for line in lines] == [(0, 0.2), (1, 0.3), (2, 0.4)]
    assert [(tmp_path / str(i) / "series.npz").exists() for i in range(3)] == [True, False, False]
    assert all((tmp_path / str(i) / name).exists() for i in range(3) for name in ("config.json", "summary.json"))
    assert all(line["ended"] == "no" and line["tick_single_ms"] is None for line in lines)


def test_tick_times_are_told_apart_by_the_feet_on_the_ground() -> None:
    contact = np.array([[1, 1], [1, 0], [0, 1], [1, 1], [0, 1]], dtype=float)
    figures = tick_figures({"in_contact": contact, "tick_ms": np.array([1.0, 10.0, 20.0, 3.0, 30.0])})
    assert (figures["tick_double_ms"], figures["tick_single_ms"]) == (2.0, 20.0)
    assert figures["tick_single_p99_ms"] == pytest.approx(29.8)


def test_how_a_run_ended() -> None:
    assert ending({"fell": False, "stop_cause": None}) == "no"
    assert ending({"fell": True, "fell_at_s": 3.14, "stop_cause": "x"}) == "at 3.1 s"
    assert ending({"fell": False, "stop_cause": "x", "stop_time_s": 2.0}) == "stopped at 2.0 s"


@given(limit=st.floats(0.0, 0.8), reach=st.floats(0.06, 0.8))
def test_the_fastest_walk_is_the_last_on_the_grid_that_is_survived(limit: float, reach: float) -> None:
    tried: list[float] = []

    class Walks:
        """Rows of walks that stay up to a limit."""

        def obtain(self, case: Case) -> Row:
            speed = case.labels["speed"]
            tried.append(speed)
            ended = "no" if speed <= limit else "at 1.0 s"
            return Row(case.key, case.labels, {"ended": ended, "achieved": 0.9 * speed, "cpu_s": 1.0})

    search = FastestWalk("g1", 1.0, 20.0, "")
    found = climb(search, reach, Walks().obtain)
    grid = [round(STEP * i, 9) for i in range(1, 17) if STEP * i <= reach + 1e-9]
    survived = [speed for speed in grid if speed <= limit]
    assert set(tried) <= set(grid)
    assert len(set(tried)) == len(tried) == found["runs"]
    assert found["fastest"] == (survived[-1] if survived else None)
    assert found["achieved"] == (0.9 * survived[-1] if survived else None)
    assert found["falls_at"] == next((speed for speed in grid if speed > limit), None)


def test_achieved_speed_of_a_straight_way() -> None:
    time = np.arange(0.0, 20.0, 0.01)
    place = np.outer(np.minimum(time, 17.0), [0.3, 0.4])
    assert achieved_speed({"time": time, "q": place}) == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("change", "named"), [({"only": ("all",)}, "all"), ({"only": ()}, "only"), ({"work": WorkOptions(jobs=0)}, "jobs")]
)
def test_wrong_options_are_refused_before_any_run(change: dict[str, object], named: str, tmp_path: Path) -> None:
    options = dataclasses.replace(LocomotionTableOptions(), **change)
    options = dataclasses.replace(options, work=dataclasses.replace(options.work, out=tmp_path / "runs"))
    with pytest.raises(SafeWbcError, match=named):
        locomotion_table.locomotion_table(options)
    assert not (tmp_path / "runs").exists()


def test_every_section_has_a_table() -> None:
    made = chosen_tables(LocomotionTableOptions())
    assert len(made) == len(SECTIONS)
    assert locomotion_sections.MIXED.exists()


def test_the_planner_on_the_page_puts_every_foot_on_a_stone() -> None:
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    scope: dict[str, Any] = {}
    exec(compile(code, "docs/locomotion.md", "exec"), scope)
    result = scope["result"]
    assert not result.summary["fell"]
    contact, soles = np.asarray(result.series["in_contact"], dtype=bool), result.series["soles"]
    landed = [(tick + 1, foot) for tick, foot in np.argwhere(contact[1:] & ~contact[:-1])]
    assert len(landed) >= 5
    places = np.array([soles[tick, foot, :2] for tick, foot in landed])
    rows = np.array([0.12 if foot == LEFT else -0.12 for _, foot in landed])
    stones = np.column_stack([scope["STONE"] * np.round(places[:, 0] / scope["STONE"]), rows])
    # stones are 12 cm apart: a foot that comes down anywhere is 3 cm off on average
    assert np.abs(places - stones).max() < 0.015
    assert places[:, 0].max() > 0.4
