"""What a rehearsal leaves behind, whether it was played by processes in real time or in one of its own."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from controllers.deployment.stages import Stage
from robots.messages import Array

STOPS = (Stage.STOPPING.value, Stage.DAMPED.value)
"""Stages that a stop leads to."""


@dataclass(frozen=True)
class Performance:
    """One rehearsal.

    Attributes:
        truth: what was true at the twin, a row every 2 ms: ``monotonic``, ``time``, ``q``, ``v``, ...
        said: what the deployment said, with the time on the clock of ``monotonic`` [s].
        orders: what the twin, or a process, was told, likewise.
        figures: of deadlines and states.
        exit_code: of the deployment's process, if it was one.
        pauses: shape (n, 2) of the machine: when each began, and how long it was [s].
    """

    truth: Mapping[str, Array]
    said: Sequence[tuple[float, str]]
    orders: Sequence[tuple[float, str]] = ()
    figures: Mapping[str, Any] = field(default_factory=dict)
    exit_code: int | None = None
    pauses: Array = field(default_factory=lambda: np.empty((0, 2)))

    def said_at(self, begins: str) -> float:
        """When a line that begins so was first said [s]; NaN for never."""
        return next((t for t, text in self.said if text.startswith(begins)), float("nan"))

    @property
    def decided_at(self) -> float:
        """When it was decided what came of it: the first stop with a cause, or the last order, or the end [s]."""
        for t, text in self.said:
            stage, _, cause = text.partition(": ")
            if stage in STOPS and cause:
                return t
        return self.orders[-1][0] if self.orders else float(self.truth["monotonic"][-1])

    @property
    def cause(self) -> str:
        """What the deployment was stopped for; empty where it was not."""
        for _, text in self.said:
            stage, _, cause = text.partition(": ")
            if stage in STOPS and cause:
                return cause
        return ""


def upright(truth: Mapping[str, Array], since: float, until: float) -> bool:
    """Whether the robot stood on its feet between two times of ``monotonic`` [s]: no tilt over 30 degrees, not low."""
    chosen = (truth["monotonic"] >= since) & (truth["monotonic"] <= until)
    q = truth["q"][chosen]
    if not len(q):
        return False
    cosine = 1.0 - 2.0 * (q[:, 3] ** 2 + q[:, 4] ** 2)
    return bool(cosine.min() > np.cos(np.deg2rad(30.0)) and q[:, 2].min() > 0.75 * q[0, 2])


def braked_after(performance: Performance) -> float:
    """Time from the last order to when the motors were told only to brake, and nothing else from then on [s].

    NaN where they were not, or not to the end.
    """
    truth, since = performance.truth, performance.orders[-1][0]
    stiff = np.flatnonzero((truth["monotonic"] < since) | ~truth["damped"].astype(bool))
    first = 0 if stiff.size == 0 else int(stiff[-1]) + 1
    times = truth["monotonic"]
    return float(times[first] - since) if first < len(times) else float("nan")
