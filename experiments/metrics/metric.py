"""What a metric is: its key in a summary, what it means, and how people read it. Imports nothing heavy."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

GROUPS = {
    "run": "run",
    "outcome": "outcome",
    "balance": "balance",
    "safety": "safety",
    "guarantee": "guarantee",
    "tracking": "tracking",
    "locomotion": "locomotion",
    "effort": "effort",
    "computation": "computation",
    "drawn": "drawn from the seed",
    "": "of the scenario",
}
"""Groups of metrics in the order of tables and files, and what they are called."""


DEEP = -0.05
"""A bound on a distance below this says nothing: bodies as thick as a hand could lie in each other [m]."""


class Summarised(Protocol):
    """Whatever has a summary, and a configuration that may declare metrics of its scenario's own."""

    @property
    def summary(self) -> Mapping[str, Any]:
        """Values by key."""

    @property
    def config(self) -> Mapping[str, Any]:
        """As ``config.json`` has it."""


@dataclass(frozen=True, slots=True)
class Metric:
    """One entry of a summary.

    Attributes:
        key: in the summary.
        words: what a person reads; empty for what stands in the file only.
        unit: in which it is shown, after multiplying by ``factor``.
        factor: see there.
        bad: which values stand out: ``negative``, ``true``, ``false``, ``given`` or ``positive``; empty for none.
        group: one of ``GROUPS``.
        stored: unit in the file.
        meaning: in a sentence.
    """

    key: str
    words: str
    unit: str = ""
    factor: float = 1.0
    bad: str = ""
    group: str = ""
    stored: str = ""
    meaning: str = ""

    def text(self, value: Any) -> str:
        """The value as text."""
        if value is None:
            return "-"
        if isinstance(value, bool):
            return "yes" if value else "no"
        return f"{value * self.factor:.3g}" if isinstance(value, float) else str(value)

    def is_bad(self, value: Any) -> bool:
        """Whether the value is one that should not be."""
        if value is None:
            return False
        return {
            "": False,
            "given": True,
            "true": value is True,
            "false": value is False,
            "negative": isinstance(value, float) and value < 0,
            "positive": isinstance(value, int | float) and value > 0,
        }[self.bad]


def column(key: str, heading: str) -> Metric:
    """The metric of this key under a shorter heading; one that is shown as it is where the key is none."""
    return replace(declared(key) or Metric(key, heading), words=heading)


def declared(key: str) -> Metric | None:
    """The metric of this key; ``None`` where the project declares none."""
    return next((m for m in _declared() if m.key == key), None)


def known_metrics(results: Sequence[Summarised]) -> Iterator[tuple[Metric, list[Any]]]:
    """The metrics to show of runs: those that at least one has, with the value of each (``None`` where it has none).

    By group; those that a scenario from outside the project declares come with the runs.
    """
    own = (Metric(**table) for r in results for table in r.config.get("metrics", ()))
    metrics = {m.key: m for m in (*_declared(), *own) if m.words}
    order = list(GROUPS)
    for metric in sorted(metrics.values(), key=lambda m: order.index(m.group)):
        values = [_value_shown(metric, r.summary) for r in results]
        if any(v is not None for v in values):
            yield metric, values


def in_order(summary: Mapping[str, Any]) -> dict[str, Any]:
    """A summary by groups, in the order in which the metrics are declared; what is not declared comes last."""
    order, place = list(GROUPS), {m.key: (m.group, i) for i, m in enumerate(_declared())}
    keys = sorted(summary, key=lambda k: (order.index(place[k][0]), place[k][1]) if k in place else (len(order), 0))
    return {key: summary[key] for key in keys}


def _value_shown(metric: Metric, summary: Mapping[str, Any]) -> Any:
    """The value; ``None`` for a bound that says nothing."""
    value = summary.get(metric.key)
    return None if metric.group == "guarantee" and not _premises_held(summary, metric.key) else value


def _premises_held(summary: Mapping[str, Any], key: str) -> bool:
    """Whether a bound says something: conditions were met, and what they promise is above ``DEEP``."""
    if key.startswith("disturbance"):
        return True
    if summary.get("relaxed_fraction") or summary.get("qp_failures"):
        return False
    bound = summary.get("bound_running_min_m")
    return bound is None or bound > DEEP


def _declared() -> tuple[Metric, ...]:
    # here: the declarations are made of what this module defines
    from experiments.metrics.declared import METRICS
    from experiments.metrics.declared_motion import DRAWN, FEET, ONE_LEG, WALKING

    return tuple({m.key: m for m in (*METRICS, *WALKING, *FEET, *ONE_LEG, *DRAWN)}.values())
