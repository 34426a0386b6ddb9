"""Folders of runs under bad circumstances: full disks, kills, two writers."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from experiments.recording.store import DATA, RUN_FILES, add_file, claimed, holds_run, run_file, write_run
from robots.errors import ConfigError

ROOT = Path(__file__).resolve().parents[2]


def text(content: str):  # type: ignore[no-untyped-def]
    return lambda path: path.write_text(content)


def run_of(content: str, names: tuple[str, ...] = DATA) -> dict[str, object]:
    return {name: text(content) for name in names}


def contents(folder: Path) -> dict[str, str]:
    return {name: path.read_text() for name in RUN_FILES if (path := run_file(folder, name)).exists()}


def full(path: Path) -> None:
    path.write_text("half of")
    raise OSError(28, "No space left on device")


@pytest.mark.parametrize("at", range(len(DATA)))
def test_a_disk_that_is_full_at_any_file_leaves_the_earlier_run(tmp_path: Path, at: int) -> None:
    write_run(tmp_path, run_of("old", RUN_FILES))
    (tmp_path / "notes.txt").write_text("mine")
    files = run_of("new") | {DATA[at]: full}
    with pytest.raises(ConfigError, match="No space left on device"):
        write_run(tmp_path, files)
    assert contents(tmp_path) == dict.fromkeys(RUN_FILES, "old")
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted([*RUN_FILES, "notes.txt"])


def test_a_new_run_takes_the_place_of_all_of_the_earlier_one_and_of_nothing_else(tmp_path: Path) -> None:
    write_run(tmp_path, run_of("old", RUN_FILES))
    (tmp_path / "notes.txt").write_text("mine")
    write_run(tmp_path, run_of("new"))
    assert contents(tmp_path) == dict.fromkeys(DATA, "new")
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted([*DATA, "notes.txt"])


KILLED = """
import os, sys
from pathlib import Path
from experiments.recording import store

count, stop = 0, int(sys.argv[2])

def replace(self, target):
    global count
    count += 1
    if count == stop:
        os.kill(os.getpid(), 9)
    return os.replace(self, target)

store.Path.replace = replace
if sys.argv[3:]:
    store.write_run(Path(sys.argv[1]), {name: lambda path: path.write_text("new") for name in sys.argv[3:]})
else:
    with store.claimed(Path(sys.argv[1]), overwrite=True):
        pass
"""


def killed(folder: Path, stop: int, *names: str) -> bool:
    """Write a run of these files in a process that dies before this rename, or put the folder in order without any."""
    command = [sys.executable, "-c", KILLED, str(folder), str(stop), *names]
    code = subprocess.run(command, cwd=ROOT, check=False).returncode
    assert code in (0, -signal.SIGKILL)
    return code != 0


@pytest.mark.parametrize(
    ("old", "new"),
    [(RUN_FILES, DATA), (DATA[:2], DATA), (DATA, DATA[:2]), ((), DATA)],
    ids=["with a report", "without series", "with series", "none"],
)
def test_a_writer_that_is_killed_at_any_moment_leaves_one_whole_run(
    tmp_path: Path, old: tuple[str, ...], new: tuple[str, ...]
) -> None:
    """Killed before each rename in turn, until it gets through: the old files away, that sealed, the new in, sealed."""
    renames = len(old) + 1 + len(new) + 1
    for stop in range(1, renames + 2):
        folder = tmp_path / str(stop)
        write_run(folder, run_of("old", old))
        assert killed(folder, stop, *new) == (stop <= renames)
        whole = dict.fromkeys(old, "old") if stop <= renames else dict.fromkeys(new, "new")
        assert contents(folder) == whole
        assert holds_run(folder) == bool(whole)
        # whoever claims the folder next puts it in order
        with claimed(folder, overwrite=True):
            pass
        assert sorted(p.name for p in folder.iterdir()) == sorted(whole)


def test_who_puts_a_folder_in_order_may_be_killed_too(tmp_path: Path) -> None:
    old, sealed = DATA[:2], len(DATA[:2]) + 1
    for stop in range(1, len(old) + 3):
        folder = tmp_path / str(stop)
        write_run(folder, run_of("old", old))
        assert killed(folder, sealed + len(DATA) + 1, *DATA)
        assert killed(folder, stop) == (stop <= len(old) + 1)
        assert contents(folder) == dict.fromkeys(old, "old")
        with claimed(folder, overwrite=True):
            pass
        assert sorted(p.name for p in folder.iterdir()) == sorted(old)


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_study_is_never_taken_for_a_run(tmp_path: Path, overwrite: bool) -> None:
    for name in ("study.json", "report.html"):
        (tmp_path / name).write_text("{}", encoding="utf-8")
    with pytest.raises(ConfigError, match="a folder without a study"), claimed(tmp_path, overwrite):
        pass
    assert (tmp_path / "report.html").read_text(encoding="utf-8") == "{}"


@pytest.mark.parametrize("name", ["report.html", "video.mp4"])
def test_files_of_others_are_not_replaced_in_silence(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("mine", encoding="utf-8")
    with pytest.raises(ConfigError, match=f"a folder without {name}"), claimed(tmp_path):
        pass
    assert (tmp_path / name).read_text(encoding="utf-8") == "mine"
    with claimed(tmp_path, overwrite=True):
        pass


def test_a_folder_that_holds_a_run_is_not_taken_in_silence(tmp_path: Path) -> None:
    for place in (tmp_path / "run", tmp_path / "runs" / "one"):
        write_run(place, run_of("old"))
    for folder in (tmp_path / "run", tmp_path / "runs"):
        with pytest.raises(ConfigError, match="--overwrite"), claimed(folder):
            pass
        with claimed(folder, overwrite=True) as taken:
            assert taken == folder
    assert contents(tmp_path / "run") == dict.fromkeys(DATA, "old")


def test_one_writer_at_a_time(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    with claimed(folder), pytest.raises(ConfigError, match="no other run is writing to"), claimed(folder):
        pass
    assert not folder.exists()
    with claimed(folder):
        pass


def test_a_writer_that_was_killed_keeps_nobody_out(tmp_path: Path) -> None:
    program = f"""
from pathlib import Path
from experiments.recording.store import claimed
with claimed(Path({str(tmp_path / "run")!r})):
    print("claimed", flush=True)
    __import__("signal").pause()
"""
    process = subprocess.Popen([sys.executable, "-c", program], cwd=ROOT, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "claimed\n"
    with pytest.raises(ConfigError, match="no other run is writing to"), claimed(tmp_path / "run"):
        pass
    os.kill(process.pid, signal.SIGKILL)
    process.communicate()
    with claimed(tmp_path / "run") as folder:
        assert folder.is_dir()


def test_a_file_more_is_whole_or_not_there(tmp_path: Path) -> None:
    add_file(tmp_path, "report.html", text("old"))
    with pytest.raises(ConfigError, match="No space left"):
        add_file(tmp_path, "report.html", full)
    assert (tmp_path / "report.html").read_text() == "old"
    add_file(tmp_path, "video.mp4", lambda path: None)
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]
