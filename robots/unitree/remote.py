"""The remote, as its bytes lie in every state.

Source: unitree_sdk2, example/g1/low_level/gamepad.hpp: head (2 bytes), buttons (16 bits, little-endian), then lx, rx,
ry, L2, ly as floats at 4, 8, 12, 16, 20; the rest idle. All bytes zero: nothing has come from it.
"""

import struct
from dataclasses import dataclass

import numpy as np

from robots.unitree.messages import Bytes

BUTTONS = (
    *("R1", "L1", "start", "select", "R2", "L2", "F1", "F2"),
    *("A", "B", "X", "Y", "up", "right", "down", "left"),
)
"""From the least significant bit on."""


def button_bits(*names: str) -> int:
    """Bits of some buttons."""
    return sum(1 << BUTTONS.index(name) for name in names)


@dataclass(frozen=True, slots=True)
class Remote:
    """What a person holds.

    Attributes:
        buttons: that are pressed, of ``BUTTONS``.
        left: stick, x to the right and y forward, -1 to 1.
        right: likewise.
        heard: whether anything has come from it.
    """

    buttons: frozenset[str]
    left: tuple[float, float]
    right: tuple[float, float]
    heard: bool

    def pressed(self, *names: str) -> bool:
        """Whether all of these buttons are pressed."""
        return self.buttons.issuperset(names)


def read_remote(data: Bytes) -> Remote:
    """The remote of a state's 40 bytes."""
    raw = data.tobytes()
    bits = int.from_bytes(raw[2:4], "little")
    lx, rx, ry, _, ly = struct.unpack_from("<5f", raw, 4)
    pressed = frozenset(name for i, name in enumerate(BUTTONS) if bits >> i & 1)
    return Remote(pressed, (lx, ly), (rx, ry), any(raw))


def write_remote(data: Bytes, remote: Remote) -> None:
    """Put a remote into a state's 40 bytes, as who plays the robot does."""
    bits = button_bits(*remote.buttons)
    data[:] = 0
    if remote.heard:
        # the head is what tells an idle remote from a lost one
        sticks = remote.left[0], *remote.right, 0.0, remote.left[1]
        data[:24] = np.frombuffer(struct.pack("<BBH5f", 0x55, 0x51, bits, *sticks), np.uint8)
