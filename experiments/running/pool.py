"""Tasks side by side, whose results are wanted as they are; what is to be kept is a study."""

from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

import joblib
from rich.console import Console
from rich.progress import Progress

T = TypeVar("T")


def in_parallel(tasks: Sequence[Callable[[], T]], jobs: int, console: Console) -> Iterator[T]:
    """Results in the order of the tasks, ``jobs`` of which run at a time, each in a process of its own.

    Loky's processes are started anew instead of forked: numba and MuJoCo do not survive a fork of a process that has
    used them.
    """
    with joblib.parallel_config(inner_max_num_threads=1, backend="loky"), Progress(console=console) as bar:
        line = bar.add_task(f"{len(tasks)} tasks", total=len(tasks))
        pool = joblib.Parallel(n_jobs=jobs, batch_size=1, return_as="generator")
        for result in pool(joblib.delayed(task)() for task in tasks):
            bar.advance(line)
            yield result
