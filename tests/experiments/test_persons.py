"""The keyboard: what a person says counts once, and what cannot be read does no harm."""

import os
import time
from collections.abc import Iterator

import pytest

from controllers.deployment.stages import Stage
from experiments.cli.persons import DWELL, STANDS, Keyboard
from robots.clocks import MACHINE
from tests.support.fake_g1 import FakeG1


class Typed:
    """A keyboard that is a pipe."""

    def __init__(self, yes: bool = False) -> None:
        source, self._sink = os.pipe()
        self.person = Keyboard(yes, source)

    def type(self, data: bytes) -> None:
        os.write(self._sink, data)
        time.sleep(0.05)

    def close(self) -> None:
        if self._sink >= 0:
            os.close(self._sink)
            self._sink = -1
            time.sleep(0.05)


@pytest.fixture
def typed() -> Iterator[Typed]:
    keyboard = Typed()
    yield keyboard
    keyboard.close()


NOTHING = (False, False, False)


def test_each_line_is_a_wish_once(typed: Typed) -> None:
    for data, wish in ((b"\n", (True, False, False)), (b"s\n", (False, True, False)), (b"D\n", (False, False, True))):
        typed.type(data)
        assert typed.person.wishes(Stage.DAMPING, True, 0.0) == wish
        assert typed.person.wishes(Stage.DAMPING, True, 0.0) == NOTHING


def test_a_go_does_not_take_back_a_damp(typed: Typed) -> None:
    typed.type(b"d\n\n")
    assert typed.person.wishes(Stage.TASK, False, 0.0)[2]


def test_what_is_no_word_is_said_and_ignored(typed: Typed, capsys: pytest.CaptureFixture[str]) -> None:
    typed.type(b"\xff\xfe help\ns")
    assert typed.person.wishes(Stage.TASK, False, 0.0) == NOTHING
    assert "Enter for go" in capsys.readouterr().out
    typed.type(b"\n")
    assert typed.person.wishes(Stage.TASK, False, 0.0) == (False, True, False)


def test_a_keyboard_that_closes_says_so(typed: Typed, capsys: pytest.CaptureFixture[str]) -> None:
    typed.close()
    assert "by the remote only" in capsys.readouterr().out


def test_an_interrupt_stops_and_a_second_one_damps(typed: Typed) -> None:
    typed.person.interrupt()
    assert typed.person.wishes(Stage.TASK, False, 0.0) == (False, True, False)
    typed.person.interrupt()
    assert typed.person.wishes(Stage.TASK, False, 0.0) == (False, False, True)


def test_without_a_person_stages_go_on_after_a_while_but_for_stopping() -> None:
    person = Typed(yes=True).person
    assert not person.wishes(Stage.POSTURE, True, 0.5 * DWELL)[0]
    assert person.wishes(Stage.POSTURE, True, DWELL)[0]
    assert not person.wishes(Stage.POSTURE, True, DWELL + 0.1)[0]
    assert person.wishes(Stage.POSTURE, True, 2 * DWELL)[0]
    assert not person.wishes(Stage.STANDING, True, STANDS - 0.1)[0]
    assert person.wishes(Stage.STANDING, True, STANDS)[0]
    assert not person.wishes(Stage.STOPPING, True, 100.0)[0]
    assert not person.wishes(Stage.TASK, False, 100.0)[0]


def test_a_dry_run_ends_by_itself_without_a_go() -> None:
    person = Typed(yes=True).person
    person.end_hung_after(10.0)
    assert person.wishes(Stage.HUNG, True, 9.0) == NOTHING
    assert person.wishes(Stage.HUNG, True, 10.1) == (False, True, False)


class Port:
    """States of a robot without physics."""

    def __init__(self, robot: FakeG1) -> None:
        self.robot, self.clock = robot, MACHINE
        self.presses: dict[int, frozenset[str]] = {}

    def receive(self, until: float) -> list[tuple[bytes, float]]:
        self.robot.buttons = self.presses.get(self.robot.tick, self.robot.buttons)
        return [(self.robot.state(), self.robot.time)]


def test_the_go_before_the_release_is_one_that_is_said_from_then_on(typed: Typed) -> None:
    port = Port(FakeG1())
    stream = port.robot.deployment.stream
    typed.type(b"\n\n")
    port.presses = {50: frozenset({"A"})}
    assert typed.person.wait_for_go(port, stream)
    assert port.robot.tick >= 50
    # a button that is held down since before is none
    port.presses = {port.robot.tick + 50: frozenset(), port.robot.tick + 60: frozenset({"A"})}
    begun = port.robot.tick
    assert typed.person.wait_for_go(port, stream)
    assert port.robot.tick >= begun + 60


def test_a_stop_before_the_release_is_heard(typed: Typed) -> None:
    port = Port(FakeG1())
    typed.type(b"s\n")
    assert not typed.person.wait_for_go(port, port.robot.deployment.stream)
    typed.person.interrupt()
    assert not Keyboard.wait_for_go(typed.person, port, port.robot.deployment.stream)
