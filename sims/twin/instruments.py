"""What the robot measures, as the messages that it sends."""

import mujoco
import numpy as np

from robots.messages import Array
from robots.unitree.g1 import MOTOR_NAMES, G1Joints
from robots.unitree.layout import BATTERY, IMU, packed
from robots.unitree.messages import StateMessage
from robots.unitree.motor_faults import TIMED_OUT
from robots.unitree.remote import write_remote
from sims.plant import ImuReading, MujocoPlant
from sims.sensors import SensorErrors, Sensors
from sims.twin.defects import Defects

VOLTAGE = 48.0
"""Of the motors [V]."""

TORSO_IMU = "imu_in_torso"
"""Frame of the second IMU."""


class Instruments:
    """Reads the plant, with the sensors' errors and the robot's defects.

    Args:
        plant: that is measured.
        joints: of its robot.
        errors: of its sensors.
        defects: of the robot, as they are when it is measured.
        rng: source of biases and noise.

    Raises:
        ConfigError: the description has no IMU in the torso.
    """

    def __init__(
        self, plant: MujocoPlant, joints: G1Joints, errors: SensorErrors, defects: Defects, rng: np.random.Generator
    ) -> None:
        self._plant, self._joints, self._errors, self._defects, self._rng = plant, joints, errors, defects, rng
        plant.robot.frame(TORSO_IMU)
        self._sensors = Sensors(plant, errors, rng)
        self._site = int(plant.data.site(TORSO_IMU).id)
        self._gyro_bias = errors.gyro_bias * _direction(rng)
        self._accelerometer_bias = errors.accelerometer_bias * _direction(rng)
        self._stuck: ImuReading | None = None
        self.message = StateMessage()
        self._motors = np.arange(len(MOTOR_NAMES))

    def state(self, timed_out: bool) -> StateMessage:
        """The state now but for its check sum; ``timed_out``: whether the motors have timed out."""
        plant, defects, message = self._plant, self._defects, self.message
        reading, imu = self._sensors.read(), plant.imu()
        self._joints.write_state(reading, imu.quaternion, message, round(1e3 * plant.time))
        message.mode_machine = defects.mode_machine
        motors, here = message.motors, self._motors
        motors["q"][here] += defects.encoder
        if defects.torque_constant is not None:
            motors["tau_est"][here] *= defects.torque_constant / self._errors.torque_scale
        motors["temperature"][here] = np.round(defects.temperature)[:, None]
        motors["vol"][here] = VOLTAGE
        motors["motorstate"][here] = defects.errors | np.uint32(TIMED_OUT if timed_out else 0)
        self._write_imu(imu.quaternion)
        write_remote(message.remote, defects.remote)
        return message

    def _write_imu(self, quaternion: Array) -> None:
        """Angles of the IMU, and what is wrong with it."""
        fields, defects = self.message.imu[0], self._defects
        fields["gyroscope"][0] += defects.gyro_step
        if not defects.imu_stuck:
            self._stuck = None
        elif self._stuck is None:
            self._stuck = ImuReading(fields["gyroscope"].copy(), fields["accelerometer"].copy(), quaternion.copy())
        if self._stuck is not None:
            quaternion = self._stuck.quaternion
            fields["gyroscope"], fields["accelerometer"] = self._stuck.gyro, self._stuck.accelerometer
            fields["quaternion"] = quaternion[[3, 0, 1, 2]]
        fields["rpy"] = roll_pitch_yaw(quaternion)
        fields["temperature"] = 40

    def torso_imu(self) -> bytes:
        """What the IMU in the torso says now."""
        model, data, site = self._plant.model, self._plant.data, mujoco.mjtObj.mjOBJ_SITE
        errors, rng, rate, acceleration = self._errors, self._rng, np.zeros(6), np.zeros(6)
        mujoco.mj_objectVelocity(model, data, site, self._site, rate, 1)
        mujoco.mj_objectAcceleration(model, data, site, self._site, acceleration, 1)
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, data.site_xmat[self._site])
        fields = np.zeros(1, IMU)
        imu = fields[0]
        imu["quaternion"], imu["rpy"] = quaternion, roll_pitch_yaw(quaternion[[1, 2, 3, 0]])
        imu["gyroscope"] = rate[:3] + self._gyro_bias + errors.gyro_noise * rng.standard_normal(3)
        noise = errors.accelerometer_noise * rng.standard_normal(3)
        imu["accelerometer"] = acceleration[3:] + self._accelerometer_bias + noise
        imu["temperature"] = 40
        return packed(fields)

    def battery(self) -> bytes:
        """How the battery is."""
        fields = np.zeros(1, BATTERY)
        fields["soc"], fields["soh"], fields["bmsvoltage"] = self._defects.battery, 100, round(1e3 * VOLTAGE)
        return packed(fields)


def roll_pitch_yaw(quaternion: Array) -> Array:
    """Angles (3,) about x, y and z, yaw turned last [rad]; ``quaternion`` (4,) x, y, z, w."""
    x, y, z, w = quaternion
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    return np.array([roll, pitch, np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))])


def _direction(rng: np.random.Generator) -> Array:
    """A unit vector (3,), all directions alike."""
    v = rng.standard_normal(3)
    return v / np.linalg.norm(v)
