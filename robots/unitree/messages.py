"""``LowCmd_`` and ``LowState_`` as prepared bytes with views into them: nothing is encoded in the loop."""

import numpy as np
from numpy.typing import NDArray

from robots.unitree.crc import Words, crc32
from robots.unitree.layout import (
    COMMAND_SIZE,
    FIRST_COMMAND,
    FIRST_STATE,
    HEADER,
    IMU,
    MOTOR_COMMAND,
    MOTOR_STATE,
    MOTORS,
    STATE_SIZE,
)

Bytes = NDArray[np.uint8]


class Message:
    """Prepared bytes of one type, header and payload, sealed by the check sum in their last four.

    In C's struct, over which the check sum goes, the first motor's ``mode`` lies two bytes later than on the wire, and
    all from its ``q`` on four bytes later.

    Args:
        size: of the payload [bytes].
        first: where the first motor's ``q`` is in it.
        motor: dtype of a motor from its ``q`` on.
        modes: where ``mode_pr`` is, with ``mode_machine`` behind it.

    Attributes:
        size: of the whole message [bytes].
        motors: shape (35,) of ``motor``, a view; all zero at first.
    """

    def __init__(self, size: int, first: int, motor: "np.dtype[np.void]", modes: int) -> None:
        self.size, self._first, self._variant = len(HEADER) + size, first, modes
        self._bytes = np.zeros(self.size, np.uint8)
        self._bytes[: len(HEADER)] = np.frombuffer(HEADER, np.uint8)
        self._payload = self._bytes[len(HEADER) :]
        stride = motor.itemsize
        self.motors = self._payload[first : first + stride * MOTORS].view(motor)
        places = [first - 2, *(first - 4 + stride * i for i in range(1, MOTORS))]
        self._modes = [self._payload[place : place + 1] for place in places]
        self._struct = np.zeros(size // 4 + 1, np.uint32)

    @property
    def mode_pr(self) -> int:
        """0: ankles and waist as serial joints; 1: the two motors of their linkage."""
        return int(self._payload[self._variant])

    @mode_pr.setter
    def mode_pr(self, value: int) -> None:
        self._payload[self._variant] = value

    @property
    def mode_machine(self) -> int:
        """The robot's variant, as it reports it: 5 with 29 joints, 6 with its waist fixed, 4 with 23."""
        return int(self._payload[self._variant + 1])

    @mode_machine.setter
    def mode_machine(self, value: int) -> None:
        self._payload[self._variant + 1] = value

    def enable(self, motor: int, on: bool = True) -> None:
        """Set a motor's ``mode``: 1 where it is to follow, 0 where it is off."""
        self._modes[motor][0] = on

    def enabled(self, motor: int) -> bool:
        """Whether a motor is to follow."""
        return bool(self._modes[motor][0])

    def words(self) -> Words:
        """The struct's words before the check sum."""
        memory, payload, first = self._struct.view(np.uint8), self._payload, self._first
        memory[: first - 2] = payload[: first - 2]
        memory[first] = payload[first - 2]
        memory[first + 4 :] = payload[first:]
        return self._struct[:-1]

    def sealed(self) -> bytes:
        """The message with its check sum, header before it: what goes out."""
        self._payload[-4:] = np.frombuffer(crc32(self.words()).to_bytes(4, "little"), np.uint8)
        return self._bytes.tobytes()

    def read(self, data: bytes) -> bool:
        """Take over what came in, header included; returns whether it is whole.

        It is not where its length is another one, where it is no little-endian CDR (nothing is taken over then), or
        where its check sum is wrong.
        """
        if len(data) != self.size or data[:2] != HEADER[:2]:
            return False
        self._bytes[:] = np.frombuffer(data, np.uint8)
        return crc32(self.words()) == int.from_bytes(self._payload[-4:].tobytes(), "little")


class CommandMessage(Message):
    """``LowCmd_``: written field by field, then sealed."""

    def __init__(self) -> None:
        super().__init__(COMMAND_SIZE, FIRST_COMMAND, MOTOR_COMMAND, modes=0)


class StateMessage(Message):
    """``LowState_``: read as it comes in, or written by who plays the robot.

    Attributes:
        imu: shape (1,) of :data:`robots.unitree.layout.IMU`, that in the pelvis, a view.
        remote: shape (40,) bytes of the remote, a view.
    """

    def __init__(self) -> None:
        super().__init__(STATE_SIZE, FIRST_STATE, MOTOR_STATE, modes=8)
        self.imu = self._payload[16:70].view(IMU)
        self.remote = self._payload[2028:2068]

    @property
    def buttons(self) -> int:
        """Bits of the remote's buttons, see :data:`robots.unitree.remote.BUTTONS`."""
        return int(self.remote[2]) | int(self.remote[3]) << 8

    @property
    def tick(self) -> int:
        """A counter of the robot's."""
        return int.from_bytes(self._payload[12:16].tobytes(), "little")

    @tick.setter
    def tick(self, value: int) -> None:
        self._payload[12:16] = np.frombuffer((value & 0xFFFFFFFF).to_bytes(4, "little"), np.uint8)
