"""Settings of a safety filter beside its conditions' parameters."""

from dataclasses import dataclass

import numpy as np

from robots.checks import all_finite, require_non_negative, require_one_of, require_positive
from robots.errors import ConfigError
from robots.messages import Array
from safety.filters.recovery import RecoverySettings

INFEASIBLE = ("least_slack", "unsafe_pass_nominal")
"""What is done where no velocity satisfies the conditions; the second is the papers' naive baseline."""


@dataclass(frozen=True, slots=True)
class MetricWeights:
    """Weights of the metric in which the nearest input is sought, each 0 or above; 0 all is the papers' form.

    Attributes:
        foot: w_f, on velocity given to the feet.
        balance: w_b, on changes of the tasks that keep balance.
        hand: w_h, on changes of the hands' tasks.
    """

    foot: float = 1e3
    balance: float = 1e3
    hand: float = 1e2

    def __post_init__(self) -> None:
        for name in self.__slots__:
            require_non_negative(f"{name}_weight", getattr(self, name))


@dataclass(frozen=True, slots=True, eq=False)
class FilterSettings:
    """How a filter is run.

    Attributes:
        infeasible: one of ``INFEASIBLE``, for ``cbf``, ``issf``, ``ecbf``, ``ssa`` and ``sss``.
        max_age: inputs older than this are refused [s], above 0.
        order: 1, the input is a velocity; 2, it is an acceleration.
        velocity_max: shape (nv,) bounds on the velocity after a step, order 2 only, kept as a copy; ``None`` for none.
        dt: that step [s], above 0; order 2, and recovery.
        recovery: how to come back from behind a barrier, see :mod:`safety.filters.recovery`; only for order 1 and
            filters that solve a QP. ``None``: the conditions are as strict there as anywhere.
    """

    infeasible: str = "least_slack"
    max_age: float = 0.1
    order: int = 1
    velocity_max: Array | None = None
    dt: float = 0.002
    recovery: RecoverySettings | None = None

    def __post_init__(self) -> None:
        if self.order not in {1, 2}:
            raise ConfigError("order", self.order, "1 (velocity) or 2 (acceleration)")
        require_one_of("infeasible", self.infeasible, INFEASIBLE)
        require_positive("max_age", self.max_age)
        require_positive("dt", self.dt)
        if self.velocity_max is not None:
            object.__setattr__(self, "velocity_max", checked_bounds("velocity_max", self.velocity_max))


def checked_bounds(name: str, bounds: Array) -> Array:
    """A copy of bounds (nv,), nobody may write to it.

    Raises:
        ConfigError: they are not one finite number above 0 per input.
    """
    out = np.array(bounds, dtype=float)
    if out.ndim != 1:
        raise ConfigError(name, bounds, "of shape (nv,), one number per input")
    if not (all_finite(out) and (out > 0).all()):
        raise ConfigError(name, bounds, "finite and above 0 throughout, one number per input")
    out.setflags(write=False)
    return out
