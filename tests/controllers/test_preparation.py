"""Before the first command: what has to be met, and that the motors are left alone where it is not."""

from collections.abc import Callable

import numpy as np
import pytest

from controllers.deployment.preparation import (
    RELEASES,
    Check,
    NotReadyError,
    checks,
    connect,
    release,
    require_met,
)
from robots.clocks import MACHINE
from robots.unitree.stream import StateStream
from robots.unitree.switcher import SwitcherError
from tests.support.fake_g1 import PERIOD, FakeG1

STILL = np.zeros((100, 3))


class Port:
    """States at once, as long as there are any; commands of others."""

    def __init__(self, robot: FakeG1, states: int = 10_000, broken: bool = False) -> None:
        self.robot, self._left, self._broken, self.others, self.clock = robot, states, broken, 0, MACHINE

    def receive(self, until: float) -> list[tuple[bytes, float]]:
        if self._left == 0:
            return []
        self._left -= 1
        data = self.robot.state()
        return [(data[:-1] + bytes([data[-1] ^ 1]) if self._broken else data, self.robot.time)]

    def strangers(self) -> int:
        found, self.others = self.others, 0
        return found


class Switcher:
    """The on-board service: active for some releases, or refusing them."""

    def __init__(self, releases: int, refuses: bool = False) -> None:
        self._left, self._refuses, self.released = releases, refuses, 0

    def mode(self) -> str:
        return "ai" if self._left else ""

    def release(self) -> None:
        if self._refuses:
            raise SwitcherError("ReleaseMode", 7008)
        self.released += 1
        self._left -= 1


def connected(change: Callable[[FakeG1], None] = lambda robot: None) -> StateStream:
    robot = FakeG1()
    change(robot)
    stream = robot.deployment.stream
    for _ in range(20):
        # a state is written by who plays the robot, and changed where a test says so
        robot.state()
        change(robot)
        stream.take(robot.message.sealed(), robot.time)
    return stream


def found(
    change: Callable[[FakeG1], None] = lambda robot: None, rate: float = 500.0, **given: object
) -> dict[str, Check]:
    values = {"battery": 80.0, "gyro": STILL} | given
    return {check.name: check for check in checks(connected(change), rate, values["battery"], values["gyro"])}


def test_a_sound_robot_meets_every_check() -> None:
    all_of_them = found()
    assert [name for name, check in all_of_them.items() if not check.met] == []
    require_met(list(all_of_them.values()))


def waist(robot: FakeG1) -> None:
    robot.message.mode_machine = 6


def hot(robot: FakeG1) -> None:
    robot.message.motors["temperature"][3] = 20, 81


def faulty(robot: FakeG1) -> None:
    robot.message.motors["motorstate"][3] = 0x100


def outside(robot: FakeG1) -> None:
    robot.message.motors["q"][3] = 5.0


def silent(robot: FakeG1) -> None:
    robot.message.remote[:] = 0


def tilted(robot: FakeG1) -> None:
    robot.message.imu["quaternion"] = np.cos(0.1), np.sin(0.1), 0.0, 0.0


def light(robot: FakeG1) -> None:
    robot.message.imu["accelerometer"] = 0.0, 0.0, 1.0


@pytest.mark.parametrize(
    ("change", "name", "text"),
    [
        (waist, "variant", "mode_machine 6"),
        (hot, "temperature", "81 degrees"),
        (faulty, "motors", "left_knee_joint: temperature of the shell"),
        (outside, "joints", "left_knee_joint 2"),
        (silent, "remote", "silent"),
        (tilted, "gravity", "0.20 rad"),
        (light, "gravity", "1.00 m/s^2"),
    ],
)
def test_what_is_wrong_is_named_alone(change: Callable[[FakeG1], None], name: str, text: str) -> None:
    all_of_them = found(change)
    assert [c.name for c in all_of_them.values() if not c.met] == [name]
    assert text in all_of_them[name].text
    with pytest.raises(NotReadyError, match=name):
        require_met(list(all_of_them.values()))


@pytest.mark.parametrize(
    ("given", "name"),
    [({"rate": 300.0}, "rate of states"), ({"battery": 12.0}, "battery"), ({"gyro": STILL + 0.3}, "gyro")],
)
def test_what_is_wrong_around_it_is_named_alone(given: dict[str, object], name: str) -> None:
    assert [c.name for c in found(**given).values() if not c.met] == [name]


def test_motors_that_wait_for_a_command_have_no_error_and_a_battery_may_be_unknown() -> None:
    def waiting(robot: FakeG1) -> None:
        robot.message.motors["motorstate"] = 0x40000000

    all_of_them = found(waiting, battery=float("nan"))
    assert all(check.met for check in all_of_them.values())
    assert "look at it" in all_of_them["battery"].text


def test_every_fault_is_in_the_refusal() -> None:
    with pytest.raises(NotReadyError, match=r"variant.*battery"):
        require_met(list(found(waist, battery=3.0).values()))


def test_states_are_waited_for_and_their_rate_is_told() -> None:
    robot = FakeG1()
    assert connect(Port(robot), robot.deployment.stream) == pytest.approx(1.0 / PERIOD, rel=1e-6)


@pytest.mark.parametrize("broken", [False, True])
def test_without_sound_states_there_is_no_robot(broken: bool) -> None:
    robot = FakeG1()
    with pytest.raises(NotReadyError, match="no robot"):
        connect(Port(robot, 100_000 if broken else 40, broken), robot.deployment.stream, timeout=0.2)


def test_a_service_is_released_as_often_as_it_takes() -> None:
    said: list[str] = []
    for releases in (0, 1, 3):
        switcher = Switcher(releases)
        release(switcher, Port(FakeG1()), said.append, pause=0.0, quiet=0.0)
        assert switcher.released == releases
    assert len(said) == 4 and all("limp" in text for text in said)


def test_a_service_that_comes_back_ends_the_start_and_says_that_the_robot_is_limp() -> None:
    with pytest.raises(NotReadyError, match=rf"active after {RELEASES} releases.*LIMP"):
        release(Switcher(100), Port(FakeG1()), lambda text: None, pause=0.0, quiet=0.0)


def test_a_refusal_says_why_and_that_nothing_has_happened() -> None:
    with pytest.raises(NotReadyError, match="7008") as refused:
        release(Switcher(1, refuses=True), Port(FakeG1()), lambda text: None, pause=0.0, quiet=0.0)
    assert "LIMP" not in str(refused.value)


def test_whoever_else_commands_the_motors_ends_the_start() -> None:
    port = Port(FakeG1())

    class Comes(Switcher):
        def mode(self) -> str:
            return ""

    taken = port.strangers

    def twice() -> int:
        # what came before the release was the service's; what comes after it is not
        count, port.others = taken(), 7
        return count

    port.strangers = twice
    with pytest.raises(NotReadyError, match="7 commands"):
        release(Comes(0), port, lambda text: None, pause=0.0, quiet=0.0)
