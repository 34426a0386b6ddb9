"""What a study is made of: cases, each with a key, labels, and what evaluates it; and the row that a case leaves."""

import hashlib
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from experiments.metrics.metric import Metric
from robots.errors import ConfigError

if TYPE_CHECKING:
    from experiments.studies.store import RowStore

Metrics = Mapping[str, Any]
"""Figures of a case by name: what JSON takes; tables within it are flattened in the results file."""

Evaluate = Callable[["RowStore"], Metrics]
"""Evaluates a case; has to survive pickling. It is given the store of the study, whose ``folder`` is where it may
leave files, and whose :meth:`~experiments.studies.store.RowStore.obtain` evaluates further cases."""

KEY = re.compile(r"[A-Za-z0-9][A-Za-z0-9._,=+-]{0,199}")
"""What a key may be: it is the name of a file."""


@dataclass(frozen=True, slots=True)
class Case:
    """One evaluation.

    Attributes:
        key: tells it from every other case in the same folder; the same key means the same content.
        labels: names and values of the parameters that set it apart, for tables.
        evaluate: gives its metrics.
        folder: where the run is saved, below the folder of the study; ``None``: nowhere.
        alone: whether it is evaluated after all others, by one process while no other evaluates any: for times.
        files: that it leaves in ``folder``; where one of them is missing it is evaluated again.
    """

    key: str
    labels: Mapping[str, Any]
    evaluate: Evaluate
    folder: str | None = None
    alone: bool = False
    files: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not KEY.fullmatch(self.key):
            raise ConfigError("key of a case", self.key, f"a file name that matches {KEY.pattern}")


def content_key(name: str, content: Any) -> str:
    """A key: a name, and sixteen hexadecimal digits that stand for a content, which JSON takes."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return f"{name}-{hashlib.sha256(text.encode()).hexdigest()[:16]}"


@dataclass(frozen=True, slots=True)
class Row:
    """What became of a case.

    Attributes:
        key: of the case.
        labels: of the case.
        metrics: what evaluating it gave; empty where it failed.
        error: why it failed, in words; ``None`` where it did not.
        seconds: how long it took on the clock [s].
        versions: of the packages that it was made with.
        folder: of the run, below the folder of the study; ``None``: none was saved.
    """

    key: str
    labels: Mapping[str, Any]
    metrics: Metrics
    error: str | None = None
    seconds: float = 0.0
    versions: Mapping[str, str] = field(default_factory=dict)
    folder: str | None = None

    @property
    def stop_cause(self) -> str | None:
        """Why its run was stopped before its end, in words; ``None`` where it was not."""
        return self.metrics.get("stop_cause")

    def entries(self) -> dict[str, Any]:
        """Metrics and labels in one table; where both have a name, the label counts."""
        return {**self.metrics, **self.labels}


@dataclass(frozen=True, slots=True)
class Study:
    """A set of cases.

    Attributes:
        title: for people.
        cases: in the order of the table. Cases with the same key are evaluated once.
        prepare: called once in every process before its first case, for example to compile kernels; hashable, and has
            to survive pickling.
        command: command line that makes it, for people.
        metrics: how to show those that the project does not declare.
    """

    title: str
    cases: Sequence[Case]
    prepare: Callable[[], None] | None = None
    command: str = ""
    metrics: tuple[Metric, ...] = ()

    def distinct(self) -> list[Case]:
        """The cases to evaluate: the first of every key."""
        return list({case.key: case for case in reversed(self.cases)}.values())[::-1]
