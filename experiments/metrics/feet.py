"""Metrics of side steps: how close the feet and the legs came."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from robots.description import RobotDescription
from robots.errors import DescriptionError
from robots.messages import Array

FEET = ("left_foot", "right_foot")
"""Collision bodies of the feet, by the names that descriptions give them."""


def feet_column(robot: RobotDescription) -> int:
    """Column of the series ``h_self_collision`` that holds the barrier between the feet.

    Raises:
        DescriptionError: the feet are no self-collision pair of the description.
    """
    for column, pair in enumerate(robot.self_collision_pairs):
        if set(pair) == set(FEET):
            return column
    raise DescriptionError(robot.file, "self_collision.leg_pairs", robot.leg_pairs, f"with the pair {list(FEET)}")


def feet_metrics(robot: RobotDescription, series: Mapping[str, Array]) -> dict[str, Any]:
    """How close feet and legs came, and the steps taken.

    Args:
        robot: that ran.
        series: recorded.

    Returns:
        Smallest true barrier between the feet and among all pairs of legs [m], fraction of time in which the feet and
        in which any pair of legs penetrated each other, and number of steps.
    """
    pairs = series["h_self_collision"]
    feet = pairs[:, feet_column(robot)]
    legs = pairs[:, pairs.shape[1] - len(robot.leg_pairs) :].min(axis=1)
    return {
        "min_h_feet_m": float(feet.min()),
        "min_h_legs_m": float(legs.min()),
        "feet_penetrate_fraction": float((feet < 0).mean()),
        "legs_penetrate_fraction": float((legs < 0).mean()),
        "steps": steps_taken(series["in_contact"]),
    }


def steps_taken(in_contact: Array) -> int:
    """How often a foot has come down, by plan: ``in_contact`` (T, 2) per tick."""
    return int((np.diff(in_contact, axis=0) > 0).sum())
