"""Side steps that would make the feet collide: the locomotion of section 5.2.1 of Lee et al."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from controllers.gaits.gait import Gait
from controllers.gaits.lateral_steps import LateralSteps, lateral_step_tuning
from controllers.gaits.walking import walk_tuning, walking_changes
from experiments.recording.recording import RunResult
from experiments.running.run import check_options, run
from experiments.scenarios.options import LateralStepsOptions
from experiments.scenarios.scenario import Scenario, Series
from robots.description import RobotDescription
from robots.errors import DescriptionError
from robots.kinematics import Kinematics

FEET = ("left_foot", "right_foot")
"""Collision bodies of the feet, by the names that descriptions give them."""


def check_lateral_steps(options: LateralStepsOptions) -> RobotDescription:
    """Check every option before anything is made or written; returns the robot.

    Raises:
        SafeWbcError: an option is not allowed, or the robot's description lacks what the side steps need.
    """
    robot = check_options(options)
    lateral_step_tuning(robot)
    walk_tuning(robot)
    feet_column(robot)
    return robot


def feet_column(robot: RobotDescription) -> int:
    """Column of the series ``h_self_collision`` that holds the barrier between the feet.

    Raises:
        DescriptionError: the feet are no self-collision pair of the description.
    """
    for column, pair in enumerate(robot.self_collision_pairs):
        if set(pair) == set(FEET):
            return column
    raise DescriptionError(robot.file, "self_collision.leg_pairs", robot.leg_pairs, f"with the pair {list(FEET)}")


def run_lateral_steps(options: LateralStepsOptions, progress: Callable[[float], None] | None = None) -> RunResult:
    """Take the side steps of ``[tuning.lateral_steps]``; see :func:`experiments.running.run.run`.

    Raises:
        SafeWbcError: an option is not allowed; nothing has run then.
    """
    robot = check_lateral_steps(options)
    changes = walking_changes(robot, options.load_estimate)
    settings = {
        "walking": dataclasses.asdict(walk_tuning(robot)),
        "lateral_steps": dataclasses.asdict(lateral_step_tuning(robot)),
    }
    scenario = Scenario("lateral-steps", gait=_gait, changes=changes, settings=settings, figures=feet_figures)
    return run(scenario, options, progress)


def _gait(kin: Kinematics) -> Gait:
    return LateralSteps(kin, lateral_step_tuning(kin.robot), walk_tuning(kin.robot))


def feet_figures(robot: RobotDescription, series: Series) -> dict[str, Any]:
    """How close feet and legs came, and the steps taken.

    Args:
        robot: that ran.
        series: recorded.

    Returns:
        Smallest true barrier between the feet and among all pairs of legs [m], share of time in which the feet and in
        which any pair of legs penetrated each other, and number of steps.
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


def steps_taken(in_contact: np.ndarray) -> int:
    """How often a foot has come down, by plan: ``in_contact`` (T, 2) per tick."""
    return int((np.diff(in_contact, axis=0) > 0).sum())
