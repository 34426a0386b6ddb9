"""What a simulated robot's own sensors say: IMU, encoders, motor torques, with the errors that such sensors have."""

from dataclasses import dataclass

import numpy as np

from robots.checks import require_non_negative, require_positive
from robots.messages import Array, SensorReading
from sims.plant import MujocoPlant


@dataclass(frozen=True, slots=True)
class SensorErrors:
    """Errors of a robot's own sensors: white noise by its deviation, biases by their length.

    Attributes:
        gyro_bias: length of the gyro's bias, in a direction that is drawn [rad/s].
        gyro_noise: [rad/s].
        gyro_drift: rate at which the gyro's bias moves, in a direction that is drawn [rad/s^2].
        accelerometer_bias: length of the accelerometer's bias, likewise [m/s^2].
        accelerometer_noise: [m/s^2].
        joint_position: noise of the encoders [rad].
        joint_velocity: noise of the joints' rates [rad/s].
        torque: noise of the motors' torques [N m].
        torque_scale: what the motors take a torque of 1 N m for, above 0 [N m].
    """

    gyro_bias: float = 0.01
    gyro_noise: float = 0.005
    gyro_drift: float = 0.0
    accelerometer_bias: float = 0.05
    accelerometer_noise: float = 0.05
    joint_position: float = 1e-4
    joint_velocity: float = 0.02
    torque: float = 0.5
    torque_scale: float = 1.0

    def __post_init__(self) -> None:
        for name in self.__slots__:
            (require_positive if name == "torque_scale" else require_non_negative)(
                f"sensor {name}", getattr(self, name)
            )


NO_ERRORS = SensorErrors(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""Of sensors that say what is."""


class Sensors:
    """The sensors of a plant.

    Attributes:
        gyro_bias: shape (3,) now, true [rad/s].
        accelerometer_bias: shape (3,) true [m/s^2].
    """

    def __init__(self, plant: MujocoPlant, errors: SensorErrors, rng: np.random.Generator) -> None:
        """For ``plant``; directions of biases and noise are drawn from ``rng``."""
        self._plant, self._errors, self._rng = plant, errors, rng
        self.gyro_bias = errors.gyro_bias * _direction(rng)
        self.accelerometer_bias = errors.accelerometer_bias * _direction(rng)
        self._drift = errors.gyro_drift * _direction(rng)
        self._since = plant.time

    def read(self) -> SensorReading:
        """What they say now; IMU and torques of the physics step that has just been made."""
        imu = self._plant.imu()
        return self._reading(imu.gyro, imu.accelerometer)

    def read_at_rest(self) -> SensorReading:
        """What they would say if something held the robot still where it is."""
        site = self._plant.data.site(self._plant.robot.roles["imu"])
        return self._reading(np.zeros(3), -site.xmat.reshape(3, 3).T @ self._plant.model.opt.gravity)

    def _reading(self, gyro: Array, accelerometer: Array) -> SensorReading:
        plant, errors, rng = self._plant, self._errors, self._rng
        self.gyro_bias = self.gyro_bias + (plant.time - self._since) * self._drift
        self._since = plant.time
        nj = len(plant.robot.joints)
        return SensorReading(
            plant.data.qpos[7:] + errors.joint_position * rng.standard_normal(nj),
            plant.data.qvel[6:] + errors.joint_velocity * rng.standard_normal(nj),
            errors.torque_scale * plant.torque + errors.torque * rng.standard_normal(nj),
            gyro + self.gyro_bias + errors.gyro_noise * rng.standard_normal(3),
            accelerometer + self.accelerometer_bias + errors.accelerometer_noise * rng.standard_normal(3),
            plant.time,
        )


def _direction(rng: np.random.Generator) -> Array:
    """A unit vector (3,), all directions alike."""
    v = rng.standard_normal(3)
    return v / np.linalg.norm(v)
