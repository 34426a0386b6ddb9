"""The report of runs: one file that needs nothing else."""

from pathlib import Path

import numpy as np
import pytest

from experiments.recording.recording import (
    Recording,
)
from experiments.reports import report
from experiments.reports.report import write_report
from robots.errors import ConfigError
from tests.support.made_runs import ROBOTS, made_run, with_series
from tests.support.page import Page


@pytest.fixture(scope="module")
def pair() -> list[Recording]:
    """The same motion twice, once without a filter, which ends early."""
    return [made_run(filter="none", ticks=25), made_run(plant={"mass_scale": 1.2})]


def test_the_report_needs_nothing_else(pair: list[Recording], tmp_path: Path) -> None:
    film = tmp_path / "film.mp4"
    film.write_bytes(b"not really a film")
    frames = [[(0.0, b"png"), (0.1, b"png")], []]
    text = write_report(tmp_path / "report.html", pair, "Hands", frames, film).read_text(encoding="utf-8")
    page = Page(text)
    assert page.references
    assert all(reference.startswith("data:") for reference in page.references)
    assert not {"script", "link", "iframe", "object"} & set(page.tags)
    assert "http" not in text
    assert "url(" not in text
    assert "@import" not in text
    assert len(text) < 3_000_000
    assert page.headings == [
        "Outcome", "Figures", "Film", "Pictures", "Distances", "Guarantee", "Limits", "Hands", "Balance",
        "Centre of mass", "Filter", "Torques", "Computing time",
    ]  # fmt: skip
    assert "no filter" in page.words
    assert "ISSf-CBF, mass +20 %" in page.words
    assert '"mass_scale": 1.2' in page.words


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_short_run_without_hands_is_reported(robot: str, tmp_path: Path) -> None:
    result = made_run(robot, ticks=5, hands=False)
    result = with_series(result, zmp=np.full((5, 2), np.nan))
    page = Page(write_report(tmp_path / "r.html", [result], "Short").read_text(encoding="utf-8"))
    assert "Hands" not in page.headings
    assert "Pictures" not in page.headings
    assert "Film" not in page.headings
    assert {"Distances", "Guarantee", "Balance", "Torques"} <= set(page.headings)
    assert page.tags.count("img") == 8


@pytest.mark.parametrize("ticks", [0, 1])
def test_a_run_that_ended_at_once_is_reported(ticks: int, tmp_path: Path) -> None:
    results = [made_run(ticks=ticks), made_run(ticks=3)]
    page = Page(write_report(tmp_path / "r.html", results, "Early").read_text(encoding="utf-8"))
    assert ("ended before the first tick" in page.words) == (ticks == 0)


def test_text_from_outside_is_shown_as_text(tmp_path: Path) -> None:
    result = made_run(ticks=2, filter="<script>a</script>", note="</pre><b>")
    page = Page(write_report(tmp_path / "r.html", [result], "<i>x & y</i>", note="<u>n</u>").read_text("utf-8"))
    assert not {"script", "i", "b", "u"} & set(page.tags)
    assert "<i>x & y</i>" in page.words
    assert "<u>n</u>" in page.words


def test_a_large_film_is_linked_by_its_relative_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report, "LARGEST_EMBEDDED_VIDEO", 3)
    (tmp_path / "films").mkdir()
    film = tmp_path / "films" / "a film #1.mp4"
    film.write_bytes(b"long")
    text = write_report(tmp_path / "r.html", [made_run(ticks=2)], "Film", video=film).read_text(encoding="utf-8")
    assert "films/a%20film%20%231.mp4" in Page(text).references


def test_a_report_needs_runs_matching_frames_and_a_place(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="results"):
        write_report(tmp_path / "r.html", [], "None")
    with pytest.raises(ConfigError, match="frames"):
        write_report(tmp_path / "r.html", [made_run(ticks=2)], "None", frames=[[], []])
    with pytest.raises(ConfigError, match="report"):
        write_report(tmp_path / "missing" / "r.html", [made_run(ticks=2)], "None")
