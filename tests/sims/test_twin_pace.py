"""Keeping time with a clock made by hand, and the record of a run."""

from pathlib import Path

import numpy as np
import pytest

from robots.errors import ConfigError
from sims.twin import record as records
from sims.twin.pace import Pace
from sims.twin.record import Record


class Clock:
    """Time that passes while somebody sleeps, or works."""

    def __init__(self) -> None:
        self.now, self.naps = 5.0, 0

    def __call__(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        assert seconds > 0.0
        self.naps += 1
        self.now += seconds


def paced() -> tuple[Clock, Pace]:
    clock = Clock()
    return clock, Pace(0.001, clock, clock.sleep)


def test_periods_begin_at_absolute_times() -> None:
    clock, pace = paced()
    begun = []
    for i in range(100):
        begun.append(pace.wait())
        clock.now += 1e-4 * (i % 7)
    np.testing.assert_allclose(begun, 5.0 + 1e-3 * np.arange(100), atol=6e-5)
    assert (pace.periods, pace.late, pace.dropped) == (100, 0, 0.0)
    assert clock.naps > 100


def test_what_is_a_little_late_is_caught_up_and_counted() -> None:
    clock, pace = paced()
    pace.wait()
    clock.now += 0.005
    waits = [pace.wait() for _ in range(10)]
    # at 5 ms the periods of 1 to 5 ms begin at once, by 4, 3, 2, 1 and 0 ms late
    np.testing.assert_allclose(waits[:5], 5.005, atol=6e-5)
    np.testing.assert_allclose(waits[5:], 5.006 + 1e-3 * np.arange(5), atol=6e-5)
    assert pace.late == 4 and pace.worst == pytest.approx(0.004) and pace.dropped == 0.0


def test_what_is_too_late_is_given_up_and_counted() -> None:
    clock, pace = paced()
    pace.wait()
    clock.now += 0.051
    at_once = sum(pace.wait() < 5.0511 for _ in range(30))
    # behind by 50 ms, of which 10 are caught up: the late period and ten more
    assert at_once == 11 and pace.dropped == pytest.approx(0.040)
    assert pace.worst == pytest.approx(0.050)


def test_time_stops_where_it_is_told_to() -> None:
    clock, pace = paced()
    clock.now += 2.0
    pace.stop()
    clock.now += 3.0
    assert pace.passed == pytest.approx(2.0) and pace.now() == pytest.approx(7.0)


def test_a_record_holds_every_row_over_its_blocks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(records, "ROWS", 4)
    for rows in (1, 4, 9):
        record = Record(tmp_path / "a.npz")
        for i in range(rows):
            record.add(time=0.5 * i, q=np.full(3, i), damped=i > 2)
        record.save([(0.0, "ready"), (0.5, "end")])
        with np.load(tmp_path / "a.npz") as saved:
            np.testing.assert_array_equal(saved["time"], 0.5 * np.arange(rows))
            np.testing.assert_array_equal(saved["q"], np.arange(rows)[:, None] * np.ones(3))
            assert saved["damped"].dtype == bool and saved["damped"].sum() == max(0, rows - 3)
            assert list(saved["events"]) == ["ready", "end"] and list(saved["event_times"]) == [0.0, 0.5]
    assert [p.name for p in tmp_path.iterdir()] == ["a.npz"]


def test_an_empty_record_holds_its_events(tmp_path: Path) -> None:
    Record(tmp_path / "a.npz").save([])
    with np.load(tmp_path / "a.npz") as saved:
        assert set(saved) == {"events", "event_times"}


def test_a_save_that_fails_leaves_what_was_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.npz"
    path.write_text("before")
    record = Record(path)

    def full(*arguments: object, **arrays: object) -> None:
        raise OSError("no space")

    monkeypatch.setattr(np, "savez_compressed", full)
    with pytest.raises(OSError, match="no space"):
        record.save([])
    assert path.read_text() == "before" and [p.name for p in tmp_path.iterdir()] == ["a.npz"]


def test_a_file_that_cannot_be_is_refused_at_once(tmp_path: Path) -> None:
    for path in (tmp_path / "a.csv", tmp_path / "none" / "a.npz"):
        with pytest.raises(ConfigError, match="record"):
            Record(path)
