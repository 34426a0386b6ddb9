"""What a rehearsal came to, in figures: from what was true at the twin and what the deployment said."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from controllers.deployment.stages import Stage
from experiments.rehearsal.fault_cases import Expected, FaultCase
from experiments.rehearsal.performance import Performance, braked_after, upright
from experiments.running.ground_truth import TrueBarriers
from robots.description import RobotDescription
from robots.messages import Array

DONE = "the task is over"

FAMILIES = ("self_collision", "leg_collision", "joint_limit")

HELD_FOR = 2.5
"""How long a robot that holds has to stand, before the hoist is raised [s]."""


def least_barriers(robot: RobotDescription, truth: Mapping[str, Array], since: float, until: float) -> dict[str, float]:
    """Smallest true barrier of each family between two times [s]; metres, or rad of joints."""
    barriers = TrueBarriers(robot, ())
    least = dict.fromkeys(FAMILIES, np.inf)
    chosen = (truth["monotonic"] >= since) & (truth["monotonic"] <= until)
    for q in truth["q"][chosen]:
        h = barriers.evaluate(q).h
        for family in FAMILIES:
            least[family] = min(least[family], float(h[barriers.slices[family]].min()))
    return least


def task_figures(robot: RobotDescription, performance: Performance) -> dict[str, Any]:
    """How a task went."""
    p = performance
    began, stopped = p.said_at(Stage.TASK.value), p.said_at(Stage.STOPPING.value)
    done = p.cause == DONE
    until = stopped if np.isfinite(stopped) else p.truth["monotonic"][-1]
    until_raised = p.said_at(Stage.DAMPED.value)
    standing = until if np.isnan(until_raised) else min(until + HELD_FOR, until_raised)
    least = least_barriers(robot, p.truth, began, until)
    chosen = (p.truth["monotonic"] >= began) & (p.truth["monotonic"] <= until)
    xy = p.truth["q"][chosen][:, :2]
    return {
        "done": done,
        "upright": bool(np.isfinite(began)) and done and upright(p.truth, p.said_at(Stage.STANDING.value), standing),
        "safe": all(value > 0.0 for value in least.values()),
        "cause": p.cause,
        "way_m": float(np.linalg.norm(xy[-1] - xy[0])) if len(xy) else float("nan"),
        **{f"min_h_{family}": value for family, value in least.items()},
        **p.figures,
    }


def fault_figures(case: FaultCase, performance: Performance, raised_at: float) -> dict[str, Any]:
    """What a fault led to, and whether that is as expected.

    Args:
        case: the fault.
        performance: with the fault as its last order.
        raised_at: when the hoist was raised, NaN for never [s].
    """
    p, at = performance, performance.orders[-1][0]
    after = [(t - at, text) for t, text in p.said if t >= at]
    stops = [(t, text) for t, text in after if text.startswith((Stage.STOPPING.value, Stage.DAMPED.value))]
    reacted = next((t for t, _ in stops), float("nan"))
    damped = next((t for t, text in stops if text.startswith(Stage.DAMPED.value)), float("nan"))
    cause = next((text for _, text in stops), "")
    braked = braked_after(p)
    found = {"reacts_s": reacted, "brakes_s": braked, "cause": cause.partition(": ")[2]}
    if case.expected in (Expected.GUARDIAN, Expected.DRIVES_DAMP):
        met = bool(braked <= case.within)
    elif case.expected is Expected.DRIVES_HOLD:
        met = bool(np.isnan(braked))
    elif case.expected is Expected.GOES_ON:
        # what it ends with has nothing to do with the fault
        found["brakes_s"] = None
        met = cause.endswith(DONE) and upright(p.truth, at, at + reacted)
    else:
        met = bool(reacted <= case.within and case.cause in cause)
        if case.expected in (Expected.DAMP, Expected.FADE):
            met = met and braked - reacted <= case.brakes
        else:
            until = min(at + reacted + HELD_FOR, raised_at if np.isfinite(raised_at) else np.inf)
            met = met and upright(p.truth, at, until) and not damped < reacted + HELD_FOR
    return {"as_expected": bool(met), "end": last_stage(p)} | found


def last_stage(performance: Performance) -> str:
    """The stage in which it ended."""
    stages = [stage.value for stage in Stage]
    said = [text.partition(":")[0] for _, text in performance.said]
    return next((text for text in reversed(said) if text in stages), "")
