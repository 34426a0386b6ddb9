"""The tables of docs/output.md, made from the declarations: ``python -m experiments.cli.output_page FILE``."""

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from experiments.metrics.declared import METRICS
from experiments.metrics.deployment import DEPLOYMENT
from experiments.metrics.estimate import ESTIMATE
from experiments.metrics.metric import GROUPS, Metric
from experiments.recording.channels import CHANNELS, CLOCKS
from experiments.recording.deployment_channels import DEPLOYMENT_CHANNELS
from experiments.scenarios.registry import SCENARIOS
from robots.errors import ConfigError

BEGIN, END = "<!-- {}: made from the declarations by make docs-output -->", "<!-- end -->"
"""Around a table in the page; the name tells which."""


def tables() -> dict[str, str]:
    """Every table by the name that its place in the page has."""
    made = {"metrics": _table(("key", "unit", "meaning"), _common_metrics())}
    made["metrics of scenarios"] = _table(("key", "scenarios", "unit", "meaning"), _own_metrics())
    for clock in CLOCKS:
        rows = ((f"`{c.name}`", c.shape, c.unit, c.meaning) for c in CHANNELS if c.per == clock)
        made[f"arrays per {clock}"] = _table(("array", "shape", "unit", "meaning"), rows)
    arrays = ((f"`{c.name}`", c.shape, c.unit, c.meaning) for c in DEPLOYMENT_CHANNELS)
    made["arrays of a deployment"] = _table(("array", "shape", "unit", "meaning"), arrays)
    figures = ((f"`{m.key}`", m.words, m.unit if m.factor == 1.0 else "") for m in DEPLOYMENT)
    made["metrics of a deployment"] = _table(("key", "what it is", "unit"), figures)
    return made


def with_tables(page: str) -> str:
    """The page with every table in its place as the declarations have it now.

    Raises:
        ConfigError: a table has no place in the page.
    """
    for name, table in tables().items():
        begin = BEGIN.format(name)
        if page.count(begin) != 1:
            raise ConfigError("page", page[:40], f"with the line {begin!r} once")
        before, _, rest = page.partition(begin)
        page = f"{before}{begin}\n{table}\n{END}" + rest.partition(END)[2]
    return page


def _common_metrics() -> Iterator[tuple[str, ...]]:
    for group, title in GROUPS.items():
        found = [m for m in (*METRICS, *ESTIMATE) if m.group == group]
        if found:
            yield (f"**{title}**", "", "")
        yield from ((f"`{m.key}`", m.stored, m.meaning) for m in found)


def _own_metrics() -> Iterator[tuple[str, ...]]:
    owners: dict[str, list[str]] = {}
    metrics: dict[str, Metric] = {}
    for scenario in SCENARIOS:
        for metric in scenario.metrics:
            owners.setdefault(metric.key, []).append(f"`{scenario.name}`")
            metrics[metric.key] = metric
    for key, metric in metrics.items():
        yield f"`{key}`", ", ".join(owners[key]), metric.stored, metric.meaning


def _table(head: Sequence[str], rows: Iterator[tuple[str, ...]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


if __name__ == "__main__":
    path = Path(sys.argv[1])
    path.write_text(with_tables(path.read_text(encoding="utf-8")), encoding="utf-8")
