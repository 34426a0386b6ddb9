"""``safewbc doctor --g1`` beside a played robot over loopback, and where something is missing."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="the extra g1 is not installed")

from rich.console import Console

from experiments.cli import doctor_g1
from experiments.cli.doctor import doctor
from experiments.cli.doctor_g1 import Finding, clock_of, findings
from experiments.scenarios.options import DoctorOptions
from robots.errors import WithoutEffectError
from robots.loader import load_robot
from robots.unitree.dds import LOOPBACK
from robots.unitree.switcher import SwitcherService
from sims.twin.dds_ports import DdsPorts
from sims.twin.twin import Twin, TwinConfig

DOMAIN, OTHER, EMPTY = 95, 96, 97
"""None that anything else uses; nobody is in the last."""


@contextmanager
def played(domain: int, *orders: str) -> Iterator[list[bytes]]:
    """A twin in a thread that has obeyed some orders; yields the commands that came to its motors."""
    ports, came = DdsPorts(domain, LOOPBACK), []
    twin = Twin(load_robot("g1"), TwinConfig(), ports, SwitcherService(ports.network))
    take = ports.commands

    def commands() -> list[bytes]:
        found = list(take())
        came.extend(found)
        return found

    ports.commands = commands
    for order in orders:
        twin.obey(order)
    done = threading.Event()

    def play() -> None:
        begin = time.monotonic()
        while not done.is_set():
            twin.step(time.monotonic())
            time.sleep(max(0.0, begin + twin.time - time.monotonic()))

    thread = threading.Thread(target=play)
    thread.start()
    try:
        yield came
    finally:
        done.set()
        thread.join()


def found(domain: int = DOMAIN, interface: str = LOOPBACK) -> dict[str, Finding]:
    return {line.name: line for line in findings(interface, domain)}


def test_a_sound_robot_is_sound_and_its_motors_are_told_nothing() -> None:
    with played(DOMAIN) as came:
        lines = found()
    assert came == []
    # how fast a thread plays is the machine's matter
    judged = {name: line.mark for name, line in lines.items() if name not in ("clock", "rate of states", "scheduling")}
    assert judged == {
        "cyclonedds": "ok", "interface": "ok", "type hashes": "note", "rt/lowstate": "ok", "rt/secondary_imu": "ok",
        "rt/lf/bmsstate": "ok", "variant": "ok", "broken states": "ok", "joints": "ok", "temperature": "ok",
        "motors": "ok", "battery": "ok", "gravity": "ok", "remote": "ok", "gyro": "ok", "on-board service": "ok",
        "rt/lowcmd": "note",
    }  # fmt: skip
    assert lines["interface"].text == "lo, 127.0.0.1"
    assert lines["variant"].text == "mode_machine 5: 29 joints"
    assert lines["battery"].text == "90 %"
    assert "'ai' has the motors" in lines["on-board service"].text
    assert "goes on by 2 a state" in lines["clock"].text
    assert [text.split()[0] for text in lines["type hashes"].text.split(", ")] == [
        "LowCmd_", "LowState_", "IMUState_", "BmsState_"
    ]  # fmt: skip


def test_what_a_robot_must_not_have_fails() -> None:
    with played(OTHER, "waist-locked", "battery 10", "foreign-writer", "remote-lost"):
        lines = found(OTHER)
    for name, told in (("variant", "waist locked"), ("battery", "10 %"), ("remote", "silent")):
        assert lines[name].mark == "FAIL" and told in lines[name].text and "must be" in lines[name].text
    assert lines["rt/lowcmd"].mark == "note" and "2 other writers" in lines["rt/lowcmd"].text


def test_nobody_there_is_told_and_ends_with_1(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(doctor_g1, "FIND", 0.2)
    assert doctor(DoctorOptions(g1=True, interface=LOOPBACK, domain=EMPTY)) == 1
    lines = capsys.readouterr().out.splitlines()
    marks = {" ".join(line.split()[:2]) for line in lines}
    assert {"FAIL rt/lowstate", "note rt/secondary_imu", "FAIL on-board", "ok rt/lowcmd"} <= marks
    assert any("is the robot on" in line for line in lines)


def test_an_interface_that_is_not_there_ends_it(capsys: pytest.CaptureFixture[str]) -> None:
    lines = found(interface="none0")
    assert list(lines) == ["cyclonedds", "interface", "scheduling"]
    assert lines["interface"].mark == "FAIL" and "lo" in lines["interface"].text
    assert doctor_g1.doctor_g1("none0", DOMAIN, Console()) == 1
    assert capsys.readouterr().out.startswith("ok   cyclonedds")


def test_options_of_the_robot_have_no_effect_without_it() -> None:
    for options in ({"interface": "lo"}, {"domain": 1}):
        with pytest.raises(WithoutEffectError):
            doctor(DoctorOptions(**options))


def test_the_robots_clock_is_compared_with_this_machines() -> None:
    """Periods 100 ppm too long, a counter that goes on by 3, one state lost, and the counter's own wrap."""
    n = np.delete(np.arange(1000), 500)
    late = np.random.default_rng(0).normal(0.0, 1e-4, len(n))
    ticks = np.column_stack([(2**32 - 600 + 3 * n) % 2**32, 50.0 + 0.002 * (1.0 + 1e-4) * n + late])
    line = clock_of(ticks)
    assert line.mark == "ok" and "goes on by 3 a state" in line.text and line.text.endswith("; 1 lost")
    drift, sure = (float(line.text.split(word)[0].split()[-1]) for word in (" ±", " ppm"))
    assert abs(drift - 100.0) < 4.0 * sure and sure < 10.0
    slow = np.column_stack([ticks[:, 0], 1.05 * ticks[:, 1]])
    assert clock_of(slow).mark == "FAIL"
