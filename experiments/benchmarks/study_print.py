"""Small studies: figures on the terminal, and files beside each other."""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from experiments.metrics.metric import Metric
from experiments.reports.metric_tables import rows_table
from experiments.reports.table import show
from experiments.running.terminal import make_console

Runs = Sequence[tuple[Mapping[str, Any], Any]]
"""What a study of runs gives: figures and series of each."""


def show_study(
    study: Callable[[], Runs],
    plot: Callable[[Runs], bytes],
    waiting: str,
    title: str,
    columns: Sequence[Metric],
    out: Path | None,
) -> None:
    """Make all runs of a study and print their table; with ``out`` write it there as JSON, and a plot beside."""
    console = make_console()
    with console.status(waiting):
        runs = study()
    figures = [figures for figures, _ in runs]
    show(rows_table(figures, columns, title), console)
    if out is not None:
        write_study(console, out, figures, plot(runs))


def write_study(console: Console, out: Path, figures: Any, plot: bytes) -> None:
    """Write figures as JSON to ``out`` and a plot as PNG beside it."""
    out.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    picture = out.with_suffix(".png")
    picture.write_bytes(plot)
    console.print(f"figures: {out}\nplot:    {picture}")
