"""Figures of merit of walking, from the recorded series."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from robots.messages import Array, Indices

Series = Mapping[str, NDArray[Any]]

PAIR = 2
"""Steps over which a velocity is measured: a left and a right one, so that the body's swaying cancels."""


def walk_metrics(series: Series, commands: Array | None = None) -> dict[str, Any]:
    """What any walk can be measured by.

    Args:
        series: recorded.
        commands: shape (T, 3) commanded forward [m/s], left [m/s] and turning velocity [rad/s] at each tick, zero for
            stop and for stepping on the spot; the errors of velocity are left out if not given.

    Returns:
        ``steps``; ``distance_m``, way of the middle between the soles from touchdown to touchdown;
        ``step_height_min_m``, smallest over the steps of how high the sole came; and :func:`velocity_errors`.
    """
    landings = touchdowns(series)
    middle = series["soles"][:, :, :2].mean(axis=1)
    way = middle[[0, *landings]]
    out = {
        "steps": len(landings),
        "distance_m": float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum()),
        "step_height_min_m": min(swing_heights(series), default=None),
    }
    return out if commands is None else out | velocity_errors(series, commands)


def touchdowns(series: Series) -> Indices:
    """Ticks at which the plan puts a foot down, in order."""
    contact = np.asarray(series["in_contact"], dtype=bool)
    return np.flatnonzero((contact[1:] & ~contact[:-1]).any(axis=1)) + 1


def swing_heights(series: Series) -> list[float]:
    """How high each finished swing took its sole above where it left the ground, left foot's first [m]."""
    contact, heights = np.asarray(series["in_contact"], dtype=bool), series["soles"][:, :, 2]
    out = []
    for foot in range(contact.shape[1]):
        change = np.diff(contact[:, foot].astype(int))
        landings = np.flatnonzero(change == 1)
        for lift in np.flatnonzero(change == -1):
            if (after := landings[landings > lift]).size:
                out.append(float(heights[lift : after[0] + 1, foot].max() - heights[lift, foot]))
    return out


def velocity_errors(series: Series, commands: Array) -> dict[str, float | None]:
    """Errors of the body's velocity against the command, each measured over a pair of steps.

    A pair counts where the command has been the same since the touchdown before it: one step to get to speed.

    Args:
        series: recorded.
        commands: shape (T, 3), see :func:`walk_metrics`.

    Returns:
        ``velocity_error_x_mps``, ``velocity_error_y_mps``, ``velocity_error_wz_radps``: mean over the pairs of the
        error's size; the same with ``_max`` before the unit: the largest; ``None`` where no pair counts.
    """
    landings = touchdowns(series)
    errors = [
        achieved_velocity(series, landings[i], landings[i + PAIR]) - commands[landings[i]]
        for i in range(1, len(landings) - PAIR)
        if (commands[landings[i - 1] : landings[i + PAIR] + 1] == commands[landings[i]]).all()
    ]
    sizes = np.abs(np.reshape(errors, (-1, 3)))
    out: dict[str, float | None] = {}
    for k, (name, unit) in enumerate((("x", "mps"), ("y", "mps"), ("wz", "radps"))):
        out[f"velocity_error_{name}_{unit}"] = float(sizes[:, k].mean()) if len(sizes) else None
        out[f"velocity_error_{name}_max_{unit}"] = float(sizes[:, k].max()) if len(sizes) else None
    return out


def achieved_velocity(series: Series, first: int, last: int) -> Array:
    r"""The constant velocity of the body, in its own heading, that takes it from its pose at one tick to another.

    .. math:: (v_x, v_y, \omega) = \operatorname{Log}(X_{first}^{-1} X_{last}) / \Delta t

    The pose is the place of the CoM and the heading of the base.

    Returns:
        Shape (3,): forward [m/s], left [m/s], turning [rad/s]; the turn between the two is less than half a circle.
    """
    yaws = [_heading(series["q"][i]) for i in (first, last)]
    turn = math.remainder(yaws[1] - yaws[0], math.tau)
    way = series["com"][last, :2] - series["com"][first, :2]
    # a body that turns while it moves goes along an arc: its chord points half the turn to the side
    chord, direction = float(np.hypot(*way)), math.atan2(way[1], way[0]) - yaws[0] - 0.5 * turn
    arc = chord / float(np.sinc(turn / math.tau))
    seconds = float(series["time"][last] - series["time"][first])
    return np.array([arc * math.cos(direction), arc * math.sin(direction), turn]) / seconds


def _heading(q: Array) -> float:
    """Direction of the base's forward axis, seen from above [rad]."""
    forward = pin.Quaternion(q[3:7]).matrix()[:, 0]
    return math.atan2(forward[1], forward[0])
