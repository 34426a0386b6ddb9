"""The rows of a study on disk: one file each, written beside and renamed, and claimed while it is being made."""

import fcntl
import functools
import json
import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from experiments.recording.plain import plain
from experiments.recording.store import run_file
from experiments.studies.case import Case, Row
from robots.errors import ConfigError, SafeWbcError


@dataclass(frozen=True, slots=True)
class RowStore:
    """Rows of one study, in ``rows/<key>.json`` below its folder.

    A row is there whole or not at all, whatever is killed. While a process makes it, it holds a lock on
    ``claims/<key>``, which the system takes back when that process ends in any way; so no case is evaluated by two
    processes at a time, and one that finds the row made meanwhile takes it.

    Attributes:
        folder: of the study; every process that evaluates cases has to see it under this path.
    """

    folder: Path

    def __contains__(self, key: str) -> bool:
        return self._path(key).exists()

    def is_done(self, case: Case) -> bool:
        """Whether a case has its row and, unless it failed, the files that it leaves."""
        return case.key in self and (self._has_files(case) or self.read(case).error is not None)

    def read(self, case: Case) -> Row:
        """The row of a case, with the labels that the case has now.

        Raises:
            ConfigError: there is none, or it was not written by this project.
        """
        return row_from(read_json(self._path(case.key)), case.key, case.labels, case.folder)

    def obtain(self, case: Case) -> Row:
        """The row of a case, which is evaluated and stored unless it is done."""
        with self._claim(case.key):
            if not self.is_done(case):
                self._write(case, evaluated(case, self))
        self._claim_path(case.key).unlink(missing_ok=True)
        return self.read(case)

    def was_begun(self, key: str) -> bool:
        """Whether the process that evaluated a case ended before it was done, or is at it now."""
        return self._claim_path(key).exists()

    def record_failure(self, case: Case, error: str) -> None:
        """Store a row that says only why there is nothing."""
        self._write(case, Row(case.key, case.labels, {}, error))
        self._claim_path(case.key).unlink(missing_ok=True)

    def forget_failures(self) -> int:
        """Remove the rows of failed cases, so that they are evaluated again; returns how many there were."""
        failed = [path for path in self._rows().glob("*.json") if read_json(path).get("error") is not None]
        for path in failed:
            path.unlink()
        return len(failed)

    def prepare(self) -> None:
        """Make the folders.

        Raises:
            ConfigError: the folder cannot be written.
        """
        try:
            for folder in (self._rows(), self.folder / "claims"):
                folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            allowed = f"a folder that can be written ({error.strerror or error})"
            raise ConfigError("out", str(self.folder), allowed) from error

    @contextmanager
    def driver(self) -> Iterator[None]:
        """Hold the folder as the one process that hands out its cases.

        Raises:
            ConfigError: another process holds it, or the folder cannot be written.
        """
        self.prepare()
        with (self.folder / "study.lock").open("a") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                allowed = "a folder that no other process is filling at this moment"
                raise ConfigError("out", str(self.folder), allowed) from error
            yield

    def _has_files(self, case: Case) -> bool:
        return all(run_file(self.folder / str(case.folder), name).exists() for name in case.files)

    @contextmanager
    def _claim(self, key: str) -> Iterator[None]:
        with self._claim_path(key).open("a") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            yield

    def _write(self, case: Case, row: Row) -> None:
        content = {
            "key": case.key,
            "labels": case.labels,
            "metrics": row.metrics,
            "error": row.error,
            "seconds": row.seconds,
            "versions": row.versions,
        }
        write_whole(self._path(case.key), json.dumps(plain(content), indent=1, allow_nan=False) + "\n")

    def _rows(self) -> Path:
        return self.folder / "rows"

    def _path(self, key: str) -> Path:
        return self._rows() / f"{key}.json"

    def _claim_path(self, key: str) -> Path:
        return self.folder / "claims" / key


class CaseFailedError(SafeWbcError):
    """A case failed that another one needs."""


def sound(row: Row) -> dict[str, Any]:
    """The entries of a row.

    Raises:
        CaseFailedError: its case failed.
    """
    if row.error is not None:
        raise CaseFailedError(f"case {row.key} failed: {row.error}")
    return row.entries()


def evaluated(case: Case, store: RowStore) -> Row:
    """Evaluate a case; what it raises becomes the error of its row."""
    # first: what is evaluated is stored at once, so that a kill between the two is as unlikely as can be
    versions, start = versions_now(), time.monotonic()
    try:
        metrics, error = dict(case.evaluate(store)), None
        json.dumps(plain(metrics), allow_nan=False)
    except Exception as raised:
        metrics, error = {}, f"{type(raised).__name__}: {raised}"
    return Row(case.key, case.labels, metrics, error, time.monotonic() - start, versions)


@functools.cache
def versions_now() -> dict[str, str]:
    """Versions of the packages that rows are made with now."""
    from experiments.metrics.balance import versions

    return versions()


def row_from(table: Mapping[str, Any], key: str, labels: Mapping[str, Any], folder: str | None) -> Row:
    """A row from the content of its file.

    Raises:
        ConfigError: an entry is missing.
    """
    try:
        metrics, error, seconds, versions = (table[name] for name in ("metrics", "error", "seconds", "versions"))
    except KeyError as missing:
        raise ConfigError(f"row {key}", sorted(table), f"an object with the entry {missing}") from missing
    return Row(key, dict(labels), metrics, error, seconds, versions, folder)


def read_json(path: Path) -> dict[str, Any]:
    """A JSON object.

    Raises:
        ConfigError: the file is missing or holds something else.
    """
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigError("study", str(path), f"a JSON file written by this project ({error})") from error
    if not isinstance(table, dict):
        raise ConfigError("study", str(path), "a JSON object")
    return table


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file beside and rename it, so that at ``path`` there is the old or the new one, never a part.

    What a killed process left of it beside is written over: no two processes may write the same file at a time.

    Raises:
        ConfigError: it cannot be written.
    """
    beside = path.with_name(f".{path.name}.tmp")
    try:
        with beside.open("wb") as file:
            file.write(content.encode() if isinstance(content, str) else content)
            file.flush()
            os.fsync(file.fileno())
        beside.replace(path)
        _sync_folder(path.parent)
    except OSError as error:
        with suppress(OSError):
            beside.unlink()
        allowed = f"a file that can be written ({error.strerror or error})"
        raise ConfigError("out", str(path), allowed) from error


def _sync_folder(folder: Path) -> None:
    """Have the name of a new file on the disk too, not its content alone."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
