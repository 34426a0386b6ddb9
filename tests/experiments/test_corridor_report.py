"""The corridor on the command line: table, report, files, refusals."""

import json
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from experiments.cli import main as cli
from experiments.metrics.metric import Metric
from experiments.recording.store import DATA
from experiments.reports.corridor import write_corridor_report
from experiments.reports.corridor_table import figure_cell
from experiments.reports.table import Cell
from experiments.running.corridor_loop import NAIVE, CorridorLoop, CorridorRun
from experiments.scenarios.corridor import (
    Corridor,
)
from experiments.studies.corridor import report_scene
from experiments.studies.index import read_study
from robots.description import RobotDescription
from robots.errors import ConfigError
from tests.support.corridor import DURATION


@pytest.fixture(scope="module")
def bare_cbf(corridor_g1: RobotDescription) -> CorridorRun:
    """CBF without a margin, as in its own paper."""
    return CorridorLoop(corridor_g1, Corridor(), "cbf", margins="own").run(DURATION)


def test_a_score_without_anything_to_score_reads_none(bare_cbf: CorridorRun) -> None:
    assert figure_cell(Metric("C", "C"), bare_cbf.summary["C"]) == Cell("none")


def test_rounding_is_no_overlap_and_an_overlap_stands_out() -> None:
    figure = Metric("min_h_hand_m", "nearest hand", "mm", 1e3, "negative")
    for value, text, bad in ((-1e-9, "0.0", False), (-0.0012, "-1.2", True), (0.0012, "1.2", False)):
        assert figure_cell(figure, value) == Cell(text, bad)


def test_the_report_is_one_file_with_everything_in_it(
    corridor_g1: RobotDescription, corridor_runs: dict[str, CorridorRun], tmp_path: Path
) -> None:
    chosen, scene = list(corridor_runs.values()), report_scene(Corridor(), corridor_g1)
    path = write_corridor_report(tmp_path / "report.html", scene, corridor_g1, chosen, note="no <pictures>")
    page = path.read_text(encoding="utf-8")
    assert page.count("data:image/png") == 4
    assert "no &lt;pictures&gt;" in page
    assert "http" not in page.replace("http-equiv", "")
    for run in chosen:
        assert run.title in page
    with pytest.raises(ConfigError, match="report"):
        write_corridor_report(tmp_path / "missing" / "report.html", scene, corridor_g1, chosen)


def call(folder: Path, monkeypatch: pytest.MonkeyPatch, *arguments: str) -> object:
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "argv", ["safewbc", "run", "corridor", *arguments])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    return caught.value.code


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--filters", "pssa", "foo"], ["filters = 'foo'", "ssa-naive"]),
        (["--filters", "ecbf"], ["filters = 'ecbf'"]),
        (["--filters"], ["filters", "at least one"]),
        (["--filters", "cbf", "cbf"], ["filters", "once"]),
        (["--gap", "-0.1"], ["gap = -0.1", "from 0.11 m", "to 0.3 m"]),
        (["--gap", "0.1"], ["gap = 0.1", "the hand just fits"]),
        (["--gap", "nan"], ["gap = nan"]),
        (["--duration", "0"], ["duration = 0.0"]),
        (["--weight", "0"], ["weight = 0.0", "above 0"]),
        (["--margins", "all"], ["margins = 'all'", "shared, own"]),
        (["--seed", "-1"], ["seed = -1"]),
        (["--out", "plain/below"], ["out = '", "plain/below'", "a folder that can be written"]),
    ],
    ids=" ".join,
)
def test_a_bad_option_is_refused_in_one_line_and_nothing_is_written(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: Sequence[str],
    told: Sequence[str],
) -> None:
    (tmp_path / "plain").write_text("keep me")
    assert call(tmp_path, monkeypatch, *arguments) == 2
    err = capsys.readouterr().err
    assert err.startswith("safewbc: ")
    assert err.count("\n") == 1
    for words in told:
        assert words in err
    assert [p.name for p in tmp_path.iterdir()] == ["plain"]


def test_a_run_leaves_what_is_needed_to_look_at_it_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ("--filters", "pssa", NAIVE, "--duration", "0.2", "--gap", "0.15", "--no-report", "--out", "here")
    assert call(tmp_path, monkeypatch, *arguments) == 0
    files = sorted(str(p.relative_to(tmp_path / "here")) for p in (tmp_path / "here").rglob("*") if p.is_file())
    kept = {f"{name}/{file}" for name in ("pssa", NAIVE) for file in DATA}
    assert kept < set(files)
    assert "report.html" not in files
    config = json.loads((tmp_path / "here" / "pssa" / "config.json").read_text())
    assert config["scenario"]["gap"] == 0.15
    rows = read_study(tmp_path / "here").rows()
    assert [row.labels["filter"] for row in rows] == ["pssa", NAIVE]
    for row in rows:
        summary = json.loads((tmp_path / "here" / str(row.folder) / "summary.json").read_text())
        assert {name: summary[name] for name in row.metrics if name != "cpu_s"} == {
            name: value for name, value in row.metrics.items() if name != "cpu_s"
        }
    with np.load(tmp_path / "here" / "pssa" / "series.npz") as series:
        assert series["q"].shape == (20, 17)
        assert series["h_obstacle"].shape == (20, 19, 3)
        assert len(config["rows"]) == 19 * 3 + series["h_self_collision"].shape[1]
    out = capsys.readouterr().out
    assert "|  | pssa | ssa-naive |" in out
    assert "| infeasible ticks |" in out


def test_a_second_call_takes_the_runs_that_are_there_and_makes_the_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = ("--duration", "0.2", "--no-report", "--jobs", "1", "--out", "here", "--filters")
    assert call(tmp_path, monkeypatch, *arguments, "cbf") == 0
    kept = {path.name: path.read_bytes() for path in (tmp_path / "here" / "rows").iterdir()}
    assert call(tmp_path, monkeypatch, *arguments, "cbf", "none") == 0
    now = {path.name: path.read_bytes() for path in (tmp_path / "here" / "rows").iterdir()}
    assert kept.items() < now.items()
    assert len(now) == 2
    # fewer filters, then one that the call before left out: the rows are there, so it is no other study
    for name in ("cbf", "none"):
        assert call(tmp_path, monkeypatch, *arguments, name) == 0
    assert {path.name: path.read_bytes() for path in (tmp_path / "here" / "rows").iterdir()} == now
