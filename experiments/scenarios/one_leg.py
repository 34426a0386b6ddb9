"""Set-up and metrics of standing on one leg while the hands go to far targets: section 5.3.1 of Lee et al."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from controllers.gaits.gait import Gait
from controllers.gaits.one_leg import HandsThereAndBack, OneLeg, OneLegTuning
from controllers.motions.hands import Motion
from controllers.reference import WholeBodyReference
from controllers.whole_body.config import BalanceTuning, FilterTuning
from controllers.whole_body.feedforward import TORQUE_MODES
from controllers.whole_body.robot_config import controller_config, from_table
from experiments.scenarios.hand_motions import arm_length
from experiments.scenarios.options import FilterOptions
from experiments.scenarios.resolve import filter_changes
from experiments.scenarios.scenario import Setup
from robots.checks import require_one_of
from robots.description import RobotDescription
from robots.kinematics import Kinematics
from robots.messages import Array

ARM = 0.7473
"""Length of the paper's robot's arm, by :func:`experiments.scenarios.hand_motions.arm_length` [m]."""

LEFT_WAY, RIGHT_WAY = np.array([0.0, 0.6, 0.6]), np.array([0.0, -0.3, -0.3])
"""Ways of the hands, world axes, for that arm; others go as far in proportion [m]."""

BALANCE_WEIGHT = 1e5
"""Weight of feet and balance in the filter's cost, a hundred times the default: a hand that pulls towards a target out
of reach pulls all the time, and with the default draws the CoM a centimetre away, half of what a narrow sole has."""

SWING_WEIGHT = 1e3
"""Weight of the raised foot's position: more than the hands have, less than balance. It gives way where its ankle comes
to a limit, as on the G1, whose foot is then held 2 cm further in."""

WORKSPACE_ALPHA, WORKSPACE_EPSILON = 10.0, 0.3
"""Of the workspace bounds [1/s, m s/rad^2], against 5 and 5 elsewhere. An arm that is nearly straight has a short
gradient, so little margin by the ISSf term, while the body that carries it moves; and a joint with dry friction draws
the arm in only once its velocity command is large enough."""

UP = 0.1
"""The foot counts as up from this height of its sole's centre over where it stood [m]."""


def one_leg_setup(robot: RobotDescription, safety: FilterOptions, torque: str, load_estimate: bool) -> Setup:
    """Set-up of a robot that stands on its left leg; arguments as the options of a :class:`Taichi`.

    Raises:
        ConfigError: an option, or the description's ``[tuning.taichi]``, is not allowed.
    """
    require_one_of("torque", torque, TORQUE_MODES)
    tuning = from_table(OneLegTuning, robot, "taichi")
    # the hands wait for the gait that was made before them
    gaits: list[OneLeg] = []

    def gait(kin: Kinematics) -> Gait:
        gaits.append(OneLeg(kin, tuning))
        return gaits[-1]

    def hands(robot: RobotDescription, reference: WholeBodyReference) -> Motion:
        assert reference.hands is not None
        left, right = (hand.position.copy() for hand in reference.hands)
        return HandsThereAndBack(gaits[-1], (left, right), hand_targets(robot, left, right), tuning)

    changes = _changes(robot, safety, torque, load_estimate)
    return Setup(
        hands=hands,
        gait=gait,
        changes=changes,
        settings={"taichi": dataclasses.asdict(tuning)},
        reference_motion=True,
    )


def _changes(robot: RobotDescription, options: FilterOptions, torque: str, load_estimate: bool) -> dict[str, Any]:
    """What the controller needs besides the robot's own tuning, see the constants of this module."""
    safety: FilterTuning = filter_changes(robot, options)["safety"]
    safety = dataclasses.replace(
        safety,
        foot_weight=BALANCE_WEIGHT,
        swing_weight=SWING_WEIGHT,
        balance_weight=BALANCE_WEIGHT,
        workspace=dataclasses.replace(safety.workspace, alpha=WORKSPACE_ALPHA, epsilon=WORKSPACE_EPSILON),
    )
    changes: dict[str, Any] = {"torque": torque, "safety": safety}
    if load_estimate:
        gain = controller_config(robot).balance.dcm_gain
        changes["balance"] = BalanceTuning(dcm_gain=gain, mass_time_constant=1.0)
    return changes


def hand_targets(robot: RobotDescription, left: Array, right: Array) -> tuple[Array, Array]:
    """Where the hands go from ``left`` and ``right``, (3,) each, world [m]."""
    kin = Kinematics(robot)
    ways = ((left, "left", LEFT_WAY), (right, "right", RIGHT_WAY))
    first, second = (start + arm_length(kin, side) / ARM * way for start, side, way in ways)
    return first, second


def one_leg_metrics(series: Mapping[str, Array]) -> dict[str, Any]:
    """Metrics of a run: how long the foot was up, what it carries at the end.

    Returns:
        ``foot_up_s``: time for which the right sole was higher than ``UP`` [s]; ``right_load_end``: fraction of the
        vertical force that the right foot carries at the end, 0 where the feet carry nothing.
    """
    height = series["soles"][:, 1, 2] - series["soles"][0, 1, 2]
    force = series["foot_wrench"][-1, :, 2]
    dt = float(series["time"][1] - series["time"][0]) if len(series["time"]) > 1 else 0.0
    return {
        "foot_up_s": round(dt * int((height > UP).sum()), 9),
        "right_load_end": float(force[1] / force.sum()) if force.sum() > 0 else 0.0,
    }
