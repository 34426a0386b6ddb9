"""What a metric is: its key in a summary, what it means, and how people read it. Imports nothing heavy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
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
    "estimate": "state estimate",
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
