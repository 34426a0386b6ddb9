"""A clock that waits for those who go by it: who is waited for, for how long, and that nobody misses a time."""

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from robots import clocks
from robots.clocks import LOOK, MACHINE, SharedClock
from robots.errors import ConfigError
from sims.twin.lockstep import GIVES_UP, Lockstep

PERIOD = 0.001


@dataclass
class Reality:
    """Time of the machine; what others do at each nap of the twin."""

    path: Path
    now: float = 100.0
    come: int = 0
    owes: bool = False
    naps: int = 0
    at_naps: list = field(default_factory=list)  # type: ignore[type-arg]

    def __post_init__(self) -> None:
        clock = SharedClock.create(self.path, 50.0)
        self.lockstep = Lockstep(PERIOD, clock, lambda: (self.come, self.owes), lambda: self.now, self.sleep)

    def sleep(self, seconds: float) -> None:
        self.naps += 1
        self.now += seconds
        for do in self.at_naps:
            do()

    def join(self, role: str) -> SharedClock:
        return SharedClock(self.path, role)

    def answer(self) -> None:
        self.come, self.owes = self.come + 1, False

    def begin(self, clock: SharedClock) -> None:
        """Go by the clock, state after state, with an answer to each."""
        clock.now()
        self.answer()


@pytest.fixture
def real(tmp_path: Path) -> Reality:
    return Reality(tmp_path / "clock")


def test_where_nobody_is_time_passes_as_it_does(real: Reality) -> None:
    times = [real.lockstep.wait() for _ in range(1000)]
    np.testing.assert_allclose(times, 50.0 + PERIOD * np.arange(1, 1001), atol=1e-9)
    assert real.now == pytest.approx(100.999, abs=1e-4)
    assert real.lockstep.passed == pytest.approx(0.999, abs=1e-4)


def test_time_waits_until_everybody_has_seen_it(real: Reality) -> None:
    slow, quick = real.join("deployment"), real.join("guardian")
    slow.now()
    quick.now()
    real.at_naps = [quick.now, lambda: real.naps % 40 == 0 and slow.now()]
    for _ in range(20):
        before = real.lockstep.now()
        real.lockstep.wait()
        # nobody has been passed by
        assert real.lockstep._clock.seen("deployment") >= before and real.lockstep._clock.seen("guardian") >= before
    # the first period begins at once, and each of the others when the slow one has looked, 40 naps later
    assert real.naps == 19 * 40 and real.lockstep.given_up == 0


def test_a_state_is_answered_within_a_period_however_long_that_takes(real: Reality) -> None:
    controller = real.join("deployment")
    real.begin(controller)
    answered_after = []
    for _ in range(10):
        # a state goes out; the period after it begins without its answer, the next one does not
        real.owes, real.naps = True, 0
        real.at_naps = [controller.now]
        real.lockstep.wait()
        assert real.naps <= 1 and real.owes
        real.at_naps = [controller.now, lambda: real.answer() if real.naps == 700 else None]
        real.lockstep.wait()
        answered_after.append(real.naps)
        assert not real.owes
    assert answered_after == [700] * 10 and real.lockstep.given_up == 0


def test_who_never_answers_is_not_waited_for(real: Reality) -> None:
    controller = real.join("deployment")
    controller.now()
    real.owes, real.at_naps = True, [controller.now]
    for _ in range(50):
        real.lockstep.wait()
    assert real.naps <= 50 and real.lockstep.given_up == 0


@pytest.mark.parametrize("how", ["killed", "silent"])
def test_who_stops_is_given_up_and_waited_for_again_when_they_go_on(real: Reality, how: str) -> None:
    controller, guardian = real.join("deployment"), real.join("guardian")
    real.begin(controller)
    guardian.now()
    real.at_naps = [guardian.now] if how == "killed" else [guardian.now, controller.now]
    real.lockstep.wait()
    real.owes = True
    began = real.now
    for _ in range(100):
        real.lockstep.wait()
    # once, and not for each period
    assert real.lockstep.given_up == 1
    assert GIVES_UP < real.now - began < GIVES_UP + 0.05
    # it goes on: it is waited for as before
    real.begin(controller)
    real.at_naps = [guardian.now, lambda: real.naps % 30 == 0 and controller.now()]
    real.naps = 0
    for _ in range(5):
        real.lockstep.wait()
    assert real.naps > 100 and real.lockstep.given_up == 1


def test_who_leaves_is_not_waited_for(real: Reality) -> None:
    controller = real.join("deployment")
    real.begin(controller)
    controller.leave()
    began = real.now
    for _ in range(100):
        real.lockstep.wait()
    assert real.lockstep.given_up == 0 and real.now - began == pytest.approx(0.099, abs=1e-3)
    # and still sees the time
    assert controller.now() == real.lockstep.now()
    assert math.isinf(real.lockstep._clock.seen("deployment"))


def test_at_its_end_time_goes_on_as_it_does(real: Reality) -> None:
    observer = SharedClock(real.path)
    for _ in range(5):
        real.lockstep.wait()
    ended_at = observer.now()
    real.lockstep.stop()
    observer.sleep(0.01)
    assert observer.now() >= ended_at + 0.01 and real.lockstep.now() == ended_at
    passed = real.lockstep.passed
    real.now += 10.0
    assert real.lockstep.passed == passed > 0.0
    assert f"factor {0.002 / passed:.4f}" in real.lockstep.told(0.002)[0]


def test_a_machine_that_stands_still_gives_nobody_up(real: Reality) -> None:
    controller = real.join("deployment")
    controller.now()
    real.lockstep.wait()

    def stands_still() -> None:
        real.now += 2.0
        if real.naps == 20:
            controller.now()

    real.at_naps = [stands_still]
    real.lockstep.wait()
    assert real.lockstep.given_up == 0 and real.naps == 20


def test_an_observer_is_not_waited_for(real: Reality) -> None:
    observer = SharedClock(real.path)
    for _ in range(10):
        observer.now()
        real.lockstep.wait()
    assert all(real.lockstep._clock.seen(role) == 0.0 for role in ("deployment", "guardian"))


def test_a_clock_that_nobody_moves_any_more_runs_on(real: Reality, monkeypatch: pytest.MonkeyPatch) -> None:
    observer = SharedClock(real.path)
    began = observer.now()
    monkeypatch.setattr(clocks, "STANDS_STILL", 0.02)
    observer.sleep(0.05)
    assert observer.now() > began + 0.05
    # and shows what it is told where it is moved again
    real.lockstep.wait()
    assert observer.now() == real.lockstep.now()


@pytest.mark.parametrize("content", [None, b"", b"short"])
def test_what_is_no_clock_is_refused(tmp_path: Path, content: bytes | None) -> None:
    if content is not None:
        (tmp_path / "clock").write_bytes(content)
    with pytest.raises(ConfigError, match=r"clock = .*twin --clock"):
        SharedClock(tmp_path / "clock", "guardian")


def test_the_machines_clock_is_monotonic_and_sleeps() -> None:
    before = MACHINE.now()
    MACHINE.sleep(LOOK)
    assert MACHINE.now() >= before + LOOK
    MACHINE.leave()


def test_a_clock_that_cannot_be_made_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"clock = .*can be written \(No such file"):
        SharedClock.create(tmp_path / "nowhere" / "clock", 1.0)
