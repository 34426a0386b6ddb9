"""One table, three forms: drawn in a terminal, as HTML in a page, as Markdown anywhere else."""

from dataclasses import dataclass

from rich.console import Console, Group

from experiments.reports.terminal_table import TerminalTable
from robots.errors import ConfigError

MORE_LABELS = 2
"""So many columns beyond those of words may be needed to tell rows apart."""


@dataclass(frozen=True, slots=True)
class Column:
    """One column.

    Attributes:
        heading: above it; may have several lines.
        unit: of all of its cells, shown in square brackets; empty for none.
        words: whether it holds words, which stand to the left, instead of numbers, which stand to the right.
    """

    heading: str
    unit: str = ""
    words: bool = False

    @property
    def label(self) -> str:
        """Heading and unit in one line."""
        heading = " ".join(self.heading.split("\n"))
        return f"{heading} [{self.unit}]" if self.unit else heading


@dataclass(frozen=True, slots=True)
class Cell:
    """What stands in one place.

    Attributes:
        text: what is shown.
        bad: whether it tells of something that should not be.
        link: address that it leads to in a page, relative or in full; empty for none.
    """

    text: str
    bad: bool = False
    link: str = ""


@dataclass(frozen=True, slots=True)
class Row:
    """One row.

    Attributes:
        cells: from the left, each a :class:`Cell` or plain text; those that are not given are empty.
        unit: of all of its numbers, where rows have units of their own; empty for none.
        bold: whether it stands out.
        section: whether a new section begins with it.
    """

    cells: tuple[Cell | str, ...]
    unit: str = ""
    bold: bool = False
    section: bool = False


@dataclass(frozen=True, slots=True)
class Table:
    """A table.

    Attributes:
        columns: at least one; the leading ones name what a row is of.
        rows: from the top.
        title: above it; its further lines are text below the first one.
        caption: text below it.

    Raises:
        ConfigError: there is no column, or a row has more cells than there are columns.
    """

    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    title: str = ""
    caption: str = ""

    def __post_init__(self) -> None:
        """Check the sizes."""
        if not self.columns:
            raise ConfigError("columns", self.columns, "at least one")
        for row in self.rows:
            if len(row.cells) > len(self.columns):
                raise ConfigError("cells", row.cells, f"at most {len(self.columns)}, one for each column")

    def cells(self, row: Row) -> tuple[Cell, ...]:
        """The cells of one of the rows, one for each column."""
        given = tuple(cell if isinstance(cell, Cell) else Cell(cell) for cell in row.cells)
        return given + (Cell(""),) * (len(self.columns) - len(given))

    @property
    def has_units(self) -> bool:
        """Whether rows have units of their own."""
        return any(row.unit for row in self.rows)

    @property
    def labels(self) -> int:
        """Number of leading columns that name what a row is of: those of words, and more if these tell rows apart."""
        leading = next((i for i, column in enumerate(self.columns) if not column.words), len(self.columns))
        least = max(leading, 1)
        most = min(least + MORE_LABELS, len(self.columns))
        return next((count for count in range(least, most + 1) if self._told_apart(count)), least)

    def _told_apart(self, count: int) -> bool:
        names = [tuple(cell.text for cell in self.cells(row)[:count]) for row in self.rows]
        return len(set(names)) == len(names)

    def text(self, row: Row, i: int) -> str:
        """What stands in column ``i`` of one of the rows; a unit that the row has of its own is in the first one."""
        text = self.cells(row)[i].text
        return f"{text} ({row.unit})" if row.unit and i == 0 else text

    def rich(self, width: int) -> Group:
        """The table for a terminal of ``width`` characters.

        Where it is wider, headings are broken into lines, then the table is folded: further columns stand below, beside
        the same labels. No number is broken or cut, as long as one column of them fits beside the labels.
        """
        return TerminalTable(self, width).drawn()

    def markdown(self) -> str:
        """The table as Markdown: all columns and every number whole; the title is a heading of the third level."""
        head, _, text = self.title.partition("\n")
        lines = [[_escaped(column.label) for column in self.columns], ["---"] * len(self.columns)]
        lines += [self._markdown_row(row) for row in self.rows]
        parts = [f"### {head}" if head else "", text]
        parts.append("\n".join("| " + " | ".join(line) + " |" for line in lines))
        return "\n\n".join(part for part in (*parts, self.caption) if part)

    def _markdown_row(self, row: Row) -> list[str]:
        texts = [_escaped(self.text(row, i)) for i in range(len(self.columns))]
        return [f"**{text}**" if text and row.bold else text for text in texts]

    def html(self) -> str:
        """The table as part of a page."""
        from experiments.reports.page import render

        return render("table.html.jinja", table=self)


def _escaped(text: str) -> str:
    """Text that ends no cell of a Markdown table."""
    return text.replace("|", "\\|").replace("\n", " ")


def show(table: Table, console: Console | None = None) -> None:
    """Print a table: drawn where ``console`` is a terminal, and folded to its width; anywhere else as Markdown.

    Args:
        table: to print.
        console: where to; standard output if not given.
    """
    console = Console() if console is None else console
    if console.is_terminal:
        console.print(table.rich(console.width))
    else:
        console.out(table.markdown() + "\n", highlight=False)
