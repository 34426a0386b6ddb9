"""A G1 of 29 joints: which motor is which joint, and commands and readings in the project's own terms."""

import numpy as np

from robots.checks import require_one_of
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.messages import Array, Indices, MotorCommand, SensorReading
from robots.unitree.messages import CommandMessage, StateMessage

LEG = ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")
ARM = ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow", "wrist_roll", "wrist_pitch", "wrist_yaw")

MOTOR_NAMES = (
    *(f"{side}_{joint}" for side in ("left", "right") for joint in LEG),
    *("waist_yaw", "waist_roll", "waist_pitch"),
    *(f"{side}_{joint}" for side in ("left", "right") for joint in ARM),
)
"""Joint of each motor's slot; the description calls it so with ``_joint`` behind. Source: unitree_sdk2, defines.h."""

MODE_MACHINE = 5
"""The variant with 29 joints; the same robot reports 6 while its waist is fixed."""

SERIAL = 0
"""``mode_pr``: ankles and waist as serial joints, which the firmware turns into what its linkages need."""


class G1Joints:
    """Joints of a description in the motors' slots, by name.

    Attributes:
        slots: shape (nj,) motor of each joint, in the description's order.
    """

    def __init__(self, robot: RobotDescription) -> None:
        """For a description with exactly the robot's joints, in any order.

        Raises:
            ConfigError: a joint is missing, or is none of the robot's.
        """
        names = [f"{name}_joint" for name in MOTOR_NAMES]
        if wrong := sorted(set(robot.joint_names) ^ set(names)):
            raise ConfigError("joints", ", ".join(wrong), "those of a G1 of 29 joints, each once")
        self.robot = robot
        self.slots: Indices = np.array([names.index(name) for name in robot.joint_names], dtype=np.intp)
        self._lower, self._upper = robot.position_limits
        self._effort, self._speed = robot.joint_array("effort"), robot.joint_array("velocity")

    def write(
        self, command: MotorCommand, message: CommandMessage, mode_machine: int, any_variant: bool = False
    ) -> None:
        """Fill a message: positions, velocities and torques within their limits, other slots zero and off.

        Args:
            command: for all joints.
            message: whose motors are written.
            mode_machine: that the robot reports.
            any_variant: of the robot will do: to brake one that calls itself another one while it is driven.

        Raises:
            ConfigError: the command has a number that is none, a negative gain, or is for another variant of the robot.
        """
        if not any_variant:
            require_one_of("mode_machine", str(mode_machine), (str(MODE_MACHINE),))
        for name in ("q", "v", "tau", "kp", "kd"):
            values = getattr(command, name)
            wrong = ~np.isfinite(values) | ((values < 0.0) if name in ("kp", "kd") else False)
            if wrong.any():
                i = int(np.argmax(wrong))
                allowed = "finite and 0 or above" if name in ("kp", "kd") else "finite"
                raise ConfigError(f"{name} of {self.robot.joint_names[i]}", values[i], allowed)
        message.mode_pr, message.mode_machine = SERIAL, mode_machine
        motors = message.motors
        motors["q"][self.slots] = np.clip(command.q, self._lower, self._upper)
        motors["dq"][self.slots] = np.clip(command.v, -self._speed, self._speed)
        motors["tau"][self.slots] = np.clip(command.tau, -self._effort, self._effort)
        motors["kp"][self.slots], motors["kd"][self.slots] = command.kp, command.kd
        for slot in self.slots:
            message.enable(int(slot))

    def read_command(self, message: CommandMessage, stamp: float) -> MotorCommand:
        """What a message tells the motors; those that are off have no gains and no torque."""
        motors = message.motors[self.slots]
        on = np.array([message.enabled(int(slot)) for slot in self.slots], dtype=float)
        q, v, tau, kp, kd = (motors[name].astype(float) for name in ("q", "dq", "tau", "kp", "kd"))
        return MotorCommand(q, v, on * tau, on * kp, on * kd, stamp)

    def reading(self, message: StateMessage, stamp: float) -> SensorReading:
        """What a state says, at a time of one's own clock [s]."""
        motors, imu = message.motors[self.slots], message.imu[0]
        return SensorReading(
            motors["q"].astype(float),
            motors["dq"].astype(float),
            motors["tau_est"].astype(float),
            imu["gyroscope"].astype(float),
            imu["accelerometer"].astype(float),
            stamp,
        )

    def write_state(self, reading: SensorReading, quaternion: Array, message: StateMessage, tick: int) -> None:
        """Fill a state, as who plays the robot does; ``quaternion`` (4,) x, y, z, w of the IMU."""
        message.mode_pr, message.mode_machine, message.tick = SERIAL, MODE_MACHINE, tick
        motors, imu = message.motors, message.imu[0]
        motors["q"][self.slots], motors["dq"][self.slots] = reading.joint_position, reading.joint_velocity
        motors["tau_est"][self.slots] = reading.torque
        imu["gyroscope"], imu["accelerometer"] = reading.gyro, reading.accelerometer
        imu["quaternion"] = quaternion[[3, 0, 1, 2]]
        for slot in self.slots:
            message.enable(int(slot))
