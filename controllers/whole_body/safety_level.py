"""The safety level of a tick: barrier rows, and the strategy that keeps them, which can be changed."""

from collections.abc import Callable, Sequence

from controllers.whole_body.config import ControllerConfig
from controllers.whole_body.strategies import make_strategy
from controllers.whole_body.strategy import SafetyStrategy
from controllers.whole_body.velocity_filter import VelocityFilter
from robots.kinematics import Kinematics
from robots.messages import Array
from safety.barriers.barrier_set import Barrier, BarrierSet, ObstacleBarrier, standard_barriers
from safety.barriers.rows import BarrierRows
from safety.filters.safety_filter import SafetyFilter
from safety.geometry.shapes import Obstacle
from wbc.dynwbc import DynWbc


class SafetyLevel:
    """Barriers and the strategy at work.

    Attributes:
        barriers: what is kept.
        strategy: keeps it.
    """

    def __init__(
        self,
        kin: Kinematics,
        config: ControllerConfig,
        dynwbc: DynWbc,
        obstacle_kinds: Sequence[str],
        extra_barriers: Callable[[Kinematics], Sequence[Barrier]] | None,
    ) -> None:
        """For one robot; arguments as of :class:`controllers.whole_body.controller.WholeBodyController`."""
        self._kin, self._dynwbc, self._joint_limits = kin, dynwbc, kin.robot.joint_array("velocity")
        extra = () if extra_barriers is None else extra_barriers(kin)
        self.barriers: BarrierSet = standard_barriers(kin, obstacle_kinds, extra)
        self._obstacles = next((b for b in self.barriers.barriers if isinstance(b, ObstacleBarrier)), None)
        self.strategy = self._make(config)
        dynwbc.expect_conditions(self.strategy.condition_count)
        self._key = _key(config)
        # prepared, or at work before
        self._others: dict[tuple[str, bool], SafetyStrategy] = {}
        self._last: tuple[Array, Array] | None = None

    def _make(self, config: ControllerConfig) -> SafetyStrategy:
        return make_strategy(config, self.barriers.size, self._joint_limits, self._dynwbc)

    @property
    def filter(self) -> SafetyFilter | None:
        """The filter of velocities; ``None`` where the conditions are DynWBC's."""
        return self.strategy.filter if isinstance(self.strategy, VelocityFilter) else None

    @property
    def obstacle_kinds(self) -> tuple[str, ...]:
        """Kind of each obstacle that every tick is given."""
        return () if self._obstacles is None else tuple(self._obstacles.kinds)

    def rows(self, obstacles: Sequence[Obstacle]) -> BarrierRows:
        """Rows at the kinematics' state, of second order where the strategy needs it.

        Raises:
            ValueError: number or kinds of obstacles are not as announced.
        """
        if self._obstacles is not None:
            self._obstacles.set_obstacles(obstacles)
        elif obstacles:
            raise ValueError(f"{len(obstacles)} obstacles given, 0 announced")
        second_order = self.strategy.second_order
        if second_order:
            self._kin.update_second_order()
        return self.barriers.evaluate(self._kin, second_order)

    def note(self, v_des: Array, v: Array) -> None:
        """What a tick came to: desired velocity and command (nv,), for another strategy to go on from."""
        self._last = v_des, v

    def reset(self) -> None:
        """The robot is at rest: nothing is left of the ticks before."""
        self.strategy.reset()
        self._last = None

    def warm(self) -> None:
        """Have everything ready that the strategy makes in its first tick."""
        self.strategy.prepare(self.barriers.families)

    def prepare(self, config: ControllerConfig) -> None:
        """Make the strategy of a configuration that may be asked for later."""
        key = _key(config)
        if key == self._key:
            return
        strategy = self._others.setdefault(key, self._make(config))
        strategy.prepare(self.barriers.families)
        self._dynwbc.prepare_conditions(strategy.condition_count)

    def change(self, config: ControllerConfig) -> None:
        """Go on with the strategy of this configuration from the command of the last tick.

        Raises:
            ConfigError: it has parameters of another filter; nothing changes.
        """
        if _key(config) == self._key:
            self.strategy.set_safety(config.safety)
            return
        strategy = self._others.get(_key(config)) or self._make(config)
        strategy.set_safety(config.safety)
        strategy.prepare(self.barriers.families)
        strategy.reset()
        if self._last is not None:
            strategy.resume(*self._last)
        self._dynwbc.expect_conditions(strategy.condition_count)
        self._others[self._key] = self.strategy
        self.strategy, self._key = strategy, _key(config)


def _key(config: ControllerConfig) -> tuple[str, bool]:
    """What makes another strategy necessary."""
    return config.filter, config.adaptive
