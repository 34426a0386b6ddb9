"""The twin as a process of its own over loopback, as a controller meets it; and options that it refuses."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="the extra g1 is not installed")

from experiments.cli import twin as command
from experiments.cli.twin import Lines, checked
from experiments.scenarios.hardware_options import TwinOptions
from robots.errors import ConfigError
from robots.loader import load_robot
from robots.messages import MotorCommand
from robots.unitree.dds import LOOPBACK, Network
from robots.unitree.g1 import G1Joints
from robots.unitree.messages import CommandMessage, StateMessage
from robots.unitree.switcher import SwitcherClient

DOMAIN = 84
"""None that anything else uses."""

ROOT = Path(__file__).resolve().parents[2]
ROBOT = load_robot("g1")


def started(*arguments: str) -> subprocess.Popen[str]:
    """A twin that has said that it is ready."""
    line = [sys.executable, "-m", "safewbc", "twin", "g1", "--domain", str(DOMAIN), *arguments]
    process = subprocess.Popen(line, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "[    0.000] ready\n"
    return process


class Controller:
    """Answers every state with the posture, as a controller does."""

    def __init__(self, network: Network) -> None:
        self.joints, self.message, self.state = G1Joints(ROBOT), CommandMessage(), StateMessage()
        self._states, self._commands = network.reader("rt/lowstate", depth=64), network.writer("rt/lowcmd")
        self.broken = 0

    def until(self, met: Callable[[], object], timeout: float) -> None:
        """Go on until something is so."""
        zero, end = np.zeros(29), time.monotonic() + timeout
        q, kp, kd = ROBOT.posture("standing").joints, ROBOT.joint_array("kp"), ROBOT.joint_array("kd")
        while not met():
            assert time.monotonic() < end
            for data in self._states.take():
                self.broken += not self.state.read(data)
                held = MotorCommand(q, zero, zero, kp, kd, 0.0)
                self.joints.write(held, self.message, self.state.mode_machine)
                self._commands.send(self.message.sealed())
            time.sleep(2e-4)

    def knee(self) -> float:
        """Torque of the left knee [N m]."""
        slot = int(self.joints.slots[ROBOT.joint_names.index("left_knee_joint")])
        return float(self.state.motors["tau_est"][slot])


def test_a_controller_releases_the_robot_holds_it_and_sees_it_stand_on_the_ground(tmp_path: Path) -> None:
    # whatever else the machine does, commands are in time
    process = started("--sensor-errors", "0", "--motor-timeout", "60", "--record", str(tmp_path / "a.npz"))
    assert process.stdin is not None
    try:
        network = Network(DOMAIN, LOOPBACK)
        controller, client = Controller(network), SwitcherClient(network, 20.0)
        assert client.mode() == "ai"
        controller.until(lambda: controller.state.tick > 0, 20.0)
        client.release()
        assert client.mode() == ""
        begin = controller.state.tick
        controller.until(lambda: controller.state.tick > begin + 1000, 20.0)
        hanging = controller.knee()
        process.stdin.write("lower\nnonsense\nstatus\n")
        process.stdin.flush()
        begin = controller.state.tick
        # 0.15 m at 0.05 m/s, and then a part of its weight
        controller.until(lambda: controller.state.tick > begin + 4500, 60.0)
        assert abs(controller.knee() - hanging) > 5.0
        process.stdin.write("end\n")
        out, _ = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 0 and controller.broken == 0
    lines = [line.partition("] ")[2].partition(":")[0] for line in out.splitlines() if line.startswith("[")]
    assert lines == ["released", "lower", "refused", "status", "end"]
    assert out.count("real time: factor") == out.count("LowCmd: ") == 2
    with np.load(tmp_path / "a.npz") as saved:
        assert saved["foot_wrench"][-1, :, 2].min() > 20.0
        assert (np.diff(saved["time"]) > 0.0).all() and (np.diff(saved["monotonic"]) >= 0.0).all()
        assert list(saved["events"][:2]) == ["ready", "released"]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_it_with_its_record_and_the_end_of_its_input_does_not(
    number: signal.Signals, tmp_path: Path
) -> None:
    process = started("--record", str(tmp_path / "a.npz"))
    assert process.stdin is not None
    try:
        process.stdin.close()
        time.sleep(0.5)
        assert process.poll() is None
        process.send_signal(number)
        assert process.wait(60) == 0
        assert process.stdout is not None and f"end: {number.name}" in process.stdout.read()
    finally:
        process.kill()
    with np.load(tmp_path / "a.npz") as saved:
        assert len(saved["time"]) > 50


def test_it_ends_by_itself_after_its_script_and_its_duration(tmp_path: Path) -> None:
    script = tmp_path / "script.txt"
    script.write_text("0.1 battery 30\n0.2 lower\n")
    process = started("--script", str(script), "--duration", "0.3")
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    assert out.splitlines()[:3] == ["[    0.100] battery 30", "[    0.200] lower", "[    0.300] end: duration"]


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"domain": 0}, ["domain", "0", "1 to 230", "robot's"]),
        ({"domain": 231}, ["domain", "231"]),
        ({"mass_scale": 0.0}, ["mass_scale", "0.0"]),
        ({"friction": -1.0}, ["friction", "-1.0"]),
        ({"sensor_errors": 30.0}, ["sensor_errors", "30.0", "0 to 20"]),
        ({"gyro_drift": -1.0}, ["gyro_drift", "-1.0"]),
        ({"torque_constant": 3.0}, ["torque_constant", "3.0"]),
        ({"motor_timeout": 0.0}, ["motor_timeout", "0.0"]),
        ({"duration": -1.0}, ["duration", "-1.0"]),
        ({"seed": -1}, ["seed", "-1"]),
        ({"cpu": 4096}, ["cpu", "4096", "0"]),
        ({"interface": "no-such-interface"}, ["interface", "no-such-interface"]),
        ({"script": Path("none.txt")}, ["script", "none.txt"]),
        ({"record": Path("none/a.npz")}, ["record", "none/a.npz"]),
    ],
)
def test_what_is_not_allowed_is_refused_before_anything_starts(
    options: dict[str, object], told: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # the process of the tests keeps its own
    monkeypatch.setattr(command, "schedule", lambda cpu, first: "as it was")
    with pytest.raises(ConfigError) as caught:
        command.twin(TwinOptions("g1", **{"domain": DOMAIN + 2} | options))
    for part in told:
        assert part in str(caught.value)


def test_options_reach_the_twin() -> None:
    config = checked(
        TwinOptions(
            "g1",
            mass_scale=1.2,
            friction=0.5,
            sensor_errors=2.0,
            gyro_drift=0.6,
            torque_constant=0.9,
            seed=3,
            on_timeout="damp",
            motor_timeout=0.2,
        )
    )
    assert (config.plant.changes.mass_scale, config.plant.changes.sole_friction) == (1.2, 0.5)
    assert (config.errors.gyro_bias, config.errors.torque_scale) == (0.02, 0.9)
    assert config.errors.gyro_drift == pytest.approx(0.01)
    assert (config.seed, config.on_timeout, config.motor_timeout) == (3, "damp", 0.2)


def test_lines_come_whole_and_their_end_is_none() -> None:
    reading, writing = os.pipe()
    lines = Lines(reading)
    assert lines.take() == []
    os.write(writing, b"low")
    assert lines.take() == []
    os.write(writing, b"er\n\n raise \nsta")
    assert lines.take() == ["lower", "raise"]
    os.close(writing)
    assert lines.take() == ["sta"]
    assert lines.take() == []
    os.close(reading)
