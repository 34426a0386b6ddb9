"""A table as a terminal shows it: headings in several lines, then folded, where it is wider than the terminal."""

import sys
from collections.abc import Mapping, Sequence
from textwrap import wrap
from typing import TYPE_CHECKING, Literal

from rich.box import SIMPLE_HEAD
from rich.cells import cell_len
from rich.console import Group
from rich.table import Table as RichTable
from rich.text import Text

if TYPE_CHECKING:
    from experiments.reports.table import Row, Table

Justify = Literal["left", "right"]

WORDS_WIDTH = 30
"""Longer words of a cell may be broken into lines [characters]."""

GAP = 2
"""Characters that a column takes beside its own."""

BAD = "red"
"""Style of what should not be."""


class TerminalTable:
    """A table within a width: which columns stand in which block, how wide they are, and the blocks themselves."""

    def __init__(self, table: "Table", width: int) -> None:
        """For a terminal of ``width`` characters."""
        self._table, self._width = table, width
        columns = range(len(table.columns))
        self._headings = [f"{c.heading}\n[{c.unit}]" if c.unit else c.heading for c in table.columns]
        cells = [max((cell_len(table.text(row, i)) for row in table.rows), default=0) for i in columns]
        self._least = [self._least_width(i, cells[i]) for i in columns]
        self._full = [max(cells[i], *map(cell_len, self._headings[i].split("\n")), 1) for i in columns]

    def _least_width(self, i: int, cell: int) -> int:
        """Characters that a column needs for its longest number and the longest word of its heading."""
        column = self._table.columns[i]
        words = [cell_len(word) for word in column.label.split()]
        return max(min(cell, WORDS_WIDTH if column.words else sys.maxsize), *words, 1)

    def drawn(self) -> Group:
        """All blocks, the title above and the caption below."""
        title, caption = ([Text(text)] if text else [] for text in (self._table.title, self._table.caption))
        return Group(*title, *(self._block(columns) for columns in self.folded()), *caption)

    def folded(self) -> list[list[int]]:
        """Indices of the columns of each block: as few blocks as fit, of about the same width."""
        width, blocks = self._width, self._filled(self._width)
        while len(blocks) > 1 and len(narrower := self._filled(width - 1)) == len(blocks):
            blocks, width = narrower, width - 1
        return blocks

    def _filled(self, width: int) -> list[list[int]]:
        labels = list(range(self._table.labels))
        blocks = [labels.copy()]
        for i in range(len(labels), len(self._table.columns)):
            taken = sum(self._least[k] + GAP for k in (*blocks[-1], i))
            if taken > width and len(blocks[-1]) > len(labels):
                blocks.append(labels.copy())
            blocks[-1].append(i)
        return blocks

    def _widths(self, columns: Sequence[int]) -> dict[int, int]:
        """Widths of the columns of a block: headings as low as they can be, what is left to those that lack least."""
        lines = 1
        widths = self._widths_for(columns, lines)
        while self._room(widths) < 0 and any(widths[i] > self._least[i] for i in columns):
            lines += 1
            widths = self._widths_for(columns, lines)
        for i in sorted(columns, key=lambda i: self._full[i] - widths[i]):
            widths[i] += min(max(self._room(widths), 0), self._full[i] - widths[i])
        return widths

    def _room(self, widths: Mapping[int, int]) -> int:
        return self._width - sum(w + GAP for w in widths.values())

    def _widths_for(self, columns: Sequence[int], lines: int) -> dict[int, int]:
        """The least widths with which no heading has more than so many lines, as far as that can be."""
        possible = {i: range(self._least[i], self._full[i]) for i in columns}
        return {
            i: next((w for w in widths if self._height(i, w) <= lines), self._full[i]) for i, widths in possible.items()
        }

    def _height(self, i: int, width: int) -> int:
        return sum(len(wrap(line, width, break_on_hyphens=False)) for line in self._headings[i].split("\n"))

    def _block(self, columns: Sequence[int]) -> RichTable:
        block = RichTable(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
        for i, width in self._widths(columns).items():
            justify: Justify = "left" if self._table.columns[i].words else "right"
            # as text: square brackets round a unit are no markup
            block.add_column(Text(self._headings[i]), justify=justify, width=width)
        for row in self._table.rows:
            if row.section:
                block.add_section()
            block.add_row(*(self._cell(row, i) for i in columns), style="bold" if row.bold else None)
        return block

    def _cell(self, row: "Row", i: int) -> Text:
        return Text(self._table.text(row, i), BAD if self._table.cells(row)[i].bad else "")
