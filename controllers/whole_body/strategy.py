"""Where in a tick the barrier conditions are imposed: the protocol of the strategies."""

from dataclasses import dataclass
from typing import Protocol

from controllers.whole_body.config import FilterTuning
from robots.messages import Array, Indices, Mask
from safety.barriers.rows import BarrierRows, HalfSpaces
from safety.filters.results import FilterResult
from wbc.dynwbc import DynWbcResult


@dataclass(frozen=True, slots=True)
class MetricJacobians:
    """What the filter is to leave alone, by weight.

    Attributes:
        feet: shape (12, nv) Jacobians of left and right sole.
        balance: shape (l, nv) of the tasks that keep balance.
        hands: shape (m, nv) of the hands' tasks; ``None`` where the hands are no tasks.
    """

    feet: Array
    balance: Array
    hands: Array | None


@dataclass(frozen=True, slots=True)
class AccelerationConditions:
    """What DynWBC's acceleration has to satisfy.

    Attributes:
        spaces: half-spaces of the barriers.
        joint_bounds: lowest and highest acceleration of the joints, (nj,) each [rad/s^2].
    """

    spaces: HalfSpaces
    joint_bounds: tuple[Array, Array]


class SafetyStrategy(Protocol):
    """Keeps barriers: by filtering KinWBC's velocity before DynWBC, or by conditions within DynWBC.

    A tick asks for the velocity, then for the conditions, and after DynWBC for the result.
    """

    @property
    def second_order(self) -> bool:
        """Whether the barrier rows need their curvature."""
        ...

    @property
    def condition_count(self) -> int:
        """How many conditions DynWBC is given."""
        ...

    def prepare(self, family: Indices) -> None:
        """Have everything ready for rows of these families (n,)."""
        ...

    def reset(self) -> None:
        """The robot is at rest: nothing is left of the ticks before."""
        ...

    def resume(self, v_des: Array, v: Array) -> None:
        """Go on from the desired velocity and the command (nv,) of the last tick, which another strategy answered."""
        ...

    def set_safety(self, safety: FilterTuning) -> None:
        """Take other parameters, weights and bounds, from the next tick on.

        Raises:
            ConfigError: they have parameters of another filter; nothing changes.
        """
        ...

    def filter_velocity(
        self, rows: BarrierRows, v_des: Array, tasks: MetricJacobians, in_contact: Mask, v: Array
    ) -> FilterResult:
        """The velocity that DynWBC is to follow.

        Args:
            rows: of the barriers.
            v_des: shape (nv,) KinWBC's velocity.
            tasks: what is to be left alone.
            in_contact: shape (2,) whether each foot is meant to be on the ground.
            v: shape (nv,) measured velocity.
        """
        ...

    def conditions(self, rows: BarrierRows, v: Array) -> AccelerationConditions | None:
        """What DynWBC's acceleration has to satisfy at the measured velocity ``v`` (nv,); ``None``: nothing."""
        ...

    def conclude(
        self, filtered: FilterResult, conditions: AccelerationConditions | None, dynamic: DynWbcResult, v: Array
    ) -> FilterResult:
        """The velocity that the motors are told, and what it does to the barriers.

        Args:
            filtered: of :meth:`filter_velocity`.
            conditions: of :meth:`conditions`.
            dynamic: what DynWBC found.
            v: shape (nv,) measured velocity.
        """
        ...
