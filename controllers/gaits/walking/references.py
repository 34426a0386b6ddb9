"""What the whole body is asked for while it walks: feet, CoM, heading."""

import math

import numpy as np

from controllers.balance.dcm_plan import DcmReference
from controllers.gaits.foot_state import BodyKinematics, Feet
from controllers.gaits.footholds import LEFT, RIGHT
from controllers.reference import PointReference, WholeBodyReference
from robots.messages import Array

STILL = np.zeros(3)
STILL.setflags(write=False)
"""Velocity and acceleration of what stands [m/s, m/s^2]."""

Swing = tuple[int, Array]
"""Which foot is in the air, and its x, y, height, yaw, their rates, their second rates: shape (3, 4)."""


class WalkingReference:
    """Writes references: soles where they stand or swing, base and torso upright in the mean heading of the feet.

    The CoM's reference is that of the pendulum whose DCM is planned; only its height is used for control.
    """

    def __init__(self, kin: BodyKinematics, feet: Feet) -> None:
        """Base and torso keep the posture against the feet that they have now."""
        roles, back = kin.robot.roles, _about_z(-_mean_angle(*feet.yaws))
        self._upright = [back @ kin.frame_placement(kin.frame_id(roles[r]))[0] for r in ("base", "torso")]
        self._com = kin.com[:2].copy()
        self._time: float | None = None

    def write(
        self,
        reference: WholeBodyReference,
        t: float,
        dcm: DcmReference,
        feet: Feet,
        swing: Swing | None,
        load_limits: Array,
    ) -> None:
        """Write everything that a gait gives for time ``t`` [s] into ``reference``.

        Args:
            reference: changed in place.
            t: of this tick [s].
            dcm: planned.
            feet: footholds of the feet on the ground.
            swing: the foot in the air.
            load_limits: shape (2,) largest share of the weight on each foot.
        """
        reference.dcm, reference.load_limits = dcm, load_limits
        reference.in_contact = np.array([True, True])
        reference.sole_turns = np.zeros((2, 2))
        yaws = [hold.yaw for hold in feet.footholds]
        for foot in (LEFT, RIGHT):
            hold, point = feet.footholds[foot], reference.soles[foot]
            point.position = np.array([hold.x, hold.y, feet.heights[foot]])
            point.velocity = point.acceleration = STILL
        if swing is not None:
            foot, path = swing
            point = reference.soles[foot]
            point.position, point.velocity, point.acceleration = path[:, :3]
            reference.in_contact[foot] = False
            yaws[foot], reference.sole_turns[foot] = float(path[0, 3]), path[1:, 3]
        left, right = yaws
        reference.sole_rotations = (_about_z(left), _about_z(right))
        turn = _about_z(_mean_angle(left, right))
        reference.base_rotation, reference.torso_rotation = turn @ self._upright[0], turn @ self._upright[1]
        reference.turn_rate = 0.5 * float(reference.sole_turns[:, 0].sum())
        self._write_com(reference, t, dcm, feet.com_height + 0.5 * sum(feet.heights))

    def _write_com(self, reference: WholeBodyReference, t: float, dcm: DcmReference, height: float) -> None:
        dt = 0.0 if self._time is None else t - self._time
        self._time = t
        velocity = dcm.omega * (dcm.position - self._com)
        self._com = dcm.position + (self._com - dcm.position) * math.exp(-dcm.omega * dt)
        position = np.array([self._com[0], self._com[1], height])
        reference.com = PointReference(position, np.array([velocity[0], velocity[1], 0.0]))


def _mean_angle(a: float, b: float) -> float:
    """Half-way from ``a`` to ``b``, the shorter way round [rad]."""
    return a + 0.5 * math.remainder(b - a, math.tau)


def _about_z(yaw: float) -> Array:
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
