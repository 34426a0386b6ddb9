"""The study over alpha and epsilon: which runs it makes, what they are judged by, and how they are shown."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from experiments.recording.recording import Recording
from experiments.reports.plots.epsilon import collisions_plot
from experiments.studies.case import Row
from experiments.studies.epsilon import (
    ECBF_ABOVE,
    FIGURES,
    GRIDS,
    NEAR,
    PAPER_ALPHAS,
    PLOT,
    Setup,
    Variant,
    blocks,
    cases_of,
    check_epsilon,
    columns_of,
    epsilon_study,
    jitter,
    panel_of,
    scenario_of,
    setups,
    told,
    variants,
)
from experiments.studies.study_options import EpsilonOptions
from experiments.studies.work import WorkOptions
from robots.errors import ConfigError
from robots.loader import load_robot

ROBOT = load_robot("g1")
PAPER = EpsilonOptions(size="paper")


def test_the_grid_is_the_papers_and_more() -> None:
    assert PAPER_ALPHAS == (1, 5, 10, 15, 20, 25, 30, 35, 40, 45, 50)
    found = list(variants(GRIDS["paper"]))
    assert {v.epsilon for v in found if v.filter == "issf"} >= {10.0, 20.0, 30.0, 0.5}
    # the paper leaves the eCBF out up to 20 1/s
    assert sorted(v.alpha for v in found if v.filter == "ecbf" and v.alpha) == [25, 30, 35, 40, 45, 50]
    assert ECBF_ABOVE == 20.0 and len(found) == 1 + 11 + 6 + 7 * 11


def test_every_friction_at_the_first_rate_and_every_rate_with_the_robots_friction() -> None:
    assert [(s.friction, s.rate) for s in setups(PAPER) if s.robot == "g1"] == [
        (0.0, 500.0),
        (0.5, 500.0),
        (1.0, 500.0),
        (1.0, 1000.0),
        (1.0, 2000.0),
    ]


def test_a_run_is_hand_tracking_with_these_values() -> None:
    options = EpsilonOptions(mass_scale=1.3)
    run = scenario_of(Setup("g1", 0.5, 2000.0), Variant("issf", 30.0, 2.0), options, GRIDS["smoke"])
    assert (run.safety.filter, run.safety.alpha, run.safety.epsilon) == ("issf", 30.0, 2.0)
    assert run.plant.mass_scale == 1.3 and run.plant.joint_friction_scale == 0.5
    assert run.control_rate == 2000.0 and run.plant.physics_dt == 0.0005 and run.duration == 5.0


def test_no_case_is_there_twice() -> None:
    grid = check_epsilon(EpsilonOptions())
    keys = [case.key for setup in setups(EpsilonOptions()) for case in cases_of(setup, grid, EpsilonOptions())]
    assert len(set(keys)) == len(keys) == 2 * 2 * (1 + 4 + 2 + 8)


def recording(v: Any, h: Any) -> Recording:
    series = {"v_safe": np.asarray(v, dtype=float), "h_self_collision": np.asarray(h, dtype=float)[:, None]}
    return Recording(ROBOT, {"scenario": {"control_rate": 500.0}}, {}, series)


def test_jitter_is_the_rms_jerk_near_the_boundary() -> None:
    ticks, dt = 200, 0.002
    t = dt * np.arange(ticks)
    v = np.zeros((ticks, 8))
    # a parabola jerks by its second derivative; the base's own entries do not count
    v[:, 6], v[:, 7], v[:, 0] = 3.0 * t**2, -3.0 * t**2, np.random.default_rng(0).standard_normal(ticks)
    near = np.full(2 * ticks, NEAR / 2)
    assert jitter(recording(v, near)) == pytest.approx(6.0, rel=1e-6)
    far = np.full(2 * ticks, 2 * NEAR)
    assert jitter(recording(v, far)) is None
    # what chatters by a alternates by 4 a / dt^2 in its second difference
    v[:, 6:] = 1e-3 * (-1.0) ** np.arange(ticks)[:, None]
    assert jitter(recording(v, near)) == pytest.approx(4e-3 / dt**2)


def row(variant: Variant, ratio: float) -> dict[str, Any]:
    return {
        "filter": variant.filter,
        "column": variant.column,
        "alpha": variant.alpha,
        "fell": False,
        **dict.fromkeys((figure.key for figure in FIGURES), 0.001),
        "collision_ratio": ratio,
    }


def test_a_table_has_a_line_for_each_figure_and_slope() -> None:
    rows = [row(Variant("none"), 1.02), row(Variant("cbf", 10.0), 0.5), row(Variant("issf", 10.0, 2.0), 0.0)]
    lines = blocks(rows)
    assert [line["figure"] for line in lines] == [f"{figure.words} [{figure.unit}]" for figure in FIGURES]
    assert lines[0]["cbf"] == "50" and lines[0]["issf 2"] == "0" and "none" not in lines[0]
    assert told(rows) == "Without a filter 102 % are left. 0 of 3 runs fell."
    names = [column.key for column in columns_of(GRIDS["smoke"])]
    assert names == ["figure", "alpha", "cbf", "ecbf", "issf 1", "issf 10"]


def test_the_plot_takes_what_is_there() -> None:
    rows = [
        Row("a", {"column": "cbf", "alpha": 10.0}, {"collision_ratio": 0.5}),
        Row("b", {"column": "cbf", "alpha": 5.0}, {"collision_ratio": 0.4}),
        Row("c", {"column": "issf 10", "alpha": 5.0}, {"collision_ratio": 0.0}),
        Row("d", {"column": "none", "alpha": None}, {"collision_ratio": 1.0}),
    ]
    panel = panel_of("set-up", rows)
    assert panel.lines == {"cbf": [(10.0, 0.5), (5.0, 0.4)], "issf 10": [(5.0, 0.0)]}
    assert collisions_plot([panel]).startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("options", "name"),
    [
        (EpsilonOptions(robots=()), "robots"),
        (EpsilonOptions(alphas=(0.0,)), "alphas"),
        (EpsilonOptions(epsilons=(-1.0,)), "epsilons"),
        (EpsilonOptions(friction=(11.0,)), "friction"),
        (EpsilonOptions(mass_scale=0.0), "mass_scale"),
        (EpsilonOptions(rates=(500.0, 0.0)), "rates"),
        (EpsilonOptions(duration=0.0), "duration"),
    ],
)
def test_what_is_not_allowed_is_refused_by_its_name(options: EpsilonOptions, name: str) -> None:
    with pytest.raises(ConfigError, match=name):
        check_epsilon(options)


def test_a_run_is_judged_by_what_is_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """From the command line's options to the table and the plot, by runs of a moment."""
    options = EpsilonOptions(
        robots=("tocabi",), alphas=(30.0,), epsilons=(10.0,), friction=(1.0,), duration=0.1, work=WorkOptions(1)
    )
    options = replace(options, work=replace(options.work, out=tmp_path / "study"))
    assert epsilon_study(options) == 0
    out = capsys.readouterr().out
    for figure in FIGURES:
        assert f"{figure.words} [{figure.unit}]" in out
    assert (tmp_path / "study" / PLOT).read_bytes().startswith(b"\x89PNG")
    rows = [json.loads(path.read_text()) for path in (tmp_path / "study" / "rows").glob("*.json")]
    assert len(rows) == 4
    assert all({figure.key for figure in FIGURES} < row["metrics"].keys() for row in rows)
    # the reference does not come near the torso so soon, the room above the bound is there from the first tick
    (issf,) = (row["metrics"] for row in rows if row["labels"]["filter"] == "issf")
    assert issf["jitter"] is None and issf["margin_self_collision_m"] >= 0.0
