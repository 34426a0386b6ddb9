"""The tables on locomotion: which runs stand in them, that each is allowed, and what the searches find."""

import dataclasses
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from controllers.gaits.footholds import LEFT
from experiments.reports.metric_tables import rows_table
from experiments.running.pool import Row, RunTask, ending, in_parallel, tick_figures
from experiments.running.run import prepare
from experiments.scenarios.lateral_steps import LateralSteps
from experiments.scenarios.scenario import Scenario
from experiments.scenarios.stand import Stand
from experiments.scenarios.taichi import Taichi
from experiments.scenarios.walk import Walk
from experiments.studies import locomotion_table
from experiments.studies import locomotion_tables as locomotion_sections
from experiments.studies.locomotion_tables import StudyTable, chosen_tables
from experiments.studies.speed import STEP, achieved_speed, climb
from experiments.studies.study_options import SECTIONS, LocomotionTableOptions
from robots.errors import SafeWbcError

PAGE = Path(__file__).parents[2] / "docs" / "locomotion.md"


def tables(folder: Path, **options: Any) -> dict[str, StudyTable]:
    """Each section's table."""
    made = {}
    for name in SECTIONS:
        (made[name],) = chosen_tables(LocomotionTableOptions(only=(name,), **options), folder)
    return made


def runs_of(table: StudyTable) -> list[Scenario]:
    return [task.options for task in table.tasks if isinstance(task, RunTask)]


@pytest.mark.parametrize("quick", [False, True])
def test_every_run_is_allowed_and_has_a_folder_of_its_own(quick: bool, tmp_path: Path) -> None:
    tasks = [t for table in tables(tmp_path, quick=quick).values() for t in table.tasks if isinstance(t, RunTask)]
    assert len({task.folder for task in tasks}) == len(tasks)
    for task in tasks:
        prepare(task.options)


def test_robots_masses_grounds_and_filters_of_the_runs(tmp_path: Path) -> None:
    made = tables(tmp_path)
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
    assert len(made["random-walks"].tasks) == 50
    assert [name for name, table in made.items() if table.alone] == ["ticks"]


def test_the_page_has_the_columns_that_the_command_prints(tmp_path: Path) -> None:
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    for table in tables(tmp_path).values():
        assert f"### {table.title}" in lines
        head = rows_table([], table.columns).markdown().splitlines()[0]
        assert head in lines, table.title


def test_lines_stand_under_the_title_they_belong_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Sections are printed in order and as many lines as tasks; those measured alone come last."""
    order: list[tuple[str, int]] = []

    def pretended(tasks: Sequence[Callable[[], Row]], jobs: int, console: Console) -> Iterator[Row]:
        for task in tasks:
            assert isinstance(task, RunTask)
            order.append((task.folder.parent.name, jobs))
            yield {"robot": task.folder.name, "ended": "no", "cpu_s": 1.0}

    monkeypatch.setattr(locomotion_table, "in_parallel", pretended)
    monkeypatch.setattr(locomotion_table, "warm_up", lambda console, robot: None)
    options = LocomotionTableOptions(only=("ticks", "lateral-steps", "taichi"), out=tmp_path / "runs", jobs=3)
    assert locomotion_table.locomotion_table(options) == 0
    made = tables(tmp_path / "runs")
    expected = {name: len(made[name].tasks) for name in ("taichi", "lateral-steps", "ticks")}
    assert Counter(order) == {(name, 1 if name == "ticks" else 3): n for name, n in expected.items()}
    parts = capsys.readouterr().out.split("### ")[1:]
    assert [part.splitlines()[0] for part in parts] == [made[name].title for name in expected]
    for part, (name, count) in zip(parts, expected.items(), strict=True):
        lines = [line for line in part.splitlines() if line.startswith("| ")][2:]
        assert [line.split(" | ")[0].lstrip("| ") for line in lines] == [t.folder.name for t in made[name].tasks]  # type: ignore[attr-defined]
        assert len(lines) == count


def test_each_line_is_a_run_that_was_saved(tmp_path: Path) -> None:
    """Made in processes of their own, in the order of the tasks."""
    tasks = [RunTask(Stand(duration=0.2 + 0.1 * i), tmp_path / str(i), {"case": i}, series=i == 0) for i in range(3)]
    lines = list(in_parallel(tasks, 2, Console(stderr=True)))
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

    def walk(speed: float) -> Row:
        tried.append(speed)
        return {"ended": "no" if speed <= limit else "at 1.0 s", "achieved": 0.9 * speed}

    fastest, achieved, falls_at = climb(walk, reach)
    grid = [round(STEP * i, 9) for i in range(1, 17) if STEP * i <= reach + 1e-9]
    survived = [speed for speed in grid if speed <= limit]
    assert set(tried) <= set(grid)
    assert fastest == (survived[-1] if survived else None)
    assert achieved == (0.9 * survived[-1] if survived else None)
    assert falls_at == next((speed for speed in grid if speed > limit), None)


def test_achieved_speed_of_a_straight_way() -> None:
    time = np.arange(0.0, 20.0, 0.01)
    place = np.outer(np.minimum(time, 17.0), [0.3, 0.4])
    assert achieved_speed({"time": time, "q": place}) == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("change", "named"), [({"only": ("all",)}, "all"), ({"only": ()}, "only"), ({"jobs": 0}, "jobs")]
)
def test_wrong_options_are_refused_before_any_run(change: dict[str, object], named: str, tmp_path: Path) -> None:
    options = dataclasses.replace(LocomotionTableOptions(out=tmp_path / "runs"), **change)  # type: ignore[arg-type]
    with pytest.raises(SafeWbcError, match=named):
        locomotion_table.locomotion_table(options)
    assert not (tmp_path / "runs").exists()


def test_every_section_has_a_table() -> None:
    made = chosen_tables(LocomotionTableOptions(), Path("x"))
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
