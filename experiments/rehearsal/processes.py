"""A rehearsal as it is with a robot: twin and deployment as processes, over DDS on this machine.

In real time, or in lockstep: then all go by the twin's clock, and what follows calls its times monotonic too.
"""

import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from controllers.deployment.heartbeat import memory_file
from controllers.deployment.ring import Kind, read_log
from controllers.deployment.stages import Stage
from experiments.rehearsal.cores import Cores
from experiments.rehearsal.performance import Performance
from robots.clocks import MACHINE, Clock, SharedClock
from robots.errors import ConfigError, SafeWbcError
from sims.twin.orders import read_order

START = 180.0
"""How long a process may take to be ready: kernels may have to be compiled [s]."""

MUCH_SLOWER = 10.0
"""How many times longer than by the clock something may take in real time."""

EARLY = 0.01
"""By how much the twin's time of an order may be before that of whoever gave it [s]."""

GUARDIAN = re.compile(r"guardian: process (\d+)")

RAISES = 3.0
"""After a stop, when the hoist is raised [s]."""

SLOW = 0.02
"""How long a controller that is slow is stopped [s]."""


@dataclass
class Child:
    """A process whose lines are read as they come.

    Attributes:
        lines: as they came.
    """

    arguments: Sequence[str]
    lines: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        environment = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"}
        self.process = subprocess.Popen(
            [sys.executable, "-m", "safewbc", *self.arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env=environment,
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.lines.append(line.rstrip("\n"))

    def tell(self, line: str) -> None:
        """Write a line to its standard input; one that has ended is told nothing."""
        assert self.process.stdin is not None
        with contextlib.suppress(OSError):
            self.process.stdin.write(line + "\n")
            self.process.stdin.flush()

    def said(self, pattern: str, after: int = 0) -> bool:
        """Whether a line, from the one of number ``after`` on, matches."""
        return any(re.search(pattern, text) for text in list(self.lines)[after:])

    def wait_for(self, pattern: str, timeout: float) -> bool:
        """Wait for a line; ``False`` where the process has ended without, or the time is over [s]."""
        end = time.monotonic() + timeout
        while not self.said(pattern):
            if self.process.poll() is not None:
                self._reader.join(1.0)
                return self.said(pattern)
            if time.monotonic() > end:
                return False
            time.sleep(0.02)
        return True

    def end(self, timeout: float) -> int | None:
        """Wait for its end; kill it where it does not come."""
        try:
            self.process.wait(timeout)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self._reader.join(1.0)
        return self.process.returncode

    @property
    def text(self) -> str:
        """All it has said."""
        return "\n".join(self.lines)


@dataclass(frozen=True, slots=True)
class Place:
    """Where twin and deployment meet.

    Attributes:
        domain: of DDS.
        lockstep: all go by the twin's clock, which waits for them.
    """

    domain: int
    lockstep: bool = False

    @property
    def how(self) -> str:
        """In a word."""
        return "lockstep" if self.lockstep else "processes"


class Pair:
    """Twin and deployment on one DDS domain of this machine.

    Args:
        folder: that everything is written to.
        place: where they meet.
        twin: options of the twin.
        task: words of the deployment's task.

    Attributes:
        orders: what was done, and when [s].
        raised_at: when the hoist was raised, NaN for never [s].
    """

    def __init__(self, folder: Path, place: Place, twin: Sequence[str], task: Sequence[str]) -> None:
        self.folder = folder
        self.orders: list[tuple[float, str]] = []
        self._record, self._out = folder / "truth.npz", folder / "deployment"
        # of one that was interrupted
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        self._lowered, self._stopped_at, self._task = False, float("nan"), list(task)
        self.raised_at = float("nan")
        cores = [] if place.lockstep else sorted(os.sched_getaffinity(0))
        self._cores = [str(cores[0]), str(cores[-1])] if len(cores) > 1 else []
        self._watched = Cores([int(core) for core in self._cores])
        core = ["--cpu", self._cores[0]] if self._cores else []
        self._clock_file = memory_file(Path(f"clock-{place.domain}")) if place.lockstep else None
        self._clock: Clock = MACHINE
        self._where = ["--domain", str(place.domain), "--interface", "lo"]
        if self._clock_file is not None:
            self._where += ["--clock", str(self._clock_file)]
        self.twin = Child(["twin", "g1", *self._where, *core, "--record", str(self._record), *twin])
        self.deployment: Child | None = None
        self.guardian: int | None = None

    def __enter__(self) -> "Pair":
        self._watched.__enter__()
        return self

    def __exit__(self, *of: type[BaseException] | BaseException | TracebackType | None) -> None:
        self._watched.__exit__(*of)
        if self._clock_file is not None:
            self._clock_file.unlink(missing_ok=True)
        if self.deployment is not None and self.deployment.process.poll() is None:
            self.deployment.process.kill()
        if self.guardian is not None:
            _kill(self.guardian, signal.SIGKILL)
        if self.twin.process.poll() is None:
            self.twin.process.kill()

    def begin(self, orders: Sequence[str] = ()) -> None:
        """Wait for the twin, tell it the ``orders``, and start the deployment.

        Raises:
            SafeWbcError: the twin does not start.
        """
        if not self.twin.wait_for(r"\] ready", START):
            raise SafeWbcError(f"the twin did not start:\n{self.twin.text}")
        if self._clock_file is not None:
            self._clock = SharedClock(self._clock_file)
        for line in orders:
            self.twin.tell(line)
        core = ["--cpu", self._cores[1]] if self._cores else []
        options = ["--yes", *self._where, *core, "--out", str(self._out), "--log-seconds", "150"]
        self.deployment = Child(["deploy", "g1", *options, *self._task])
        if self._clock_file is not None:
            # until it goes by the clock, time passes as it does, however long it takes to start
            self.deployment.wait_for(rf"\] {Stage.CONNECT.value}", START)

    def order(self, line: str) -> None:
        """Tell the twin, or do something to a process, and note when."""
        child = self.deployment
        assert child is not None
        self.orders.append((self._clock.now(), line))
        if line == "kill":
            child.process.kill()
        elif line == "stop":
            child.process.send_signal(signal.SIGSTOP)
        elif line == "slow":
            child.process.send_signal(signal.SIGSTOP)
            self._clock.sleep(SLOW)
            child.process.send_signal(signal.SIGCONT)
        elif line in ("kill guardian", "kill both"):
            assert self.guardian is not None
            if line == "kill both":
                # neither is to see the other go
                for number in (signal.SIGSTOP, signal.SIGKILL):
                    _kill(child.process.pid, number)
                    _kill(self.guardian, number)
            else:
                _kill(self.guardian, signal.SIGKILL)
        else:
            self.twin.tell(line)

    def run_to(self, stage: Stage, timeout: float) -> bool:
        """Go on to a stage, doing what a person does at the hoist; whether it was reached in time [s]."""
        child = self.deployment
        assert child is not None
        self._until(lambda: self._reached(stage), timeout)
        return child.said(rf"\] {stage.value}")

    def run_to_the_end(self, timeout: float) -> bool:
        """Go on until the deployment's process has ended; whether it did in time [s]."""
        child = self.deployment
        assert child is not None
        return self._until(lambda: child.process.poll() is not None, timeout)

    def wait(self, seconds: float) -> None:
        """Go on for a time [s]."""
        end = self._clock.now() + seconds
        self._until(lambda: self._clock.now() >= end, seconds + 1.0)

    def _reached(self, stage: Stage) -> bool:
        child = self.deployment
        assert child is not None
        return child.said(rf"\] {stage.value}") or child.process.poll() is not None

    def _until(self, met: Callable[[], bool], timeout: float) -> bool:
        end, latest = self._clock.now() + timeout, time.monotonic() + MUCH_SLOWER * timeout
        while not met():
            if self._clock.now() > end or time.monotonic() > latest:
                return False
            self._tend()
            time.sleep(0.02)
        return True

    def _tend(self) -> None:
        """The hoist goes down where the robot is to be lowered, and up some time after it was stopped."""
        child = self.deployment
        assert child is not None
        if self.guardian is None and (found := GUARDIAN.search(child.text)):
            self.guardian = int(found[1])
        if not self._lowered and child.said(rf"\] {Stage.LOWERED.value}"):
            self._lowered = True
            self.twin.tell("lower")
        if np.isnan(self._stopped_at) and child.said(rf"\] {Stage.STOPPING.value}"):
            self._stopped_at = self._clock.now()
        if np.isnan(self.raised_at) and self._clock.now() - self._stopped_at > RAISES:
            self.raised_at = self._clock.now()
            self.twin.tell("raise")

    def finish(self) -> Performance:
        """End both, and read what they leave."""
        child = self.deployment
        assert child is not None
        code = child.process.poll()
        if code is None:
            # one that is stopped does not end by itself
            child.process.kill()
            child.end(5.0)
        self.twin.tell("end")
        self.twin.end(30.0)
        if self.guardian is not None:
            _kill(self.guardian, signal.SIGTERM)
        (self.folder / "twin.txt").write_text(self.twin.text + "\n", encoding="utf-8")
        (self.folder / "deployment.txt").write_text(child.text + "\n", encoding="utf-8")
        if not self._record.exists():
            raise SafeWbcError(f"the twin left no record:\n{self.twin.text}")
        with np.load(self._record) as file:
            truth = {name: file[name] for name in file.files}
        figures = {}
        if (summary := self._out / "deployment.json").exists():
            figures = json.loads(summary.read_text(encoding="utf-8"))
        if found := re.search(r"real time: factor ([\d.]+)", self.twin.text):
            figures["real_time_factor"] = float(found[1])
        if found := re.search(r"LowCmd: (\d+) received", self.twin.text):
            figures["commands_received"] = int(found[1])
        if found := re.search(r"(\d+) times somebody was not waited for", self.twin.text):
            figures["given_up"] = int(found[1])
        return Performance(truth, self._said(), when_obeyed(self.orders, truth), figures, code, self._watched.end())

    def _said(self) -> list[tuple[float, str]]:
        """What was said, from the log."""
        path = self._out / "log.bin"
        return [(r.time, r.data.decode()) for r in read_log(path) if r.kind is Kind.EVENT] if path.exists() else []


def when_obeyed(orders: Sequence[tuple[float, str]], truth: Mapping[str, Any]) -> list[tuple[float, str]]:
    """Orders with the times at which the twin carried them out, where it was the twin that did [s].

    Whoever gives them may be kept from it between looking at the clock and telling.

    Args:
        orders: with the times at which they were given, of the clock of ``truth["monotonic"]``.
        truth: record of the twin.
    """
    obeyed = np.interp(truth["event_times"], truth["time"], truth["monotonic"])
    events = list(zip(obeyed, truth["events"], strict=True))
    found = []
    for given, line in orders:
        at = given
        # orders to a process are none of the twin's
        with contextlib.suppress(ConfigError):
            text = read_order(line).text
            later = [t for t, event in events if event == text and t >= given - EARLY]
            at = float(min(later, default=given))
        found.append((at, line))
    return found


def _kill(process: int, number: int) -> None:
    try:
        os.kill(process, number)
    except ProcessLookupError:
        pass
