"""Pauses of the machine: what counts as one, and what is played again for one."""

import math
from itertools import repeat
from typing import Any

import numpy as np
import pytest

from experiments.rehearsal.cores import LATE, PAUSE, PERIOD, SLOW, Cores, longest_pause, watch
from experiments.rehearsal.performance import Performance
from experiments.rehearsal.rehearse import AGAIN, Piece, play_fairly


def pauses_of(lateness: list[float], efforts: list[float]) -> list[tuple[float, float]]:
    """What is said where looks come late, and their work takes so long [s]."""
    clock, found, late, took = [100.0], [], [*lateness], [*efforts]

    def sleep(seconds: float) -> None:
        clock[0] += seconds + late.pop(0)

    def work() -> None:
        clock[0] += took.pop(0)

    watch(lambda began, length: found.append((began, length)), lambda: bool(late), lambda: clock[0], sleep, work)
    return found


CALM = 10

WORK = 2e-5


def test_a_look_that_is_late_is_a_pause_and_one_in_time_is_none() -> None:
    assert pauses_of([0.0, 0.5 * LATE] * CALM, [WORK, 3.0 * WORK] * CALM) == []
    lateness = [0.0] * CALM + [1.1 * PAUSE] + [0.0] * CALM + [0.5 * PAUSE] + [0.0] * CALM
    ((began, length),) = pauses_of(lateness, [WORK] * len(lateness))
    assert began == pytest.approx(100.0 + CALM * (PERIOD + WORK) + PERIOD)
    assert length == pytest.approx(1.1 * PAUSE + WORK)


def test_a_core_that_is_slow_for_a_while_pauses_and_one_that_is_slow_once_does_not() -> None:
    slow, often = 2.0 * SLOW * WORK, math.ceil(PAUSE / PERIOD) + 1
    assert pauses_of([0.0] * 21, [WORK] * 10 + [slow] + [WORK] * 10) == []
    # with a look between them that was not bad
    efforts = [WORK] * CALM + [slow] * often + [WORK] + [slow] * often + [WORK] * CALM
    ((_, length),) = pauses_of([0.0] * len(efforts), efforts)
    looks = 2 * often + 1
    assert length == pytest.approx(2 * often * slow + WORK + (looks - 1) * PERIOD)


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


def test_processes_start_and_end() -> None:
    with Cores([0]) as cores:
        pauses = cores.end()
    assert pauses.shape[1] == 2 and not np.any(pauses[:, 1] < PAUSE)
    with pytest.raises(IndexError), Cores([0]):
        raise IndexError
