"""Nominal policy of the benchmarks: hands and base go to their goals and take no account of anything else."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from robots.checks import all_finite, require_positive
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.messages import Array
from wbc.kinwbc import KinWbc
from wbc.tasks import PostureTask, Task, TaskGains

WAIST_LIMIT, ARM_LIMIT, BASE_LIMIT = 0.1, 1.5, 0.3
"""Bounds of the SPARK benchmark on velocities [rad/s, rad/s, m/s and rad/s]."""

ACCELERATION_SCALE = 100.0
"""Its bounds on accelerations are those on velocities times this [1/s]."""


@dataclass(frozen=True, slots=True)
class NominalGains:
    """Gains of the policy.

    Attributes:
        hand: task gain of the hands, and their largest speed [1/s, m/s].
        base: task gain of the base, and its largest speed [1/s, m/s and rad/s together].
        posture: task gain of the joints, and the largest norm of their velocity [1/s, rad/s].
        damping: k_d of the acceleration version [1/s], above 0.
    """

    hand: TaskGains = field(default_factory=lambda: TaskGains(2.0, 0.3))
    base: TaskGains = field(default_factory=lambda: TaskGains(1.0, 0.3))
    posture: TaskGains = field(default_factory=lambda: TaskGains(1.0, 1.0))
    damping: float = 5.0

    def __post_init__(self) -> None:
        require_positive("damping", self.damping)


class PointTask(Task):
    """A point that is fixed in a frame to ``position`` (3,), world [m]."""

    rows = 3

    def __init__(self, frame_id: int, offset: Array, gains: TaskGains) -> None:
        """``frame_id`` as given by :meth:`Kinematics.frame_id`; ``offset`` (3,) in the frame's axes [m]."""
        super().__init__(gains)
        self._frame_id = frame_id
        self._offset = np.array(offset, dtype=float)
        self.position = np.zeros(3)

    def place(self, kin: Kinematics) -> Array:
        """The point (3,) in the world [m]."""
        rotation, origin = kin.frame_placement(self._frame_id)
        return origin + rotation @ self._offset

    def evaluate(self, kin: Kinematics) -> tuple[Array, Array]:
        """See :meth:`Task.evaluate`."""
        rotation, _ = kin.frame_placement(self._frame_id)
        jacobian = kin.frame_jacobian(self._frame_id)
        arm = rotation @ self._offset
        # velocity of the point: that of the frame's origin plus omega x arm
        linear = jacobian[:3] + np.cross(jacobian[3:], arm, axis=0)
        return linear, self.gains.correction(self.position - self.place(kin))


class PlanarBaseTask(Task):
    """A planar base to ``goal`` (3,) = [x, y, yaw] [m, m, rad]; turns the shorter way."""

    rows = 3

    def __init__(self, nv: int, gains: TaskGains) -> None:
        """For a robot whose velocity has ``nv`` entries, the base's first."""
        super().__init__(gains)
        self.goal = np.zeros(3)
        self._jacobian = np.eye(3, nv)

    def evaluate(self, kin: Kinematics) -> tuple[Array, Array]:
        """See :meth:`Task.evaluate`; the velocity is in the base's own axes."""
        x, y, c, s = kin.q[:4]
        dx, dy = self.goal[0] - x, self.goal[1] - y
        turn = math.remainder(self.goal[2] - math.atan2(s, c), math.tau)
        return self._jacobian, self.gains.correction(np.array([c * dx + s * dy, c * dy - s * dx, turn]))


class NominalPolicy:
    r"""Velocity (or acceleration) that brings points of the robot to goals, by KinWBC, and knows of no obstacle.

    Levels: the planar base, where there is one; then the points, all of them together; then the posture. The answer is
    clipped entry by entry to ``limits``. At acceleration level, with v_des the clipped velocity,

    .. math:: u = k_d (v^{des} - v) = k_p e - k_d v, \qquad k_p = k_d k

    with k the task gain. Source: the benchmark SPARK v1.0 moves by the same law (10 e - 5 v), with e from an inverse
    kinematics that it solves to the end every tick.

    Attributes:
        points: the tasks of the points; set ``position`` of each.
        base: the task of the planar base, or ``None``; set its ``goal``.
    """

    def __init__(
        self,
        kin: Kinematics,
        points: Sequence[tuple[str, Array]],
        posture: Array,
        gains: NominalGains | None = None,
        limits: Array | None = None,
    ) -> None:
        """Goals are where the robot is at the kinematics' configuration until they are set.

        Args:
            kin: updated kinematics, on a planar or fixed base.
            points: frame name and offset in the frame's axes (3,) [m] of each point that gets a goal.
            posture: shape (nj,) angles that the joints go to as far as the points leave them free [rad].
            gains: of the tasks.
            limits: shape (nv,) bounds on the size of each velocity, above 0; ``None``: none.

        Raises:
            ConfigError: a floating base, another number of angles, or a limit that is not above 0.
            UnknownNameError: no such frame.
        """
        nj = kin.nv - kin.nv_base
        if kin.base == "floating":
            raise ConfigError("base", kin.base, "planar or fixed: nothing here keeps a floating base upright")
        if np.shape(posture) != (nj,) or not all_finite(posture):
            raise ConfigError("posture", posture, f"{nj} finite numbers")
        if limits is not None and (np.shape(limits) != (kin.nv,) or not (all_finite(limits) and (limits > 0).all())):
            raise ConfigError("limits", limits, f"{kin.nv} finite numbers above 0")
        self.gains = gains or NominalGains()
        self._limits = None if limits is None else np.array(limits, dtype=float)
        self.points = tuple(PointTask(kin.frame_id(name), offset, self.gains.hand) for name, offset in points)
        for task in self.points:
            task.position = task.place(kin)
        self.base = PlanarBaseTask(kin.nv, self.gains.base) if kin.base == "planar" else None
        if self.base is not None:
            self.base.goal = np.array([kin.q[0], kin.q[1], math.atan2(kin.q[3], kin.q[2])])
        rest = PostureTask(nj, self.gains.posture, kin.nv_base)
        rest.set_target(np.array(posture, dtype=float))
        first = [] if self.base is None else [self.base]
        self._solver = KinWbc(kin.nv, [first, self.points, [rest]])

    def velocity(self, kin: Kinematics) -> Array:
        """Desired velocity (nv,), clipped to the limits [m/s, rad/s]."""
        v = self._solver.solve(self._solver.evaluate(kin))
        return v if self._limits is None else np.clip(v, -self._limits, self._limits)

    def acceleration(self, kin: Kinematics, v: Array) -> Array:
        """Desired acceleration (nv,) at velocity ``v`` (nv,); its own bounds are the caller's [m/s^2, rad/s^2]."""
        return self.gains.damping * (self.velocity(kin) - v)


def benchmark_limits(kin: Kinematics, order: int = 1) -> Array:
    """Bounds (nv,) of the SPARK benchmark on the G1's velocities (``order`` 1) or accelerations (``order`` 2).

    Joints called waist have one bound, all others that of the arms.

    Raises:
        ConfigError: another order.
    """
    if order not in (1, 2):
        raise ConfigError("order", order, "1 (velocity) or 2 (acceleration)")
    joints = [WAIST_LIMIT if name.startswith("waist") else ARM_LIMIT for name in kin.joint_names]
    limits = np.array([BASE_LIMIT] * kin.nv_base + joints)
    return limits if order == 1 else ACCELERATION_SCALE * limits
