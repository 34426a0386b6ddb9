"""Options that all studies have: where their cases are evaluated, and where rows go. Nothing heavy is imported here."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class WorkOptions:
    """Where the cases are evaluated, and where they are kept."""

    jobs: int = 2
    """Cases evaluated at a time [-]."""
    cluster: str | None = None
    """Address of a dask scheduler to evaluate them on instead, tcp://host:port; its workers need one thread each, and
    the folder of the study under the path that it has here."""
    retry_failed: bool = False
    """Evaluate cases again that failed before."""
    out: Path | None = None
    """Folder of rows, runs and results; given that of a study that was cut short, the study goes on where it was;
    runs/<study>-<time> if not given."""
