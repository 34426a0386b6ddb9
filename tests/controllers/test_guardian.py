"""The guardian: silent while the controller speaks, and braking for good when it does not."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from controllers.deployment.heartbeat import COUNTED_AT_MOST, FIELDS, Heartbeat, Silence
from controllers.deployment.watchman import ASKED, SILENCE, SILENT, Watchman, brake_message
from robots.unitree.messages import CommandMessage
from robots.unitree.remote import button_bits
from tests.support.fake_g1 import ROBOT, FakeG1

DOMAIN = 87
PATIENCE = 1.0
"""Of the guardians here: how soon a machine with other work to do gets round to a test is not what is tested [s]."""

ROOT = Path(__file__).resolve().parents[2]
BOTH = button_bits("L2", "B")

# --- when


def test_it_waits_until_the_controller_has_begun() -> None:
    watchman = Watchman()
    assert not any(watchman.look(0.001 * i, 0.0, BOTH) for i in range(1000))


def test_silence_is_noticed_within_its_time() -> None:
    watchman, t = Watchman(), 0.0
    for _ in range(1000):
        t += 0.001
        assert not watchman.look(t, t - 0.001, 0)
    last = t - 0.001
    while not watchman.look(t, last, 0):
        t += 0.001
    assert SILENCE < t - last <= SILENCE + 0.003
    assert watchman.cause == SILENT


def test_it_is_for_good() -> None:
    watchman = Watchman()
    for i in range(30):
        watchman.look(0.001 * i, 0.5, 0)
    assert all(watchman.look(0.1 + 0.001 * i, 0.1 + 0.001 * i, 0) for i in range(100))


def test_l2_and_b_together_and_nothing_less() -> None:
    watchman = Watchman()
    for i, names in enumerate((("L2",), ("B",), ("R2", "B"), ())):
        assert not watchman.look(0.001 * i, 1.0 + i, button_bits(*names))
    assert watchman.look(0.01, 9.0, button_bits("L2", "B", "up")) and watchman.cause == ASKED


def test_a_machine_that_stood_still_counts_as_one_look() -> None:
    watchman = Watchman()
    assert not watchman.look(1.0, 1.0, 0)
    assert not watchman.look(1.5, 1.0, 0)
    # the controller gets the rest of its time
    looks = 0
    while not watchman.look(1.501 + 0.001 * looks, 1.0, 0):
        looks += 1
    assert looks >= (SILENCE - 2 * COUNTED_AT_MOST) / 0.001


def test_a_silence_is_what_was_watched_of_it() -> None:
    silence = Silence()
    silence.look(1.0, 5.0)
    assert [silence.look(1.0 + 0.002 * i, 5.0) for i in range(1, 4)] == pytest.approx([0.002, 0.004, 0.006])
    assert silence.look(2.0, 5.0) == pytest.approx(0.006 + COUNTED_AT_MOST)
    assert silence.look(2.001, 5.1) == 0.0


def test_its_command_brakes_and_nothing_else() -> None:
    message = CommandMessage()
    assert message.read(brake_message(ROBOT, 6))
    assert message.mode_machine == 6
    motors = message.motors[:29]
    assert not motors["kp"].any() and not motors["tau"].any() and (motors["kd"] > 0.0).all()
    assert all(message.enabled(i) == (i < 29) for i in range(35))


# --- what the two processes share


def test_what_one_process_marks_another_reads(tmp_path: Path) -> None:
    path = tmp_path / "heart"
    heart = Heartbeat(path, create=True)
    assert [heart.read(field) for field in FIELDS] == [0.0] * len(FIELDS)
    code = (
        "import sys; from pathlib import Path; from controllers.deployment.heartbeat import Heartbeat; "
        "Heartbeat(Path(sys.argv[1])).mark('latched', 12.5)"
    )
    subprocess.run([sys.executable, "-c", code, str(path)], check=True, cwd=ROOT)
    assert heart.read("latched") == 12.5 and heart.read("sent") == 0.0


def test_what_is_not_permitted_is_said() -> None:
    """In a process of its own: what is asked for would stay."""
    code = (
        "from controllers.deployment.realtime import *; "
        "print(schedule(50)); print(pin(None)); print(pin(10**6)); print(lock_memory()); freeze_garbage(); "
        "import gc; print(gc.isenabled())"
    )
    out = subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT, capture_output=True, text=True).stdout
    lines = out.splitlines()
    assert "scheduling" in lines[0] and lines[1] == "on any processor" and lines[2].startswith("on any processor (")
    assert "locked" in lines[3] and lines[4] == "False"


# --- the process


@contextlib.contextmanager
def guardian(heart: Path) -> Iterator["subprocess.Popen[bytes]"]:
    arguments = ["-m", "controllers.deployment.guardian", str(heart), str(DOMAIN), "lo", "g1", str(PATIENCE)]
    process = subprocess.Popen([sys.executable, *arguments], cwd=ROOT)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def wait_until_it_watches(heart: Heartbeat) -> None:
    end = time.monotonic() + 60.0
    while not heart.read("guarded"):
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.mark.parametrize("what", ["silence", "buttons", "end"])
def test_the_process_brakes_when_it_has_to(tmp_path: Path, what: str) -> None:
    pytest.importorskip("cyclonedds", reason="the extra g1 is not installed")
    from robots.unitree.dds import Network  # noqa: PLC0415

    network, robot = Network(DOMAIN, "lo"), FakeG1()
    states, commands = network.writer("rt/lowstate"), network.reader("rt/lowcmd", depth=64)
    heart = Heartbeat(tmp_path / "heart", create=True)
    with guardian(tmp_path / "heart") as process:
        wait_until_it_watches(heart)
        end = time.monotonic() + 10.0
        while not (states.readers and commands.writers) and time.monotonic() < end:
            time.sleep(0.01)
        for _ in range(200):
            states.send(robot.state())
            heart.mark("sent", time.monotonic())
            time.sleep(0.001)
        assert commands.newest() is None and not heart.read("latched")
        if what == "end":
            heart.mark("ended", time.monotonic())
            assert process.wait(10.0) == 0 and commands.newest() is None
            return
        began = time.monotonic()
        robot.buttons = frozenset({"L2", "B"} if what == "buttons" else ())
        found: list[bytes] = []
        while time.monotonic() < began + 20.0 and len(found) < 50:
            states.send(robot.state())
            if what == "buttons":
                heart.mark("sent", time.monotonic())
            found += commands.take()
            time.sleep(0.002)
        assert len(found) >= 50
        assert set(found) == {brake_message(ROBOT, 5)}
        assert bool(heart.read("asked")) == (what == "buttons")
        assert heart.read("latched") >= began
        os.kill(process.pid, signal.SIGTERM)
        assert process.wait(10.0) == 0


def test_the_times_are_plain_numbers(tmp_path: Path) -> None:
    heart = Heartbeat(tmp_path / "heart", create=True)
    heart.mark("sent", 1e9 + 0.123456)
    assert heart.read("sent") == 1e9 + 0.123456
    assert np.frombuffer((tmp_path / "heart").read_bytes())[FIELDS.index("sent")] == 1e9 + 0.123456
