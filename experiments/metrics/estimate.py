"""How far a state estimate was from the truth, and how that is declared."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pinocchio as pin

from experiments.metrics.metric import Metric
from robots.messages import Array

SETTLED = 0.5
"""Errors count from here on [s]."""

TOUCHING = 0.02
"""A foot stands where it really bears more than this fraction of the weight, the median of what both bear."""

ESTIMATE = (
    Metric(
        "base_velocity_error_m_s",
        "base velocity, RMS error",
        "mm/s",
        1e3,
        group="estimate",
        stored="m/s",
        meaning="error of the estimated linear velocity of the base, world axes, root mean square of x, y and z, from "
        "0.5 s on; absent without `--state estimated`, as are all of this group",
    ),
    Metric(
        "tilt_error_rad",
        "tilt of the base, RMS error",
        "mrad",
        1e3,
        group="estimate",
        stored="rad",
        meaning="root mean square of the angle between the true vertical and the estimated one in the base's axes",
    ),
    Metric(
        "height_error_m",
        "height of the base, largest error",
        "mm",
        1e3,
        group="estimate",
        stored="m",
        meaning="largest error of the estimated height of the base",
    ),
    Metric(
        "position_drift_m",
        "position of the base, error at the end",
        "mm",
        1e3,
        group="estimate",
        stored="m",
        meaning="horizontal distance of the base from where it is estimated to be, at the end",
    ),
    Metric(
        "foot_force_error_n",
        "force on a sole, RMS error",
        "N",
        group="estimate",
        stored="N",
        meaning="error of the estimated force along the normals of both soles, root mean square",
    ),
    Metric(
        "contact_agreement",
        "contact as it is",
        "%",
        1e2,
        group="estimate",
        stored="-",
        meaning="fraction of the ticks and feet on which the estimated contact (probability above one half) is the "
        "true one (more than a fiftieth of the weight)",
    ),
    Metric(
        "estimate_ms_median",
        "state estimate, median",
        "ms",
        group="computation",
        stored="ms",
        meaning="median of the time that a state estimate took, on the machine of the run; absent likewise",
    ),
)
"""By group."""


def estimate_figures(series: dict[str, Array]) -> dict[str, Any]:
    """What ``ESTIMATE`` declares; nothing for a run on the true state."""
    if "q_estimated" not in series:
        return {}
    late = series["time"] >= SETTLED
    late[-1:] = True
    q, guess, velocity = series["q"][late], series["q_estimated"][late], velocity_errors(series)[late]
    true, estimated = base_rotations(q), base_rotations(guess)
    tilt = np.arccos(np.clip(np.vecdot(true[:, 2], estimated[:, 2]), -1.0, 1.0))
    force = series["foot_wrench"][late][:, :, 2]
    stands = force > TOUCHING * np.median(force.sum(axis=1))
    return {
        "base_velocity_error_m_s": float(np.sqrt(np.mean(np.vecdot(velocity, velocity)))),
        "tilt_error_rad": float(np.sqrt(np.mean(tilt**2))),
        "height_error_m": float(np.abs(guess[:, 2] - q[:, 2]).max()),
        "position_drift_m": float(np.linalg.norm(guess[-1, :2] - q[-1, :2])),
        "foot_force_error_n": float(np.sqrt(np.nanmean((series["foot_force_estimated"][late] - force) ** 2))),
        "contact_agreement": float(np.mean((series["contact_estimated"][late] > 0.5) == stands)),
        "estimate_ms_median": float(np.median(series["estimate_ms"])),
    }


def velocity_errors(series: Mapping[str, Array]) -> Array:
    """Errors (T, 3) of the base's estimated linear velocity, world axes [m/s]."""
    true, estimated = base_rotations(series["q"]), base_rotations(series["q_estimated"])
    told = np.einsum("tij,tj->ti", estimated, series["v_estimated"][:, :3])
    return told - np.einsum("tij,tj->ti", true, series["v"][:, :3])


def base_rotations(q: Array) -> Array:
    """Rotations (T, 3, 3) of the base, from configurations (T, nq)."""
    return np.array([pin.Quaternion(row[3:7]).matrix() for row in q])
