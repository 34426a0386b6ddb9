"""Figures of merit of a run."""

import platform
from importlib import metadata
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from controllers.whole_body.config import ControllerConfig
from experiments.recording.outcome import Outcome
from experiments.recording.recording import GUARANTEED, family_minima
from robots.messages import Array, Mask
from safety.filters.guarantee import safety_bounds

PACKAGES = ("safewbc", "pin", "mujoco", "daqp", "proxsuite", "numpy", "scipy", "numba", "filterpy")

CONFLICT_MARGIN = 0.02
"""The reference motion counts as in conflict while its own smallest self-collision barrier is below this [m]."""

SETTLING = 3.0
"""The CoM error counts from here on [s]."""


def convex_polygon(points: Array) -> Array:
    """Corners (k, 2) of the convex hull of points (n, 2), anticlockwise."""
    return points[ConvexHull(points).vertices]


def depth_in_hull(points: Array, corners: Array) -> Array:
    """How deep points lie in the convex hull of corners of their own.

    Args:
        points: shape (n, 2) [m].
        corners: shape (n, k, 2); at least three of each k are no line [m].

    Returns:
        Shape (n,): distance to the nearest edge's line, negative outside [m]; NaN for a point that is NaN.
    """
    depth = np.full(len(points), np.inf)
    for i in range(corners.shape[1]):
        for j in range(corners.shape[1]):
            edge = corners[:, j] - corners[:, i]
            length = np.linalg.norm(edge, axis=1)
            relative = corners - corners[:, i, None]
            side = edge[:, None, 0] * relative[..., 1] - edge[:, None, 1] * relative[..., 0]
            # an edge of the hull has every corner on its left, by distance: an edge may be as short as it likes
            border = (length > 1e-9) & (side >= -1e-9 * length[:, None]).all(axis=1)
            own = points - corners[:, i]
            distance = (edge[:, 0] * own[:, 1] - edge[:, 1] * own[:, 0]) / np.maximum(length, 1e-9)
            depth = np.where(border, np.minimum(depth, distance), depth)
    return np.where(np.isfinite(points).all(axis=1), depth, np.nan)


EDGE = 1e-4
"""The ZMP counts as inside up to this beyond the edge [m]: contact points lie on it when a foot tilts."""


LOADED = 0.1
"""A foot counts as loaded from this fraction of the weight on: a fifth of what it carries in standing."""


def zmp_inside(series: dict[str, Array]) -> Mask:
    """At which plant steps the measured ZMP lies in the support polygon of the feet that the plan has on the ground.

    Args:
        series: with ``sole_corners``, ``in_contact`` and ``step_zmp``.

    Returns:
        Shape (P,). Without a vertical force it lies nowhere, and where the plan has both feet up as well.
    """
    corners, zmp = series["sole_corners"], series["step_zmp"]
    tick, contact = _ticks_of_steps(series), _planned_contact(series)
    depth = np.full(len(zmp), np.nan)
    for feet in ([True, True], [True, False], [False, True]):
        chosen = (contact == feet).all(axis=1)[tick]
        here = corners[tick[chosen]][:, feet].reshape(int(chosen.sum()), 4 * sum(feet), 2)
        depth[chosen] = depth_in_hull(zmp[chosen], here)
    return np.asarray(depth >= -EDGE)


def zmp_inside_single(series: dict[str, Array], inside: Mask) -> float | None:
    """Fraction of ``inside`` (P,) among the plant steps at which the plan is on one foot; ``None`` without any."""
    single = (_planned_contact(series).sum(axis=1) == 1)[_ticks_of_steps(series)]
    return _fraction_of(inside & single, single)


def foot_slide(series: dict[str, Array]) -> Array:
    """How far each sole has slid since it took up its load.

    Args:
        series: with ``soles``, ``foot_wrench`` and ``in_contact``.

    Returns:
        Shape (T, 2): horizontal distance of the sole's centre from where it was when it was first loaded after the
        plan had put it on the ground [m]; NaN while the plan has it up or it carries less than ``LOADED`` of the
        weight, which is the median over the run of what both feet carry.
    """
    contact, force = _planned_contact(series), series["foot_wrench"][:, :, 2]
    loaded = contact & (force > LOADED * np.median(force.sum(axis=1)))
    slide = np.full(contact.shape, np.nan)
    for foot in range(contact.shape[1]):
        stance = np.cumsum(np.diff(contact[:, foot], prepend=False))
        ticks = np.flatnonzero(loaded[:, foot])
        _, first, which = np.unique(stance[ticks], return_index=True, return_inverse=True)
        place = series["soles"][ticks, foot, :2]
        slide[ticks, foot] = np.linalg.norm(place - place[first][which], axis=1)
    return slide


def torque_step_max(series: dict[str, Array]) -> float | None:
    """Largest change of one joint's torque from one tick to the next, as a fraction of its limit.

    The motors are off before the first tick: getting going does not count. ``None`` for fewer than three ticks.
    """
    torque, fraction = series["torque"], series["torque_fraction"]
    # the torques of a tick are those of the step before it, whose fractions have no sign
    before = np.arange(1, len(torque)) * (len(fraction) // len(torque)) - 1
    change = np.abs(np.diff(np.copysign(fraction[before], torque[1:]), axis=0))
    return _largest(change)


def _ticks_of_steps(series: dict[str, Array]) -> NDArray[np.intp]:
    """The tick that each plant step belongs to, shape (P,)."""
    steps, ticks = len(series["step_zmp"]), len(series["in_contact"])
    return np.arange(steps) // -(-steps // ticks)


def _planned_contact(series: dict[str, Array]) -> Mask:
    return np.asarray(series["in_contact"], dtype=bool)


def summarise(series: dict[str, Array], outcome: Outcome) -> dict[str, Any]:
    """Figures that every experiment has, from the recorded series; times in s, lengths in m."""
    com_error = np.linalg.norm(series["com"] - series["com_ref"], axis=1)
    # a run of one tick has none after half of it
    settled = com_error[series["time"] >= min(SETTLING, 0.5 * outcome.duration, series["time"][-1])]
    out: dict[str, Any] = {
        "duration_s": round(outcome.duration, 9),
        "fell": outcome.fell_at is not None,
        "fell_at_s": outcome.fell_at,
        "min_h_self_collision_m": _smallest(series["h_self_collision"]),
        "min_h_joint_limit_rad": _smallest(series["h_joint_limit"]),
        "min_h_workspace_m": _smallest(series["h_workspace"]),
        "min_h_obstacle_m": _smallest(series["h_obstacle"][np.isfinite(series["h_obstacle"])]),
        "com_rmse_m": float(np.sqrt(np.mean(com_error**2))),
        "com_error_settled_max_m": float(settled.max()),
        **_contact_figures(series),
        "max_torque_fraction": float(series["torque_fraction"].max()),
        "torque_step_max": torque_step_max(series),
        **_filter_figures(series),
        "tick_ms_median": float(np.median(series["tick_ms"])),
        "tick_ms_p99": float(np.percentile(series["tick_ms"], 99)),
    }
    if "h_own" in series:
        out["min_h_own"] = _smallest(series["h_own"][np.isfinite(series["h_own"])])
    return out | _hand_figures(series)


def _contact_figures(series: dict[str, Array]) -> dict[str, Any]:
    slide, inside = foot_slide(series), zmp_inside(series)
    return {
        "foot_slide_max_m": _largest(slide[np.isfinite(slide)]),
        "zmp_inside_fraction": float(inside.mean()),
        "zmp_inside_single_fraction": zmp_inside_single(series, inside),
    }


def _filter_figures(series: dict[str, Array]) -> dict[str, Any]:
    # after a stop no filter runs: those ticks neither failed nor were filtered
    running: Mask = np.asarray(np.isfinite(series["v_safe"]).all(axis=1))
    status = np.where(running, series["filter_status"], 0)
    return {
        "qp_failures": int(((series["qp_failed"] > 0) | (status == 3)).sum()),
        "filtered_fraction": _fraction_of(status > 0, running),
        "relaxed_fraction": _fraction_of(status == 2, running),
        **_steps(series["v_safe"][running]),
    }


def guarantee_figures(series: dict[str, Array], control: ControllerConfig, leg_pairs: int) -> dict[str, Any]:
    """How far the robot was from the filter's velocity, and what the filter's condition guaranteed in spite of it.

    Args:
        series: recorded.
        control: names the filter and its parameters.
        leg_pairs: number of pairs of legs.

    Returns:
        Figures of the disturbance, the bounds on self-collision of arms, torso and head, the margin left in each family
        (smallest h less its running bound), and whether every family's bound was kept. That of obstacles does not
        count: what errs there is also the estimate of where they are.
    """
    disturbance = series["disturbance"][np.isfinite(series["disturbance"])]
    largest = _largest(disturbance)
    rows = int(series["h_self_collision"].shape[1]) > leg_pairs
    guarantee = safety_bounds(control.filter, control.safety.parameters()).get("self_collision") if rows else None
    column, bound = GUARANTEED.index("self_collision"), None
    running = series["h_bound"][:, column]
    # not beyond a change of the filter
    guaranteed = np.isfinite(running) & np.isfinite(series["disturbance"])
    if guarantee is not None and guaranteed.any():
        gradient = float(series["gradient"][guaranteed, column].max())
        bound = guarantee.bound(float(series["disturbance"][guaranteed].max()), gradient)
    gap = family_minima(series, leg_pairs) - series["h_bound"]
    margins = {family: _smallest(g[np.isfinite(g)]) for family, g in zip(GUARANTEED, gap.T, strict=True)}
    own = [m for family, m in margins.items() if family != "obstacle" and m is not None]
    return {
        "disturbance_max": largest,
        "disturbance_rms": float(np.sqrt(np.mean(disturbance**2))) if disturbance.size else None,
        "bound_m": bound,
        "bound_running_min_m": _smallest(running[np.isfinite(running)]),
        "row_bound_min_m": _smallest(series["h_row_bound"][np.isfinite(series["h_row_bound"])]),
        "bound_held": all(m >= 0 for m in own) if own else None,
    } | {f"margin_{family}_{'rad' if family == 'joint_limit' else 'm'}": m for family, m in margins.items()}


def _steps(v: Array) -> dict[str, float | None]:
    """How much a velocity command (T, nv) changes from tick to tick."""
    change = np.diff(v, axis=0)
    if not change.size:
        return {"command_step_rms": None, "command_step_max": None}
    return {"command_step_rms": float(np.sqrt(np.mean(change**2))), "command_step_max": float(np.abs(change).max())}


def _largest(values: Array) -> float | None:
    return float(values.max()) if values.size else None


def _smallest(values: Array) -> float | None:
    return float(values.min()) if values.size else None


def _fraction_of(ticks: Mask, of: Mask) -> float | None:
    return float(ticks.sum() / of.sum()) if of.any() else None


def _hand_figures(series: dict[str, Array]) -> dict[str, Any]:
    names = ("hand_rmse_m", "hand_rmse_outside_conflict_m", "min_h_reference_m", "collision_ratio")
    out: dict[str, Any] = dict.fromkeys(names)
    if "left_hand_ref" not in series:
        return out
    squared = sum(np.sum((series[name] - series[f"{name}_ref"]) ** 2, axis=1) for name in ("left_hand", "right_hand"))
    mean = 0.5 * np.asarray(squared)
    out["hand_rmse_m"] = float(np.sqrt(mean.mean()))
    if "h_self_reference" in series:
        reference = series["h_self_reference"]
        free = reference[:: len(reference) // len(mean)][: len(mean)] >= CONFLICT_MARGIN
        out["hand_rmse_outside_conflict_m"] = float(np.sqrt(mean[free].mean())) if free.any() else None
        touching = float((reference < 0).mean())
        now = float((series["h_self_collision"].min(axis=1, initial=np.inf) < 0).mean())
        out["min_h_reference_m"] = float(reference.min())
        out["collision_ratio"] = now / touching if touching > 0 else None
    return out


def versions() -> dict[str, str]:
    """Versions of what a run depends on."""
    out = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            out[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            out[name] = "not installed"
    return out
