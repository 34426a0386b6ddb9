"""The folder of a run: claimed by one process, written beside and renamed, never half of one run, half of another."""

import fcntl
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from experiments.recording.plain import plain
from robots.errors import ConfigError

DATA = ("config.json", "summary.json", "series.npz")
"""Files by which a folder holds a run."""

RUN_FILES = (*DATA, "report.html", "video.mp4")
"""Everything that belongs to a run and goes with it."""

STUDY = "study.json"
"""File by which a folder holds a study."""

STAGED, LEAVING, EARLIER, LOCK = ".new", ".leaving", ".earlier", ".lock"
"""Beside the files of a run: one that is being written; the earlier one on its way aside, file by file; the same once
it is there whole (empty: there was none); and the mark of who writes."""

Writer = Callable[[Path], object]
"""Writes a file at the path that it is given."""


def prepare_folder(path: Path) -> Path:
    """Make the folder, and make sure that files can be written there: to be called before a long run.

    Args:
        path: the folder; parents are made too.

    Returns:
        The same path.

    Raises:
        ConfigError: it cannot be made, is not a folder, or does not take files.
    """
    with _refusing(path):
        path.mkdir(parents=True, exist_ok=True)
        # a file is really made: permission bits say nothing about read-only or full file systems
        with tempfile.NamedTemporaryFile(dir=path, prefix=".write-test-") as probe:
            probe.write(b"x")
            probe.flush()
            os.fsync(probe.fileno())
    return path


@contextmanager
def claimed(folder: Path, overwrite: bool = False) -> Iterator[Path]:
    """The folder around a run: made, proved to be writable, and taken by nobody else meanwhile.

    Where the run is cut short, a folder that was made for it goes again if it is empty.

    Args:
        folder: where to.
        overwrite: whether it may hold a run already, which stays until another is saved.

    Raises:
        ConfigError: it cannot be written, holds a run or a study, or another process writes to it.
    """
    made = not folder.exists()
    prepare_folder(folder)
    try:
        with _locked(folder):
            _recover(folder)
            _refuse_taken(folder, overwrite)
            yield folder
    finally:
        if made:
            # only an empty one goes
            with suppress(OSError):
                folder.rmdir()


def _refuse_taken(folder: Path, overwrite: bool) -> None:
    """Nothing that a run would replace is lost in silence: another run, a study, a file of the same name."""
    if (folder / STUDY).exists():
        raise ConfigError("out", str(folder), "a folder without a study: its rows and its page would be lost")
    if overwrite:
        return
    if holds_run(folder):
        allowed = "a folder without a run, or with --overwrite (overwrite=True) where there is such a choice"
        raise ConfigError("out", str(folder), allowed)
    if names := [name for name in RUN_FILES if run_file(folder, name).exists()]:
        raise ConfigError("out", str(folder), f"a folder without {', '.join(names)}, or with --overwrite")


def holds_run(folder: Path) -> bool:
    """Whether a folder, or one directly in it, holds files of a run."""
    return any(run_file(place, name).exists() for place in (folder, *_below(folder)) for name in DATA)


def _below(folder: Path) -> list[Path]:
    return [p for p in folder.iterdir() if p.is_dir() and p.name not in (STAGED, LEAVING, EARLIER)]


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold the folder's lock; the system lets go of it however the process ends."""
    path = folder / LOCK
    with path.open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # whoever held it may have removed the file that this one waited for
            held = path.exists() and os.path.samestat(os.fstat(file.fileno()), path.stat())
        except OSError:
            held = False
        if not held:
            raise ConfigError("out", str(folder), "a folder that no other run is writing to")
        try:
            yield
        finally:
            path.unlink(missing_ok=True)


def write_run(folder: Path, files: Mapping[str, Writer]) -> None:
    """Write the files of a run in place of those of an earlier one: all of them, or none.

    They are written beside, then renamed. Wherever this is cut short the folder holds the earlier run whole (what
    :func:`run_file` finds), or the new one. Files of the earlier run that are not written anew go with it.

    Args:
        folder: made when missing.
        files: by their names in the folder.

    Raises:
        ConfigError: the folder cannot be written.
    """
    with _refusing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        _recover(folder)
        staged = folder / STAGED
        staged.mkdir()
        try:
            for name, write in files.items():
                write(staged / name)
                _flush(staged / name)
            _exchange(folder, tuple(files))
        finally:
            shutil.rmtree(staged, ignore_errors=True)


def add_file(folder: Path, name: str, write: Writer) -> None:
    """Write one more file of a run, whole or not at all; a writer may decide to write none.

    Raises:
        ConfigError: the folder cannot be written.
    """
    with _refusing(folder):
        # the ending stays: what writes a film goes by it
        staged = folder / f"{STAGED}-{name}"
        try:
            write(staged)
            if staged.exists():
                staged.replace(folder / name)
        finally:
            staged.unlink(missing_ok=True)


def run_file(folder: Path, name: str) -> Path:
    """Where a file of the run is that a folder holds, also after a writer was killed in the middle."""
    if (folder / EARLIER).exists():
        # what is beside it may be of another run
        return folder / EARLIER / name
    leaving = folder / LEAVING / name
    return leaving if leaving.exists() else folder / name


def write_json(name: str, table: Any) -> Writer:
    """Writes a table of numbers, strings, lists and tables as JSON; NaN and infinity become ``null``.

    Raises:
        ConfigError: it holds what JSON cannot.
    """
    try:
        text = json.dumps(plain(table), indent=2, allow_nan=False)
    except TypeError as error:
        raise ConfigError(name, table, f"made of numbers, strings, lists and tables ({error})") from error
    return lambda path: _write_text(path, text + "\n")


def _write_text(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")


def _exchange(folder: Path, names: tuple[str, ...]) -> None:
    """Put the staged files where those of an earlier run are; up to the last rename that run can be restored.

    As long as files leave, the folder has no new ones; before new ones come, the earlier run is aside whole.
    """
    leaving, earlier, gone = folder / LEAVING, folder / EARLIER, folder / f"{EARLIER}-gone"
    leaving.mkdir()
    for name in RUN_FILES:
        if (folder / name).exists():
            (folder / name).replace(leaving / name)
    leaving.replace(earlier)
    for name in names:
        (folder / STAGED / name).replace(folder / name)
    earlier.replace(gone)
    shutil.rmtree(gone, ignore_errors=True)


def _recover(folder: Path) -> None:
    """Bring a folder in order whose writer was killed: the run that it took away is put back."""
    leaving, earlier = folder / LEAVING, folder / EARLIER
    if earlier.exists():
        for name in RUN_FILES:
            (folder / name).unlink(missing_ok=True)
        earlier.replace(leaving)
    if leaving.exists():
        for path in leaving.iterdir():
            path.replace(folder / path.name)
        leaving.rmdir()
    for left in (STAGED, f"{EARLIER}-gone"):
        shutil.rmtree(folder / left, ignore_errors=True)


def _flush(path: Path) -> None:
    """Have the file on the disk before anything is put in the place of another: a full one says so only then."""
    with path.open("rb") as file:
        os.fsync(file.fileno())


@contextmanager
def _refusing(folder: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise ConfigError("out", str(folder), f"a folder that can be written ({error.strerror or error})") from error
