"""Problems of the comparison of filters: the G1 as 19 spheres, alone or among spheres that move."""

from dataclasses import dataclass

from controllers.policies.nominal import benchmark_limits
from robots.collision_models import with_collision_model
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array
from robots.pinocchio_model import upper_body_joints
from safety.barriers.barrier_set import (
    BarrierSet,
    CollisionBodies,
    ObstacleBarrier,
    SelfCollisionBarrier,
    WorkspaceBarrier,
)
from safety.barriers.rows import BarrierRows, HalfSpaces
from safety.filters.conditions import BarrierParameters, FamilyParameters, RowParameters
from safety.filters.safety_filter import KINDS, FilterSettings, SafetyFilter
from safety.filters.second_order import ecbf
from safety.geometry.shapes import Obstacle

SCENES = ("feasible", "infeasible")
"""feasible: obstacles keep away from the robot, and only states are kept where a hard CBF and a hard SSA have a
solution, at least two thirds of them with SSA at work. infeasible: two of five obstacles press against the robot, from
all sides, and only states are kept where a hard SSA has none."""

OBSTACLES = {31: 0, 219: 10, 979: 50}
"""Number of rows to number of obstacles: 29 pairs of bodies with 2 workspace bounds, or with 19 rows per obstacle."""

BASES = {17: "fixed", 20: "planar", 35: "floating"}
"""Number of variables to the base: 17 joints of the upper body, or all 29 where the base floats."""

RADIUS = 0.05
"""Of the obstacles [m]."""

SQUEEZE_MARGIN = 0.1
"""Margin of self-collision where no obstacle can make rows conflict [m]: shoulder and elbow are closer by build."""

ACCELERATION_GAIN = 10.0
"""The nominal acceleration is this times what the velocity is short of the nominal one [1/s]."""


def order_of(name: str) -> int:
    """Order at which a filter is measured: 1, velocities, unless it acts on accelerations only, 2."""
    return min(KINDS[name].orders)


@dataclass(frozen=True, slots=True)
class Moment:
    """One recorded tick.

    Attributes:
        q: shape (nq,) configuration.
        v: shape (nv,) velocity the robot had arrived with.
        v_des: shape (nv,) nominal velocity.
        obstacles: where they are, and how they move until the next tick.
    """

    q: Array
    v: Array
    v_des: Array
    obstacles: tuple[Obstacle, ...]

    @property
    def u_des(self) -> Array:
        """Nominal acceleration (nv,) [m/s^2, rad/s^2]."""
        return ACCELERATION_GAIN * (self.v_des - self.v)


class Problem:
    """The rows of one size on one base.

    Attributes:
        kin: the G1 on that base.
        bodies: its 19 spheres.
        n_obstacles: number of obstacles.
        n_rows: number of barrier rows.
        parameters: of the conditions; the papers' values but for the margin where bodies are squeezed.
        v_max: shape (nv,) velocity bounds.
        a_max: shape (nv,) acceleration bounds.
    """

    def __init__(self, n_rows: int, nv: int, scene: str) -> None:
        """``n_rows`` is a key of ``OBSTACLES``, ``nv`` one of ``BASES``, ``scene`` one of ``SCENES``."""
        robot = with_collision_model(load_robot("g1"), "g1_spheres")
        base = BASES[nv]
        self.kin = Kinematics(robot, base=base, joints=None if base == "floating" else upper_body_joints(robot))
        self.n_obstacles = OBSTACLES[n_rows]
        self.n_rows = n_rows
        self.bodies = CollisionBodies(self.kin)
        self._obstacles = ObstacleBarrier(self.bodies, ("sphere",) * self.n_obstacles) if self.n_obstacles else None
        own = SelfCollisionBarrier("self_collision", self.bodies, robot.self_collision_pairs)
        self.barriers = BarrierSet(self.kin, self.bodies, [own, self._obstacles or WorkspaceBarrier(self.kin)])
        squeezed = scene == "infeasible" and not self.n_obstacles
        margin = SQUEEZE_MARGIN if squeezed else None
        self.parameters = BarrierParameters(self_collision=FamilyParameters(margin=margin))
        self.v_max, self.a_max = (benchmark_limits(self.kin, order) for order in (1, 2))
        self._row_parameters: dict[str, RowParameters] = {}

    def set_obstacles(self, moment: Moment) -> None:
        """Tell the barrier where the obstacles are."""
        if self._obstacles is not None:
            self._obstacles.set_obstacles(moment.obstacles)

    def move(self, moment: Moment, second_order: bool = False) -> None:
        """Compute the robot's kinematics at a moment, for rows of this order."""
        if second_order:
            self.kin.update_motion(moment.q, moment.v)
        else:
            self.kin.update_geometry(moment.q)

    def rows(self, moment: Moment, second_order: bool = False) -> BarrierRows:
        """Rows at a moment, from the kinematics up; overwritten by the next call."""
        self.move(moment, second_order)
        self.set_obstacles(moment)
        return self.barriers.evaluate(self.kin, second_order)

    def bound(self, name: str) -> Array:
        """Bound (nv,) on the input of the filter ``name``."""
        return self.v_max if order_of(name) == 1 else self.a_max

    def filter(self, name: str) -> SafetyFilter:
        """A new filter."""
        return SafetyFilter(
            name, self.n_rows, self.parameters, self.bound(name), settings=FilterSettings(order=order_of(name))
        )

    def conditions(self, name: str, rows: BarrierRows, v: Array) -> HalfSpaces | None:
        """What the filter ``name`` demands; ``v`` (nv,) is the velocity now. ``None`` where it demands nothing."""
        kind = KINDS[name]
        if kind.condition is None:
            return None
        if name not in self._row_parameters:
            self._row_parameters[name] = self.parameters.of_rows(rows.family, kind.margins)
        parameters = self._row_parameters[name]
        return kind.condition(rows, parameters) if order_of(name) == 1 else ecbf(rows, v, parameters)
