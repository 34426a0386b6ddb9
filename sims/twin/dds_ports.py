"""A twin's ports on a network."""

from collections.abc import Iterable

from robots.unitree.dds import Network, Writer

WAITING = 64
"""Commands that wait to be taken."""


class DdsPorts:
    """The robot's topics; see :class:`sims.twin.ports.Ports`.

    Somebody else's commands go out from a participant of their own, so that they come in here as any other's.

    Args:
        domain: not 0, which is the robot's.
        interface: by its name.

    Attributes:
        network: of the robot.

    Raises:
        ConfigError: DDS cannot use the interface, or no such domain.
    """

    def __init__(self, domain: int, interface: str) -> None:
        self.network, self._others = Network(domain, interface), Network(domain, interface)
        self._commands = self.network.reader("rt/lowcmd", own=False, depth=WAITING)
        self._state = self.network.writer("rt/lowstate")
        self._torso_imu = self.network.writer("rt/secondary_imu")
        self._battery = self.network.writer("rt/lf/bmsstate")
        self._waiting: list[bytes] = []
        self._come, self._owes = 0, False
        self._own: Writer | None = None
        self._foreign: Writer | None = None

    def commands(self) -> Iterable[bytes]:
        """See :class:`sims.twin.ports.Ports`."""
        self._look()
        taken, self._waiting = self._waiting, []
        return taken

    def debt(self) -> tuple[int, bool]:
        """How many commands have come, and whether a state has gone out since the last of them.

        Nothing is counted while somebody else's are sent from here: whose a command is cannot be seen.
        """
        self._look()
        return self._come, self._owes

    def _look(self) -> None:
        come = list(self._commands.take())
        self._waiting += come
        if self._foreign is None:
            self._come += len(come)
            self._owes = self._owes and not come

    def send_state(self, data: bytes) -> None:
        """See :class:`sims.twin.ports.Ports`."""
        self._state.send(data)
        self._owes = True

    def send_torso_imu(self, data: bytes) -> None:
        """See :class:`sims.twin.ports.Ports`."""
        self._torso_imu.send(data)

    def send_battery(self, data: bytes) -> None:
        """See :class:`sims.twin.ports.Ports`."""
        self._battery.send(data)

    def send_own_command(self, data: bytes | None) -> None:
        """See :class:`sims.twin.ports.Ports`."""
        self._own = _sent(self.network, self._own, data)

    def send_foreign_command(self, data: bytes | None) -> None:
        """See :class:`sims.twin.ports.Ports`."""
        self._foreign = _sent(self._others, self._foreign, data)


def _sent(network: Network, writer: Writer | None, data: bytes | None) -> Writer | None:
    """Send by a writer, which is there only as long as it has something to send."""
    if data is None:
        return None
    writer = writer or network.writer("rt/lowcmd")
    writer.send(data)
    return writer
