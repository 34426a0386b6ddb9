"""A sweep: hand tracking of robots of several masses without and with a filter, as rows that survive a kill.

python examples/sweep.py
"""

import tempfile
from collections.abc import Sequence
from pathlib import Path

from experiments.scenarios.hand_tracking import HandTracking
from experiments.studies.backends import LocalBackend
from experiments.studies.case import Study
from experiments.studies.engine import carry_out
from experiments.studies.grid import make_sweep
from experiments.studies.tables import pivot
from experiments.studies.values import Choices


def main(
    duration: float = 3.0, masses: Sequence[float] = (1.0, 1.2), jobs: int = 2, folder: Path | None = None
) -> list[float]:
    """Run every filter with every mass; returns the smallest self-collision barrier of each run [mm].

    In a ``folder`` the rows stay: started again with it, only what is missing is run.
    """
    values = {"filter": Choices(("none", "issf")), "mass_scale": Choices(tuple(masses))}
    sweep = make_sweep(HandTracking(duration=duration), values, series=False)
    with tempfile.TemporaryDirectory() as temporary:
        rows = carry_out(Study("masses", sweep.cases), folder or Path(temporary), LocalBackend(jobs))
    print(pivot(rows, "filter", "mass_scale", "min_h_self_collision_m", "min").markdown())
    return [1e3 * row.metrics["min_h_self_collision_m"] for row in rows]


if __name__ == "__main__":
    main()
