"""``LowCmd_`` and ``LowState_`` as prepared bytes with views into them: nothing is encoded in the loop."""

import numpy as np
from numpy.typing import NDArray

from robots.errors import ConfigError
from robots.unitree.crc import Words, crc32
from robots.unitree.layout import (
    COMMAND_SIZE,
    COMMAND_WORDS,
    FIRST_COMMAND,
    FIRST_STATE,
    HEADER,
    IMU,
    MOTOR_COMMAND,
    MOTOR_COMMAND_STRIDE,
    MOTOR_STATE,
    MOTOR_STATE_STRIDE,
    MOTORS,
    STATE_SIZE,
    STATE_WORDS,
)

Bytes = NDArray[np.uint8]


def _modes(payload: Bytes, first: int, stride: int) -> list[NDArray[np.uint8]]:
    """Views (1,) of every motor's ``mode``: the first motor's lies two bytes before its ``q``, the others' four."""
    places = [first - 2, *(first - 4 + stride * i for i in range(1, MOTORS))]
    return [payload[place : place + 1] for place in places]


class CommandMessage:
    """``LowCmd_``: written field by field, then sealed with its check sum.

    Attributes:
        motors: shape (35,) of :data:`robots.unitree.layout.MOTOR_COMMAND`, a view; all zero at first.
    """

    def __init__(self) -> None:
        self._bytes = np.zeros(len(HEADER) + COMMAND_SIZE, np.uint8)
        self._bytes[: len(HEADER)] = np.frombuffer(HEADER, np.uint8)
        self._payload = self._bytes[len(HEADER) :]
        end = FIRST_COMMAND + MOTOR_COMMAND_STRIDE * MOTORS
        self.motors = self._payload[FIRST_COMMAND:end].view(MOTOR_COMMAND)
        self._modes = _modes(self._payload, FIRST_COMMAND, MOTOR_COMMAND_STRIDE)
        self._struct = np.zeros(COMMAND_WORDS + 1, np.uint32)

    @property
    def mode_pr(self) -> int:
        """0: ankles and waist as serial joints; 1: the two motors of their linkage."""
        return int(self._payload[0])

    @mode_pr.setter
    def mode_pr(self, value: int) -> None:
        self._payload[0] = value

    @property
    def mode_machine(self) -> int:
        """The robot's variant, as it reports it."""
        return int(self._payload[1])

    @mode_machine.setter
    def mode_machine(self, value: int) -> None:
        self._payload[1] = value

    def enable(self, motor: int, on: bool = True) -> None:
        """Set a motor's ``mode``: 1 where it is to follow, 0 where it is off."""
        self._modes[motor][0] = on

    def enabled(self, motor: int) -> bool:
        """Whether a motor is to follow."""
        return bool(self._modes[motor][0])

    def words(self) -> Words:
        """The struct's words (250,) before the check sum."""
        memory, payload = self._struct.view(np.uint8), self._payload
        memory[:2] = payload[:2]
        memory[4] = payload[2]
        memory[8 : COMMAND_SIZE + 4] = payload[4:]
        return self._struct[:COMMAND_WORDS]

    def sealed(self) -> bytes:
        """The message with its check sum, header before it: what goes out."""
        crc = crc32(self.words())
        self._payload[COMMAND_SIZE - 4 :] = np.frombuffer(crc.to_bytes(4, "little"), np.uint8)
        return self._bytes.tobytes()

    def read(self, data: bytes) -> bool:
        """Take over what came in, header included; returns whether its check sum is right.

        Raises:
            ConfigError: it has not the length of a command.
        """
        _take(data, self._bytes, "LowCmd_")
        return crc32(self.words()) == int.from_bytes(self._payload[COMMAND_SIZE - 4 :].tobytes(), "little")


class StateMessage:
    """``LowState_``: read as it comes in, or written by who plays the robot.

    Attributes:
        motors: shape (35,) of :data:`robots.unitree.layout.MOTOR_STATE`, a view.
        imu: shape (1,) of :data:`robots.unitree.layout.IMU`, that in the pelvis, a view.
        remote: shape (40,) bytes of the remote, a view.
    """

    def __init__(self) -> None:
        self._bytes = np.zeros(len(HEADER) + STATE_SIZE, np.uint8)
        self._bytes[: len(HEADER)] = np.frombuffer(HEADER, np.uint8)
        payload = self._payload = self._bytes[len(HEADER) :]
        end = FIRST_STATE + MOTOR_STATE_STRIDE * MOTORS
        self.imu = payload[16:70].view(IMU)
        self.motors = payload[FIRST_STATE:end].view(MOTOR_STATE)
        self.remote = payload[2028:2068]
        self._modes = _modes(payload, FIRST_STATE, MOTOR_STATE_STRIDE)
        self._struct = np.zeros(STATE_WORDS + 1, np.uint32)

    @property
    def size(self) -> int:
        """Of the whole message [bytes]."""
        return int(self._bytes.size)

    @property
    def mode_pr(self) -> int:
        """As of :attr:`CommandMessage.mode_pr`."""
        return int(self._payload[8])

    @mode_pr.setter
    def mode_pr(self, value: int) -> None:
        self._payload[8] = value

    @property
    def mode_machine(self) -> int:
        """The robot's variant: 5 with 29 joints, 6 with its waist fixed, 4 with 23."""
        return int(self._payload[9])

    @mode_machine.setter
    def mode_machine(self, value: int) -> None:
        self._payload[9] = value

    @property
    def tick(self) -> int:
        """A counter of the robot's."""
        return int.from_bytes(self._payload[12:16].tobytes(), "little")

    @tick.setter
    def tick(self, value: int) -> None:
        self._payload[12:16] = np.frombuffer((value & 0xFFFFFFFF).to_bytes(4, "little"), np.uint8)

    def enable(self, motor: int, on: bool = True) -> None:
        """Set a motor's ``mode``."""
        self._modes[motor][0] = on

    def words(self) -> Words:
        """The struct's words (522,) before the check sum."""
        memory, payload = self._struct.view(np.uint8), self._payload
        memory[:70] = payload[:70]
        memory[72] = payload[70]
        memory[76 : STATE_SIZE + 4] = payload[72:]
        return self._struct[:STATE_WORDS]

    def sealed(self) -> bytes:
        """The message with its check sum, header before it."""
        crc = crc32(self.words())
        self._payload[STATE_SIZE - 4 :] = np.frombuffer(crc.to_bytes(4, "little"), np.uint8)
        return self._bytes.tobytes()

    def read(self, data: bytes) -> bool:
        """Take over what came in, header included; returns whether its check sum is right.

        Raises:
            ConfigError: it has not the length of a state.
        """
        _take(data, self._bytes, "LowState_")
        return crc32(self.words()) == int.from_bytes(self._payload[STATE_SIZE - 4 :].tobytes(), "little")


def _take(data: bytes, into: Bytes, name: str) -> None:
    """Copy a message over another one of the same kind."""
    if len(data) != into.size or data[:2] != HEADER[:2]:
        raise ConfigError(name, f"{len(data)} bytes", f"{into.size} bytes of little-endian CDR")
    into[:] = np.frombuffer(data, np.uint8)
