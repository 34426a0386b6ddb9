"""Figures of a deployment, and how they are declared: measured, estimated, or of the clock."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from experiments.metrics.metric import Metric
from experiments.recording.recording import GUARANTEED
from robots.messages import Array, Mask

CONTROLLED = ("standing", "task", "stopping")
"""Stages in which the controller has the robot."""


def _metric(key: str, words: str, group: str, unit: str = "", bad: str = "", factor: float = 1.0) -> Metric:
    return Metric(key, words, unit, factor, bad, group)


def h_key(family: str) -> str:
    """Key of the smallest barrier of a family."""
    return f"min_h_estimated_{family}_{'rad' if family == 'joint_limit' else 'm'}"


BARRIERS = tuple(
    _metric(
        h_key(family),
        f"smallest barrier at the estimated state, {family.replace('_', ' ')}",
        "safety",
        "deg" if family == "joint_limit" else "mm",
        "negative",
        float(np.degrees(1.0)) if family == "joint_limit" else 1e3,
    )
    for family in GUARANTEED
)

DEPLOYMENT = (
    _metric("duration_s", "from the first period to the last", "run", "s"),
    _metric("cause", "ended since", "outcome"),
    _metric("last_stage", "in the stage", "outcome"),
    _metric("controlled_s", "under control on its feet", "outcome", "s"),
    _metric("tilt_estimated_max_rad", "largest estimated tilt of the base on its feet", "balance", "mrad", factor=1e3),
    *BARRIERS,
    _metric("way_estimated_m", "estimated way of the base on its feet, first to last", "locomotion", "m"),
    _metric("torque_max_fraction", "largest measured torque on its feet, part of the limit", "effort", "%", factor=1e2),
    _metric("torque_max_joint", "of the joint", "effort"),
    _metric("temperature_max", "hottest motor", "effort", "degrees Celsius"),
    _metric("battery_min_percent", "lowest charge of the battery", "effort", "%"),
    _metric("tick_ms_median", "estimate and tick, median", "computation", "ms"),
    _metric("tick_ms_p99", "estimate and tick, 99th percentile", "computation", "ms"),
    _metric("tick_ms_max", "estimate and tick, longest", "computation", "ms"),
    _metric("age_ms_median", "age of the state at its command, median", "computation", "ms"),
    _metric("age_ms_p99", "age of the state at its command, 99th percentile", "computation", "ms"),
    _metric("age_ms_max", "age of the state at its command, largest", "computation", "ms"),
    _metric("periods", "commands", "computation"),
    _metric("held_back", "commands not ready in time, and not sent", "computation", bad="positive"),
    _metric("qp_failures", "commands without a solution of DynWBC", "computation", bad="positive"),
    _metric("bridged", "periods without a new state", "computation", bad="positive"),
    _metric("states_lost", "states that never came", "computation", bad="positive"),
    _metric("states_broken", "states with a wrong check sum", "computation", bad="positive"),
    _metric("states_repeated", "states that came twice, or late", "computation", bad="positive"),
    _metric("different", "commands that a replay computes otherwise", "computation", bad="positive"),
)
"""In the order to show them."""


def deployment_figures(series: Mapping[str, Array], stages: Sequence[str], effort: Array) -> dict[str, Any]:
    """What the arrays of a deployment come to; ``None`` for what there was no period for.

    Args:
        series: of at least one period, see :data:`experiments.recording.deployment_channels.DEPLOYMENT_CHANNELS`.
        stages: by their numbers.
        effort: shape (nj,) limits of the torques [N m].
    """
    controlled = np.isin(series["stage"], [stages.index(name) for name in CONTROLLED if name in stages])
    period = float(np.median(np.diff(series["time"]))) if len(series["time"]) > 1 else 0.0
    out = {
        "duration_s": float(series["time"][-1]),
        "last_stage": stages[int(series["stage"][-1])],
        "controlled_s": float(controlled.sum()) * period,
        "temperature_max": _most(series["temperature"]),
        "battery_min_percent": _least(series["battery"]),
        "periods": len(series["time"]),
        "held_back": int((series["sent"] == 0).sum()),
        "qp_failures": int(series["qp_failed"].sum()),
        "bridged": int((series["missing"] > 0).sum()),
    }
    return out | _on_its_feet(series, controlled, effort) | _times(series)


def _on_its_feet(series: Mapping[str, Array], controlled: Mask, effort: Array) -> dict[str, Any]:
    """Figures of the stages in which the controller has the robot."""
    if not controlled.any():
        return {}
    fraction = np.abs(series["torque"][controlled]) / effort
    q = series["q_estimated"][controlled]
    joint = np.argmax(np.max(fraction, axis=0))
    least = np.min(series["h_estimated"][controlled], axis=0)
    return {
        "torque_max_fraction": float(fraction.max()),
        "torque_max_joint": int(joint),
        "tilt_estimated_max_rad": float(tilt(q).max()),
        "way_estimated_m": float(np.linalg.norm(q[-1, :2] - q[0, :2])),
    } | {h_key(f): float(h) for f, h in zip(GUARANTEED, least, strict=True) if np.isfinite(h)}


def tilt(q: Array) -> Array:
    """Angle (T,) between the base's own vertical and the world's, for configurations (T, nq) [rad]."""
    out: Array = np.arccos(np.clip(1.0 - 2.0 * (q[:, 3] ** 2 + q[:, 4] ** 2), -1.0, 1.0))
    return out


def _times(series: Mapping[str, Array]) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for name in ("tick_ms", "age_ms"):
        values = series[name][np.isfinite(series[name])]
        if values.size:
            out[f"{name}_median"], out[f"{name}_p99"] = float(np.median(values)), float(np.percentile(values, 99))
            out[f"{name}_max"] = float(values.max())
    return out


def _most(values: Array) -> float | None:
    return float(np.nanmax(values)) if np.isfinite(values).any() else None


def _least(values: Array) -> float | None:
    return float(np.nanmin(values)) if np.isfinite(values).any() else None
