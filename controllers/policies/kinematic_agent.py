"""An agent for a kinematic plant: a nominal policy and a safety filter behind one call a tick."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, cast, runtime_checkable

from controllers.perception import Detection
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.messages import Array, RobotState
from safety.barriers.barrier_set import BarrierSet, ObstacleBarrier
from safety.barriers.rows import BarrierRows
from safety.filters.safety_filter import FilterResult, SafetyFilter
from safety.geometry.shapes import Obstacle


class Policy(Protocol):
    """What the robot would do if nothing were in its way."""

    def velocity(self, kin: Kinematics) -> Array:
        """Desired velocity (nv,) at the kinematics' configuration [m/s, rad/s]."""
        ...


@runtime_checkable
class AcceleratingPolicy(Policy, Protocol):
    """One that filters of order 2 need."""

    def acceleration(self, kin: Kinematics, v: Array) -> Array:
        """Desired acceleration (nv,) at the state of the kinematics and ``v`` (nv,) [m/s^2, rad/s^2]."""
        ...


class Surroundings(Protocol):
    """What an agent knows of the world without measuring it: obstacles, and where the policy is to go."""

    def obstacles(self, t: float) -> Sequence[Obstacle]:
        """Every obstacle at ``t`` [s], in an order and of kinds that stay."""
        ...

    def move_goals(self, t: float) -> None:
        """Give the policy its goals of ``t`` [s]."""
        ...


@dataclass(frozen=True, slots=True)
class KinematicOutput:
    """What one tick came to.

    Attributes:
        command: shape (nv,) velocity for the plant; acceleration where the filter is of order 2.
        v_des: shape (nv,) of the policy, likewise.
        rows: barrier rows at the state, valid until the next tick.
        result: of the filter.
        filter_seconds: that the filter took.
    """

    command: Array
    v_des: Array
    rows: BarrierRows
    result: FilterResult
    filter_seconds: float


class KinematicAgent:
    """Drives a kinematic plant: policy, barriers, filter; by accelerations where the filter is of order 2.

    Args:
        kin: of the robot, on any base.
        policy: gives the nominal velocity or acceleration.
        barriers: to keep; an obstacle barrier among them is told the obstacles of ``surroundings``.
        safety_filter: for the rows of ``barriers``.
        dt: control period [s].
        surroundings: known without error.
        clock: monotonic seconds, for the filter's time.

    Raises:
        ConfigError: a filter of order 2 with a policy that has no accelerations.
    """

    def __init__(
        self,
        kin: Kinematics,
        policy: Policy,
        barriers: BarrierSet,
        safety_filter: SafetyFilter,
        dt: float,
        surroundings: Surroundings,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self.kin, self.policy, self.barriers, self.filter, self.dt = kin, policy, barriers, safety_filter, dt
        self._surroundings, self._clock = surroundings, clock
        if safety_filter.settings.order == 2 and not isinstance(policy, AcceleratingPolicy):
            raise ConfigError("policy", type(policy).__name__, "one with accelerations, for a filter of order 2")
        self._obstacles = next((b for b in barriers.barriers if isinstance(b, ObstacleBarrier)), None)

    def tick(self, state: RobotState, detections: Sequence[Detection] = ()) -> KinematicOutput:
        """The command for a measured state; ``detections`` are not looked at."""
        t, second = state.stamp, self.filter.settings.order == 2
        if second:
            self.kin.update_motion(state.q, state.v)
        else:
            self.kin.update_geometry(state.q)
        self._surroundings.move_goals(t)
        if self._obstacles is not None:
            self._obstacles.set_obstacles(self._surroundings.obstacles(t))
        rows = self.barriers.evaluate(self.kin, second)
        v_des = self._desired(state, second)
        began = self._clock()
        result = self.filter.apply(rows, v_des, velocity=state.v if second else None)
        return KinematicOutput(result.v, v_des, rows, result, self._clock() - began)

    def _desired(self, state: RobotState, second: bool) -> Array:
        """What the policy asks for: a velocity or an acceleration."""
        if not second:
            return self.policy.velocity(self.kin)
        return cast(AcceleratingPolicy, self.policy).acceleration(self.kin, state.v)
