"""A network that is slow, uneven and loses some of what it carries."""

import heapq
from typing import Generic, TypeVar

import numpy as np

from sims.twin.faults import Fault

T = TypeVar("T")


class Link(Generic[T]):
    """One direction of a network: what comes out when. Without a fault all comes out at once.

    Args:
        rng: source of jitter and losses.
    """

    names = ("network",)
    """Of the faults that begin here."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._delay = self._jitter = self._loss = 0.0
        self._way: list[tuple[float, int, T]] = []
        self._sent = 0

    def begin(self, fault: Fault, t: float) -> None:
        """Begin to delay by the first number and up to the second more [ms], and to lose the third [%]."""
        self._delay, self._jitter = 1e-3 * fault.number(0), 1e-3 * fault.number(1)
        self._loss = fault.number(2) / 100.0

    def clear(self, name: str | None = None) -> None:
        """End the fault; what is on its way still comes when it would have."""
        if name in (None, *self.names):
            self._delay = self._jitter = self._loss = 0.0

    def send(self, thing: T, t: float) -> None:
        """Send a thing at ``t`` [s]."""
        if self._loss and self._rng.random() < self._loss:
            return
        late = self._delay + (self._jitter * float(self._rng.random()) if self._jitter else 0.0)
        self._sent += 1
        heapq.heappush(self._way, (t + late, self._sent, thing))

    def due(self, t: float) -> list[T]:
        """What has arrived by ``t`` [s], in the order of its arrival."""
        out = []
        while self._way and self._way[0][0] <= t + 1e-9:
            out.append(heapq.heappop(self._way)[2])
        return out
