"""The robot's messages: every field where CDR and C have it, the check sum bit by bit, joints by name, limits."""

import ctypes
import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.loader import load_robot
from robots.messages import Array, MotorCommand, SensorReading
from robots.unitree.crc import crc32
from robots.unitree.g1 import MODE_MACHINE, MOTOR_NAMES, G1Joints
from robots.unitree.layout import COMMAND_SIZE, HEADER, MOTORS, STATE_SIZE
from robots.unitree.messages import CommandMessage, StateMessage
from robots.unitree.remote import BUTTONS, Remote, read_remote, write_remote


def bit_by_bit(words: list[int]) -> int:
    """CRC-32/MPEG-2 over words, each from its most significant bit on."""
    crc = 0xFFFFFFFF
    for word in words:
        for bit in range(31, -1, -1):
            top = crc >> 31 & 1
            crc = crc << 1 & 0xFFFFFFFF
            if top != word >> bit & 1:
                crc ^= 0x04C11DB7
    return crc


@given(st.lists(st.integers(0, 2**32 - 1), min_size=1, max_size=40))
@settings(max_examples=50, deadline=None)
def test_the_check_sum_is_that_of_every_bit(words: list[int]) -> None:
    assert crc32(np.array(words, dtype="<u4")) == bit_by_bit(words)


def test_the_check_sum_of_words_made_by_hand() -> None:
    # the catalogue's check value of CRC-32/MPEG-2 is that of "123456789"; of its first eight bytes as two words:
    assert crc32(np.array([0x31323334, 0x35363738], dtype="<u4")) == bit_by_bit([0x31323334, 0x35363738])
    # nothing but the start, shifted through the polynomial
    assert crc32(np.array([0xFFFFFFFF], dtype="<u4")) == 0
    assert crc32(np.array([0], dtype="<u4")) == 0xC704DD7B


class Motor(ctypes.Structure):
    _fields_ = (
        ("mode", ctypes.c_uint8),
        *((name, ctypes.c_float) for name in ("q", "dq", "tau", "kp", "kd")),
        ("reserve", ctypes.c_uint32),
    )


class Command(ctypes.Structure):
    _fields_ = (
        ("mode_pr", ctypes.c_uint8),
        ("mode_machine", ctypes.c_uint8),
        ("motors", Motor * MOTORS),
        ("reserve", ctypes.c_uint32 * 4),
        ("crc", ctypes.c_uint32),
    )


class Imu(ctypes.Structure):
    _fields_ = (
        ("quaternion", ctypes.c_float * 4),
        ("gyroscope", ctypes.c_float * 3),
        ("accelerometer", ctypes.c_float * 3),
        ("rpy", ctypes.c_float * 3),
        ("temperature", ctypes.c_int16),
    )


class MotorState(ctypes.Structure):
    _fields_ = (
        ("mode", ctypes.c_uint8),
        *((name, ctypes.c_float) for name in ("q", "dq", "ddq", "tau_est")),
        ("temperature", ctypes.c_int16 * 2),
        ("vol", ctypes.c_float),
        ("sensor", ctypes.c_uint32 * 2),
        ("motorstate", ctypes.c_uint32),
        ("reserve", ctypes.c_uint32 * 4),
    )


class State(ctypes.Structure):
    _fields_ = (
        ("version", ctypes.c_uint32 * 2),
        ("mode_pr", ctypes.c_uint8),
        ("mode_machine", ctypes.c_uint8),
        ("tick", ctypes.c_uint32),
        ("imu", Imu),
        ("motors", MotorState * MOTORS),
        ("remote", ctypes.c_uint8 * 40),
        ("reserve", ctypes.c_uint32 * 4),
        ("crc", ctypes.c_uint32),
    )


def cdr(value: object, at: int = 0) -> bytes:
    """A C value in CDR from an offset on: each number aligned to its size, nothing between otherwise."""
    if isinstance(value, ctypes.Structure):
        fields = [getattr(value, name) for name, *_ in value._fields_]
    elif isinstance(value, ctypes.Array):
        fields = list(value)
    else:
        raise TypeError(type(value))
    kinds = _kinds(value)
    out = b""
    for field, kind in zip(fields, kinds, strict=True):
        if isinstance(field, ctypes.Structure | ctypes.Array):
            out += cdr(field, at + len(out))
            continue
        size = struct.calcsize(kind)
        out += bytes(-(at + len(out)) % size) + struct.pack(f"<{kind}", field)
    return out


def _kinds(value: ctypes.Structure | ctypes.Array) -> list[str]:  # type: ignore[type-arg]
    codes = {ctypes.c_uint8: "B", ctypes.c_int16: "h", ctypes.c_uint32: "I", ctypes.c_float: "f"}
    if isinstance(value, ctypes.Array):
        return [codes.get(value._type_, "")] * len(value)
    return [codes.get(kind, "") for _, kind in value._fields_]


def fill(value: object, rng: np.random.Generator) -> None:
    """Every number of a C value at random, what a check sum is made of included."""
    names = [name for name, *_ in value._fields_] if isinstance(value, ctypes.Structure) else range(len(value))
    for name, kind in zip(names, _kinds(value), strict=True):
        if kind:
            number = rng.normal() if kind == "f" else int(rng.integers(0, 100))
            setattr(value, name, number) if isinstance(name, str) else value.__setitem__(name, number)
        else:
            fill(getattr(value, name) if isinstance(name, str) else value[name], rng)


@pytest.mark.parametrize(
    ("struct_", "message", "size"), [(Command, CommandMessage, COMMAND_SIZE), (State, StateMessage, STATE_SIZE)]
)
def test_wire_and_struct_are_those_of_c_and_of_cdr(struct_: type, message: type, size: int) -> None:
    value, made = struct_(), message()
    fill(value, np.random.default_rng(1))
    words = np.frombuffer(bytes(value), "<u4")
    value.crc = bit_by_bit([int(word) for word in words[:-1]])
    wire = cdr(value)
    assert len(wire) == size
    assert ctypes.sizeof(struct_) == size + 4
    # C's padding is no field: the filled one has zeros there
    assert made.read(HEADER + wire)
    np.testing.assert_array_equal(made.words(), words[:-1])
    assert made.sealed() == HEADER + wire
    broken = bytearray(HEADER + wire)
    broken[100] ^= 1
    assert not made.read(bytes(broken))
    # of another length, or no little-endian CDR: nothing is taken over
    before = made.words().copy()
    assert not made.read(wire) and not made.read(b"") and not made.read(bytes((0, 0, 0, 0)) + wire)
    np.testing.assert_array_equal(made.words(), before)


def test_every_view_is_the_field_of_its_name() -> None:
    command, made = Command(), CommandMessage()
    fill(command, np.random.default_rng(2))
    made.read(HEADER + cdr(command))
    for i in (0, 1, 17, 34):
        for name in ("q", "dq", "tau", "kp", "kd", "reserve"):
            assert made.motors[name][i] == getattr(command.motors[i], name)
        assert made.enabled(i) == bool(command.motors[i].mode)
    assert (made.mode_pr, made.mode_machine) == (command.mode_pr, command.mode_machine)
    state, told = State(), StateMessage()
    fill(state, np.random.default_rng(3))
    told.read(HEADER + cdr(state))
    for i in (0, 1, 17, 34):
        for name in ("q", "dq", "ddq", "tau_est", "vol", "motorstate"):
            assert told.motors[name][i] == getattr(state.motors[i], name)
        np.testing.assert_array_equal(told.motors["temperature"][i], list(state.motors[i].temperature))
    for name in ("quaternion", "gyroscope", "accelerometer", "rpy"):
        np.testing.assert_array_equal(told.imu[name][0], np.array(getattr(state.imu, name), np.float32))
    assert (told.tick, told.mode_machine, told.mode_pr) == (state.tick, state.mode_machine, state.mode_pr)
    np.testing.assert_array_equal(told.remote, list(state.remote))


# --- joints


@pytest.fixture(scope="module")
def g1() -> RobotDescription:
    return load_robot("g1")


def command_of(g1: RobotDescription, seed: int = 0) -> MotorCommand:
    rng, nj = np.random.default_rng(seed), len(g1.joints)
    lower, upper = g1.position_limits
    q = rng.uniform(lower, upper)
    (v, tau), (kp, kd) = rng.uniform(-1, 1, (2, nj)), rng.uniform(0, 50, (2, nj))
    return MotorCommand(q, v, tau, kp, kd, 0.25)


def test_a_joint_is_in_the_slot_that_has_its_name(g1: RobotDescription) -> None:
    joints, message, command = G1Joints(g1), CommandMessage(), command_of(g1)
    joints.write(command, message, MODE_MACHINE)
    for name, q, kd in zip(g1.joint_names, command.q, command.kd, strict=True):
        slot = MOTOR_NAMES.index(name.removesuffix("_joint"))
        assert message.motors["q"][slot] == np.float32(q)
        assert message.motors["kd"][slot] == np.float32(kd)
        assert message.enabled(slot)
    assert message.mode_pr == 0 and message.mode_machine == MODE_MACHINE
    for slot in range(29, MOTORS):
        assert not message.enabled(slot)
        assert bytes(message.motors[slot]) == bytes(28)
    again = joints.read_command(message, 0.25)
    for name in ("q", "v", "tau", "kp", "kd"):
        np.testing.assert_allclose(getattr(again, name), getattr(command, name), rtol=1e-6)


class Reordered:
    """A description whose joints come in reverse."""

    def __init__(self, g1: RobotDescription) -> None:
        self._g1 = g1
        self.joint_names = g1.joint_names[::-1]
        lower, upper = g1.position_limits
        self.position_limits = lower[::-1], upper[::-1]

    def joint_array(self, name: str) -> Array:
        return self._g1.joint_array(name)[::-1]


def test_the_order_of_a_description_does_not_matter(g1: RobotDescription) -> None:
    """The same motion of the same joints is the same message."""
    command, usual, reverse = command_of(g1), CommandMessage(), CommandMessage()
    G1Joints(g1).write(command, usual, MODE_MACHINE)
    turned = MotorCommand(
        *(getattr(command, name)[::-1] for name in ("q", "v", "tau", "kp", "kd")), stamp=command.stamp
    )
    joints = G1Joints(Reordered(g1))
    joints.write(turned, reverse, MODE_MACHINE)
    assert reverse.sealed() == usual.sealed()
    np.testing.assert_allclose(joints.read_command(usual, 0.0).q, turned.q, rtol=1e-6)
    state = StateMessage()
    reading = SensorReading(turned.q, turned.v, turned.tau, np.zeros(3), np.zeros(3), 0.0)
    joints.write_state(reading, np.array([0.0, 0.0, 0.0, 1.0]), state, 1)
    there = G1Joints(g1).reading(state, 0.0)
    for name, values in (("joint_position", command.q), ("joint_velocity", command.v), ("torque", command.tau)):
        np.testing.assert_allclose(getattr(there, name), values, rtol=1e-6)


def test_what_goes_out_is_within_the_limits(g1: RobotDescription) -> None:
    joints, message = G1Joints(g1), CommandMessage()
    far = replace(command_of(g1), q=np.full(29, 9.0), v=np.full(29, -99.0), tau=np.full(29, 1e3))
    joints.write(far, message, MODE_MACHINE)
    out = joints.read_command(message, 0.0)
    np.testing.assert_allclose(out.q, g1.position_limits[1], rtol=1e-6)
    np.testing.assert_allclose(out.v, -g1.joint_array("velocity"), rtol=1e-6)
    np.testing.assert_allclose(out.tau, g1.joint_array("effort"), rtol=1e-6)


@pytest.mark.parametrize("name", ["q", "v", "tau", "kp", "kd"])
def test_a_command_that_is_none_is_refused_and_nothing_is_written(g1: RobotDescription, name: str) -> None:
    joints, message = G1Joints(g1), CommandMessage()
    joints.write(command_of(g1), message, MODE_MACHINE)
    before = message.sealed()
    for bad in (np.nan, np.inf, *((-1.0,) if name in ("kp", "kd") else ())):
        values = getattr(command_of(g1), name).copy()
        values[3] = bad
        with pytest.raises(ConfigError, match=f"{name} of {g1.joint_names[3]}"):
            joints.write(replace(command_of(g1), **{name: values}), message, MODE_MACHINE)
    for variant in (0, 4, 6):
        with pytest.raises(ConfigError, match="mode_machine"):
            joints.write(command_of(g1), message, variant)
    assert message.sealed() == before


def test_another_robot_has_other_joints() -> None:
    with pytest.raises(ConfigError, match="29 joints"):
        G1Joints(load_robot("tocabi"))


def test_a_reading_goes_there_and_back(g1: RobotDescription) -> None:
    rng, joints, message = np.random.default_rng(5), G1Joints(g1), StateMessage()
    (q, v, torque), (gyro, force) = rng.normal(size=(3, 29)), rng.normal(size=(2, 3))
    reading = SensorReading(q, v, torque, gyro, force, 1.5)
    joints.write_state(reading, np.array([0.1, 0.2, 0.3, 0.9]), message, 2**32 + 7)
    other = StateMessage()
    assert other.read(message.sealed())
    again = joints.reading(other, 1.5)
    for name in ("joint_position", "joint_velocity", "torque", "gyro", "accelerometer"):
        np.testing.assert_allclose(getattr(again, name), getattr(reading, name), rtol=1e-6)
    np.testing.assert_allclose(other.imu["quaternion"][0], [0.9, 0.1, 0.2, 0.3], rtol=1e-6)
    assert other.tick == 7 and other.mode_machine == MODE_MACHINE


def test_the_remote_is_read_as_it_is_written() -> None:
    message = StateMessage()
    assert not read_remote(message.remote).heard
    for pressed in (set(), {"L2", "B"}, set(BUTTONS), {"left"}):
        remote = Remote(frozenset(pressed), (0.25, -0.5), (1.0, 0.125), heard=True)
        write_remote(message.remote, remote)
        assert read_remote(message.remote) == remote
        assert read_remote(message.remote).pressed("L2", "B") == ({"L2", "B"} <= pressed)
    # by the bits: L2+B are 5 and 9
    message.remote[2:4] = np.frombuffer((1 << 5 | 1 << 9).to_bytes(2, "little"), np.uint8)
    assert read_remote(message.remote).buttons == {"L2", "B"}
