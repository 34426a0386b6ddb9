"""The fastest walk forward that a robot does not fall in."""

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.gaits.walking import walk_tuning
from experiments.metrics.metric import Metric
from experiments.recording.recording import save_result
from experiments.running.pool import Row, row
from experiments.running.run import run
from experiments.scenarios.options import PlantOptions
from experiments.scenarios.walk import Walk
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


def fastest_walk(robot: str, mass_scale: float, duration: float, folder: Path) -> Row:
    """The largest speed, on a grid of ``STEP`` up from ``SLOWEST``, before the first at which the robot falls.

    Where it falls at ``SLOWEST`` already the search goes down instead. It ends where longer steps would be needed.

    Returns:
        A line: ``fastest``, ``achieved`` in that walk, ``falls_at``, ``reach`` of the longest steps [m/s]; ``None``
        where there is none.
    """
    start, runs = time.process_time(), 0
    reach = walk_tuning(load_robot(robot)).fastest(1.0).vx

    def walk(speed: float) -> Row:
        nonlocal runs
        runs += 1
        scenario = Walk(robot=robot, vx=speed, duration=duration, plant=PlantOptions(mass_scale=mass_scale))
        result = run(scenario)
        save_result(result, folder / f"{robot}-mass-{mass_scale:g}-{speed:.2f}", series=False)
        return row(result) | {"achieved": achieved_speed(result.series)}

    fastest, achieved, falls_at = climb(walk, reach)
    return {
        "robot": robot,
        "mass_scale": mass_scale,
        "fastest": fastest,
        "achieved": achieved,
        "falls_at": falls_at,
        "reach": reach,
        "runs": runs,
        "cpu_s": time.process_time() - start,
    }


def climb(walk: Callable[[float], Row], reach: float) -> tuple[float | None, float | None, float | None]:
    """Search of :func:`fastest_walk`.

    Args:
        walk: line of a walk at a speed [m/s]: ``ended``, ``achieved``.
        reach: highest speed to try [m/s].

    Returns:
        Largest speed survived, what was achieved in it, lowest speed tried at which the robot fell; ``None`` where
        there is none [m/s].
    """
    fastest, achieved, falls_at = None, None, None
    top = int(reach / STEP + 1e-9)
    index = min(round(SLOWEST / STEP), top)
    while 0 < index <= top:
        speed = round(index * STEP, 9)
        tried = walk(speed)
        if tried["ended"] == "no":
            fastest, achieved = speed, tried["achieved"]
            if falls_at is not None:
                break
            index += 1
        else:
            falls_at = speed
            if fastest is not None:
                break
            index -= 1
    return fastest, achieved, falls_at


def achieved_speed(series: Mapping[str, NDArray[Any]]) -> float:
    """Mean speed of the base between the middle of the walk and four seconds before its end, by its way [m/s].

    Four: the command to stop comes three seconds before the end.
    """
    times, place = series["time"], series["q"][:, :2]
    first, last = np.searchsorted(times, [0.5 * times[-1], times[-1] - 4.0])
    seconds = float(times[last] - times[first])
    return float(np.linalg.norm(place[last] - place[first])) / seconds if seconds > 0 else 0.0
