"""The fastest walk forward that a robot does not fall in."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.gaits.walking import walk_tuning
from experiments.metrics.metric import Metric
from experiments.recording.recording import Recording
from experiments.running.run_rows import run_row
from experiments.scenarios.options import PlantOptions
from experiments.scenarios.walk import Walk
from experiments.studies.case import Case, Row, content_key
from experiments.studies.runs import run_case
from experiments.studies.search import Bracket, largest_that_holds
from experiments.studies.sections import Entries
from experiments.studies.store import RowStore, sound
from robots.loader import load_robot

SLOWEST, STEP, WALK_TIME = 0.3, 0.05, 20.0
"""Where the search begins, its steps [m/s], and the time of each walk [s]."""

SPEED_COLUMNS = (
    Metric("robot", "robot"),
    Metric("mass_scale", "mass"),
    Metric("fastest", "fastest that does not fall", "m/s"),
    Metric("achieved", "achieved", "m/s"),
    Metric("falls_at", "falls at", "m/s"),
    Metric("reach", "longest steps allow", "m/s"),
    Metric("runs", "runs"),
)


@dataclass(frozen=True, slots=True)
class FastestWalk:
    """Searches the largest speed, on a grid of ``STEP``, before the first at which the robot falls.

    It begins at ``SLOWEST`` and goes up, or down where the robot falls there already. It ends where longer steps would
    be needed than the robot's tuning allows.

    Attributes:
        robot: name, or path of a description.
        mass_scale: of the simulated robot.
        duration: of each walk [s].
        below: folder of the walks, below that of the study.
    """

    robot: str
    mass_scale: float
    duration: float
    below: str

    def __call__(self, store: RowStore) -> Entries:
        """Search; every walk is a row of its own.

        Returns:
            ``fastest``, ``achieved`` in that walk, ``falls_at``, ``reach`` of the longest steps [m/s]; ``None`` where
            there is none.
        """
        return climb(self, self.reach(), store.obtain)

    def reach(self) -> float:
        """Speed of the longest steps [m/s]."""
        return float(walk_tuning(load_robot(self.robot)).fastest(1.0).vx)

    def walk(self, level: int) -> Case:
        """The walk at a level of the grid."""
        speed, plant = speed_of(level), PlantOptions(mass_scale=self.mass_scale)
        scenario = Walk(robot=self.robot, vx=speed, duration=self.duration, plant=plant)
        folder = f"{self.below}{self.robot}-mass-{self.mass_scale:g}-{speed:.2f}"
        return run_case(scenario, {"speed": speed}, folder, series=False, measure=walk_row)

    def case(self) -> Case:
        """The search as a case."""
        content = [self.walk(1).key, STEP, SLOWEST]
        labels = {"robot": self.robot, "mass_scale": self.mass_scale}
        return Case(content_key("fastest-walk", content), labels, self)


def climb(search: FastestWalk, reach: float, obtain: Callable[[Case], Row]) -> Entries:
    """The search of :class:`FastestWalk`.

    Args:
        search: whose walks are tried.
        reach: highest speed to try [m/s].
        obtain: gives the row of a walk.
    """
    tried: dict[int, Entries] = {}

    def stays_up(level: int) -> bool:
        tried[level] = sound(obtain(search.walk(level)))
        return bool(tried[level]["ended"] == "no")

    top = int(reach / STEP + 1e-9)
    level = largest_that_holds(stays_up, Bracket(top, round(SLOWEST / STEP), 1))
    return {
        "fastest": speed_of(level) if level else None,
        "achieved": tried[level]["achieved"] if level else None,
        "falls_at": speed_of(level + 1) if level < top else None,
        "reach": reach,
        "runs": len(tried),
        "cpu_s": sum(entries["cpu_s"] for entries in tried.values()),
    }


def speed_of(level: int) -> float:
    """Speed of a level of the grid [m/s]."""
    return round(level * STEP, 9)


def walk_row(result: Recording) -> Entries:
    """Summary, how the walk ended, and the speed achieved."""
    return run_row(result) | {"achieved": achieved_speed(result.series)}


def achieved_speed(series: Mapping[str, NDArray[Any]]) -> float:
    """Mean speed of the base between the middle of the walk and four seconds before its end, by its way [m/s].

    Four: the command to stop comes three seconds before the end.
    """
    times, place = series["time"], series["q"][:, :2]
    first, last = np.searchsorted(times, [0.5 * times[-1], times[-1] - 4.0])
    seconds = float(times[last] - times[first])
    return float(np.linalg.norm(place[last] - place[first])) / seconds if seconds > 0 else 0.0
