"""What the whole body is asked for while it walks: feet, CoM, heading."""

import math

import numpy as np

from controllers.balance.dcm_plan import DcmReference
from controllers.gaits.foot_state import BodyKinematics, Feet
from controllers.gaits.footholds import LEFT, RIGHT
from controllers.gaits.walking.swing_path import FootMotion
from controllers.reference import PointReference, WholeBodyReference
from robots.messages import Array, Mask

Swing = tuple[int, FootMotion]
"""Which foot is in the air, and its motion."""


def _constant(array: np.ndarray) -> np.ndarray:
    """An array that many ticks hand out: nobody may write to it."""
    array.setflags(write=False)
    return array


STILL: Array = _constant(np.zeros(3))
"""Velocity and acceleration of what stands [m/s, m/s^2]."""

NO_TURNS: Array = _constant(np.zeros((2, 2)))
"""Rates of soles that stand."""

BOTH_FEET: Mask = _constant(np.array([True, True]))
"""Contact of a robot on both feet."""

ONE_FOOT: tuple[Mask, Mask] = (_constant(np.array([False, True])), _constant(np.array([True, False])))
"""Contact where the left foot, and where the right foot is in the air."""


class WalkingReferences:
    """Writes references: soles where they stand or swing, base and torso upright in the mean heading of the feet.

    The CoM's reference is that of the pendulum whose DCM is planned; only its height is used for control. Arrays are
    made anew where their numbers change and are read-only where several ticks share them, so that they may be kept.
    """

    def __init__(self, kin: BodyKinematics, feet: Feet) -> None:
        """Base and torso keep the posture against the feet that they have now."""
        roles, back = kin.robot.roles, _about_z(-_mean_angle(*feet.yaws))
        self._upright = np.array([back @ kin.frame_placement(kin.frame_id(roles[r]))[0] for r in ("base", "torso")])
        self._com = (float(kin.com[0]), float(kin.com[1]))
        self._time: float | None = None
        self._soles = (_SharedRotation(), _SharedRotation())
        self._heading = math.nan
        self._body = self._upright

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
            load_limits: shape (2,) largest fraction of the weight on each foot.
        """
        reference.dcm, reference.load_limits = dcm, load_limits
        if swing is None:
            _stand(reference.soles[LEFT], feet.centres[LEFT])
            _stand(reference.soles[RIGHT], feet.centres[RIGHT])
            reference.in_contact, reference.sole_turns, reference.turn_rate = BOTH_FEET, NO_TURNS, 0.0
            yaws = feet.yaws
        else:
            yaws = self._write_step(reference, feet, *swing)
        reference.sole_rotations = (self._soles[LEFT].at(yaws[LEFT]), self._soles[RIGHT].at(yaws[RIGHT]))
        reference.base_rotation, reference.torso_rotation = self._turned(_mean_angle(*yaws))
        self._write_com(reference, t, dcm, feet.com_height + feet.height)

    def _write_step(
        self, reference: WholeBodyReference, feet: Feet, foot: int, motion: FootMotion
    ) -> tuple[float, float]:
        """One foot on the ground and ``foot`` in the air; returns the directions of both [rad]."""
        _stand(reference.soles[1 - foot], feet.centres[1 - foot])
        point = reference.soles[foot]
        point.position, point.velocity, point.acceleration, yaw, rate, second_rate = motion
        # base and torso turn with the mean of the feet
        reference.in_contact, reference.turn_rate = ONE_FOOT[foot], 0.5 * rate
        if foot == LEFT:
            reference.sole_turns = np.array([[rate, second_rate], [0.0, 0.0]])
            return yaw, feet.footholds[RIGHT].yaw
        reference.sole_turns = np.array([[0.0, 0.0], [rate, second_rate]])
        return feet.footholds[LEFT].yaw, yaw

    def _turned(self, heading: float) -> Array:
        """Rotations of base and torso at a heading [rad], (2, 3, 3): the same array for as long as it is the same."""
        if heading != self._heading:
            self._heading, self._body = heading, _constant(_about_z(heading) @ self._upright)
        return self._body

    def _write_com(self, reference: WholeBodyReference, t: float, dcm: DcmReference, height: float) -> None:
        """The CoM that follows the planned DCM, integrated from tick to tick with the DCM of this one."""
        dt = 0.0 if self._time is None else t - self._time
        self._time = t
        (x, y), (cx, cy), omega = dcm.position.tolist(), self._com, dcm.omega
        velocity = np.array([omega * (x - cx), omega * (y - cy), 0.0])
        decay = math.exp(-omega * dt)
        self._com = cx, cy = x + (cx - x) * decay, y + (cy - y) * decay
        point = reference.com
        point.position, point.velocity, point.acceleration = np.array([cx, cy, height]), velocity, STILL


class _SharedRotation:
    """The rotation about the vertical by the last angle asked for: that of a foot that stands, in tick after tick."""

    def __init__(self) -> None:
        self._yaw, self._rotation = math.nan, _about_z(0.0)

    def at(self, yaw: float) -> Array:
        if yaw != self._yaw:
            self._yaw, self._rotation = yaw, _constant(_about_z(yaw))
        return self._rotation


def _stand(point: PointReference, place: Array) -> None:
    point.position, point.velocity, point.acceleration = place, STILL, STILL


def _mean_angle(a: float, b: float) -> float:
    """Half-way from ``a`` to ``b``, the shorter way round [rad]."""
    return a + 0.5 * math.remainder(b - a, math.tau)


def _about_z(yaw: float) -> Array:
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0]).reshape(3, 3)
