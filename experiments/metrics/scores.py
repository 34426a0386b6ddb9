"""Scores of the p-SSA paper, section V-D, and of SPARK, section IV-F. Higher is better in all; the best is 1."""

import numpy as np

from robots.messages import Array

TOUCH = 1e-6
"""Overlap [m] from which bodies count as colliding: less is rounding."""

TRACKING_SCALE = 0.002
"""Of the squared distance to a goal, eq. (14) [m^2]."""
CONTROL_SCALE = 0.2
"""Of the squared total violation of conditions, eq. (15) [m^2/s^2]."""
SAFETY_SCALE = 0.0002
"""Of the squared depth in the margin, eq. (16) [m^2]."""


def tracking_score(distances: Array) -> float:
    r"""How well goals are tracked, J of eq. (14).

    .. math:: J = \frac{1}{n T} \sum_{t, i} \exp(-d_{i,t}^2 / 0.002)

    Args:
        distances: shape (T, n) of each hand to its goal at each tick [m].
    """
    return float(np.mean(np.exp(-np.square(distances) / TRACKING_SCALE)))


def control_score(violation: Array) -> float | None:
    r"""How little conditions are violated where they are, C of eq. (15).

    .. math:: C = \operatorname{mean}_{t:\, s_t > 0} \exp(-s_t^2 / 0.2)

    Args:
        violation: shape (T,) total violation s_t of each tick [m/s].

    Returns:
        The score; ``None`` where no condition is ever violated.
    """
    positive = violation[violation > 0]
    return float(np.mean(np.exp(-np.square(positive) / CONTROL_SCALE))) if positive.size else None


def safety_score(depth: Array) -> float | None:
    r"""How little of the margin is used where it is entered, S of eq. (16).

    .. math:: S = \operatorname{mean}_{t, i:\, d_{i,t} < d_{min}} \exp(-(d_{i,t} - d_{min})^2 / 0.0002)

    Args:
        depth: any shape, :math:`\phi = d_{min} - d` of each pair at each tick [m].

    Returns:
        The score; ``None`` where no margin is ever entered (the paper writes 0 there, where 1 would be the limit).
    """
    positive = depth[depth > 0]
    return float(np.mean(np.exp(-np.square(positive) / SAFETY_SCALE))) if positive.size else None


def feasible_rate(violation: Array) -> float:
    """Fraction of ticks without violation, R_feas of eq. (17); ``violation``: shape (T,) total of each tick [m/s]."""
    return 1.0 - float(np.mean(violation > 0))


def goal_score(distances: Array, size: float, scale: float) -> float:
    r"""How well goals of some size are kept, J of eqs. (17), (18) and (21) of SPARK.

    .. math:: J = \frac{1}{n T} \sum_{t, i} \exp(-\max(d_{i,t} - r, 0)^2 / \sigma)

    The paper leaves the size r and the scale open; its code, version 1.0, has 0.05 m and 0.002 m^2 for hands, 0.1 m and
    0.05 m^2 for the base.

    Args:
        distances: shape (T, n) to the goals at each tick [m].
        size: r [m].
        scale: sigma, above 0 [m^2].
    """
    return float(np.mean(np.exp(-np.square(np.maximum(distances - size, 0.0)) / scale)))
