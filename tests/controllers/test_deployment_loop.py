"""The loop: whatever raises brakes the motors, nothing stiff leaves late, and the guardian is not fought."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from controllers.deployment.deployment import SEEN
from controllers.deployment.heartbeat import Heartbeat
from controllers.deployment.loop import DAMPED_FOR, DEAF_FOR, FIRST_STATE, OFF_AFTER, DeploymentLoop, Timing
from controllers.deployment.ring import Kind, RingLog, read_log
from controllers.deployment.stages import Stage
from controllers.deployment.watchman import SILENCE
from robots.unitree.messages import CommandMessage
from robots.unitree.stream import PERIOD
from tests.support.fake_g1 import FakeG1


class Port:
    """Network and clock of a robot without physics; a test makes it late, deaf or broken."""

    def __init__(self, robot: FakeG1, heart: Heartbeat) -> None:
        self.robot, self.heart = robot, heart
        self.now = 50.0
        self.sent: list[bytes] = []
        self.silent = False
        self.work = 2e-4
        self.on_receive: Callable[[int], None] = lambda count: None
        self.on_send: Callable[[int], None] = lambda count: None
        self.count = 0

    def clock(self) -> float:
        # every look at it comes after some work
        self.now += self.work
        return self.now

    def receive(self, until: float) -> list[tuple[bytes, float]]:
        self.count += 1
        self.on_receive(self.count)
        self.heart.mark("guarded", self.now)
        self.now = max(self.now, 50.0 + PERIOD * self.count)
        if self.silent:
            return []
        return [(self.robot.state(), self.now)]

    def send(self, command: bytes) -> None:
        self.on_send(len(self.sent))
        self.sent.append(command)

    def strangers(self) -> int:
        return 0

    def battery(self) -> float:
        return 80.0


class Nobody:
    """A person who goes on until a stage, and then says nothing more."""

    def __init__(self, until: Stage) -> None:
        self._until, self.stop, self.lets_go = until, False, True

    def wishes(self, stage: Stage, asks: bool, since: float) -> tuple[bool, bool, bool]:
        says = stage is not self._until and (self.lets_go or stage is not Stage.DAMPED)
        return asks and says and since > SEEN, self.stop, False


class Played:
    """A loop with everything around it."""

    def __init__(self, folder: Path, until: Stage = Stage.POSTURE, write: bool = True) -> None:
        self.robot = FakeG1()
        self.heart = Heartbeat(folder / "heart", create=True)
        self.port = Port(self.robot, self.heart)
        self.path = folder / "log.bin"
        self.log = RingLog(self.path, 50_000_000, {})
        self.person = Nobody(until)
        self.loop = DeploymentLoop(
            self.robot.deployment, self.port, self.heart, self.log, self.person, write, self.port.clock
        )

    def brakes(self, data: bytes) -> bool:
        message = CommandMessage()
        assert message.read(data)
        motors = message.motors[:29]
        return not motors["kp"].any() and not motors["tau"].any() and bool((motors["kd"] > 0.0).all())


@pytest.fixture
def played(tmp_path: Path) -> Played:
    return Played(tmp_path)


def stop_after(played: Played, count: int) -> None:
    def at(now: int) -> None:
        if now >= count:
            played.person.stop = True

    played.port.on_receive = at


def test_it_ends_after_it_has_braked_for_long_enough(played: Played) -> None:
    stop_after(played, 800)
    assert played.loop.run() == "stop"
    assert played.loop.braked
    assert all(played.brakes(data) for data in played.port.sent[-DAMPED_FOR:])
    assert not played.brakes(played.port.sent[-DAMPED_FOR - 1])
    kinds = [record.kind for record in read_log(played.path)]
    assert kinds.count(Kind.COMMAND) == len(played.port.sent) == kinds.count(Kind.SENT)


def test_it_goes_on_braking_until_a_person_lets_the_robot_go(played: Played) -> None:
    played.person.lets_go = False
    stop_after(played, 800)
    inner = played.port.on_receive

    def at(count: int) -> None:
        inner(count)
        if count > 6000:
            played.person.lets_go = True

    played.port.on_receive = at
    assert played.loop.run() == "stop" and played.loop.braked
    assert 6000 < played.port.count < 6010
    assert all(played.brakes(data) for data in played.port.sent[-5000:])


def test_it_goes_on_braking_until_the_robot_is_off(played: Played) -> None:
    played.person.lets_go = False
    stop_after(played, 800)
    inner = played.port.on_receive

    def at(count: int) -> None:
        inner(count)
        played.port.silent = count > 3000

    played.port.on_receive = at
    assert played.loop.run() == "stop" and played.loop.braked
    assert played.port.now - 50.0 - 3000 * PERIOD == pytest.approx(OFF_AFTER, abs=0.1)
    assert all(played.brakes(data) for data in played.port.sent[-2000:])


@pytest.mark.parametrize("where", ["receive", "send", "log"])
def test_whatever_raises_brakes_the_motors(played: Played, where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise OSError("no such device")

    counts: list[int] = []

    def once(count: int) -> None:
        counts.append(count)
        if len(counts) == 200:
            broken()

    if where == "receive":
        played.port.on_receive = once
    elif where == "send":
        played.port.on_send = once
    else:
        written = played.log.write
        calls = iter(range(10**9))

        def write(*arguments: object) -> None:
            if next(calls) == 800:
                broken()
            written(*arguments)

        monkeypatch.setattr(played.log, "write", write)
    cause = played.loop.run()
    assert cause == "OSError: no such device" and played.loop.braked
    assert all(played.brakes(data) for data in played.port.sent[-DAMPED_FOR:])
    stiff = [i for i, data in enumerate(played.port.sent) if not played.brakes(data)]
    assert stiff[-1] <= 201


def test_a_network_that_stays_broken_does_not_keep_it_for_ever(played: Played) -> None:
    def broken(count: int) -> None:
        if count > 200:
            played.port.now += PERIOD
            raise OSError("gone")

    played.port.on_receive = broken
    begun = played.port.now
    assert played.loop.run() == "OSError: gone"
    # what it leaves is for the guardian: it is not told that all is over
    assert not played.loop.braked and played.port.now - begun < DEAF_FOR + 5.0


def test_a_late_command_is_not_sent_but_the_one_before(played: Played) -> None:
    late: list[int] = []

    def slow(count: int) -> None:
        played.port.work = 3e-3 if count == 700 else 2e-4
        if count == 701:
            late.append(len(played.port.sent))

    played.port.on_receive = slow
    played.person.stop = False
    stop_at = 770
    inner = played.port.on_receive

    def both(count: int) -> None:
        inner(count)
        if count >= stop_at:
            played.person.stop = True

    played.port.on_receive = both
    played.loop.run()
    assert played.loop.timing.late == 1
    i = late[0] - 1
    assert played.port.sent[i] == played.port.sent[i - 1] != played.port.sent[i + 1]


def test_a_second_late_command_in_a_row_goes_out(played: Played) -> None:
    """Motors must not be without anything new for long."""
    sent: list[int] = []

    def slow(count: int) -> None:
        played.port.work = 3e-3 if count in (700, 701) else 2e-4
        sent.append(len(played.port.sent))
        played.person.stop = count >= 750

    played.port.on_receive = slow
    played.loop.run()
    assert (played.loop.timing.late, played.loop.timing.late_pairs) == (2, 1)
    first, second = played.port.sent[sent[699]], played.port.sent[sent[700]]
    assert first == played.port.sent[sent[699] - 1] != second


def test_braking_that_no_state_answers_does_not_count(played: Played) -> None:
    """A cable that is out: nobody knows whether the motors were told; the guardian goes on."""

    def cut(count: int) -> None:
        played.person.stop = count >= 250
        played.port.silent = count >= 250
        if played.port.silent:
            played.port.now += PERIOD

    played.port.on_receive = cut
    begun = played.port.now
    played.loop.run()
    assert not played.loop.braked
    assert DEAF_FOR < played.port.now - begun < DEAF_FOR + 3.0


def test_a_process_that_was_stopped_says_nothing_when_it_goes_on(played: Played) -> None:
    """The guardian had the motors meanwhile, whether its mark was seen in time or not."""

    def stopped(count: int) -> None:
        played.port.work = 4.0 * SILENCE if count == 250 else 2e-4
        if count == 251:
            played.heart.mark("latched", played.port.now)
            played.port.before = len(played.port.sent)  # type: ignore[attr-defined]

    played.port.on_receive = stopped
    cause = played.loop.run()
    assert "guardian has taken over" in str(cause)
    # the periods up to the stop were answered, the one of the stop and those after it were not
    assert len(played.port.sent) <= 249


def test_nothing_is_sent_beside_a_guardian_that_latches_in_mid_period(played: Played) -> None:
    def latches(count: int) -> None:
        if count == 200:
            step = played.robot.deployment.step

            def slow(around: object) -> bytes:
                played.heart.mark("latched", played.port.now)
                return step(around)

            played.robot.deployment.step = slow

    played.port.on_receive = latches
    played.loop.run()
    assert len(played.port.sent) == 199 and played.robot.is_at(Stage.DAMPED)


def test_without_a_first_state_it_ends_with_a_cause(played: Played) -> None:
    played.port.silent = True
    begun = played.port.now
    assert "no sound state" in str(played.loop.run())
    assert FIRST_STATE < played.port.now - begun < FIRST_STATE + 0.1
    assert len(played.port.sent) == 1 and played.brakes(played.port.sent[0])


def test_before_the_first_state_a_stop_is_heard(played: Played) -> None:
    played.port.silent = True
    played.person.stop = True
    begun = played.port.now
    played.loop.run()
    assert played.port.now - begun < 0.1


def test_a_dry_run_sends_nothing(tmp_path: Path) -> None:
    played = Played(tmp_path, write=False)
    stop_after(played, 800)
    played.loop.run()
    assert played.port.sent == [] and played.heart.read("sent") == 0.0


def test_periods_go_on_at_their_pace_where_no_state_comes(played: Played) -> None:
    """The motors fade out by the number of periods: they have to be as long as with states."""
    waits: list[float] = []

    def receive(until: float) -> list[tuple[bytes, float]]:
        played.port.count += 1
        played.heart.mark("guarded", played.port.now)
        if played.port.count < 200:
            played.port.now = max(played.port.now, 50.0 + PERIOD * played.port.count)
            return [(played.robot.state(), played.port.now)]
        played.port.now = max(played.port.now, until)
        waits.append(played.port.now)
        played.person.stop = played.port.count > 205
        return []

    played.port.receive = receive
    played.loop.run()
    steps = np.diff(waits)
    assert abs(np.median(steps) - PERIOD) < 5e-4


def test_periods_without_a_state_are_no_late_ones() -> None:
    timing = Timing()
    found = [timing.count(1e-3, 3e-3, 0.0, fresh) for fresh in (True, False, True)]
    assert found == [True, False, True]
    assert (timing.late, timing.late_pairs, timing.without, timing.late_in_a_row) == (2, 0, 1, 1)
    timing.count(1e-3, 3e-3, 0.0, True)
    assert (timing.late, timing.late_pairs, timing.late_in_a_row) == (3, 1, 2)
    assert not timing.count(3e-3, 1e-3, 0.0, True) and timing.late_in_a_row == 0
    assert np.isfinite(timing.work).all()
