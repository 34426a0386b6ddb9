"""Pauses of the machine: what counts as one, and what is played again for one."""

from itertools import repeat
from typing import Any

import numpy as np
import pytest

from experiments.rehearsal.pauses import PAUSE, PERIOD, PauseWatch, longest_pause, watch
from experiments.rehearsal.performance import Performance
from experiments.rehearsal.rehearse import AGAIN, Piece, play_fairly


def test_a_look_that_is_late_is_a_pause_and_one_in_time_is_none() -> None:
    lateness = [0.0, 0.5 * PAUSE, 1.1 * PAUSE, 0.0, 0.02]
    clock, found, left = [100.0], [], [*lateness]

    def sleep(seconds: float) -> None:
        clock[0] += seconds + left.pop(0)

    watch(lambda began, length: found.append((began, length)), lambda: bool(left), lambda: clock[0], sleep)
    began = [100.0 + i * PERIOD + sum(lateness[: i - 1]) for i in range(1, 6)]
    np.testing.assert_allclose(found, [(began[2], 1.1 * PAUSE), (began[4], 0.02)], rtol=0.0, atol=1e-9)


def test_the_longest_pause_that_reaches_into_a_time() -> None:
    pauses = np.array([[1.0, 0.05], [2.0, 0.01], [3.0, 0.02]])
    assert longest_pause(pauses, 1.04, 2.5) == 0.05
    assert longest_pause(pauses, 1.06, 2.5) == 0.01
    assert longest_pause(pauses, 1.9, 3.0) == 0.02
    assert longest_pause(pauses, 2.5, 2.9) == longest_pause(np.empty((0, 2)), 0.0, 9.0) == 0.0


def performance(said: list[tuple[float, str]], orders: list[tuple[float, str]]) -> Performance:
    return Performance({"monotonic": np.array([0.0, 9.0])}, said, orders)


def test_what_comes_of_it_is_decided_at_the_stop_with_a_cause() -> None:
    said = [(1.0, "task"), (2.0, "stopping: battery: 15 %"), (3.0, "latched damping: at rest")]
    assert performance(said, [(1.5, "battery 15")]).decided_at == 2.0
    assert performance(said[:1], [(1.5, "kill")]).decided_at == 1.5
    assert performance(said[:1], []).decided_at == 9.0


def played(rows: list[dict[str, Any]]) -> dict[str, Any]:
    left = iter(rows)
    return play_fairly(Piece("piece", lambda: next(left)))


GOOD, BAD = {"upright": True, "safe": True}, {"upright": False, "safe": True}


def test_only_what_failed_while_the_machine_paused_is_played_again() -> None:
    assert played([GOOD | {"longest_pause_s": 0.02}])["again"] == 0
    assert played([BAD | {"longest_pause_s": 0.0}]) == BAD | {"longest_pause_s": 0.0, "again": 0}
    assert played([BAD]) == BAD | {"again": 0}
    paused = BAD | {"longest_pause_s": 0.02}
    assert played([paused, paused, GOOD]) == GOOD | {"again": 2}
    assert played([paused, BAD, GOOD]) == BAD | {"again": 1}


def test_a_machine_that_always_pauses_gets_its_failure_in_the_end() -> None:
    rows = repeat(BAD | {"longest_pause_s": 0.02})
    assert play_fairly(Piece("piece", lambda: next(rows))) == BAD | {"longest_pause_s": 0.02, "again": AGAIN}


def test_watchers_start_and_end() -> None:
    with PauseWatch([0]) as watched:
        pauses = watched.end()
    assert pauses.shape[1] == 2 and not np.any(pauses[:, 1] < PAUSE)
    with pytest.raises(IndexError), PauseWatch([0]):
        raise IndexError
