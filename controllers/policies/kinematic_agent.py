"""An agent for a kinematic plant: a nominal policy and a safety filter behind one call a tick."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from controllers.perception import Detection
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
        command: shape (nv,) velocity for the plant.
        v_des: shape (nv,) of the policy.
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
    """Drives a kinematic plant by velocities: policy, barriers, filter.

    Args:
        kin: of the robot, on any base.
        policy: gives the nominal velocity.
        barriers: to keep; an obstacle barrier among them is told the obstacles of ``surroundings``.
        safety_filter: of velocities, for the rows of ``barriers``.
        dt: control period [s].
        surroundings: known without error.
        clock: monotonic seconds, for the filter's time.
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
        self._obstacles = next((b for b in barriers.barriers if isinstance(b, ObstacleBarrier)), None)

    def tick(self, state: RobotState, detections: Sequence[Detection] = ()) -> KinematicOutput:
        """The velocity for a measured configuration; ``detections`` are not looked at."""
        t = state.stamp
        self.kin.update_geometry(state.q)
        self._surroundings.move_goals(t)
        if self._obstacles is not None:
            self._obstacles.set_obstacles(self._surroundings.obstacles(t))
        rows = self.barriers.evaluate(self.kin)
        v_des = self.policy.velocity(self.kin)
        began = self._clock()
        result = self.filter.apply(rows, v_des)
        return KinematicOutput(result.v, v_des, rows, result, self._clock() - began)
