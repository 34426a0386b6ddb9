"""Where every field of the robot's messages is, on the wire and in the struct of the check sum.

On the wire (CDR, little-endian, each field aligned to its size from the payload's begin, no padding at the end of a
struct) and in C's memory the same fields follow each other, and differ in one place only: C aligns each motor to four
bytes, CDR its first field to one. So the first motor's ``mode`` is two bytes earlier on the wire, and all that follows
it is four bytes earlier.

Source: fields of unitree_ros2, cyclonedds_ws/.../unitree_hg/msg, and unitree_sdk2_python, idl/unitree_hg.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from robots.errors import ConfigError

MOTORS = 35
"""Slots for motors in a message; the G1 of 29 joints has the first 29."""

HEADER = bytes((0, 1, 0, 0))
"""Before the payload: CDR, little-endian."""

COMMAND_SIZE, STATE_SIZE, IMU_SIZE, BATTERY_SIZE = 1000, 2088, 54, 164
"""Of the payloads [bytes]."""

FIRST_COMMAND, FIRST_STATE = 4, 72
"""Where the first motor's ``q`` is on the wire; its ``mode`` lies two bytes before, that of every other four."""

MOTOR_COMMAND = np.dtype(
    {
        "names": ["q", "dq", "tau", "kp", "kd", "reserve"],
        "formats": ["<f4"] * 5 + ["<u4"],
        "offsets": [0, 4, 8, 12, 16, 20],
        "itemsize": 28,
    }
)
"""A motor's command from its ``q`` on; the ``mode`` of the next one lies at its end."""

MOTOR_STATE = np.dtype(
    {
        "names": ["q", "dq", "ddq", "tau_est", "temperature", "vol", "sensor", "motorstate", "reserve"],
        "formats": ["<f4", "<f4", "<f4", "<f4", ("<i2", 2), "<f4", ("<u4", 2), "<u4", ("<u4", 4)],
        "offsets": [0, 4, 8, 12, 16, 20, 24, 32, 36],
        "itemsize": 56,
    }
)
"""A motor's state likewise."""

IMU = np.dtype(
    {
        "names": ["quaternion", "gyroscope", "accelerometer", "rpy", "temperature"],
        "formats": [("<f4", 4), ("<f4", 3), ("<f4", 3), ("<f4", 3), "<i2"],
        "offsets": [0, 16, 28, 40, 52],
        "itemsize": IMU_SIZE,
    }
)
"""``IMUState_``: quaternion w, x, y, z; rad/s; m/s^2; rad; degrees Celsius."""

BATTERY = np.dtype(
    {
        "names": [
            *("version_high", "version_low", "fn", "cell_vol", "bmsvoltage", "current", "soc", "soh"),
            *("temperature", "cycle", "manufacturer_date", "bmsstate", "reserve"),
        ],
        "formats": [
            *("u1", "u1", "u1", ("<u2", 40), ("<u4", 3), "<i4", "u1", "u1"),
            *(("<i2", 12), "<u2", "<u2", ("<u4", 5), ("<u4", 3)),
        ],
        "offsets": [0, 1, 2, 4, 84, 96, 100, 101, 102, 126, 128, 132, 152],
        "itemsize": BATTERY_SIZE,
    }
)
"""``BmsState_``: ``soc`` is what is left in the battery [%]."""

Fields = NDArray[Any]
"""Shape (1,) of one of the dtypes above: its fields by their names."""


def packed(fields: Fields) -> bytes:
    """A message without a check sum, header included: what goes out."""
    return HEADER + fields.tobytes()


def unpacked(data: bytes, kind: "np.dtype[np.void]") -> Fields:
    """The fields of a message without a check sum, shape (1,) of ``kind``, read-only.

    Raises:
        ConfigError: it is shorter than its type, or is not little-endian CDR.
    """
    if len(data) < len(HEADER) + kind.itemsize or data[:2] != HEADER[:2]:
        least = len(HEADER) + kind.itemsize
        raise ConfigError("message", f"{len(data)} bytes", f"at least {least} bytes of little-endian CDR")
    return np.frombuffer(data, kind, 1, len(HEADER))
