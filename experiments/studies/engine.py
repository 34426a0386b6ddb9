"""Carries out studies: what is done already is kept, what fails is a row, what is killed goes on where it was."""

import itertools
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from experiments.studies.backends import Backend, Job, LocalBackend, WorkerLostError
from experiments.studies.case import Case, Row, Study
from experiments.studies.index import write_index
from experiments.studies.progress import study_console, study_progress
from experiments.studies.results_file import write_results
from experiments.studies.store import RowStore, versions_now

LOST = "WorkerLost: the process that evaluated it ended (killed, out of memory, or a crash in compiled code)"
"""Error of a case that takes its process down even when it is evaluated alone."""

IDLE_LOSSES = 3
"""How often processes may end that have no case in hand: beyond it something is wrong with the machine."""


def carry_out(study: Study, folder: Path, backend: Backend | None = None, retry_failed: bool = False) -> list[Row]:
    """Evaluate the cases that are not done yet, and write the results file.

    Args:
        study: what to do.
        folder: its rows, runs and results; holding rows of an earlier start, it goes on there.
        backend: where cases are evaluated; two processes of this machine if not given.
        retry_failed: evaluate cases again that failed before.

    Returns:
        A row for every case, in their order.

    Raises:
        ConfigError: another process is at work in the folder, it is that of another study, or it cannot be written.
    """
    return list(rows_of(study, folder, backend, retry_failed))


def rows_of(study: Study, folder: Path, backend: Backend | None = None, retry_failed: bool = False) -> Iterator[Row]:
    """The rows of :func:`carry_out`, each as soon as it and all before it are there.

    Interrupted, it leaves the rows that are done, and no results file of them: that is written at the end.
    """
    store = RowStore(folder.resolve())
    with store.driver():
        write_index(study, store.folder)
        if retry_failed:
            store.forget_failures()
        todo = [case for case in study.distinct() if not store.is_done(case)]
        missing = {case.key for case in todo}
        _tell_of_versions([store.read(case) for case in study.distinct() if case.key not in missing])
        done = _evaluated(study, todo, store, LocalBackend(2) if backend is None else backend)
        rows = []
        for case in study.cases:
            while case.key in missing:
                missing.discard(next(done))
            rows.append(store.read(case))
            yield rows[-1]
        write_results(rows, store.folder)


def _tell_of_versions(kept: Sequence[Row]) -> None:
    """One line where rows that are kept were made with other versions of packages than new ones will be."""
    now = versions_now()
    others = [row.versions for row in kept if row.versions and row.versions != now]
    if others:
        pairs = {(n, v.get(n), now.get(n)) for v in others for n in {*v, *now} if v.get(n) != now.get(n)}
        changes = ", ".join(sorted(f"{name} {before} (now {after})" for name, before, after in pairs))
        study_console().print(f"rows that other versions of packages made and that are kept: {len(others)}; {changes}")


def _evaluated(study: Study, todo: Sequence[Case], store: RowStore, backend: Backend) -> Iterator[str]:
    """Keys as they are done, with how far it is told on the terminal."""
    if not todo:
        return
    cases = {case.key: case for case in todo}
    jobs = {case.key: Job(case, store, study.prepare, os.getpid()) for case in todo}
    shared = {key: job for key, job in jobs.items() if not job.case.alone}
    alone = {key: job for key, job in jobs.items() if job.case.alone}
    with study_progress(study_console(), study.title, len(todo)) as advance:
        for key in itertools.chain(_survived(shared, store, backend), _survived(alone, store, LocalBackend(1))):
            advance(store.read(cases[key]).error is not None)
            yield key


def _survived(jobs: dict[str, Job], store: RowStore, backend: Backend) -> Iterator[str]:
    """Keys as they are done; where a process ends, the cases that it may have ended in are evaluated alone.

    Raises:
        WorkerLostError: processes end again and again before they have begun a case.
    """
    idle_losses = 0
    if backend.in_driver:
        # an earlier driver may have ended in them, and this one would in its turn
        yield from _suspects_alone(jobs, store, backend)
    while jobs:
        try:
            for key in backend.run(list(jobs.values())):
                del jobs[key]
                yield key
        except WorkerLostError:
            for key in [key for key, job in jobs.items() if store.is_done(job.case)]:
                del jobs[key]
                yield key
            suspects = list(_suspects_alone(jobs, store, backend))
            idle_losses += not suspects
            if idle_losses > IDLE_LOSSES:
                raise
            yield from suspects


def _suspects_alone(jobs: dict[str, Job], store: RowStore, backend: Backend) -> Iterator[str]:
    """Keys of the jobs that were begun and not done, each evaluated alone and taken out of ``jobs``."""
    for key in [key for key in jobs if store.was_begun(key)]:
        _alone(jobs.pop(key), store, backend)
        yield key


def _alone(job: Job, store: RowStore, backend: Backend) -> None:
    try:
        backend.alone(job)
    except WorkerLostError:
        if not store.is_done(job.case):
            store.record_failure(job.case, LOST)
