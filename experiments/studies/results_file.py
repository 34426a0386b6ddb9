"""The rows of a study as one table in a file: Parquet, or CSV where pyarrow is not installed."""

import csv
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from experiments.recording.plain import plain
from experiments.studies.case import Row
from experiments.studies.store import write_whole

PARQUET, CSV = "results.parquet", "results.csv"

INSTALL = "results.csv is written in place of results.parquet: pip install 'safewbc[study]' for Parquet"
"""What to say where pyarrow is missing."""


def write_results(rows: Sequence[Row], folder: Path) -> Path:
    """Write the results file of a study, and remove that of the other form; returns its path."""
    table = columns(rows)
    content: str | bytes
    if find_spec("pyarrow") is None:
        path, other, content = folder / CSV, folder / PARQUET, _csv(table)
    else:
        path, other, content = folder / PARQUET, folder / CSV, _parquet(table)
    write_whole(path, content)
    other.unlink(missing_ok=True)
    return path


def columns(rows: Sequence[Row]) -> dict[str, list[Any]]:
    """Columns by name, each with an entry a row: parameters, metrics, then what is known of the row itself.

    A parameter counts where a metric has its name. Tables become columns of their own (``versions.numpy``), lists
    become text.
    """
    flat = [flat_row(row) for row in rows]
    names = dict.fromkeys(name for kind in range(3) for row in flat for name in row[kind])
    joined = [{**metrics, **of_row, **labels} for labels, metrics, of_row in flat]
    return {name: _one_type([row.get(name) for row in joined]) for name in names}


def flat_row(row: Row) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Labels, metrics, and what is known of the row itself, as flat tables of numbers, words and ``None``."""
    of_row = {
        "key": row.key,
        "error": row.error,
        "seconds": row.seconds,
        "folder": row.folder,
        "versions": row.versions,
    }
    labels, metrics, known = (_flat(plain(table)) for table in (row.labels, row.metrics, of_row))
    return labels, metrics, known


def _flat(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    out: dict[str, Any] = {}
    for name, value in table.items():
        if isinstance(value, Mapping):
            out |= _flat(value, f"{prefix}{name}.")
        else:
            out[prefix + name] = json.dumps(value) if isinstance(value, list) else value
    return out


def _one_type(values: list[Any]) -> list[Any]:
    """The values of a column in one type: numbers as floats where one is, words where they are mixed."""
    kinds = {type(value) for value in values if value is not None}
    if kinds == {int, float}:
        return [None if value is None else float(value) for value in values]
    if len(kinds) > 1:
        return [None if value is None else str(value) for value in values]
    return values


def _parquet(table: Mapping[str, list[Any]]) -> bytes:
    import pyarrow
    import pyarrow.parquet

    sink = io.BytesIO()
    arrays = {name: pyarrow.array(values) for name, values in table.items()}
    pyarrow.parquet.write_table(pyarrow.table(arrays), sink)
    return sink.getvalue()


def _csv(table: Mapping[str, list[Any]]) -> str:
    sink = io.StringIO()
    writer = csv.writer(sink, lineterminator="\n")
    writer.writerow(table)
    writer.writerows(_cells(values) for values in zip(*table.values(), strict=True))
    return sink.getvalue()


def _cells(values: Iterable[Any]) -> list[str]:
    # repr: every digit of a float; an empty cell for what is not known
    return ["" if v is None else repr(v) if isinstance(v, float) else str(v) for v in values]
