"""Tables and plots of small studies: figures on the terminal, files beside each other, one look of axes."""

import io
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from experiments.figures import Figure
from experiments.plot_style import GRID, INK


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


def frame(axes: Iterable[Axes]) -> None:
    """Give axes the look of the studies' plots."""
    for axis in axes:
        axis.grid(True, color=GRID, lw=0.8)
        axis.tick_params(colors=INK, labelsize=8, length=0)
        axis.spines[["top", "right"]].set_visible(False)


def png(drawing: Drawing) -> bytes:
    """A drawing as PNG."""
    buffer = io.BytesIO()
    drawing.savefig(buffer, format="png")
    return buffer.getvalue()
