r"""The check sum of the robot's messages.

CRC-32 with the polynomial 0x04C11DB7, start 0xFFFFFFFF, over 32-bit little-endian words, each from its most significant
bit on, without reflection and without a final XOR: CRC-32/MPEG-2 over the words' bytes in reverse. Source:
unitree_sdk2, example/g1/low_level/g1_ankle_swing_example.cpp, and unitree_sdk2_python, utils/crc.py.

The standard library has the reflected CRC with the same polynomial. The CRC of words is that of the words with all bits
in reverse, its own bits in reverse: reversing the bytes of a word and the bits of each byte reverses the word.
"""

import zlib

import numpy as np
from numpy.typing import NDArray

REVERSED = bytes(int(f"{i:08b}"[::-1], 2) for i in range(256))
"""Every byte with its bits in reverse."""

Words = NDArray[np.uint32]


def crc32(words: Words) -> int:
    """The check sum of some words.

    Args:
        words: little-endian, side by side in memory.
    """
    mirrored = words.byteswap().tobytes().translate(REVERSED)
    return int.from_bytes((zlib.crc32(mirrored) ^ 0xFFFFFFFF).to_bytes(4, "little").translate(REVERSED), "big")
