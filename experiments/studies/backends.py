"""Where the cases of a study are evaluated: in this process, in processes of this machine, or on a dask cluster."""

import functools
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import joblib
from joblib.externals.loky.process_executor import TerminatedWorkerError

from experiments.studies.case import Case
from experiments.studies.store import RowStore
from robots.checks import require_between
from robots.errors import ConfigError, SafeWbcError

TIMEOUT = 10.0
"""How long a cluster may take to answer at first [s]."""


class WorkerLostError(SafeWbcError):
    """A process that evaluated cases ended: killed, out of memory, or crashed in compiled code."""


@dataclass(frozen=True, slots=True)
class Job:
    """One case as it is handed to a process.

    Attributes:
        case: to evaluate.
        store: of its row.
        prepare: called once in the process before its first case.
        driver: number of the process that hands out the cases.
    """

    case: Case
    store: RowStore
    prepare: Callable[[], None] | None
    driver: int

    def __call__(self) -> str:
        """Evaluate and store; returns the key."""
        if os.getpid() != self.driver and threading.current_thread() is threading.main_thread():
            # Ctrl-C reaches every process of the terminal; it is the driver that ends the others
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        if self.prepare is not None:
            _prepare(self.prepare)
        self.store.obtain(self.case)
        return self.case.key


def do(job: Job) -> str:
    """Do a job; returns its key. A function, since dask hashes what it calls."""
    return job()


@functools.cache
def _prepare(prepare: Callable[[], None]) -> None:
    """Call it, once in a process."""
    prepare()


class Backend(Protocol):
    """Evaluates jobs, side by side."""

    @property
    def in_driver(self) -> bool:
        """Whether jobs are done in the driver's own process: one that takes its process down takes the driver down."""
        ...

    def run(self, jobs: Sequence[Job]) -> Iterator[str]:
        """Keys, in the order in which the jobs are done.

        Raises:
            WorkerLostError: a process that evaluated one of them ended.
        """
        ...

    def alone(self, job: Job) -> None:
        """Do one job in a process that does nothing else.

        Raises:
            WorkerLostError: that process ended.
        """
        ...


@dataclass(frozen=True, slots=True)
class LocalBackend:
    """Processes of this machine; with one of them, this process itself.

    Loky's processes are started anew instead of forked: numba and MuJoCo do not survive a fork of a process that has
    used them.

    Attributes:
        jobs: how many cases are evaluated at a time, 1 to 64.
    """

    jobs: int

    def __post_init__(self) -> None:
        require_between("jobs", self.jobs, 1, 64)

    @property
    def in_driver(self) -> bool:
        """See :class:`Backend`."""
        return self.jobs == 1

    def run(self, jobs: Sequence[Job]) -> Iterator[str]:
        """See :class:`Backend`."""
        return self._run(jobs, self.jobs)

    def alone(self, job: Job) -> None:
        """See :class:`Backend`."""
        # two: with one, joblib takes this process
        list(self._run([job], 2))

    def _run(self, jobs: Sequence[Job], processes: int) -> Iterator[str]:
        try:
            with joblib.parallel_config(backend="loky", inner_max_num_threads=1):
                pool = joblib.Parallel(n_jobs=processes, batch_size=1, return_as="generator_unordered")
                yield from pool(joblib.delayed(do)(job) for job in jobs)
        except TerminatedWorkerError as error:
            raise WorkerLostError(str(error)) from error


@dataclass(frozen=True, slots=True)
class DaskBackend:
    """Workers of a dask cluster, which see the folder of the study under the path that it has here.

    Attributes:
        client: connected to its scheduler; a ``distributed.Client``.
    """

    client: Any

    @property
    def in_driver(self) -> bool:
        """See :class:`Backend`."""
        return False

    def run(self, jobs: Sequence[Job]) -> Iterator[str]:
        """See :class:`Backend`."""
        from distributed import KilledWorker

        try:
            with joblib.parallel_config(backend="dask", client=self.client):
                pool = joblib.Parallel(batch_size=1, return_as="generator_unordered")
                yield from pool(joblib.delayed(do)(job) for job in jobs)
        except KilledWorker as error:
            raise WorkerLostError(str(error)) from error

    def alone(self, job: Job) -> None:
        """See :class:`Backend`."""
        list(self.run([job]))


def connect(cluster: str) -> DaskBackend:
    """The backend of a dask cluster.

    Args:
        cluster: address of its scheduler, for example ``tcp://host:8786``.

    Raises:
        ConfigError: ``distributed`` is not installed, nothing answers there, or a worker has more than one thread.
    """
    try:
        from distributed import Client
    except ImportError as error:
        allowed = "left out where distributed is not installed: pip install 'safewbc[cluster]'"
        raise ConfigError("cluster", cluster, allowed) from error
    try:
        client = Client(cluster, timeout=TIMEOUT)
    except (OSError, ValueError) as error:
        raise ConfigError("cluster", cluster, f"the address of a dask scheduler that answers ({error})") from error
    threads = [worker["nthreads"] for worker in client.scheduler_info(n_workers=-1)["workers"].values()]
    if any(n != 1 for n in threads):
        client.close()
        # a run holds Python's lock nearly all the time, and clocks of its ticks would tell of the other threads
        raise ConfigError("cluster", cluster, "of workers with one thread each: dask worker --nthreads 1")
    return DaskBackend(client)
