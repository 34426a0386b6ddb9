"""The robot's topics on a real network, that of this machine: types, bytes, two processes."""

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="the extra g1 is not installed")

from cyclonedds.idl import IdlStruct, make_idl_struct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import array, byte, float32, uint8, uint32

from robots.errors import ConfigError
from robots.loader import load_robot
from robots.messages import MotorCommand, SensorReading
from robots.unitree import idl
from robots.unitree.body import G1Body, NoStateError
from robots.unitree.dds import LOOPBACK, Network, configuration
from robots.unitree.g1 import MODE_MACHINE, G1Joints
from robots.unitree.messages import CommandMessage, StateMessage

DOMAIN = 83
"""None that anything else uses."""

ROOT = Path(__file__).resolve().parents[2]

HASHES = {
    "IMUState_": "7d41667541",
    "LowCmd_": "42b0283aa7e1",
    "LowState_": "2be9706c9587",
}
"""How the hashes of the types begin, as cyclonedds 11 makes them from fields with ``byte`` for octet."""


@pytest.fixture(scope="module")
def network() -> Network:
    return Network(DOMAIN, LOOPBACK)


def until(met: Callable[[], object], timeout: float = 10.0) -> None:
    end = time.monotonic() + timeout
    while not met():
        assert time.monotonic() < end
        time.sleep(0.005)


def test_types_have_the_robots_names_and_hashes() -> None:
    for name, begin in HASHES.items():
        kind = getattr(idl, name)
        assert idl.type_hash(kind).startswith(begin)
        assert kind.__idl__.idl_transformed_typename == f"unitree_hg::msg::dds_::{name}"


def test_the_hash_is_that_of_the_fields_and_octets_are_no_uint8() -> None:
    """Bytes instead of samples change nothing of the type; ``uint8`` does."""

    def motor(octet: object) -> dict[str, object]:
        return {"mode": octet, **dict.fromkeys(("q", "dq", "tau", "kp", "kd"), float32), "reserve": uint32}

    def made(octet: object) -> type[IdlStruct]:
        part = final(make_idl_struct("MotorCmd_", "unitree_hg.msg.dds_.MotorCmd_", motor(octet)))
        fields = {
            "mode_pr": octet,
            "mode_machine": octet,
            "motor_cmd": array[part, 35],
            "reserve": array[uint32, 4],
            "crc": uint32,
        }
        return final(make_idl_struct("LowCmd_", "unitree_hg.msg.dds_.LowCmd_", fields))

    assert idl.type_hash(made(byte)) == idl.type_hash(idl.LowCmd_)
    assert idl.type_hash(made(uint8)) != idl.type_hash(idl.LowCmd_)


def state_of(tick: int) -> StateMessage:
    joints, message = G1Joints(load_robot("g1")), StateMessage()
    q = 0.01 * np.arange(29) + 1e-3 * tick
    reading = SensorReading(q, np.zeros(29), np.zeros(29), np.zeros(3), np.array([0.0, 0.0, 9.81]), 0.0)
    joints.write_state(reading, np.array([0.0, 0.0, 0.0, 1.0]), message, tick)
    return message


def test_bytes_come_in_as_they_go_out(network: Network) -> None:
    writer, reader = network.writer("rt/lowstate"), network.reader("rt/lowstate")
    until(lambda: reader.writers and writer.readers)
    for tick in range(20):
        sent = state_of(tick).sealed()
        writer.send(sent)
        assert reader.wait(5.0) == sent
    assert reader.received == 20
    assert reader.newest() is None


def test_a_body_takes_in_sound_states_only(network: Network) -> None:
    robot = load_robot("g1")
    body, writer, commands = G1Body(network, robot), network.writer("rt/lowstate"), network.reader("rt/lowcmd")
    until(lambda: writer.readers and commands.writers)
    with pytest.raises(NoStateError):
        body.read()
    held = MotorCommand(np.zeros(29), np.zeros(29), np.zeros(29), np.ones(29), np.ones(29), 0.0)
    with pytest.raises(ConfigError, match="mode_machine"):
        body.send(held)
    writer.send(state_of(5).sealed())
    assert body.wait(5.0)
    assert body.message.tick == 5 and body.read().joint_position[3] == pytest.approx(0.035)
    broken = bytearray(state_of(6).sealed())
    broken[300] ^= 4
    writer.send(bytes(broken))
    assert not body.wait(0.2)
    assert (body.broken, body.message.tick) == (1, 5)
    body.send(held)
    message = CommandMessage()
    assert message.read(commands.wait(5.0))
    assert message.mode_machine == MODE_MACHINE and body.sent == 1
    body.message.motors["temperature"][int(body.joints.slots[7])] = 40, 91
    assert body.hottest() == (robot.joint_names[7], 91.0)


ANSWERS = """
import sys
from robots.loader import load_robot
from robots.messages import MotorCommand
from robots.unitree.body import G1Body
from robots.unitree.dds import LOOPBACK, Network
import numpy as np
body = G1Body(Network(int(sys.argv[1]), LOOPBACK), load_robot("g1"))
for _ in range(int(sys.argv[2])):
    while not body.wait(1.0):
        pass
    zero = np.zeros(29)
    body.send(MotorCommand(body.read().joint_position, zero, zero, zero, zero, 0.0))
"""


def test_another_process_answers_every_state(network: Network) -> None:
    """Its positions come back as set-points, in the slots of the joints."""
    states, commands = network.writer("rt/lowstate"), network.reader("rt/lowcmd")
    before = states.readers
    other = subprocess.Popen([sys.executable, "-c", ANSWERS, str(DOMAIN), "50"], cwd=ROOT)
    try:
        until(lambda: states.readers > before and commands.writers, 60.0)
        message, joints = CommandMessage(), G1Joints(load_robot("g1"))
        for tick in range(50):
            state = state_of(tick)
            states.send(state.sealed())
            answer = commands.wait(10.0)
            assert answer is not None and message.read(answer)
            expected = np.clip(state.motors["q"][joints.slots], *load_robot("g1").position_limits)
            np.testing.assert_allclose(message.motors["q"][joints.slots], expected, rtol=1e-6)
        assert other.wait(30) == 0
    finally:
        other.kill()


def test_a_network_that_is_none_is_refused(network: Network) -> None:
    with pytest.raises(ConfigError, match="interface"):
        configuration("")
    with pytest.raises(ConfigError, match="domain"):
        Network(500, LOOPBACK)
    with pytest.raises(ConfigError, match="no-such-interface"):
        Network(DOMAIN + 1, "no-such-interface")
    with pytest.raises(ConfigError, match="topic"):
        network.reader("rt/nothing")
