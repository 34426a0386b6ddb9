"""What a twin leaves behind: what was true, what it was told, and what happened when."""

import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robots.errors import ConfigError
from robots.messages import Array

ROWS = 5000
"""Rows that are made at a time: ten seconds."""


class Record:
    """Rows of numbers, in memory until they are saved.

    Args:
        path: of the file.

    Raises:
        ConfigError: it is no ``.npz``, or in a folder that cannot be written to.
    """

    def __init__(self, path: Path) -> None:
        if path.suffix != ".npz":
            raise ConfigError("record", str(path), "a file that ends with .npz")
        if not os.access(path.parent, os.W_OK) or path.is_dir():
            raise ConfigError("record", str(path), "a file in a folder that can be written to")
        self._path = path
        self._blocks: dict[str, list[NDArray[Any]]] = {}
        self._row = ROWS

    def add(self, **values: Array | float | bool) -> None:
        """Add a row: the same names each time, of the same shapes."""
        if self._row == ROWS:
            for name, value in values.items():
                self._blocks.setdefault(name, []).append(np.empty((ROWS, *np.shape(value)), np.asarray(value).dtype))
            self._row = 0
        for name, value in values.items():
            self._blocks[name][-1][self._row] = value
        self._row += 1

    def arrays(self) -> dict[str, NDArray[Any]]:
        """All rows so far, by name."""
        return {name: np.concatenate(blocks)[: self._row - ROWS or None] for name, blocks in self._blocks.items()}

    def save(self, events: list[tuple[float, str]]) -> None:
        """Write all rows, and the events with their times [s], under the file's name in one go."""
        arrays: dict[str, Any] = self.arrays()
        arrays["event_times"] = np.array([t for t, _ in events], dtype=float)
        arrays["events"] = np.array([text for _, text in events], dtype=str)
        handle, beside = tempfile.mkstemp(dir=self._path.parent, prefix=f".{self._path.name}-", suffix=".npz")
        try:
            with os.fdopen(handle, "wb") as file:
                np.savez_compressed(file, **arrays)
            os.chmod(beside, 0o644)
            os.replace(beside, self._path)
        except BaseException:
            Path(beside).unlink(missing_ok=True)
            raise
