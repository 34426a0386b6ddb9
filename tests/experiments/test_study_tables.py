"""What is shown of a study: means and intervals over seeds, pivots, plots, the report and its links."""

import dataclasses
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from experiments.metrics.metric import Metric
from experiments.studies.backends import LocalBackend
from experiments.studies.case import Case, Row, Study
from experiments.studies.engine import carry_out
from experiments.studies.index import StudyFolder, read_study
from experiments.studies.pivot import PivotOptions, show_pivot
from experiments.studies.plots import compared, numeric_parameters, plot_over
from experiments.studies.present import present, write_study_report
from experiments.studies.statistics import groups, numeric_metrics, spread, varied
from experiments.studies.store import RowStore
from experiments.studies.tables import chosen_metrics, metric_called, pivot, study_table
from robots.errors import ConfigError, UnknownNameError

values = st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=12)


@given(values)
def test_an_interval_holds_the_mean_and_lies_within_the_values(sample: list[float]) -> None:
    found = spread(sample)
    assert found.mean == pytest.approx(np.mean(sample))
    slack = 1e-9 * (1.0 + max(map(abs, sample)))
    assert min(sample) - slack <= found.low <= found.high <= max(sample) + slack
    assert spread(sample) == found


def test_an_interval_holds_the_true_mean_about_as_often_as_it_says() -> None:
    rng = np.random.default_rng(0)
    found = [spread(rng.normal(3.0, 1.0, 30).tolist()) for _ in range(200)]
    held = np.mean([s.low <= 3.0 <= s.high for s in found])
    # percentile intervals of 30 normal values hold it in 93 to 94 of 100; three standard deviations of the fraction
    assert abs(held - 0.935) < 3 * np.sqrt(0.935 * 0.065 / 200)


def row(labels: Mapping[str, Any], error: str | None = None, **metrics: Any) -> Row:
    key = "-".join(map(str, labels.values()))
    return Row(key, labels, {} if error else metrics, error, folder=f"runs/{key}")


ROWS = [
    row({"filter": f, "epsilon": e, "seed": s}, h=h + 0.001 * s, fell=s == 1 and f == "cbf", note="words")
    for f, e, h in (("cbf", None, -0.004), ("issf", 1.0, 0.002), ("issf", 10.0, 0.001))
    for s in (0, 1, 2)
]


H, FELL = metric_called("h"), metric_called("fell")
"""A metric that nobody declares, and one that the project does."""


def test_rows_are_grouped_by_everything_but_the_seed() -> None:
    found = groups(ROWS)
    assert [dict(g.labels) for g in found] == [
        {"filter": "cbf", "epsilon": None},
        {"filter": "issf", "epsilon": 1.0},
        {"filter": "issf", "epsilon": 10.0},
    ]
    first = found[0].spread("h")
    assert first is not None
    assert first.mean == pytest.approx(-0.003)
    assert first.low < first.mean < first.high
    assert found[0].spread("missing") is None
    assert varied(ROWS)["epsilon"] == [None, 1.0, 10.0]
    assert numeric_metrics(ROWS) == ["h", "fell"]


def test_the_table_has_means_intervals_and_shares() -> None:
    table = study_table(ROWS, [H, FELL])
    assert [c.heading for c in table.columns] == ["filter", "epsilon", "runs", "h", "fell"]
    cells = [[str(getattr(c, "text", c)) for c in line.cells] for line in table.rows]
    assert [line[:3] for line in cells] == [["cbf", "-", "3"], ["issf", "1", "3"], ["issf", "10", "3"]]
    assert re.fullmatch(r"-0\.003 \[-0\.00\d+, -0\.00\d+\]", cells[0][3])
    # one of three fell, and none
    assert cells[0][4].startswith("33.3 [")
    assert cells[1][4] == "0"


def test_failures_are_counted_and_left_out_of_the_mean() -> None:
    broken = [*ROWS[:2], dataclasses.replace(ROWS[2], metrics={}, error="ValueError: no")]
    (line,) = study_table(broken, [H]).rows
    assert [str(c) for c in line.cells[:3]] == ["cbf", "3", "1"]
    assert str(line.cells[3]).startswith("-0.0035 [")


def test_runs_that_were_stopped_are_told_apart(tmp_path: Path) -> None:
    stopped = row({"filter": "cbf", "epsilon": None, "seed": 3}, h=0.5, stop_cause="lost the reference")
    table = study_table([*ROWS, stopped], [H])
    assert [c.heading for c in table.columns] == ["filter", "epsilon", "runs", "stopped", "h"]
    assert [[table.cells(line)[i].text for i in (2, 3)] for line in table.rows] == [["4", "1"], ["3", "0"], ["3", "0"]]
    assert [table.cells(line)[3].bad for line in table.rows] == [True, False, False]
    assert "stopped" not in [c.heading for c in study_table(ROWS, [H]).columns]
    assert pivot([*ROWS, stopped], "filter", None, "h").caption.endswith("1 of 10 runs were stopped before their end")
    assert "stopped" not in pivot(ROWS, "filter", None, "h").caption
    path = write_study_report(StudyFolder(tmp_path, "a study", "safewbc sweep", ()), [*ROWS, stopped], [H])
    assert "lost the reference" in path.read_text(encoding="utf-8")


def test_a_pivot_is_a_statistic_over_all_that_share_two_values() -> None:
    def cells(statistic: str, across: str | None = "epsilon") -> list[list[str]]:
        return [[str(c) for c in line.cells] for line in pivot(ROWS, "filter", across, "h", statistic).rows]

    assert cells("min") == [["cbf", "-0.004", "-", "-"], ["issf", "-", "0.002", "0.001"]]
    assert cells("max") == [["cbf", "-0.002", "-", "-"], ["issf", "-", "0.004", "0.003"]]
    assert cells("count") == [["cbf", "3", "-", "-"], ["issf", "-", "3", "3"]]
    assert cells("mean", None) == [["cbf", "-0.003"], ["issf", "0.0025"]]
    assert [c.heading for c in pivot(ROWS, "filter", "epsilon", "h").columns[1:]] == [
        "epsilon -",
        "epsilon 1",
        "epsilon 10",
    ]


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"down": "colour"}, "colour"),
        ({"across": "colour"}, "colour"),
        ({"metric": "note"}, "note"),
        ({"statistic": "mode"}, "mode"),
    ],
)
def test_what_a_study_does_not_have_is_refused_by_name(change: dict[str, str], named: str) -> None:
    usual: dict[str, Any] = {"down": "filter", "across": "epsilon", "metric": "h"}
    with pytest.raises((ConfigError, UnknownNameError), match=named):
        pivot(ROWS, **usual | change)


def test_metrics_that_are_asked_for_have_to_be_there() -> None:
    assert chosen_metrics(ROWS, ["h"]) == (H,)
    assert chosen_metrics(ROWS, []) == (FELL,)
    with pytest.raises(UnknownNameError, match="note"):
        chosen_metrics(ROWS, ["note"])


def test_plots_are_over_numbers_and_tell_words_apart() -> None:
    assert numeric_parameters(ROWS) == ["epsilon"]
    assert compared(ROWS, "epsilon") == "filter"
    assert plot_over(ROWS, "epsilon", [H, FELL]).startswith(b"\x89PNG")


@dataclasses.dataclass(frozen=True)
class Height:
    """A height that depends on one number, and a failure."""

    x: float

    def __call__(self, store: RowStore) -> dict[str, Any]:
        if self.x == 2:
            raise ValueError("two <is> too many")
        return {"h": 0.001 * self.x}


def made(folder: Path, *own: Metric) -> Study:
    cases = [Case(f"x-{x}-{s}", {"x": x, "seed": s}, Height(x), f"runs/x-{x}-{s}") for x in (1, 2, 3) for s in (0, 1)]
    study = Study("a < b", cases, command="safewbc sweep stand --mass-scale=1,2", metrics=own)
    carry_out(study, folder, LocalBackend(1))
    return study


def test_metrics_of_ones_own_are_shown_as_they_are_declared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    own = Metric("h", "leeway", "mm", 1e3)
    made(tmp_path, own)
    study = read_study(tmp_path)
    assert study.metrics == (own,)
    assert chosen_metrics([*study.rows(), *ROWS], [], study.metrics) == (FELL, own)
    assert present(study, study.rows()) == 1
    assert "| x | runs | failed | leeway [mm] |" in capsys.readouterr().out
    assert "leeway" in (tmp_path / "report.html").read_text(encoding="utf-8")
    assert show_pivot(PivotOptions(tmp_path, "x", "h")) == 0
    printed = capsys.readouterr().out
    assert "leeway (h)" in printed
    assert "| 3 | 3 |" in printed


def test_the_report_has_table_plots_failures_and_links(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made(tmp_path)
    study = read_study(tmp_path)
    assert present(study, study.rows(), ["h"]) == 1
    assert "| x | runs | failed | h |" in capsys.readouterr().out
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<h1>a &lt; b</h1>" in page
    assert "safewbc sweep stand --mass-scale=1,2" in page
    assert "two &lt;is&gt; too many" in page
    assert page.count('src="data:image/png') == 1
    assert 'href="runs/x-1-0/"' in page
    assert "safewbc replay runs/x-3-1" in page
    # nothing is linked where nothing was saved
    assert 'href="runs/x-2-0/"' not in page


def test_a_pivot_of_a_study_that_is_under_way(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made(tmp_path)
    (tmp_path / "rows" / "x-3-1.json").unlink()
    (path,) = tmp_path.glob("results.*")
    path.unlink()
    assert show_pivot(PivotOptions(tmp_path, "x", "h", statistic="count", write_results=True)) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("| ")]
    assert lines[2:] == ["| 1 | 2 |", "| 2 | - |", "| 3 | 1 |"]
    assert list(tmp_path.glob("results.*"))
    with pytest.raises(ConfigError, match=r"study\.json"):
        show_pivot(PivotOptions(tmp_path / "rows", "x", "h"))
