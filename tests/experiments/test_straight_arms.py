"""The study of hands out of reach: its figures on made-up series, and a short run of it with its files."""

import json
from pathlib import Path

import numpy as np
import pytest

from experiments.benchmarks.pictured import straight_plot
from experiments.benchmarks.straight_arms import (
    COLUMNS,
    LIMIT,
    TITLE,
    command_steps,
    step_figures,
    straight_study,
)
from experiments.benchmarks.study_print import show_study


def test_steps_are_the_largest_change_of_any_joint_and_the_base_does_not_count() -> None:
    v = np.zeros((6, 9))
    v[2:, 7] = 2.0 * LIMIT
    v[4:, 8] = -0.1
    v[:, :6] = 100.0 * np.arange(6)[:, None]
    series = {"v_safe": v}
    np.testing.assert_allclose(command_steps(series), [0.0, 2.0 * LIMIT, 0.0, 0.1, 0.0], rtol=0, atol=1e-12)
    figures = step_figures(series, 1.0 / 3.0)
    assert figures == {"step_max": 2.0 * LIMIT, "jumps": 1, "step_end": 0.1}


def test_a_short_study_has_every_case_its_table_and_its_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    runs = straight_study(["g1"], ["up"], ["none"], 1.1)
    assert [figures["singular"] for figures, _ in runs] == ["cut", "damped"]
    assert runs[1][0]["jumps"] == 0
    show_study(lambda: runs, straight_plot, "running", TITLE, COLUMNS, tmp_path / "straight.json")
    printed = capsys.readouterr().out
    assert all(column.words.split()[0] in printed for column in COLUMNS)
    assert [row["target"] for row in json.loads((tmp_path / "straight.json").read_text())] == ["up", "up"]
    assert (tmp_path / "straight.png").read_bytes().startswith(b"\x89PNG")
