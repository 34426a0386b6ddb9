"""The person at the robot: what is told to them, and what they answer at the keyboard."""

import os
import queue
import threading
from typing import Any

from controllers.deployment.stages import Stage
from robots.clocks import MACHINE, Clock
from robots.unitree.remote import button_bits

DWELL = 1.0
"""How long a stage lasts at least before it is left without a person [s]."""

STANDS = 3.0
"""The same for standing [s]."""

WORDS = {"": "go", "s": "stop", "d": "damp"}
"""What a line of the keyboard means."""

GO = button_bits("A")


class Announcer:
    """Prints from a thread of its own: a terminal that waits keeps no command waiting."""

    def __init__(self, clock: Clock = MACHINE) -> None:
        self._texts: queue.SimpleQueue[tuple[float, str] | None] = queue.SimpleQueue()
        self._clock, self._began = clock, clock.now()
        self._thread = threading.Thread(target=self._print, daemon=True)
        self._thread.start()

    def tell(self, text: str) -> None:
        """Have a line printed, with the time since the begin."""
        self._texts.put((self._clock.now() - self._began, text))

    def _print(self) -> None:
        while (told := self._texts.get()) is not None:
            print(f"[{told[0]:9.3f}] {told[1]}", flush=True)

    def close(self) -> None:
        """Print what is left."""
        self._texts.put(None)
        self._thread.join(1.0)


class Keyboard:
    """Go, stop and damp, by lines of standard input; see :class:`controllers.deployment.loop.Person`."""

    def __init__(self, yes: bool, source: int = 0) -> None:
        """``yes``: go on without a person where a stage asks for one; ``source``: what is read, standard input."""
        self._yes, self._words = yes, queue.SimpleQueue[str]()
        self._interrupts, self._hung_for, self._again_at = 0, float("inf"), 0.0
        threading.Thread(target=self._listen, args=(source,), daemon=True).start()

    def _listen(self, source: int) -> None:
        # not by a buffered reader, whose lock would be held when the program ends
        rest = b""
        while data := os.read(source, 4096):
            *lines, rest = (rest + data).split(b"\n")
            for line in lines:
                word = line.decode(errors="replace").strip().lower()
                if word in WORDS:
                    self._words.put(WORDS[word])
                else:
                    print(f"{word!r}: Enter for go, s for stop, d to damp", flush=True)
        if not self._yes:
            print("the keyboard is closed: go, stop and damp by the remote only", flush=True)

    def interrupt(self) -> None:
        """Ctrl-C, or a terminal that is closed: stop, and once more: damp."""
        self._interrupts += 1
        self._words.put("stop" if self._interrupts == 1 else "damp")

    def end_hung_after(self, seconds: float) -> None:
        """Stop by itself after so long under control while hung [s]."""
        self._hung_for = seconds

    def _said(self) -> set[str]:
        """What has been said since the last time."""
        found: set[str] = set()
        while True:
            try:
                found.add(self._words.get_nowait())
            except queue.Empty:
                return found

    def wishes(self, stage: Stage, asks: bool, since: float) -> tuple[bool, bool, bool]:
        """See :meth:`controllers.deployment.loop.Person.wishes`."""
        said = self._said()
        stop, damp = "stop" in said, "damp" in said
        if stage is Stage.HUNG and self._hung_for < float("inf"):
            return False, stop or since > self._hung_for, damp
        return "go" in said or self._goes_by_itself(stage, asks, since), stop, damp

    def _goes_by_itself(self, stage: Stage, asks: bool, since: float) -> bool:
        """Where nobody is asked: after a while, and again where that has not been enough."""
        if since < DWELL:
            self._again_at = 0.0
        dwell = STANDS if stage is Stage.STANDING else DWELL
        if not self._yes or not asks or stage is Stage.STOPPING or since < max(dwell, self._again_at):
            return False
        self._again_at = since + DWELL
        return True

    def wait_for_go(self, port: Any, stream: Any) -> bool:
        """Wait for a person's go, at keyboard or remote, that is said from now on; ``False`` where they stop."""
        early = self._said()
        if early & {"stop", "damp"}:
            return False
        held = GO
        while not self._yes:
            for data, arrived in port.receive(port.clock.now() + 0.02):
                if stream.take(data, arrived) is not None:
                    if stream.message.buttons & GO & ~held:
                        return True
                    held = stream.message.buttons & GO
            said = self._said()
            if said & {"stop", "damp"}:
                return False
            if "go" in said:
                return True
        return True
