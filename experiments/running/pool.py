"""Runs of a study: side by side, each saved by the process that made it, which hands back its figures only."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import joblib
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import Progress

from experiments.recording.recording import RunResult, save_result
from experiments.running.run import run
from experiments.scenarios.scenario import Scenario

T = TypeVar("T")
Row = dict[str, Any]
"""Figures of one line of a table, by key."""

Task = Callable[[], Row]
"""Makes one line; has to survive pickling."""


def in_parallel(tasks: Sequence[Callable[[], T]], jobs: int, console: Console) -> Iterator[T]:
    """Results in the order of the tasks, ``jobs`` of which run at a time, each in a process of its own.

    Loky's processes are started anew instead of forked: numba and MuJoCo do not survive a fork of a process that has
    used them. A backend registered with joblib (dask, ray) takes their place: see ``joblib.parallel_config``.
    """
    with joblib.parallel_config(inner_max_num_threads=1, backend="loky"), Progress(console=console) as bar:
        line = bar.add_task(f"{len(tasks)} tasks", total=len(tasks))
        pool = joblib.Parallel(n_jobs=jobs, batch_size=1, return_as="generator")
        for result in pool(joblib.delayed(task)() for task in tasks):
            bar.advance(line)
            yield result


@dataclass(frozen=True, slots=True)
class RunTask:
    """One run of an experiment as a task.

    Attributes:
        options: of the run.
        folder: where it is saved.
        words: what the line shows beside the figures of the summary.
        series: whether the time series are saved too.
    """

    options: Scenario
    folder: Path
    words: Mapping[str, Any]
    series: bool = True

    def __call__(self) -> Row:
        """Run, save, and return the line."""
        start = time.process_time()
        result = run(self.options)
        save_result(result, self.folder, self.series)
        return row(result) | dict(self.words) | {"cpu_s": time.process_time() - start}


def row(result: RunResult) -> Row:
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
