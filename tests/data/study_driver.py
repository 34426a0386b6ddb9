"""A study to be killed: ``FOLDER LOG [JOBS]``; each case tells LOG when it begins and when it ends.

A case waits for the file LOG.go where LOG.hold names it, so that a test can kill while it is under way; the case that
LOG.kill names ends its own process.
"""

import os
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from experiments.studies.backends import LocalBackend
from experiments.studies.case import Case, Study
from experiments.studies.engine import carry_out
from experiments.studies.store import RowStore

CASES = 8


@dataclass(frozen=True)
class Square:
    """The square of a number, and a failure for 3."""

    x: int
    log: str

    def __call__(self, store: RowStore) -> dict[str, Any]:
        """Log, wait, die or fail where asked to."""
        self.tell("begin")
        if self.named("kill"):
            os.kill(os.getpid(), signal.SIGKILL)
        while self.named("hold") and not Path(f"{self.log}.go").exists():
            time.sleep(0.01)
        if self.x == 3:
            raise ValueError("three is not allowed")
        self.tell("end")
        return {"square": self.x**2, "third": self.x / 3, "table": {"inner": str(self.x)}}

    def tell(self, word: str) -> None:
        """One line, written whole whatever else writes."""
        with open(self.log, "a", encoding="utf-8") as file:
            file.write(f"{word} {self.x} {os.getpid()}\n")

    def named(self, what: str) -> bool:
        """Whether the file LOG.what names this case."""
        path = Path(f"{self.log}.{what}")
        return path.exists() and path.read_text().strip() == str(self.x)


def study(log: str) -> Study:
    """Eight squares."""
    return Study("squares", [Case(f"x-{x}", {"x": x}, Square(x, log)) for x in range(CASES)])


if __name__ == "__main__":
    # jobs in the background of a shell are started with the interrupt ignored, and pass that on
    signal.signal(signal.SIGINT, signal.default_int_handler)
    folder, log, *rest = sys.argv[1:]
    carry_out(study(log), Path(folder), LocalBackend(int(rest[0]) if rest else 2))
