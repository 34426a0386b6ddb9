"""Walking whose command is a function of time."""

from controllers.gaits.commands import CommandProfile
from controllers.gaits.foot_state import BodyKinematics
from controllers.gaits.walking.walking import Walking
from controllers.reference import WholeBodyReference
from robots.messages import RobotState


class CommandedWalk:
    """Walking whose command is a function of time: a gait.

    Args:
        walking: the gait that walks.
        command: asked at every tick.
    """

    def __init__(self, walking: Walking, command: CommandProfile) -> None:
        self.walking = walking
        self.command = command

    def apply(self, reference: WholeBodyReference, t: float, state: RobotState, kin: BodyKinematics) -> None:
        """See :meth:`controllers.gaits.gait.Gait.apply`."""
        self.walking.command = self.command(t)
        self.walking.apply(reference, t, state, kin)

    def stop(self) -> None:
        """See :meth:`controllers.gaits.gait.Gait.stop`."""
        self.walking.stop()
