"""All metrics that the project declares, and what follows from the declarations."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from experiments.metrics.declared import METRICS
from experiments.metrics.declared_motion import DRAWN, FEET, ONE_LEG, WALKING
from experiments.metrics.estimate import ESTIMATE
from experiments.metrics.metric import DEEP, GROUPS, Metric, Summarised

DECLARED = tuple({m.key: m for m in (*METRICS, *ESTIMATE, *WALKING, *FEET, *ONE_LEG, *DRAWN)}.values())
"""In the order to show them."""

DECLARED_KEYS = tuple(m.key for m in DECLARED)
"""Their names in ``summary.json``."""


def column(key: str, heading: str) -> Metric:
    """The metric of this key under a shorter heading; one that is shown as it is where the key is none."""
    return replace(declared(key) or Metric(key, heading), words=heading)


def declared(key: str) -> Metric | None:
    """The metric of this key; ``None`` where the project declares none."""
    return next((m for m in DECLARED if m.key == key), None)


def known_metrics(results: Sequence[Summarised]) -> Iterator[tuple[Metric, list[Any]]]:
    """The metrics to show of runs: those that at least one has, with the value of each (``None`` where it has none).

    By group; those that a scenario from outside the project declares come with the runs.
    """
    own = (Metric(**table) for r in results for table in r.config.get("metrics", ()))
    metrics = {m.key: m for m in (*DECLARED, *own) if m.words}
    order = list(GROUPS)
    for metric in sorted(metrics.values(), key=lambda m: order.index(m.group)):
        values = [_value_shown(metric, r.summary) for r in results]
        if any(v is not None for v in values):
            yield metric, values


def in_order(summary: Mapping[str, Any]) -> dict[str, Any]:
    """A summary by groups, in the order in which the metrics are declared; what is not declared comes last."""
    order, place = list(GROUPS), {m.key: (m.group, i) for i, m in enumerate(DECLARED)}
    keys = sorted(summary, key=lambda k: (order.index(place[k][0]), place[k][1]) if k in place else (len(order), 0))
    return {key: summary[key] for key in keys}


def _value_shown(metric: Metric, summary: Mapping[str, Any]) -> Any:
    """The value; ``None`` for a bound that says nothing."""
    value = summary.get(metric.key)
    return None if metric.group == "guarantee" and not _premises_held(summary, metric.key) else value


def _premises_held(summary: Mapping[str, Any], key: str) -> bool:
    """Whether a bound says something: conditions were met, and what they guarantee is above ``DEEP``."""
    if key.startswith("disturbance"):
        return True
    if summary.get("relaxed_fraction") or summary.get("qp_failures"):
        return False
    bound = summary.get("bound_running_min_m")
    return bound is None or bound > DEEP
