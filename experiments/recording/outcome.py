"""How a run ended."""

from dataclasses import dataclass


@dataclass(slots=True)
class Outcome:
    """How a run ended: time of a fall [s] or ``None``, time simulated [s]."""

    fell_at: float | None
    duration: float
