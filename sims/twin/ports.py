"""Where a twin meets the world: small ports for bytes, over a network or in memory."""

from collections.abc import Iterable
from typing import Protocol


class Ports(Protocol):
    """What comes to the robot's board, and what goes out from it."""

    def commands(self) -> Iterable[bytes]:
        """Commands that have come since the last time, oldest first; none that went out from here."""
        ...

    def send_state(self, data: bytes) -> None:
        """Send a state."""
        ...

    def send_torso_imu(self, data: bytes) -> None:
        """Send what the IMU in the torso says."""
        ...

    def send_battery(self, data: bytes) -> None:
        """Send how the battery is."""
        ...

    def send_own_command(self, data: bytes | None) -> None:
        """Send a command of the robot's own service; ``None``: it has none to send any more."""
        ...

    def send_foreign_command(self, data: bytes | None) -> None:
        """Send a command of somebody else, which comes in here too; ``None``: there is none to send any more."""
        ...


class Switcher(Protocol):
    """The robot's motion switcher, see :class:`robots.unitree.switcher.SwitcherService`."""

    name: str
    refuses: bool
    selected: int

    def serve(self) -> None:
        """Answer what has come since the last time."""
        ...


class MemoryPorts:
    """Ports without a network, and a motion switcher that nobody asks.

    Attributes:
        inbox: commands that are to come in.
        states: that went out, as all of the following.
        torso_imu: likewise.
        battery: likewise.
        own_commands: likewise.
        name: of what moves the robot.
        refuses: whether a release would be refused.
        selected: how often a mode was selected.
    """

    def __init__(self, name: str = "ai") -> None:
        self.inbox: list[bytes] = []
        self.states: list[bytes] = []
        self.torso_imu: list[bytes] = []
        self.battery: list[bytes] = []
        self.own_commands: list[bytes] = []
        self.name, self.refuses, self.selected = name, False, 0

    def commands(self) -> list[bytes]:
        """See :class:`Ports`."""
        taken, self.inbox = self.inbox, []
        return taken

    def send_state(self, data: bytes) -> None:
        """See :class:`Ports`."""
        self.states.append(data)

    def send_torso_imu(self, data: bytes) -> None:
        """See :class:`Ports`."""
        self.torso_imu.append(data)

    def send_battery(self, data: bytes) -> None:
        """See :class:`Ports`."""
        self.battery.append(data)

    def send_own_command(self, data: bytes | None) -> None:
        """See :class:`Ports`."""
        if data is not None:
            self.own_commands.append(data)

    def send_foreign_command(self, data: bytes | None) -> None:
        """See :class:`Ports`."""
        if data is not None:
            self.inbox.append(data)

    def serve(self) -> None:
        """See :class:`Switcher`: there is nothing to answer."""
