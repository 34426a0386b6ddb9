"""The robot's board: which commands it takes, and what its motors do when none come any more."""

from dataclasses import replace

import numpy as np

from robots.checks import require_one_of, require_positive
from robots.messages import MotorCommand
from robots.unitree.g1 import MODE_MACHINE, SERIAL, G1Joints
from robots.unitree.layout import HEADER
from robots.unitree.messages import CommandMessage

DAMPING = 3.0
"""Gain of the drives' own damping [N m s/rad]. Source: unitree_rl_lab, Passive."""

REACTIONS = ("hold", "damp")
"""What motors may do that have timed out. Which of them a G1's do is published nowhere."""

CAUSES = ("length", "check sum", "mode_pr", "mode_machine", "not finite", "service")
"""Of a refusal; ``service``: the robot's own service has the motors."""


class Board:
    """Takes commands as a G1 does, and never raises for what comes in.

    Args:
        joints: of the robot.
        timeout: after which motors without a command time out [s].
        reaction: one of ``REACTIONS``.

    Attributes:
        mode_machine: that the robot reports, and asks for.
        received: number of commands that came in.
        accepted: number of them that the motors were given.
        refused: number of the others, by cause.
        service: what the robot's own service tells the motors; ``None`` where it is released.
        reaction: of motors that have timed out.

    Raises:
        ConfigError: ``timeout`` is not positive, or no such reaction.
    """

    def __init__(self, joints: G1Joints, timeout: float = 0.1, reaction: str = "hold") -> None:
        require_positive("motor_timeout", timeout)
        require_one_of("on_timeout", reaction, REACTIONS)
        self._joints, self._timeout, self.reaction = joints, timeout, reaction
        self._message = CommandMessage()
        zero = np.zeros(len(joints.robot.joints))
        self._limp = MotorCommand(zero, zero, zero, zero, zero, 0.0)
        self._last, self._damping, self._at = self._limp, self._limp, np.nan
        self.mode_machine = MODE_MACHINE
        self.received = self.accepted = 0
        self.refused = dict.fromkeys(CAUSES, 0)
        self.service: MotorCommand | None = None

    def take(self, data: bytes, now: float) -> None:
        """Take or refuse a command that came in at ``now`` [s], header included."""
        self.received += 1
        cause = self._cause(data)
        if cause is None:
            command = self._joints.read_command(self._message, now)
            if all(np.isfinite(getattr(command, name)).all() for name in ("q", "v", "tau", "kp", "kd")):
                self._accept(command, now)
                return
            cause = "not finite"
        self.refused[cause] += 1

    def _cause(self, data: bytes) -> str | None:
        """Why a command is refused, after it was read; ``None`` where it is not."""
        if len(data) != self._message.size or data[:2] != HEADER[:2]:
            return "length"
        if not self._message.read(data):
            return "check sum"
        if self._message.mode_pr != SERIAL:
            return "mode_pr"
        if self._message.mode_machine != self.mode_machine:
            return "mode_machine"
        return None if self.service is None else "service"

    def _accept(self, command: MotorCommand, now: float) -> None:
        self.accepted += 1
        self._last, self._at = command, now
        slots = self._joints.slots
        on = np.array([self._message.enabled(int(slot)) for slot in slots], dtype=float)
        zero = self._limp.tau
        self._damping = replace(command, v=zero, tau=zero, kp=zero, kd=DAMPING * on)

    def release(self) -> None:
        """The robot's own service leaves the motors, which are limp until the next command."""
        self.service, self._last, self._damping, self._at = None, self._limp, self._limp, np.nan

    def age(self, now: float) -> float:
        """Time since the last accepted command [s]; NaN where there is none since the release."""
        return now - self._at

    def timed_out(self, now: float) -> bool:
        """Whether the motors have timed out: commands came, and have come no more."""
        return self.service is None and self.age(now) > self._timeout

    def command(self, now: float) -> MotorCommand:
        """What the motors are told at ``now`` [s]; the same object as long as it does not change."""
        if self.service is not None:
            return self.service
        return self._damping if self.reaction == "damp" and self.timed_out(now) else self._last
