"""The search for the strongest push: against brute force, and one that a robot survives and one that fells it."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controllers.gaits.walking import walk_tuning
from experiments.running.run import run
from experiments.scenarios.pushed import SPEED
from experiments.scenarios.pushes import PUSH_TIME
from experiments.studies import pushes as push_search
from experiments.studies.case import Case
from experiments.studies.pushes import AFTER, STRIDE, PushCase, PushSearch, cases, pushed, true_mass, worst_of
from experiments.studies.search import Bracket, largest_that_holds
from experiments.studies.store import CaseFailedError, RowStore
from experiments.studies.study_options import PushSearchOptions
from experiments.studies.work import WorkOptions
from robots.errors import SafeWbcError
from robots.loader import load_robot
from robots.mujoco_spec import PhysicalChanges, build_mujoco_spec

levels = st.integers(0, 40)
strides = st.integers(1, 12)


@given(limit=levels, top=levels, start=strides, stride=strides)
def test_the_largest_level_that_holds_is_found(limit: int, top: int, start: int, stride: int) -> None:
    """Of what holds up to a limit; no level above ``top``, and none twice, is tried."""
    tried: list[int] = []

    def holds(level: int) -> bool:
        tried.append(level)
        return level <= limit

    assert largest_that_holds(holds, Bracket(top, start, stride)) == min(limit, top)
    assert len(set(tried)) == len(tried)
    assert all(1 <= level <= top for level in tried)
    # both ends of the answer are seen, not concluded
    assert min(limit, top) == 0 or min(limit, top) in tried
    assert limit >= top or limit + 1 in tried


@given(falls=st.sets(st.integers(1, 30)), top=st.integers(1, 30), start=strides, stride=strides)
def test_level_found_holds_and_the_next_one_does_not(falls: set[int], top: int, start: int, stride: int) -> None:
    """Also where a higher level holds again."""
    found = largest_that_holds(lambda level: level not in falls, Bracket(top, start, stride))
    assert found not in falls
    assert found == top or found + 1 in falls


@given(falls=st.sets(st.integers(1, 30)), top=st.integers(1, 30))
def test_no_fall_at_a_whole_stride_below_is_passed_over(falls: set[int], top: int) -> None:
    found = largest_that_holds(lambda level: level not in falls, Bracket(top, STRIDE, STRIDE))
    assert not [level for level in falls if level <= found and level % STRIDE == 0]


@given(limit=levels, top=st.integers(1, 40))
def test_a_search_takes_few_steps(limit: int, top: int) -> None:
    tried: list[int] = []
    largest_that_holds(lambda level: tried.append(level) or level <= limit, Bracket(top, 8, 8))  # type: ignore[func-returns-value]
    assert len(tried) <= top // 8 + 1 + 3


def search(top: float = 0.4) -> PushSearch:
    return PushSearch("g1", "standing", "forward", 1.0, 0.1, top, "")


def stored(store: RowStore, case: Any, **metrics: Any) -> None:
    """The row of a run, as if it had been made."""
    usual = {"fell": False, "stop_cause": None, "cpu_s": 1.0}
    store.obtain(Case(case.key, case.labels, lambda _: usual | metrics))


def test_a_search_is_made_of_rows_that_are_there(tmp_path: Path) -> None:
    store = RowStore(tmp_path)
    store.prepare()
    (push,) = search().pushes()
    for level in range(1, 5):
        stored(store, search().run(push, level), fell=level > 2)
    found = search()(store)
    assert (found["survived"], found["first_fall"]) == (pytest.approx(0.2), pytest.approx(0.3))
    assert found["survived_force"] == pytest.approx(0.2 * true_mass(push) / PUSH_TIME)
    assert found["runs"] == found["cpu_s"]
    assert found["weakest"] == push.words


def test_a_run_that_failed_fails_its_search(tmp_path: Path) -> None:
    store = RowStore(tmp_path)
    store.prepare()
    for level in range(1, 5):
        store.record_failure(search().run(search().pushes()[0], level), "ValueError: no")
    with pytest.raises(CaseFailedError, match="ValueError: no"):
        search()(store)


def test_searches_that_differ_have_keys_that_differ() -> None:
    keys = {search().case().key, search(0.5).case().key, dataclasses.replace(search(), mass_scale=1.1).case().key}
    assert len(keys) == 3
    assert search().case().key == search().case().key


@given(limits=st.lists(st.integers(0, 25), min_size=1, max_size=8), top=st.integers(1, 25))
def test_the_worst_of_the_cases_counts(limits: list[int], top: int) -> None:
    given_cases = [PushCase("g1", "walking", "left", float(i), 1.0) for i in range(len(limits))]
    level, weakest = worst_of(given_cases, top, lambda case, tried: tried <= limits[int(case.time)])
    assert level == min([*limits, top])
    assert (weakest is None) == (level == top)
    if weakest is not None:
        assert limits[int(weakest.time)] == level


def test_instants_of_walking_are_evenly_spread_over_one_step() -> None:
    pushes = cases("g1", "walking", "sideways", 1.0)
    times = sorted({case.time for case in pushes})
    gaps = np.diff([*times, times[0] + walk_tuning(load_robot("g1")).timing.period(SPEED)])
    np.testing.assert_allclose(gaps, gaps[0], atol=1e-9)
    assert {(case.time, case.direction) for case in pushes} == {(t, d) for t in times for d in ("left", "right")}


def test_mass_of_the_simulated_robot(robot_name: str) -> None:
    model = build_mujoco_spec(load_robot(robot_name), PhysicalChanges(mass_scale=1.2)).compile()
    assert true_mass(PushCase(robot_name, "standing", "left", 1.0, 1.2)) == pytest.approx(model.body_mass.sum())


def test_a_push_changes_the_momentum_by_its_impulse() -> None:
    """Standing; for as long as the ground has not had the time to push back much, and after it the robot stays up."""
    case = dataclasses.replace(cases("g1", "standing", "forward", 1.0)[0], time=0.6)
    impulse = 0.1
    result = run(pushed(case, impulse * true_mass(case) / PUSH_TIME))
    time, com = result.series["time"], result.series["com"]
    assert not result.summary["fell"]
    assert result.summary["duration_s"] == pytest.approx(case.time + PUSH_TIME + AFTER)
    # 10 ms into the push: the impulse so far, per mass
    first = int(np.searchsorted(time, case.time - 1e-9))
    speed = (com[first + 5] - com[first + 4]) / (time[first + 5] - time[first + 4])
    assert speed[0] == pytest.approx(0.09 * impulse, rel=0.25)
    assert abs(speed[1]) < 0.1 * speed[0]


def test_a_strong_push_fells_the_robot_and_the_run_then_ends() -> None:
    case = dataclasses.replace(cases("g1", "standing", "forward", 1.0)[0], time=0.6)
    result = run(pushed(case, 3.0 * true_mass(case) / PUSH_TIME))
    assert result.summary["fell"]
    assert result.summary["duration_s"] < case.time + AFTER


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"stances": ("lying",)}, "lying"),
        ({"stances": ()}, "stances"),
        ({"directions": ("up",)}, "up"),
        ({"robots": ()}, "robots"),
        ({"robots": ("nobody",)}, "nobody"),
        ({"resolution": 0.0}, "resolution"),
        ({"largest": 0.01}, "largest"),
        ({"mass_scale": -1.0}, "mass_scale"),
        ({"work": WorkOptions(jobs=0)}, "jobs"),
    ],
)
def test_wrong_options_are_refused_before_anything_is_written(
    change: dict[str, object], named: str, tmp_path: Path
) -> None:
    options = dataclasses.replace(PushSearchOptions(), **change)
    options = dataclasses.replace(options, work=dataclasses.replace(options.work, out=tmp_path / "runs"))
    with pytest.raises(SafeWbcError, match=named):
        push_search.pushes(options)
    assert not (tmp_path / "runs").exists()
