"""The log of a deployment: what was written is read back, whatever became of the writer."""

import signal
import struct
import subprocess
import sys
from pathlib import Path

import pytest

from controllers.deployment.ring import CHUNK, HEAD, MAGIC, PAGE, Kind, Record, RingLog, read_head, read_log
from robots.errors import ConfigError

ROOT = Path(__file__).resolve().parents[2]

WRITER = """
import os, signal, struct, sys
from pathlib import Path
from controllers.deployment.ring import Kind, RingLog
log = RingLog(Path(sys.argv[1]), 1 << 23, {"task": "t"})
for i in range(1500):
    log.write(Kind.STATE, 0.5 * i, struct.pack("<I", i) * 700)
print(1500, flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


def filled(path: Path, count: int, size: int = 1, length: int = 3000) -> list[Record]:
    """A log with records of some lengths; returns all that was written."""
    log, written = RingLog(path, size, {"task": {"a": 1}}), []
    for i in range(1, count + 1):
        data = struct.pack("<I", i) * ((length + 40 * (i % 7)) // 4)
        kind = (Kind.STATE, Kind.COMMAND, Kind.EVENT)[i % 3]
        log.write(kind, 0.25 * i, data)
        written.append(Record(i, 0.25 * i, kind, data))
    log.close()
    return written


def test_records_come_back_in_order_with_head_and_all(tmp_path: Path) -> None:
    written = filled(tmp_path / "log", 500, size=3 * CHUNK)
    assert read_log(tmp_path / "log") == written
    assert read_head(tmp_path / "log") == {"task": {"a": 1}}


@pytest.mark.parametrize("count", [700, 1000, 5000])
def test_a_ring_that_begins_again_keeps_the_newest_and_nothing_twice(count: int, tmp_path: Path) -> None:
    written = filled(tmp_path / "log", count)
    found = read_log(tmp_path / "log")
    assert found == written[-len(found) :]
    # of two chunks one is whole at least
    assert sum(HEAD.size + len(r.data) for r in found) > 0.99 * CHUNK


@pytest.mark.parametrize("place", ["data", "head"])
def test_a_torn_record_ends_its_chunk_and_no_other(place: str, tmp_path: Path) -> None:
    written = filled(tmp_path / "log", 500, size=3 * CHUNK)
    in_first = 0
    used = 0
    for record in written:
        used += HEAD.size + len(record.data)
        if used + HEAD.size > CHUNK:
            break
        in_first += 1
    before = sum(HEAD.size + len(r.data) for r in written[:10])
    data = bytearray((tmp_path / "log").read_bytes())
    data[PAGE + before + (HEAD.size + 50 if place == "data" else 20)] ^= 0x10
    (tmp_path / "log").write_bytes(data)
    assert read_log(tmp_path / "log") == written[:10] + written[in_first:]


def test_a_record_that_was_only_begun_is_not_there(tmp_path: Path) -> None:
    """The head counts, and is written last: bytes without it are none."""
    written = filled(tmp_path / "log", 20, size=2 * CHUNK)
    end = PAGE + sum(HEAD.size + len(r.data) for r in written)
    data = bytearray((tmp_path / "log").read_bytes())
    data[end + HEAD.size : end + HEAD.size + 100] = b"x" * 100
    (tmp_path / "log").write_bytes(data)
    assert read_log(tmp_path / "log") == written


def test_a_writer_that_is_killed_loses_nothing(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", WRITER, str(tmp_path / "log")], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == -signal.SIGKILL and done.stdout == "1500\n"
    found = read_log(tmp_path / "log")
    assert [r.number for r in found] == list(range(1, 1501))
    assert all(r.data == struct.pack("<I", i) * 700 and r.time == 0.5 * i for i, r in enumerate(found))


def test_other_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"can be read"):
        read_log(tmp_path / "none")
    (tmp_path / "other").write_bytes(b"other" * 100)
    with pytest.raises(ConfigError, match="log of a deployment"):
        read_log(tmp_path / "other")
    with pytest.raises(ConfigError, match="does not exist yet"):
        RingLog(tmp_path / "other", CHUNK, {})
    with pytest.raises(ConfigError, match="head"):
        RingLog(tmp_path / "large", CHUNK, {"text": PAGE * "x"})
    assert not (tmp_path / "large").exists()


def test_an_empty_log_has_no_records(tmp_path: Path) -> None:
    RingLog(tmp_path / "log", CHUNK, {}).close()
    assert read_log(tmp_path / "log") == [] and read_head(tmp_path / "log") == {}
    assert (tmp_path / "log").read_bytes().startswith(MAGIC)


def test_a_log_that_is_closed_takes_no_more_room_than_it_needs(tmp_path: Path) -> None:
    """A start that is refused leaves words, and not half a gigabyte."""
    log = RingLog(tmp_path / "log.bin", 50 * CHUNK, {"a": 1})
    assert (tmp_path / "log.bin").stat().st_size == PAGE + 50 * CHUNK
    for i in range(1500):
        log.write(Kind.STATE, float(i), bytes(1000))
    log.close()
    assert (tmp_path / "log.bin").stat().st_size == PAGE + 2 * CHUNK
    assert [record.time for record in read_log(tmp_path / "log.bin")] == [float(i) for i in range(1500)]


def test_one_that_has_begun_again_keeps_all_its_chunks(tmp_path: Path) -> None:
    log = RingLog(tmp_path / "log.bin", 3 * CHUNK, {})
    for i in range(5000):
        log.write(Kind.STATE, float(i), bytes(1000))
    log.close()
    assert (tmp_path / "log.bin").stat().st_size == PAGE + 3 * CHUNK
    assert read_log(tmp_path / "log.bin")[-1].time == 4999.0


def test_without_room_for_it_there_is_no_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("controllers.deployment.ring.os.posix_fallocate", full)
    with pytest.raises(ConfigError, match=r"room for 3 MB.*No space left"):
        RingLog(tmp_path / "log.bin", 3 * CHUNK, {})
    assert not (tmp_path / "log.bin").exists()
