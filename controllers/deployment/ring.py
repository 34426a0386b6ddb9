"""The log of a deployment: records in a ring of chunks in a file that is memory, which no crash of a process loses.

What is written is in the operating system's hands at once; a process that dies takes nothing of it along. The file has
a first page that says what it is, then chunks of one size. A chunk holds records one after the other; when the last
chunk is full, the oldest is written over. A record has a number that grows, a kind, a time, its bytes and a check sum,
so that a reader finds whole records only, in their order, whatever was being written when the power went.
"""

import json
import mmap
import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any

from robots.errors import ConfigError

MAGIC = b"safewbc-log-1\n"
PAGE = 65536
"""Size of the first page [bytes]."""

CHUNK = 1 << 20
"""Size of a chunk [bytes]."""

HEAD = struct.Struct("<QdIII")
"""Number, time [s], kind, length, check sum of the bytes."""


class Kind(IntEnum):
    """What a record holds."""

    EVENT = 1
    """Words, UTF-8."""
    STATE = 2
    """``LowState_`` as it came in, whole or broken."""
    AROUND = 3
    """:class:`controllers.deployment.protection.Surroundings`: a period begins."""
    COMMAND = 4
    """``LowCmd_`` as it was computed."""
    SENT = 5
    """One byte: 1 where that command was sent, 0 where it was late and the one before was sent again."""


@dataclass(frozen=True, slots=True)
class Record:
    """One record.

    Attributes:
        number: from 1 on.
        time: monotonic, of the machine that wrote it [s].
        kind: what it holds.
        data: its bytes.
    """

    number: int
    time: float
    kind: Kind
    data: bytes


class RingLog:
    """Writes records.

    Args:
        path: of the file, which must not exist.
        size: of the ring, at least two chunks [bytes].
        head: what the first page says, as JSON can.

    Raises:
        ConfigError: the file exists, there is no room for it, or the head is too long.
    """

    def __init__(self, path: Path, size: int, head: dict[str, Any]) -> None:
        text = MAGIC + json.dumps(head).encode()
        if len(text) >= PAGE:
            raise ConfigError("head of the log", len(text), f"below {PAGE} bytes")
        chunks = max(2, -(-size // CHUNK))
        try:
            with path.open("xb") as file:
                # a hole that finds no room on the disk later would end the process
                os.posix_fallocate(file.fileno(), 0, PAGE + chunks * CHUNK)
        except FileExistsError as error:
            raise ConfigError("log", str(path), "a file that does not exist yet") from error
        except OSError as error:
            path.unlink(missing_ok=True)
            needed = f"in a place with room for {(PAGE + chunks * CHUNK) / 1e6:.0f} MB ({error.strerror})"
            raise ConfigError("log", str(path), needed) from error
        with path.open("r+b") as file:
            self._memory = mmap.mmap(file.fileno(), 0)
        self._memory[: len(text)] = text
        self._path, self._full = path, False
        self._chunks, self._chunk, self._place, self._number = chunks, 0, 0, 0

    def write(self, kind: Kind, time: float, data: bytes) -> None:
        """Append a record of less than a chunk."""
        need = HEAD.size + len(data)
        if self._place + need + HEAD.size > CHUNK:
            self._chunk, self._place = (self._chunk + 1) % self._chunks, 0
            self._full = self._full or self._chunk == 0
        begin = PAGE + self._chunk * CHUNK + self._place
        self._number += 1
        memory, body = self._memory, begin + HEAD.size
        # the mark of the end first, then the bytes, then the head that makes them count
        memory[body + len(data) : body + len(data) + HEAD.size] = bytes(HEAD.size)
        memory[begin : begin + HEAD.size] = bytes(HEAD.size)
        memory[body : body + len(data)] = data
        HEAD.pack_into(memory, begin, self._number, time, kind, len(data), zlib.crc32(data))
        self._place += need

    def close(self) -> None:
        """Give the file back, without the chunks that nothing was written to."""
        self._memory.flush()
        self._memory.close()
        if not self._full:
            os.truncate(self._path, PAGE + (self._chunk + 1) * CHUNK)


def read_head(path: Path) -> dict[str, Any]:
    """What the first page says.

    Raises:
        ConfigError: there is no such file, or it is no log.
    """
    try:
        with path.open("rb") as file:
            page = file.read(PAGE)
    except OSError as error:
        raise ConfigError("log", str(path), f"a file that can be read ({error.strerror})") from error
    if not page.startswith(MAGIC):
        raise ConfigError("log", str(path), "the log of a deployment")
    return dict(json.loads(page[len(MAGIC) :].rstrip(b"\0")))


def read_log(path: Path) -> list[Record]:
    """All whole records, oldest first.

    Raises:
        ConfigError: see :func:`read_head`.
    """
    read_head(path)
    found: list[Record] = []
    with path.open("rb") as file:
        file.seek(PAGE)
        while chunk := file.read(CHUNK):
            found.extend(_records(chunk))
    return sorted(found, key=lambda record: record.number)


def _records(chunk: bytes) -> Iterator[Record]:
    place, last = 0, 0
    while place + HEAD.size <= len(chunk):
        number, time, kind, length, check = HEAD.unpack_from(chunk, place)
        data = chunk[place + HEAD.size : place + HEAD.size + length]
        # a number that goes back is what is left of an earlier round
        if number <= last or len(data) != length or zlib.crc32(data) != check:
            return
        yield Record(number, time, Kind(kind), data)
        last, place = number, place + HEAD.size + length
