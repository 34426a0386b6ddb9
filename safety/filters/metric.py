"""The metric in which the input nearest to the nominal one is sought."""

import math

import numpy as np

from robots.checks import all_finite
from robots.messages import Array
from safety.filters.filter_kernels import metric
from safety.filters.settings import MetricWeights

Jacobians = tuple[Array | None, ...]
"""Of the feet, of the tasks that keep balance and of the hands, (k, nv) each; ``None`` where there are none."""


class Metric:
    r"""H of :math:`\|v - v^{des}\|_H^2`, see :class:`safety.filters.safety_filter.SafetyFilter`.

    Attributes:
        weights: of the Jacobians.
        matrix: shape (nv, nv) H as it was written last.
    """

    def __init__(self, nv: int, weights: MetricWeights) -> None:
        """For ``nv`` inputs."""
        self.weights = weights
        self.matrix, self._none = np.zeros((nv, nv)), np.zeros((0, nv))

    def write(self, jacobians: Jacobians, v_des: Array) -> str:
        """Bring ``matrix`` up to date; why it cannot be used with the nominal input (nv,), in words."""
        feet, balance, hands = (self._none if j is None else np.ascontiguousarray(j, dtype=float) for j in jacobians)
        w = self.weights
        if math.isfinite(metric(feet, balance, hands, w.foot, w.balance, w.hand, v_des, self.matrix)):
            return ""
        return "nominal input is too large" if all_finite(self.matrix) else "weighted Jacobians are not finite"

    def at(self, jacobians: Jacobians, v_des: Array) -> Array:
        """``matrix`` brought up to date, valid until the next one."""
        self.write(jacobians, v_des)
        return self.matrix
