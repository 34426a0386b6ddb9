"""The study of a start inside the torso: its figures on made-up series, and a short run of it with its files."""

import json
from pathlib import Path

import numpy as np
import pytest

from controllers.whole_body.robot_config import controller_config
from experiments.benchmarks.pictured import recovery_plot
from experiments.benchmarks.recovery import COLUMNS, TITLE, recovery_figures, recovery_study
from experiments.benchmarks.study_print import show_study
from robots.loader import load_robot


def test_the_figures_are_those_of_the_series() -> None:
    config = controller_config(load_robot("g1"))
    depth = config.safety.self_collision.recovery_depth
    h = np.array([-4.0, -2.0, -0.5, -3.0, -0.9, 0.1]) * depth
    v = np.zeros((6, 8))
    v[2:, 7] = -0.3
    v[4:, 6] = 0.2
    torque = np.array([[0.1, -0.2], [0.4, -0.9], [0.5, -0.8]])
    figures = recovery_figures({"h": h, "v": v, "torque": torque}, config)
    assert figures["h_start_m"] == h[0]
    assert figures["h_end_m"] == h[-1]
    assert figures["step_max"] == figures["speed_max"] == 0.3
    assert figures["torque_step_max"] == pytest.approx(0.7)
    assert figures["torque_max"] == 0.9
    # it was out once before, and sank again
    assert figures["out_s"] == pytest.approx(4 * config.dt)
    assert recovery_figures({"h": h[:4], "v": v, "torque": torque}, config)["out_s"] is None


def test_a_short_study_has_every_case_its_table_and_its_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    runs = recovery_study(["g1"], ["issf"], 0.05)
    strict, eased = (figures for figures, _ in runs)
    assert (strict["way_out"], eased["way_out"]) == ("strict", "eased")
    assert strict["h_start_m"] == eased["h_start_m"] < -0.1
    assert eased["step_max"] < 0.1 < strict["step_max"]
    show_study(lambda: runs, recovery_plot, "running", TITLE, COLUMNS, tmp_path / "recovery.json")
    printed = capsys.readouterr().out
    assert all(column.words.split()[0] in printed for column in COLUMNS)
    assert [row["way_out"] for row in json.loads((tmp_path / "recovery.json").read_text())] == ["strict", "eased"]
    assert (tmp_path / "recovery.png").read_bytes().startswith(b"\x89PNG")
