"""What passes between the layers of the stack: measured state in, motor command out."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""Numbers."""

Mask = NDArray[np.bool_]
"""Yes or no for each of several things."""

Indices = NDArray[np.intp]
"""Places in other arrays."""


@dataclass(frozen=True, slots=True)
class RobotState:
    """Measured (or estimated) state of a floating-base robot, in pinocchio's conventions.

    Attributes:
        q: shape (nq,) = [base position in the world (3) [m], base quaternion x, y, z, w (4), joints [rad]].
        v: shape (nv,) = [base linear velocity (3) [m/s], base angular velocity (3) [rad/s], both in the base
            frame, joint velocities [rad/s]].
        tau: shape (nj,) motor torques [N m].
        stamp: time of measurement [s].
        foot_forces: shape (2,) force along the normal of left and right sole [N]; ``None`` where it is not measured.
        contact: shape (2,) probability that left and right sole stand on the ground; ``None`` where nothing but the
            forces tells.
    """

    q: Array
    v: Array
    tau: Array
    stamp: float
    foot_forces: Array | None = None
    contact: Array | None = None


@dataclass(frozen=True, slots=True)
class SensorReading:
    """What a robot's own sensors say at one instant; nothing of the base but by its IMU.

    Attributes:
        joint_position: shape (nj,) [rad].
        joint_velocity: shape (nj,) [rad/s].
        torque: shape (nj,) of the motors, as they estimate it [N m].
        gyro: shape (3,) rate of the IMU in its own axes [rad/s].
        accelerometer: shape (3,) specific force of the IMU in its own axes, -g at rest [m/s^2].
        stamp: time of measurement [s].
    """

    joint_position: Array
    joint_velocity: Array
    torque: Array
    gyro: Array
    accelerometer: Array
    stamp: float


@dataclass(frozen=True, slots=True)
class MotorCommand:
    r"""Set-points and gains for every motor; the drive computes the torque.

    .. math:: \tau = \tau^{opt} + K_p (q^{safe} - q) + K_d (\dot q^{safe} - \dot q)

    Source: Lee et al., "Safety-Critical Whole-Body Control for Humanoid Robots via ISSf-CBFs", eq. (19). It is also
    what a Unitree motor evaluates on board.

    Attributes:
        q: shape (nj,) desired joint positions [rad].
        v: shape (nj,) desired joint velocities [rad/s].
        tau: shape (nj,) feed-forward torques [N m].
        kp: shape (nj,) position gains [N m/rad].
        kd: shape (nj,) velocity gains [N m s/rad].
        stamp: time of the state it answers [s].
    """

    q: Array
    v: Array
    tau: Array
    kp: Array
    kd: Array
    stamp: float

    def torque(self, q: Array, v: Array) -> Array:
        """Motor torque at joint positions ``q`` [rad] and velocities ``v`` [rad/s], each (nj,), eq. (19) [N m]."""
        return self.tau + self.kp * (self.q - q) + self.kd * (self.v - v)
