r"""A simple estimator of the base, to compare with: integrated gyro, tilt from the accelerometer, one axis at a time.

The gyro without its calibrated bias is integrated; roll and pitch are drawn to the measured specific force as a
complementary filter does, :math:`\dot R = R (\omega + k\, \hat a \times \hat R^T e_z)^\times`; yaw is drawn to the
soles that stand. Position, velocity and the soles' positions have a Kalman filter for each axis of the world, which all
share one covariance but for the height, with the acceleration as input and the legs' kinematics as measurement.

Source: complementary filter on SO(3) as in Mahony, Hamel and Pflimlin, *Nonlinear complementary filters on the special
orthogonal group*, IEEE TAC 53(5), 2008, eq. (32) without bias; base position and velocity with feet as states:
Bloesch et al., *State estimation for legged robots*, RSS 2012, per axis and with rotation taken for known.
"""

import math

import numpy as np

from controllers.estimation.invariant_filter import DOWN, FilterNoise
from controllers.estimation.rotations import exponential
from robots.messages import Array, Mask
from wbc.wrench import GRAVITY

TILT_GAIN = 0.3
"""k: rate at which an error of the tilt decays [1/s]."""

YAW_GAIN = 0.5
"""Rate at which the base's yaw is drawn to that of a sole that stands [1/s]."""

POSITION, VELOCITY, SOLES = 0, 1, (2, 3)
"""Places in the state of an axis."""


class SimpleFilter:
    """See the module; the same calls and attributes as :class:`InvariantFilter`, but for the accelerometer's bias."""

    def __init__(self, noise: FilterNoise | None = None) -> None:
        """``noise``: of sensors and soles; that of :class:`FilterNoise` if not given."""
        self.noise = noise or FilterNoise()
        self.rotation, self.sole_rotations = np.eye(3), np.stack([np.eye(3)] * 2)
        self.gyro_bias = np.zeros(3)
        self._axes = np.zeros((4, 3))
        self._level, self._vertical = np.eye(4), np.eye(4)
        self._dt = 0.0

    @property
    def position(self) -> Array:
        """Position (3,) of the IMU [m]."""
        return self._axes[POSITION]

    @property
    def velocity(self) -> Array:
        """Velocity (3,) of the IMU [m/s]."""
        return self._axes[VELOCITY]

    @property
    def sole_positions(self) -> Array:
        """Positions (2, 3) of the soles [m]."""
        return self._axes[2:]

    def reset(self, rotation: Array, position: Array, soles: Array, sole_rotations: Array, gyro_bias: Array) -> None:
        """See :meth:`InvariantFilter.reset`."""
        self.rotation, self.sole_rotations, self.gyro_bias = rotation.copy(), sole_rotations.copy(), gyro_bias.copy()
        self._axes = np.vstack([position, np.zeros(3), soles])
        self._level = np.diag([1e-4, 1e-3, self.noise.ground, self.noise.ground]) ** 2
        self._vertical = self._level.copy()

    def predict(self, gyro: Array, accelerometer: Array, standing: Array, dt: float) -> None:
        """See :meth:`InvariantFilter.predict`."""
        up = self.rotation.T[:, 2]
        size = float(np.linalg.norm(accelerometer))
        # only while the robot is nearly at rest does the force say what is up
        trust = TILT_GAIN if abs(size - GRAVITY) < 0.1 * GRAVITY else 0.0
        rate = gyro - self.gyro_bias + trust * np.cross(accelerometer / max(size, 1e-9), up)
        acceleration = self.rotation @ exponential(0.5 * dt * rate) @ accelerometer + DOWN
        self._axes[POSITION] += dt * self._axes[VELOCITY] + 0.5 * dt * dt * acceleration
        self._axes[VELOCITY] += dt * acceleration
        self.rotation = self.rotation @ exponential(dt * rate)
        transition = np.eye(4)
        transition[POSITION, VELOCITY] = dt
        noise, spread = self.noise, np.zeros(4)
        # what is wrong with the tilt and the accelerometer's bias is not in the state: it counts as noise
        spread[VELOCITY] = 10.0 * noise.accelerometer
        for foot, place in enumerate(SOLES):
            on = float(standing[foot])
            spread[place] = noise.slip**on * noise.swing ** (1.0 - on)
        for covariance in (self._level, self._vertical):
            covariance[:] = transition @ covariance @ transition.T + dt * np.diag(spread**2)
        self._dt = dt

    def correct(self, soles: Array, sole_rotations: Array, standing: Mask, ground: Array | None = None) -> None:
        """See :meth:`InvariantFilter.correct`."""
        rows = np.array([[-1.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 1.0]])
        measured = soles @ self.rotation.T
        variances = np.full(2, self.noise.kinematics**2)
        self._axes[:, :2] += _gain(self._level, rows, variances) @ (measured[:, :2] - rows @ self._axes[:, :2])
        heights = measured[:, 2]
        if ground is not None and standing.any():
            feet = np.flatnonzero(standing)
            rows = np.vstack([rows, np.eye(4)[feet + 2]])
            heights = np.append(heights, ground[feet])
            variances = np.append(variances, np.full(feet.size, self.noise.ground**2))
        self._axes[:, 2] += _gain(self._vertical, rows, variances) @ (heights - rows @ self._axes[:, 2])
        self._follow_yaw(sole_rotations, standing)

    def doubt_gyro_bias(self, deviation: float) -> None:
        """See :meth:`InvariantFilter.doubt_gyro_bias`; nothing comes of it: the bias is that of the calibration."""

    def _follow_yaw(self, sole_rotations: Array, standing: Mask) -> None:
        """Turn the base towards the yaw that standing soles have kept; those in the air keep that of the base."""
        for foot in range(2):
            now = self.rotation @ sole_rotations[foot]
            if not standing[foot]:
                self.sole_rotations[foot] = now
                continue
            kept = self.sole_rotations[foot]
            error = math.atan2(kept[1, 0], kept[0, 0]) - math.atan2(now[1, 0], now[0, 0])
            error = math.remainder(error, 2.0 * math.pi)
            self.rotation = exponential(np.array([0.0, 0.0, YAW_GAIN * self._dt * error])) @ self.rotation


def _gain(covariance: Array, rows: Array, variances: Array) -> Array:
    """Kalman's gain (4, m); the covariance is corrected in place."""
    cross = covariance @ rows.T
    gain = np.linalg.solve(rows @ cross + np.diag(variances), cross.T).T
    covariance -= gain @ cross.T
    return np.asarray(gain)
