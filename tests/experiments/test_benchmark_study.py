"""The benchmark command: what it runs, how seeds become a line, and what the paper says beside it."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from experiments.reports.plots.plants import Bars, plants_plot
from experiments.studies.benchmark import (
    SUITES,
    benchmark,
    benchmark_cases,
    check_benchmark,
    evaluate,
    papers,
    summed,
    told,
)
from experiments.studies.benchmark_plants import by_plant
from experiments.studies.study_options import BenchmarkOptions
from experiments.studies.work import WorkOptions
from robots.errors import ConfigError, UnknownNameError

OPTIONS = BenchmarkOptions()


def row(**changes: Any) -> dict[str, Any]:
    entries = {
        "filter": "ssa",
        "seed": 0,
        "J_arm": 0.5,
        "J_base": None,
        "M_self": 1.0,
        "M_env": 0.5,
        "J": 0.4,
        "C": None,
        "S": 0.5,
        "R_feas": 1.0,
        "success_paper": False,
        "success": True,
        "steps_in_margin": 0.5,
        "steps_in_collision": 0.0,
        "passed_unsafe": 0,
        "goals_reached": 1,
        "saturated": 0.0,
        "unstable": False,
        "filter_ms_median": 0.1,
        "starts_in_margin": False,
        "min_h_obstacle_m": 0.02,
        "min_h_self_collision_m": 0.03,
    }
    return entries | changes


def test_a_line_is_the_mean_over_seeds_with_its_interval_and_the_papers_figure() -> None:
    rows = [row(), row(seed=1, J_arm=0.7, success=False, starts_in_margin=True, min_h_obstacle_m=-0.01)]
    (line,) = summed({"ssa": {"J_arm": 0.6, "success": 1.0}}, rows)
    assert str(line["J_arm"]).startswith("0.600 [0.5") and line["M_self"] == "1.000" and line["J_base"] is None
    assert line["success"] == 0.5 and line["success_clear"] == 1.0 and line["least_h"] == -0.01
    assert line["paper_J_arm"] == 0.6 and line["paper_success"] == 1.0 and "paper_M_env" not in line
    assert told(rows) == "1 of 2 scenes begin within the margin."


def test_filters_and_their_naive_forms_have_lines_of_their_own_beside_the_same_figure() -> None:
    lines = summed({"ssa": {"J_arm": 0.6}}, [row(), row(filter="ssa-naive"), row(filter="none")])
    assert [line["filter"] for line in lines] == ["ssa", "ssa-naive", "none"]
    assert [line.get("paper_J_arm") for line in lines] == [0.6, 0.6, None]


def test_the_papers_figures_are_of_every_case_of_the_suite() -> None:
    rigs = check_benchmark(OPTIONS)
    assert sorted(rig.case.name for rig in rigs) == sorted(papers()) and len(rigs) == 8
    # table 2 and table 3
    first = papers()["G1FixedBase_D1_AG_SO_v0"]
    assert first["cbf"] == {"J_arm": 0.6742, "M_self": 1.0, "M_env": 0.8687, "success": 1.0}
    assert papers()["G1MobileBase_D1_WG_DO_v1"]["sma"]["J_base"] == 0.6059
    assert {name for figures in papers().values() for name in figures} == {"ssa", "pfm", "cbf", "sma", "sss"}
    assert len(check_benchmark(replace(OPTIONS, suite="p-ssa"))) == 8


def test_a_case_is_what_decides_its_result() -> None:
    (rig,) = check_benchmark(replace(OPTIONS, cases=("G1FixedBase_SO_V1",)))
    keys = [case.key for case in benchmark_cases(OPTIONS, rig)]
    assert len(set(keys)) == len(keys) == len(SUITES["spark"]) * 6
    told_true = benchmark_cases(replace(OPTIONS, velocity="true"), rig)
    longer = benchmark_cases(replace(OPTIONS, steps=300), rig)
    assert not {case.key for case in told_true + longer} & set(keys)
    more = benchmark_cases(replace(OPTIONS, seeds=7), rig)
    assert {case.key for case in more} > set(keys)


def test_it_runs_prints_and_goes_on_where_it_was(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = replace(
        OPTIONS,
        suite="p-ssa",
        cases=("G1FixedBase_SO_V1",),
        filters=("none", "pssa"),
        seeds=2,
        steps=20,
        work=WorkOptions(jobs=1, out=tmp_path / "study"),
    )
    assert benchmark(options) == 0
    printed = capsys.readouterr().out
    assert "G1FixedBase_SO_V1: 5 obstacles, 2 seeds, 20 steps at most" in printed and "| pssa |" in printed
    assert benchmark(replace(options, seeds=3)) == 0
    expected = evaluate(None, "G1FixedBase_SO_V1", "code", "pssa", 2, 20)
    assert f"{expected['goals_reached']}" in capsys.readouterr().out and expected["steps"] == 20


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"filters": ("magic",)}, "filters"),
        ({"order": 3}, "order"),
        ({"suite": "p-ssa", "order": 2}, "order"),
        ({"seeds": 0}, "seeds"),
        ({"steps": 0}, "steps"),
        ({"velocity": "guessed"}, "velocity"),
        ({"first_seed": -1}, "first_seed"),
        ({"case_file": Path("nowhere.toml")}, "nowhere.toml"),
    ],
)
def test_what_is_not_allowed_is_named(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        check_benchmark(replace(OPTIONS, **changes))
    with pytest.raises(UnknownNameError, match="G2"):
        check_benchmark(replace(OPTIONS, cases=("G2",)))


def test_plants_are_compared_over_scenes_that_can_be_kept_free() -> None:
    rows = [
        {**row(plant=plant, still=still, free=free, case=case), "steps_in_collision": hit, "min_h_obstacle_m": -hit}
        for plant, case, still, free, hit in (
            ("integrator", "a", True, True, 0.0),
            ("torque", "a", True, True, 0.01),
            # obstacles that move, what begins in contact, and what was not played on both do not count
            *((plant, "b", False, True, 0.5) for plant in ("integrator", "torque")),
            *((plant, "c", True, False, 0.6) for plant in ("integrator", "torque")),
            ("torque", "d", True, True, 0.7),
        )
    ]
    (line,) = by_plant(rows)
    assert line["episodes"] == 1 and line["hit integrator"] == 0.0 and line["hit torque"] == 1.0
    assert line["least torque"] == -0.01 and line["success integrator"] == 1.0
    blown_up = [{**r, "steps_in_collision": 0.0, "unstable": True} for r in rows]
    assert by_plant(blown_up)[0]["hit torque"] == 1.0
    assert plants_plot([Bars("ssa", {"torque": 1.0}, {"torque": -0.01})], ["torque"]).startswith(b"\x89PNG")


def test_an_episode_by_torques_is_as_it_is_on_an_integrator_but_for_what_motors_do() -> None:
    ideal, driven = (
        evaluate(None, "G1FixedBase_D1_AG_SO_v0", "code", "ssa", 1, 30, plant=plant)
        for plant in ("integrator", "torque")
    )
    assert driven["steps"] == ideal["steps"] and not driven["unstable"]
    assert driven["starts_in_margin"] == ideal["starts_in_margin"] and driven["free"] and driven["still"]
    assert 0.0 < abs(driven["J_arm"] - ideal["J_arm"]) < 0.2


@pytest.mark.parametrize("plants", [("wheels",), (), ("torque", "torque")])
def test_plants_are_known_and_there_once(plants: tuple[str, ...]) -> None:
    with pytest.raises(ConfigError, match="plants"):
        check_benchmark(replace(OPTIONS, plants=plants))


def test_of_several_plants_a_last_table_and_a_plot_are_made(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = replace(
        OPTIONS,
        cases=("G1FixedBase_D1_AG_SO_v0",),
        filters=("none", "ssa"),
        plants=("integrator", "torque"),
        seeds=1,
        steps=3,
        work=WorkOptions(1, out=tmp_path / "study"),
    )
    assert benchmark(options) == 0
    out = capsys.readouterr().out
    assert "From the integrator to torques" in out and "G1FixedBase_D1_AG_SO_v0, torque: " in out
    assert "physics steps with a motor at its limit" in " ".join(out.split())
    assert (tmp_path / "study" / "plants.png").read_bytes().startswith(b"\x89PNG")
