"""A G1 on the network as a body: its states in, motor commands out."""

import time
from typing import TYPE_CHECKING

import numpy as np

from robots.description import RobotDescription
from robots.errors import SafeWbcError
from robots.messages import MotorCommand, SensorReading
from robots.unitree.g1 import G1Joints
from robots.unitree.messages import CommandMessage, StateMessage
from robots.unitree.remote import Remote, read_remote

if TYPE_CHECKING:
    from robots.unitree.dds import Network


class NoStateError(SafeWbcError):
    """No sound state has come from the robot."""


class G1Body:
    """What a G1 measures and is told, over DDS; it does not move by itself, and nothing is sent but by :meth:`send`.

    Attributes:
        joints: of the description, in the robot's slots.
        message: the last sound state, as it came.
        broken: number of states whose check sum was wrong, or whose length was none; they are not taken in.
        sent: number of commands.
    """

    def __init__(self, network: "Network", robot: RobotDescription) -> None:
        """On a network, for the description of a G1.

        Raises:
            ConfigError: the description has other joints than the robot.
        """
        self.joints = G1Joints(robot)
        self._states, self._commands = network.reader("rt/lowstate"), network.writer("rt/lowcmd")
        self.message, self._next, self._command = StateMessage(), StateMessage(), CommandMessage()
        self._reading: SensorReading | None = None
        self.broken = self.sent = 0

    def read(self) -> SensorReading:
        """The last sound state; its stamp is this machine's monotonic time at which it was taken in [s].

        Raises:
            NoStateError: none has come yet.
        """
        for data in self._states.take():
            self._take_in(data)
        if self._reading is None:
            raise NoStateError("no sound state has come from the robot on rt/lowstate")
        return self._reading

    def _take_in(self, data: bytes) -> None:
        if len(data) != self._next.size or not self._next.read(data):
            self.broken += 1
            return
        self.message, self._next = self._next, self.message
        self._reading = self.joints.reading(self.message, time.monotonic())

    def wait(self, timeout: float) -> bool:
        """Wait for a new sound state; returns whether one came within ``timeout`` [s]."""
        before, end = self._reading, time.monotonic() + timeout
        while True:
            for data in self._states.take():
                self._take_in(data)
            if self._reading is not before:
                return True
            if time.monotonic() >= end:
                return False
            time.sleep(1e-4)

    def send(self, command: MotorCommand) -> None:
        """See :meth:`robots.ports.Body.send`: within the limits, sealed, and as the variant that the robot reports.

        Raises:
            ConfigError: the command has a number that is none, or the robot is not one of 29 joints; nothing is sent.
        """
        self.joints.write(command, self._command, self.message.mode_machine)
        self._commands.send(self._command.sealed())
        self.sent += 1

    def advance(self, dt: float) -> None:
        """See :meth:`robots.ports.Body.advance`: the robot sets the pace; wait for its next state, ``dt`` at most."""
        self.wait(dt)

    @property
    def remote(self) -> Remote:
        """The remote, as of the last sound state."""
        return read_remote(self.message.remote)

    def hottest(self) -> tuple[str, float]:
        """The joint that is hottest, and how hot [degrees Celsius]."""
        heat = self.message.motors["temperature"][self.joints.slots].max(axis=1)
        i = int(np.argmax(heat))
        return self.joints.robot.joint_names[i], float(heat[i])
