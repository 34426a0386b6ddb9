"""When each foot stood and when it swung, by the plan of a recorded run."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from robots.messages import Array, Mask

Series = Mapping[str, NDArray[Any]]

SWAY_TIME = 0.6
"""Standard deviation of the Gaussian that takes a body's swaying away [s]: of once in 1.6 s, 6 % is left."""


@dataclass(frozen=True, slots=True)
class Stance:
    """One foot on the ground by plan.

    Attributes:
        foot: 0 left, 1 right.
        first: tick at which the plan put it down, 0 where it stood from the start.
        last: last tick before the plan lifted it, or of the run.
        corners: shape (4, 2) of its sole half-way between [m].
    """

    foot: int
    first: int
    last: int
    corners: Array


def stances(series: Series) -> list[Stance]:
    """Every stance of a run, in the order in which they began; none for a run without ``in_contact``."""
    if "in_contact" not in series:
        return []
    corners, contact = series["sole_corners"], _contact(series)
    out = [
        Stance(foot, first, last, corners[(first + last) // 2, foot])
        for foot in range(contact.shape[1])
        for first, last in intervals(contact[:, foot])
    ]
    return sorted(out, key=lambda stance: stance.first)


def swings(series: Series) -> list[tuple[int, int]]:
    """First and last tick of every time that the plan has some foot in the air, in order."""
    return intervals(np.asarray(~_contact(series).all(axis=1))) if "in_contact" in series else []


def walks(series: Series) -> bool:
    """Whether the plan lifts both feet."""
    return "in_contact" in series and bool((~_contact(series)).any(axis=0).all())


def intervals(flags: Mask) -> list[tuple[int, int]]:
    """First and last index of every unbroken run of ``True`` in ``flags`` (n,)."""
    edges = np.diff(flags.astype(int), prepend=0, append=0)
    return list(zip(np.flatnonzero(edges > 0).tolist(), (np.flatnonzero(edges < 0) - 1).tolist(), strict=True))


def without_sway(values: Array, time: Array) -> Array:
    """Values (T, n) at evenly spaced times (T,) [s], smoothed over ``SWAY_TIME`` to both sides: they do not lag."""
    if len(time) < 2:
        return values.copy()
    tick = (float(time[-1]) - float(time[0])) / (len(time) - 1)
    out: Array = gaussian_filter1d(values, SWAY_TIME / tick, axis=0, mode="nearest")
    return out


def _contact(series: Series) -> Mask:
    return np.asarray(series["in_contact"], dtype=bool)
