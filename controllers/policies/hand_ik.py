r"""Inverse kinematics of the benchmarks: hands to goals in the base's axes, within the joints' limits.

.. math:: \min_q \sum_i \|p_i(q) - g_i\|^2 \quad \text{s.t.} \quad q_{min} \le q \le q_{max}

from where the joints are, to the end in every tick; only places, no orientations. SPARK v1.0 solves the same problem by
an interior-point method of at most 20 steps, of which nothing is defined that this problem leaves open: of all joint
angles that bring the hands to their goals, the ones found here are near those of the start, since every step is the
shortest that the linearised problem has. Source: Levenberg-Marquardt with active bounds, Nocedal and Wright, *Numerical
optimization*, 2nd ed., sections 10.3 and 16.7.
"""

from collections.abc import Sequence

import numpy as np

from controllers.policies.ik_kernels import place_joints, reach
from robots.checks import all_finite
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.messages import Array

MOST_STEPS = 20
"""Of a solution, as there."""

TOLERANCE = 1e-5
"""Of a hand's place, entry by entry [m]."""


class HandIk:
    """Solves for joint angles; see the module.

    Args:
        robot: the description.
        joints: names of those that move, the others locked as in ``posture``.
        points: frame name and offset (3,) in its axes [m] of each point.
        posture: that gives the height of the base and the angles of the locked joints.

    Attributes:
        joint_names: in the order of the angles.
        limits: (lower, upper), each (n,) [rad].
        steps: that the last solution took.

    Raises:
        ConfigError: a point is carried by none of the joints.
        UnknownNameError: no such joint or frame.
    """

    def __init__(
        self,
        robot: RobotDescription,
        joints: Sequence[str],
        points: Sequence[tuple[str, Array]],
        posture: str = "standing",
    ) -> None:
        kin = Kinematics(robot, base="fixed", joints=joints, posture=posture)
        model, described = kin.model, [robot.joints[i] for i in kin.joint_indices]
        self.joint_names, self.limits = kin.joint_names, kin.position_limits
        self._origin = np.array([0.0, 0.0, robot.posture(posture).base_height])
        placements = [model.jointPlacements[i] for i in range(1, model.njoints)]
        self._parents = np.array([model.parents[i] - 1 for i in range(1, model.njoints)], dtype=np.int64)
        self._turns = np.array([p.rotation for p in placements])
        self._shifts = np.array([p.translation for p in placements])
        self._axes = np.array([joint.axis for joint in described], dtype=float)
        frames = [model.frames[kin.frame_id(name)] for name, _ in points]
        for (name, _), frame in zip(points, frames, strict=True):
            if frame.parentJoint == 0:
                raise ConfigError("point", name, "a frame that one of the joints carries: " + ", ".join(joints))
        self._carriers = np.array([frame.parentJoint - 1 for frame in frames], dtype=np.int64)
        self._offsets = np.array([f.placement.act(np.array(o)) for f, (_, o) in zip(frames, points, strict=True)])
        self.steps = 0

    def places(self, q: Array) -> Array:
        """Places (m, 3) of the points in the base's axes [m] at angles ``q`` (n,) [rad]."""
        n = len(self.joint_names)
        rotations, origins = np.empty((n, 3, 3)), np.empty((n, 3))
        place_joints(q, self._parents, self._turns, self._shifts, self._axes, rotations, origins)
        at = self._carriers
        return np.asarray(origins[at] + np.einsum("iab,ib->ia", rotations[at], self._offsets) - self._origin)

    def solve(self, q: Array, goals: Array) -> Array:
        """Angles (n,) [rad], within limits, that bring the points to ``goals`` or as near as steps lead.

        Args:
            q: shape (n,) to start from; brought within limits first [rad].
            goals: shape (m, 3) in the base's axes [m].

        Raises:
            ConfigError: angles or goals have another shape, or are not finite.
        """
        n, m = len(self.joint_names), len(self._carriers)
        if np.shape(q) != (n,) or not all_finite(q):
            raise ConfigError("q", q, f"{n} finite numbers")
        if np.shape(goals) != (m, 3) or not all_finite(goals):
            raise ConfigError("goals", goals, f"{m} places of 3 finite numbers")
        lower, upper = self.limits
        found = np.clip(q, lower, upper)
        self.steps = reach(
            found,
            lower,
            upper,
            self._parents,
            self._turns,
            self._shifts,
            self._axes,
            self._carriers,
            self._offsets,
            goals + self._origin,
            TOLERANCE,
            MOST_STEPS,
        )
        return found
