"""What moves feet and balance by what is measured: walking, standing on one leg."""

from typing import Protocol

from controllers.reference import WholeBodyReference
from robots.kinematics import Kinematics
from robots.messages import RobotState


class Gait(Protocol):
    """Moves feet and CoM by what is measured."""

    def apply(self, reference: WholeBodyReference, t: float, state: RobotState, kin: Kinematics) -> None:
        """Set feet, CoM, heading of ``reference`` for the tick at time ``t``.

        Args:
            reference: changed in place.
            t: time of this tick [s].
            state: measured.
            kin: kinematics of the robot, updated to ``state`` by the caller; read, not kept.
        """
        ...

    def stop(self) -> None:
        """Come to rest on both feet as soon as the feet allow it, for good."""
        ...
