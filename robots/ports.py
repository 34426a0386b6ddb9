"""What a controller drives: one small protocol, kept by simulated plants and by hardware alike."""

from typing import Protocol, TypeVar

from robots.messages import RobotState

Command_contra = TypeVar("Command_contra", contravariant=True)
"""What a body is told: a motor command, or for a kinematic plant a velocity or an acceleration."""


class Body(Protocol[Command_contra]):
    """A robot that is measured, commanded, and moves while time passes."""

    def state(self) -> RobotState:
        """What is measured now."""
        ...

    def send(self, command: Command_contra) -> None:
        """Send a command; it holds until the next one."""
        ...

    def advance(self, dt: float) -> None:
        """Let ``dt`` [s] pass: a simulation steps, hardware waits."""
        ...
