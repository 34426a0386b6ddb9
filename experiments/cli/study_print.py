"""Small studies: figures on the terminal, and files beside each other."""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from experiments.cli.console import make_console
from experiments.metrics.metric import Figure

TABLE_WIDTH = 110
"""Least width of the console for a table of :func:`show_study`: a pipe is taken to be narrower."""

Runs = Sequence[tuple[Mapping[str, Any], Any]]
"""What a study of runs gives: figures and series of each."""


def show_study(
    study: Callable[[], Runs],
    plot: Callable[[Runs], bytes],
    waiting: str,
    title: str,
    columns: Sequence[Figure],
    out: Path | None,
) -> None:
    """Make all runs of a study and print their table; with ``out`` write it there as JSON, and a plot beside."""
    console = make_console()
    console.width = max(console.width, TABLE_WIDTH)
    with console.status(waiting):
        runs = study()
    figures = [figures for figures, _ in runs]
    print_study(console, title, columns, figures)
    if out is not None:
        write_study(console, out, figures, plot(runs))


def print_study(console: Console, title: str, columns: Sequence[Figure], rows: Sequence[Mapping[str, Any]]) -> None:
    """Print the figures of ``rows`` as a table; words to the left, numbers to the right."""
    table = Table(title=title, box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    for column in columns:
        # as text: square brackets round a unit are no markup
        heading = Text(f"{column.words}\n[{column.unit}]" if column.unit else column.words)
        table.add_column(heading, justify="left" if isinstance(rows[0][column.key], str) else "right")
    for row in rows:
        table.add_row(*(column.text(row[column.key]) for column in columns))
    console.print(table)


def write_study(console: Console, out: Path, figures: Any, plot: bytes) -> None:
    """Write figures as JSON to ``out`` and a plot as PNG beside it."""
    out.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    picture = out.with_suffix(".png")
    picture.write_bytes(plot)
    console.print(f"figures: {out}\nplot:    {picture}")
