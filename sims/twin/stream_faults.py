"""The states on their way out: as they are, or late, lost, twice, exchanged or changed where a fault asks for it."""

import numpy as np

from robots.unitree.g1 import MOTOR_NAMES
from robots.unitree.messages import StateMessage
from sims.twin.faults import FOREVER, Fault

CHANGED_BYTE, CHANGED_BITS = 100, 0x40
"""What is changed in a state whose check sum is to be wrong."""


class StreamFaults:
    """Begins and ends the faults of the stream of states."""

    names = ("state-stop", "state-lost", "state-late", "state-repeated", "state-swapped", "state-crc", "state-nan")
    """Of the faults that begin here."""

    def __init__(self) -> None:
        self._left: dict[str, int] = {}
        self._until: dict[str, float] = {}
        self._joint = ""
        self._waiting: list[bytes] = []
        self._swapped: bytes | None = None
        self._before: bytes | None = None

    def begin(self, fault: Fault, t: float) -> None:
        """Begin a fault, one of ``names``, at ``t`` [s]."""
        if fault.name == "state-stop":
            self._until[fault.name] = t + fault.number(0)
        elif fault.name == "state-late":
            self._until[fault.name] = t + 1e-3 * fault.number(0)
        else:
            self._left[fault.name] = 2 if fault.name == "state-swapped" else int(fault.number(0))
        if fault.name == "state-nan":
            self._joint = fault.word(1)

    def clear(self, name: str | None = None) -> None:
        """End a fault, or all of them; states that were held back go out with the next."""
        for table in (self._left, self._until):
            for fault in [name] if name is not None else list(table):
                table.pop(fault, None)

    def passed(self, message: StateMessage, t: float) -> list[bytes]:
        """What goes out at ``t`` [s] for a state that is written but for its check sum, in this order."""
        if self._take("state-nan"):
            message.motors["q"][MOTOR_NAMES.index(self._joint)] = np.nan
        data = message.sealed()
        if self._take("state-crc"):
            data = data[:CHANGED_BYTE] + bytes([data[CHANGED_BYTE] ^ CHANGED_BITS]) + data[CHANGED_BYTE + 1 :]
        if self._before is not None and self._take("state-repeated"):
            data = self._before
        self._before = data
        if self._take("state-lost") or t < self._until.get("state-stop", -FOREVER):
            return []
        out = [*self._exchanged(data)]
        if t < self._until.get("state-late", -FOREVER):
            self._waiting += out
            return []
        out, self._waiting = [*self._waiting, *out], []
        return out

    def _exchanged(self, data: bytes) -> list[bytes]:
        """The state, none, or it and the one before it."""
        if self._take("state-swapped") and self._swapped is None:
            self._swapped = data
            return []
        held, self._swapped = self._swapped, None
        return [data] if held is None else [data, held]

    def _take(self, fault: str) -> bool:
        """Whether one more state is to have a fault."""
        left = self._left.get(fault, 0)
        if left:
            self._left[fault] = left - 1
        return left > 0
