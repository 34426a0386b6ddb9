"""What moves feet and balance by what is measured: walking, standing on one leg."""

from typing import Protocol

from controllers.reference import WholeBodyReference
from robots.messages import RobotState


class Gait(Protocol):
    """Moves feet and CoM by what is measured."""

    def apply(self, reference: WholeBodyReference, t: float, state: RobotState) -> None:
        """Set feet, CoM, heading of ``reference`` for time ``t`` [s], from the measured ``state``."""
        ...

    def stop(self) -> None:
        """Come to rest on both feet as soon as the feet allow it, for good."""
        ...
