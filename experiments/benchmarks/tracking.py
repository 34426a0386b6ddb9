"""How well moving obstacles are tracked, and what the estimated velocity is worth to the safety filter."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from rich.console import Console

from experiments.benchmarks.crossing import CROSSING, NOISE, TICK
from experiments.metrics.metric import Metric
from experiments.reports.metric_tables import rows_table
from experiments.reports.table import show
from robots.messages import Array
from safety.tracking import MODELS, ObstacleTrack, TrackerSettings
from sims.obstacles import BrownianMotion, CircularMotion, ObstacleMotion, PositionSensor, StopAndGo

RATES = (30.0, 60.0, 100.0)
"""Rates of the sensor [Hz]."""

SETTLED = 1.0
"""Time from which the estimate counts [s]."""

MAX_LAG = 0.3
"""Largest lag that is looked for [s]."""

TRACKING = (
    Metric("motion", "motion"),
    Metric("rate_hz", "rate", "Hz"),
    Metric("model", "constant"),
    Metric("speed_rms", "speed", "m/s"),
    Metric("velocity_rmse", "v error", "m/s"),
    Metric("velocity_step", "v step", "m/s"),
    Metric("velocity_step_at_once", "at once", "m/s"),
    Metric("lag_ms", "lag", "ms"),
    Metric("lag_at_once_ms", "at once", "ms"),
    Metric("raw_rmse_m", "raw", "mm", 1e3),
    Metric("position_rmse_m", "filtered", "mm", 1e3),
    Metric("velocity_within_3_sigma", "3 sigma", "%", 1e2),
    Metric("nis", "NIS", "of 3"),
    Metric("nees", "NEES", "of 6"),
    Metric("rejected", "rejected"),
)


def print_tracking(console: Console, rows: Sequence[Mapping[str, Any]], crossings: Sequence[Mapping[str, Any]]) -> None:
    """Print the rows of :func:`tracking_study` and of :func:`crossing_study` as tables."""
    noise = f"obstacle tracks: RMS values; {1e3 * NOISE:g} mm noise; raw, filtered: error of the position"
    crossed = "an obstacle crosses the hands of the G1 (upper body, kinematic); joint acceleration: RMS"
    for title, columns, lines in ((noise, TRACKING, rows), (crossed, CROSSING, crossings)):
        show(rows_table(lines, columns, title), console)


def study_motions(seed: int) -> dict[str, ObstacleMotion]:
    """The motions of the study, all within a metre of the origin."""
    corner = np.full(3, 0.5)
    return {
        "Brownian": BrownianMotion(-corner, corner, speed=0.2, memory=1.0, seed=seed),
        "circular": CircularMotion(np.zeros(3), radius=0.3, speed=0.5),
        "stop-and-go": StopAndGo(np.zeros(3), np.array([0.5, 0.2, 0.1]), going=1.0, resting=0.5),
    }


def tracking_study(seed: int = 0, rates: Sequence[float] = RATES, duration: float = 10.0) -> list[dict[str, Any]]:
    """Figures of every motion, rate and model.

    Args:
        seed: of the Brownian motion and of the sensor's noise.
        rates: of the sensor [Hz].
        duration: of each run, above ``SETTLED`` [s].

    Returns:
        A row each; see :func:`track_figures`. Two of them once more for a track that hands out at once what a
        measurement changes.
    """
    rows: list[dict[str, Any]] = []
    for name, motion in study_motions(seed).items():
        for rate in rates:
            for model in MODELS:
                settings = TrackerSettings(position_noise=NOISE, model=model)
                blended, at_once = (
                    track_figures(follow(motion, rate, s, seed, duration))
                    for s in (settings, replace(settings, blending=0.0))
                )
                case = {"motion": name, "rate_hz": rate, "model": model.removeprefix("constant_")}
                rows.append(
                    case
                    | blended
                    | {"velocity_step_at_once": at_once["velocity_step"], "lag_at_once_ms": at_once["lag_ms"]}
                )
    return rows


def follow(
    motion: ObstacleMotion, rate: float, settings: TrackerSettings, seed: int, duration: float
) -> dict[str, Array]:
    """Track one motion through a noisy sensor.

    Returns:
        By name, a row per ``TICK``: ``time`` [s]; ``true``, ``estimate`` (n, 6), position [m] and velocity [m/s];
        ``raw`` (n, 3), the last measurement [m]; ``sigma`` (n, 6), standard deviations; ``nees``; ``nis``, NaN where
        nothing was measured; ``step`` (n, 3), change of the estimated velocity since the row before [m/s], 0 in the
        first; ``rejected`` (n,), count.
    """
    track, sensor = ObstacleTrack(settings), PositionSensor(rate, NOISE, np.random.default_rng([seed, 2]))
    rows: list[dict[str, Any]] = []
    raw = np.full(3, np.nan)
    for t in TICK * np.arange(round(duration / TICK)):
        truth = np.concatenate([motion.position(t), motion.velocity(t)])
        measured = sensor.measure(truth[:3], t)
        nis = np.nan
        if measured is not None:
            track.measure(measured, t, t - TICK)
            raw, nis = measured, track.nis
        estimate = np.concatenate(track.estimate(t))
        step = estimate[3:] - rows[-1]["estimate"][3:] if rows else np.zeros(3)
        covariance = track.covariance(t)[:6, :6]
        error = estimate - truth
        rows.append(
            {
                "time": t,
                "true": truth,
                "raw": raw,
                "estimate": estimate,
                "sigma": np.sqrt(np.diag(covariance)),
                "nees": error @ np.linalg.solve(covariance, error),
                "nis": nis,
                "step": step,
                "rejected": track.rejected,
            }
        )
    return {key: np.array([row[key] for row in rows]) for key in rows[0]}


def track_figures(series: Mapping[str, Array]) -> dict[str, Any]:
    """Figures of one run of :func:`follow` from ``SETTLED`` on; lengths of vectors in the RMS values.

    The raw position is the last measurement, held until the next: what a controller without a filter would use.
    """
    s = {key: values[series["time"] >= SETTLED] for key, values in series.items()}
    error = s["estimate"] - s["true"]
    within = np.abs(error) <= 3 * s["sigma"]
    return {
        "speed_rms": _rms(s["true"][:, 3:]),
        "velocity_rmse": _rms(error[:, 3:]),
        "velocity_step": _rms(s["step"]),
        "lag_ms": 1e3 * lag(s["true"][:, 3:], s["estimate"][:, 3:]),
        "raw_rmse_m": _rms(s["raw"] - s["true"][:, :3]),
        "position_rmse_m": _rms(error[:, :3]),
        "position_within_3_sigma": float(within[:, :3].mean()),
        "velocity_within_3_sigma": float(within[:, 3:].mean()),
        "nis": float(np.nanmean(s["nis"])),
        "nees": float(s["nees"].mean()),
        "rejected": int(series["rejected"][-1]),
    }


def lag(true: Array, estimate: Array) -> float:
    """The delay [s] of ``estimate`` (n, 3) at which it correlates best with ``true`` (n, 3), a row per ``TICK``."""
    shifts = range(min(round(MAX_LAG / TICK), len(true) // 2) + 1)
    scores = [_correlation(true[: len(true) - k].ravel(), estimate[k:].ravel()) for k in shifts]
    return TICK * int(np.argmax(scores))


def _correlation(a: Array, b: Array) -> float:
    """Pearson's, 0 where one of the two does not vary."""
    a, b = a - a.mean(), b - b.mean()
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / size if size else 0.0


def _rms(vectors: Array) -> float:
    """Root mean square of the lengths of ``vectors`` (n, k)."""
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))
