"""Hands sent a metre out of reach: what the commanded velocity does where arms go straight, damped and cut."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from experiments.metrics.metric import Metric
from experiments.running.run import run
from experiments.scenarios.hand_tracking import HandTracking
from experiments.scenarios.options import FilterOptions
from robots.messages import Array

TARGETS: Mapping[str, tuple[float, float, float]] = {
    "up": (0.2, 0.2, 1.2),
    "out": (0.2, 1.3, 0.1),
    "ahead": (1.3, 0.2, 0.1),
}
"""Where the left hand is sent, from the torso's frame [m]; the right hand mirrors it."""

ROBOTS = ("g1", "tocabi")
FILTERS = ("none", "issf")
WAYS = ("cut", "damped")
"""Robots, safety filters and forms of KinWBC that are run."""

DURATION = 5.0
"""Of each run [s]."""

LIMIT = 0.3
"""Steps of the command above this count as jumps [rad/s]."""

TITLE = f"hands out of reach, {DURATION:g} s"
"""Of the table."""

COLUMNS = (
    Metric("robot", "robot"),
    Metric("target", "target"),
    Metric("filter", "filter"),
    Metric("singular", "singular values"),
    Metric("step_max", "step of the command, max", "rad/s"),
    Metric("jumps", f"ticks with more than {LIMIT:g} rad/s"),
    Metric("step_end", "the same in the last second, max", "rad/s"),
    Metric("torque_step_max", "torque step / limit", "%", 1e2),
    Metric("torque_max", "torque / limit", "%", 1e2),
)


def straight_study(
    robots: Sequence[str] = ROBOTS,
    targets: Sequence[str] = tuple(TARGETS),
    filters: Sequence[str] = FILTERS,
    duration: float = DURATION,
) -> list[tuple[dict[str, Any], dict[str, Array]]]:
    """Figures and series of every robot, target and filter, with singular values cut off and damped."""
    runs: list[tuple[dict[str, Any], dict[str, Array]]] = []
    for robot in robots:
        for target in targets:
            for name in filters:
                for way in WAYS:
                    scenario = HandTracking(
                        robot=robot,
                        duration=duration,
                        motion="target",
                        target=TARGETS[target],
                        singular=way,
                        safety=FilterOptions(filter=name),
                    )
                    result = run(scenario)
                    case = {"robot": robot, "target": target, "filter": name, "singular": way}
                    figures = step_figures(result.series, result.config["controller"]["dt"])
                    figures["torque_step_max"] = result.summary["torque_step_max"]
                    figures["torque_max"] = result.summary["max_torque_fraction"]
                    runs.append((case | figures, dict(result.series)))
    return runs


def step_figures(series: Mapping[str, Array], dt: float) -> dict[str, Any]:
    """How much the joints' commanded velocity changes from tick to tick, in a run with ticks of ``dt`` [s]."""
    steps = command_steps(series)
    return {
        "step_max": float(steps.max()),
        "jumps": int((steps > LIMIT).sum()),
        "step_end": float(steps[-round(1.0 / dt) :].max()),
    }


def command_steps(series: Mapping[str, Array]) -> Array:
    """Largest change of a joint's commanded velocity from each tick to the next, shape (ticks - 1,) [rad/s]."""
    steps: Array = np.abs(np.diff(series["v_safe"][:, 6:], axis=0)).max(axis=1)
    return steps
