"""What several tests of the corridor need."""

from controllers.policies.nominal import benchmark_limits
from experiments.running.corridor_loop import NAIVE, CorridorLoop, CorridorRun
from robots.messages import Array
from safety.barriers.rows import BarrierRows, HalfSpaces
from safety.filters.conditions import SET_MARGINS, BarrierParameters, ssa

DURATION = 8.0
"""The boards have closed, the goal has moved into one of them and the sphere is at the elbow [s]."""

COMPARED = ("pssa", "rssa", NAIVE, "ssa", "cbf")


def conditions(loop: CorridorLoop, run: CorridorRun, tick: int) -> tuple[BarrierRows, HalfSpaces, Array]:
    """Rows and SSA's conditions at a tick of a run, evaluated anew, and the bound of each velocity."""
    loop.kin.update_geometry(run.series["q"][tick])
    loop.obstacle_barrier.set_obstacles(loop.scene.obstacles(float(run.series["time"][tick])))
    rows = loop.barriers.evaluate(loop.kin)
    spaces = ssa(rows, BarrierParameters().of_rows(rows.family, SET_MARGINS))
    return rows, spaces, benchmark_limits(loop.kin)
