"""What a run tells of the disturbance that reaches each constraint family, and the largest epsilon that it allows."""

import math
from dataclasses import dataclass

import numpy as np

from experiments.recording.recording import GUARANTEED, Recording, family_minima
from experiments.running.ground_truth import TrueBarriers
from robots.messages import Array, Mask
from safety.filters.robustness import episodes, largest_epsilon, row_disturbance
from safety.geometry.shapes import Obstacle

BINDING = {"obstacle": 0.05}
"""A condition counts as binding while the filtered velocity is this close to it [m/s]; where an obstacle is, and how
fast, the filter knows from an estimate only."""

USUAL_BINDING = 1e-4
"""The same of other families [m/s, rad/s]: what a solver leaves."""

GAP = 0.05
"""Interruptions up to this long do not end an episode in which a condition binds [s]."""

GRADIENT = 1e-3
"""A row whose gradient is shorter is left out: no velocity moves it [m/rad]."""


@dataclass(frozen=True, slots=True)
class Measured:
    """What one run tells of one family.

    Attributes:
        family: of ``GUARANTEED``.
        least: smallest true barrier, at any physics step [m or rad].
        epsilon: largest that keeps the margin; infinite where none is needed, or no condition of the family bound.
        push: largest disturbance against a row, as the running bound weighs it: the steady one that would take as much
            of h [m/s or rad/s].
        squared: median squared length of the rows that bound; NaN where none did.
        binding: number of ticks at which one bound.
    """

    family: str
    least: float
    epsilon: float
    push: float
    squared: float
    binding: int


@dataclass(frozen=True, slots=True)
class RowSeries:
    """Rows of all families at every control tick, at the true state: h, squared gradients, rates asked, (T, n) each."""

    h: Array
    squared: Array
    rate: Array
    columns: dict[str, slice]


def row_series(result: Recording) -> RowSeries:
    """The true barriers of a run at its ticks, and the rate that the filtered velocity gives each."""
    series = result.series
    with_obstacle = "obstacle" in series
    truth = TrueBarriers(result.robot, ("sphere",) if with_obstacle else ())
    running = np.isfinite(series["v_safe"]).all(axis=1)
    # after a stop no filter runs any more
    ticks = range(int(running.size if running.all() else np.argmin(running)))
    velocity = np.gradient(series["obstacle"][:, :3], series["time"], axis=0) if with_obstacle else None
    h, squared, rate = [], [], []
    for k in ticks:
        obstacles = []
        if velocity is not None:
            obstacles = [Obstacle.sphere(series["obstacle"][k, :3], float(series["obstacle"][k, 3]), velocity[k])]
        rows = truth.evaluate(series["q"][k], obstacles)
        h.append(rows.h)
        squared.append(np.vecdot(rows.jac, rows.jac))
        rate.append(rows.jac @ series["v_safe"][k] + rows.dh_dt)
    return RowSeries(np.array(h), np.array(squared), np.array(rate), dict(truth.slices))


def measure(result: Recording, families: tuple[str, ...], margins: dict[str, float]) -> list[Measured]:
    """What a run tells of some families.

    Args:
        result: of a run with the filter ``issf`` and exact measurements.
        families: to look at, of ``GUARANTEED``.
        margins: barrier to keep, by family [m or rad].
    """
    rows = row_series(result)
    least = family_minima(result.series, len(result.robot.leg_pairs)).min(axis=0)
    dt = float(result.config["controller"]["dt"])
    out = []
    for family in families:
        if (columns := rows.columns.get(family)) is None or columns.start == columns.stop or len(rows.h) < 2:
            continue
        own = result.config["controller"]["safety"][family]
        part = (rows.h[:, columns], rows.squared[:, columns], rows.rate[:, columns])
        found = family_epsilon(*part, own["alpha"], own["epsilon"], dt, margins[family], _binding(family))
        out.append(Measured(family, float(least[GUARANTEED.index(family)]), *found))
    return out


def _binding(family: str) -> float:
    return BINDING.get(family, USUAL_BINDING)


def family_epsilon(
    h: Array, squared: Array, rate: Array, alpha: float, epsilon: float, dt: float, margin: float, tolerance: float
) -> tuple[float, float, float, int]:
    """Largest epsilon that keeps the margin of every row in every episode in which its condition bound.

    Args:
        h: shape (n, rows) at the ticks.
        squared: shape (n, rows) squared gradients.
        rate: shape (n, rows) rate of h that the filtered velocity gives.
        alpha: in force.
        epsilon: in force.
        dt: control period [s].
        margin: of h to keep.
        tolerance: a condition counts as binding up to this distance from it, the unit of the rate of h.

    Returns:
        epsilon, the largest push, the median squared gradient, the number of binding ticks, as in :class:`Measured`.
    """
    demand = squared / epsilon - alpha * h
    binding: Mask = (rate <= demand + tolerance) & (squared > GRADIENT**2)
    disturbance = row_disturbance(h, squared, alpha, epsilon, dt)
    best, push = math.inf, 0.0
    for i in np.flatnonzero(binding.any(axis=0)):
        for part in episodes(binding[:-1, i], round(GAP / dt)):
            e, start = disturbance[part, i], max(float(h[part.start, i]), margin)
            best = min(best, largest_epsilon(alpha, squared[part, i], e, dt, margin, start))
            push = max(push, weighed_push(alpha, e, dt))
    size = float(np.median(squared[binding])) if binding.any() else math.nan
    return best, push, size, int(binding.any(axis=1).sum())


def weighed_push(alpha: float, disturbance: Array, dt: float) -> float:
    """Largest of the mean push of the recent past, forgotten at rate alpha; 0 where nothing pushes against the row."""
    state, largest, keep = 0.0, 0.0, 1.0 - alpha * dt
    for e in disturbance.tolist():
        state = keep * state - alpha * dt * e
        largest = max(largest, state)
    return largest
