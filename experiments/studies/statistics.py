"""Metrics over the seeds of a study: mean, and how sure it is."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import bootstrap

from experiments.studies.case import Row
from experiments.studies.parameters import SEED
from robots.errors import UnknownNameError

CONFIDENCE, RESAMPLES = 0.95, 2000
"""Of the bootstrap interval: its level, and how many means of resampled values it is made of."""

STATISTICS: dict[str, Callable[[Sequence[float]], float]] = {
    "mean": lambda values: float(np.mean(values)),
    "min": min,
    "max": max,
    "median": lambda values: float(np.median(values)),
    "count": len,
}
"""What a cell of a pivot may hold, by name."""


@dataclass(frozen=True, slots=True)
class Spread:
    """A metric over seeds.

    Attributes:
        values: one for each seed in which the metric is defined.
        mean: of them.
        low: lower end of the bootstrap interval of the mean; equal to the mean where all values are.
        high: upper end.
    """

    values: tuple[float, ...]
    mean: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Group:
    """The rows that differ in their seed only.

    Attributes:
        labels: that they share.
        rows: of them.
    """

    labels: Mapping[str, Any]
    rows: tuple[Row, ...]

    @property
    def failures(self) -> int:
        """How many of them failed."""
        return sum(row.error is not None for row in self.rows)

    @property
    def stops(self) -> int:
        """How many were stopped before their end: their metrics are of a part of the run."""
        return sum(row.stop_cause is not None for row in self.rows)

    def spread(self, metric: str) -> Spread | None:
        """A metric over the rows; ``None`` where none has it."""
        values = numbers(self.rows, metric)
        return spread(values) if values else None


def groups(rows: Sequence[Row]) -> list[Group]:
    """The rows by all labels but the seed, in the order in which they come."""
    found: dict[str, list[Row]] = {}
    for row in rows:
        found.setdefault(repr(_shared(row)), []).append(row)
    return [Group(_shared(members[0]), tuple(members)) for members in found.values()]


def _shared(row: Row) -> dict[str, Any]:
    return {name: value for name, value in row.labels.items() if name != SEED}


def spread(values: Sequence[float]) -> Spread:
    """Mean and percentile bootstrap interval of values, at least one; the same values give the same interval."""
    mean = float(np.mean(values))
    if len(set(values)) == 1:
        return Spread(tuple(values), mean, mean, mean)
    interval = bootstrap(
        (np.array(values),),
        np.mean,
        n_resamples=RESAMPLES,
        confidence_level=CONFIDENCE,
        method="percentile",
        rng=np.random.default_rng(0),
    ).confidence_interval
    return Spread(tuple(values), mean, float(interval.low), float(interval.high))


def numbers(rows: Sequence[Row], metric: str) -> list[float]:
    """The values of a metric where it is a number or a yes or no (1 or 0), in the order of the rows."""
    values = (row.metrics.get(metric) for row in rows)
    return [float(value) for value in values if isinstance(value, bool | int | float)]


def numeric_metrics(rows: Sequence[Row]) -> list[str]:
    """Names of the metrics that are numbers in some row, in the order in which they come."""
    return list(dict.fromkeys(name for row in rows for name in row.metrics if numbers([row], name)))


def varied(rows: Sequence[Row]) -> dict[str, list[Any]]:
    """Labels that are not the same in all rows, with their values in the order in which they come."""
    values: dict[str, dict[str, Any]] = {}
    for row in rows:
        for name, value in row.labels.items():
            values.setdefault(name, {})[repr(value)] = value
    return {name: list(found.values()) for name, found in values.items() if len(found) > 1}


def require_metrics(rows: Sequence[Row], names: Sequence[str]) -> None:
    """Raise :class:`UnknownNameError` for a metric that no row has."""
    known = numeric_metrics(rows)
    for name in names:
        if name not in known:
            raise UnknownNameError("metric", name, known)
