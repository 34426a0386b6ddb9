"""The first tick: measured in a process of its own, medians of several."""

import json
import sys
from pathlib import Path

import pytest

from experiments.benchmarks import first as bench_first
from experiments.benchmarks.first import KINDS, in_a_process, middle
from experiments.cli import main as cli


@pytest.mark.parametrize("warm", ["yes", "no"])
def test_a_process_measures_every_figure(warm: str) -> None:
    found = in_a_process("g1", "issf", warm)
    assert tuple(found) == KINDS
    assert all(found[k] > 0 for k in KINDS)


def test_the_middle_process_counts() -> None:
    found = [dict.fromkeys(KINDS, value) for value in (5.0, 1.0, 400.0)]
    assert middle(found) == dict.fromkeys(KINDS, 5.0)


def test_every_robot_has_a_line_with_and_one_without(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[tuple[str, str, str]] = []

    def stub(robot: str, safety_filter: str, warm: str) -> dict[str, float]:
        asked.append((robot, safety_filter, warm))
        return dict.fromkeys(KINDS, 1.25 if warm == "yes" else 7.5)

    monkeypatch.setattr(bench_first, "in_a_process", stub)
    monkeypatch.setattr(bench_first, "fill_caches", lambda: None)
    out = tmp_path / "f.json"
    monkeypatch.setattr(sys, "argv", ["safewbc", "bench", "first", "--filter", "cbf", "--out", str(out)])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    assert caught.value.code == 0
    assert set(asked) == {(r, "cbf", w) for r in ("g1", "tocabi") for w in ("yes", "no")}
    found = json.loads(out.read_text())
    assert {(r, w): found[r][w]["first_ms"] for r in found for w in found[r]} == {
        ("g1", "no"): 7.5,
        ("g1", "yes"): 1.25,
        ("tocabi", "no"): 7.5,
        ("tocabi", "yes"): 1.25,
    }
    shown = capsys.readouterr().out
    assert shown.count("1.25") == shown.count("7.50") == 2 * len(KINDS)


@pytest.mark.parametrize(
    "arguments", [("--ticks", "200"), ("--solver", "proxqp"), ("--robots", "atlas"), ("--filter", "x")]
)
def test_what_it_cannot_use_is_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], arguments: tuple[str, str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["safewbc", "bench", "first", *arguments])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    assert caught.value.code == 2
    assert arguments[1] in capsys.readouterr().err
