"""A run as one line of a table."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.recording.recording import Recording

Row = dict[str, Any]
"""Metrics of one line of a table, by key."""


def run_row(result: Recording) -> Row:
    """The summary of a run, how it ended in words, and its tick times by support."""
    return {**result.summary, "ended": ending(result.summary), **tick_figures(result.series)}


def ending(summary: Mapping[str, Any]) -> str:
    """Whether the robot fell or was stopped, and when."""
    if summary["fell"]:
        return f"at {summary['fell_at_s']:.1f} s"
    if summary["stop_cause"]:
        return f"stopped at {summary['stop_time_s']:.1f} s"
    return "no"


def tick_figures(series: Mapping[str, NDArray[Any]]) -> Row:
    """Median and 99th percentile of the time of a tick [ms], while the plan has both feet down and while one.

    Returns:
        ``tick_double_ms``, ``tick_double_p99_ms``, ``tick_single_ms``, ``tick_single_p99_ms``; ``None`` where the run
        has no such tick.
    """
    both = np.asarray(series["in_contact"], dtype=bool).all(axis=1)
    out: Row = {}
    for name, chosen in (("double", both), ("single", ~both)):
        times = series["tick_ms"][chosen]
        out[f"tick_{name}_ms"] = float(np.median(times)) if times.size else None
        out[f"tick_{name}_p99_ms"] = float(np.percentile(times, 99)) if times.size else None
    return out
