"""What the commands share that carry out a study: the folder, the backend, and how to go on after an interruption."""

import shlex
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from experiments.running.terminal import unused
from experiments.studies.backends import Backend, LocalBackend, connect
from experiments.studies.case import Row, Study
from experiments.studies.engine import rows_of
from experiments.studies.index import FILE
from experiments.studies.parameters import parameters, value_of
from experiments.studies.progress import study_console
from experiments.studies.results_file import CSV, INSTALL
from experiments.studies.work import WorkOptions
from robots.errors import ConfigError


def study_folder(out: Path | None, name: str) -> Path:
    """The folder that was asked for, or a new one below ``runs``; nothing is made.

    Raises:
        ConfigError: it holds something else than a study.
    """
    if out is None:
        return unused(Path("runs") / f"{name}-{time.strftime('%Y%m%d-%H%M%S')}")
    if out.is_dir() and any(out.iterdir()) and not (out / FILE).exists():
        raise ConfigError("out", str(out), "a new or empty folder, or that of a study")
    return out


def run_study(study: Study, work: WorkOptions, folder: Path) -> Iterator[Row]:
    """The rows of a study, each as soon as it and all before it are there.

    Raises:
        SafeWbcError: an option is not allowed, or the folder cannot be used.
    """
    try:
        with _backend(work) as backend:
            yield from rows_of(study, folder, backend, work.retry_failed)
        if (folder / CSV).exists():
            study_console().print(INSTALL)
    except KeyboardInterrupt:
        study_console().print(f"cut short; what is done is kept, and this goes on with the rest:\n{study.command}")
        raise


@contextmanager
def _backend(work: WorkOptions) -> Iterator[Backend]:
    if work.cluster is None:
        yield LocalBackend(work.jobs)
        return
    backend = connect(work.cluster)
    try:
        yield backend
    finally:
        backend.client.close()


def command_line(command: str, options: Any, folder: Path) -> str:
    """The command line of a study, with its folder: what is not as by default.

    Args:
        command: its name, for example ``run pushes``.
        options: a dataclass of options.
        folder: of the study.
    """
    words, default = ["safewbc", *command.split()], type(options)()
    for parameter in parameters(type(options)).values():
        value = value_of(options, parameter)
        if value != value_of(default, parameter) and parameter.name not in ("out", "retry_failed"):
            words += _option(parameter.option, value)
    return shlex.join([*words, "--out", str(folder)])


def _option(option: str, value: Any) -> list[str]:
    if isinstance(value, bool):
        return [option if value else option.replace("--", "--no-", 1)]
    if isinstance(value, tuple | list):
        return [option, *map(str, value)]
    # one word: a value may begin with a minus
    return [f"{option}={value}"]


def tell_failures(rows: list[Row], folder: Path) -> int:
    """Say which rows failed and where all are; returns the exit code: 1 where some failed, else 0."""
    console = study_console()
    failed = [row for row in rows if row.error is not None]
    for row in failed[:10]:
        console.print(f"failed: {', '.join(f'{k} {v}' for k, v in row.labels.items())}: {row.error}", style="red")
    if len(failed) > 10:
        console.print(f"... and {len(failed) - 10} more", style="red")
    console.print(f"results: {folder}")
    return 1 if failed else 0
