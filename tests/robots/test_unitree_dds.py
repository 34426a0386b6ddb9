"""The robot's topics on a real network, that of this machine: types, bytes, two processes."""

import gc
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
from robots.messages import SensorReading
from robots.unitree import idl
from robots.unitree.body import G1Port
from robots.unitree.dds import LOOPBACK, Network, configuration
from robots.unitree.g1 import G1Joints
from robots.unitree.layout import BATTERY, packed
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


def test_a_port_hands_on_what_comes_and_sees_commands_of_others_only(network: Network) -> None:
    port, writer, commands = G1Port(network), network.writer("rt/lowstate"), network.reader("rt/lowcmd")
    others = Network(DOMAIN, LOOPBACK)
    stranger = others.writer("rt/lowcmd")
    until(lambda: writer.readers and port.commanded and stranger.readers >= 2)
    assert port.receive(time.monotonic() + 0.01) == []
    sent = [state_of(tick).sealed() for tick in range(3)]
    for data in sent:
        writer.send(data)
    found: list[bytes] = []
    end = time.monotonic() + 10.0
    while len(found) < 3 and time.monotonic() < end:
        found += [data for data, _ in port.receive(time.monotonic() + 0.1)]
    assert found == sent
    command = CommandMessage().sealed()
    port.send(command)
    assert commands.wait(5.0) == command and port.sent == 1
    assert port.strangers() == 0
    stranger.send(command)
    until(lambda: port.strangers() == 1)


def test_a_port_knows_the_battery_once_it_has_been_heard_of(network: Network) -> None:
    port, writer = G1Port(network), network.writer("rt/lf/bmsstate")
    until(lambda: writer.readers)
    assert np.isnan(port.battery())
    fields = np.zeros(1, BATTERY)
    fields["soc"] = 71
    writer.send(packed(fields))
    until(lambda: port.battery() == 71)
    assert port.battery() == 71


def test_a_reader_survives_the_end_of_a_writer() -> None:
    """That one has gone comes as a sample without data."""
    reader = Network(DOMAIN, LOOPBACK).reader("rt/lowstate")
    writers = [Network(DOMAIN, LOOPBACK).writer("rt/lowstate")]
    until(lambda: writers[0].readers and reader.writers)
    writers[0].send(state_of(1).sealed())
    assert reader.wait(5.0) == state_of(1).sealed()
    before = reader.writers
    writers.clear()
    gc.collect()
    until(lambda: reader.writers < before)
    assert reader.newest() is None


ANSWERS = """
import sys, time
from robots.loader import load_robot
from robots.messages import MotorCommand
from robots.unitree.body import G1Port
from robots.unitree.dds import LOOPBACK, Network
from robots.unitree.g1 import G1Joints
from robots.unitree.messages import CommandMessage
from robots.unitree.stream import StateStream
import numpy as np
port = G1Port(Network(int(sys.argv[1]), LOOPBACK))
joints = G1Joints(load_robot("g1"))
stream, message, answered = StateStream(joints), CommandMessage(), 0
while answered < int(sys.argv[2]):
    for data, arrived in port.receive(time.monotonic() + 1.0):
        if (reading := stream.take(data, arrived)) is not None:
            zero = np.zeros(29)
            joints.write(MotorCommand(reading.joint_position, zero, zero, zero, zero, 0.0), message, 5)
            port.send(message.sealed())
            answered += 1
"""


def test_another_process_answers_every_state(network: Network) -> None:
    """Its positions come back as set-points, in the slots of the joints."""
    states, commands = network.writer("rt/lowstate"), network.reader("rt/lowcmd")
    before = states.readers
    other = subprocess.Popen([sys.executable, "-c", ANSWERS, str(DOMAIN), "50"], cwd=ROOT)
    try:
        until(lambda: states.readers > before and commands.writers, 60.0)
        message, joints = CommandMessage(), G1Joints(load_robot("g1"))
        for tick in range(1, 51):
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
