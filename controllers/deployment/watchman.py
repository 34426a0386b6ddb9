"""When the guardian takes over, and what it tells the motors then; without network and process."""

from controllers.deployment.heartbeat import Silence
from controllers.deployment.motors import brake
from controllers.deployment.stages import DAMP_BITS
from robots.description import RobotDescription
from robots.unitree.g1 import G1Joints
from robots.unitree.messages import CommandMessage

SILENCE = 0.010
"""Of the controller, after which the guardian takes over [s]."""

SILENT, ASKED = "the controller was silent", "L2 + B at the remote"
"""Why it takes over."""


class Watchman:
    """Decides when to take over, by what it is shown.

    Args:
        patience: silence of the controller after which it does [s].

    Attributes:
        cause: why, for good; ``None`` before.
    """

    def __init__(self, patience: float = SILENCE) -> None:
        self._silence, self._patience = Silence(), patience
        self.cause: str | None = None

    def look(self, now: float, sent: float, buttons: int) -> bool:
        """Whether the motors are to brake from now on.

        Args:
            now: monotonic time [s].
            sent: when the controller has sent its last command, 0 before its first [s].
            buttons: of the remote.
        """
        silence = self._silence.look(now, sent)
        if self.cause is None and sent > 0.0:
            if silence > self._patience:
                self.cause = SILENT
            elif buttons & DAMP_BITS == DAMP_BITS:
                self.cause = ASKED
        return self.cause is not None


def brake_message(robot: RobotDescription, mode_machine: int) -> bytes:
    """The command to brake, sealed."""
    message = CommandMessage()
    G1Joints(robot).write(brake(robot, 0.0), message, mode_machine, any_variant=True)
    return message.sealed()
