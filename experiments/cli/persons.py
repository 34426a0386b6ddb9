"""The person at the robot: what is told to them, and what they answer at the keyboard."""

import queue
import sys
import threading
import time

from controllers.deployment.stages import Stage

DWELL = 1.0
"""How long a stage lasts at least before it is left without a person [s]."""

STANDS = 3.0
"""The same for standing [s]."""


class Announcer:
    """Prints from a thread of its own: a terminal that waits keeps no command waiting."""

    def __init__(self) -> None:
        self._texts: queue.SimpleQueue[tuple[float, str] | None] = queue.SimpleQueue()
        self._began = time.monotonic()
        self._thread = threading.Thread(target=self._print, daemon=True)
        self._thread.start()

    def tell(self, text: str) -> None:
        """Have a line printed, with the time since the begin."""
        self._texts.put((time.monotonic() - self._began, text))

    def _print(self) -> None:
        while (told := self._texts.get()) is not None:
            print(f"[{told[0]:9.3f}] {told[1]}", flush=True)

    def close(self) -> None:
        """Print what is left."""
        self._texts.put(None)
        self._thread.join(1.0)


class Keyboard:
    """Go, stop and damp, by lines of standard input; see :class:`controllers.deployment.loop.Person`."""

    def __init__(self, yes: bool) -> None:
        """``yes``: go on without a person where a stage asks for one."""
        self._yes, self._go, self._stop, self._damp = yes, False, False, False
        self._interrupts, self._hung_for, self._asked_at = 0, float("inf"), 0.0
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        for line in sys.stdin:
            word = line.strip().lower()
            self._go, self._stop, self._damp = not word, word == "s", word == "d"
            if word not in ("", "s", "d"):
                print(f"{word!r}: Enter for go, s for stop, d to damp", flush=True)

    def interrupt(self) -> None:
        """Ctrl-C: stop, and once more: damp."""
        self._interrupts += 1
        self._stop, self._damp = True, self._interrupts > 1

    def end_hung_after(self, seconds: float) -> None:
        """Stop by itself after so long under control while hung [s]."""
        self._hung_for = seconds

    def wishes(self, stage: Stage, asks: bool, since: float) -> tuple[bool, bool, bool]:
        """See :meth:`controllers.deployment.loop.Person.wishes`."""
        found = self._go, self._stop, self._damp
        self._go = self._stop = self._damp = False
        if stage is Stage.HUNG and since > self._hung_for:
            return False, True, False
        dwell = STANDS if stage is Stage.STANDING else DWELL
        if self._yes and asks and stage is not Stage.STOPPING and since > max(dwell, self._asked_at):
            # again after a while, where a go has not been enough
            self._asked_at = since + DWELL
            return True, found[1], found[2]
        if since < DWELL:
            self._asked_at = 0.0
        return found

    def wait_for_go(self) -> bool:
        """Wait for a person's go before the first stage; ``False`` where they stop."""
        while not self._yes:
            if self._stop or self._damp:
                return False
            if self._go:
                self._go = False
                return True
            time.sleep(0.02)
        return True
