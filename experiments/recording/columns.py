"""What a run leaves behind while it runs: named columns, each one block of memory made before the first row."""

from collections.abc import Mapping

import numpy as np

from robots.messages import Array


class Columns:
    """Rows of named numbers and arrays, kept column by column.

    The first row decides the names, shapes and types; memory that no row was written to is never touched.

    Attributes:
        count: number of rows so far.
    """

    def __init__(self, capacity: int) -> None:
        """Room for ``capacity`` rows."""
        self.count = 0
        self._capacity = capacity
        self._blocks: dict[str, Array] = {}

    def append(self, row: Mapping[str, Array | float]) -> None:
        """Copy one row; names that the first row did not have are left out.

        Raises:
            KeyError: a name of the first row is missing.
            IndexError: there is no room left.
        """
        if not self.count:
            for name, value in row.items():
                entry = np.asarray(value)
                self._blocks[name] = np.empty((self._capacity, *entry.shape), entry.dtype)
        for name, block in self._blocks.items():
            block[self.count] = row[name]
        self.count += 1

    def arrays(self) -> dict[str, Array]:
        """Every column, shape (count, ...): views."""
        return {name: block[: self.count] for name, block in self._blocks.items()}
