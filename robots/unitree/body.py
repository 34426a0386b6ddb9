"""A G1 on the network: its states as they come in, commands out, who else commands it, its battery."""

import contextlib
import time
from typing import TYPE_CHECKING

from robots.clocks import MACHINE, Clock
from robots.errors import ConfigError
from robots.unitree.layout import BATTERY, unpacked

if TYPE_CHECKING:
    from robots.unitree.dds import Network

LOOK = 1e-4
"""Pause between two looks for a state [s]."""

HEARD = 5.0
"""After which what was heard of the battery is too old [s]."""

WAITING = 64
"""States that may wait to be taken; older ones make room."""


class G1Port:
    """Topics of one robot; nothing is sent but by :meth:`send`.

    Attributes:
        clock: that times are of.
        sent: number of commands.
    """

    def __init__(self, network: "Network", clock: Clock = MACHINE) -> None:
        self.clock = clock
        self._states, self._commands = network.reader("rt/lowstate", depth=WAITING), network.writer("rt/lowcmd")
        self._others = network.reader("rt/lowcmd", own=False, depth=WAITING)
        self._batteries = network.reader("rt/lf/bmsstate")
        self._charge, self._charge_at = float("nan"), -float("inf")
        self.sent = 0

    def receive(self, until: float) -> list[tuple[bytes, float]]:
        """States that have come, oldest first, each with the time of the clock at which it was taken [s].

        Waits for one until the time ``until`` [s]; empty where none has come.
        """
        while True:
            now = self.clock.now()
            if found := [(data, now) for data in self._states.take()]:
                return found
            if now >= until:
                return []
            time.sleep(LOOK)

    def send(self, command: bytes) -> None:
        """Send a sealed command."""
        self._commands.send(command)
        self.sent += 1

    def strangers(self) -> int:
        """Number of commands of others on the robot's topic since the last time."""
        return sum(1 for _ in self._others.take())

    def battery(self) -> float:
        """Charge as last heard [%]; NaN where nothing has been heard of it for ``HEARD`` seconds."""
        newest, now = self._batteries.newest(), self.clock.now()
        if newest is not None:
            with contextlib.suppress(ConfigError):
                self._charge, self._charge_at = float(unpacked(newest, BATTERY)["soc"][0]), now
        return self._charge if now - self._charge_at < HEARD else float("nan")

    @property
    def commanded(self) -> bool:
        """Whether anybody receives the commands."""
        return self._commands.readers > 0
