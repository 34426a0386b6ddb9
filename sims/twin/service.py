"""The robot's own service: it holds a posture softly until it is released."""

import numpy as np

from robots.messages import Array, MotorCommand
from robots.unitree.g1 import MODE_MACHINE, G1Joints
from robots.unitree.messages import CommandMessage

SOFTNESS = 0.4
"""Gains of the service, as a part of the description's."""


class OwnService:
    """What the robot's own service tells the motors, and writes for all to see.

    Args:
        joints: of the robot.
        posture: shape (nj,) that it holds [rad].
        torque: shape (nj,) that the posture needs while the robot hangs [N m].

    Attributes:
        command: that the motors are given.
    """

    def __init__(self, joints: G1Joints, posture: Array, torque: Array) -> None:
        self._joints, self._message = joints, CommandMessage()
        kp, kd = (SOFTNESS * joints.robot.joint_array(name) for name in ("kp", "kd"))
        self.command = MotorCommand(posture, np.zeros_like(posture), torque, kp, kd, 0.0)

    def begin_again(self) -> None:
        """Once it has been selected anew the motors are limp."""
        zero = np.zeros_like(self.command.q)
        self.command = MotorCommand(self.command.q, zero, zero, zero, zero, 0.0)

    def message(self, mode_machine: int) -> bytes:
        """The command as it is written."""
        return written(self._joints, self.command, self._message, mode_machine)


def written(joints: G1Joints, command: MotorCommand, message: CommandMessage, mode_machine: int) -> bytes:
    """A command as bytes, for whatever variant of the robot."""
    joints.write(command, message, MODE_MACHINE)
    message.mode_machine = mode_machine
    return message.sealed()
