"""The loop of a deployment: states from the network in, commands out, in time, with everything logged."""

import struct
import time
from collections.abc import Callable
from dataclasses import astuple, dataclass, field
from typing import Protocol

from controllers.deployment.deployment import Deployment
from controllers.deployment.guardian import ASKED, SILENT
from controllers.deployment.heartbeat import Heartbeat, Silence
from controllers.deployment.protection import Surroundings
from controllers.deployment.ring import Kind, RingLog
from controllers.deployment.stages import Stage
from robots.unitree.body import G1Port

PERIOD = 0.002
"""Of states and commands [s]."""

PATIENCE = 0.0015
"""How much longer than a period a state is waited for, before the period counts as one without [s]."""

AROUND = struct.Struct("<???dqdq")
"""How :class:`Surroundings` are written."""

DAMPED_FOR = 2.0
"""How long the motors are told to brake before the program ends [s]."""


class Person(Protocol):
    """Who is asked for go, stop and damp."""

    def wishes(self, stage: Stage, asks: bool, since: float) -> tuple[bool, bool, bool]:
        """Go, stop, damp since the last period; ``since``: how long the stage has lasted [s]."""
        ...


def pack_surroundings(around: Surroundings) -> bytes:
    """As bytes of the log."""
    return AROUND.pack(*astuple(around))


def unpack_surroundings(data: bytes) -> Surroundings:
    """Back from the log."""
    return Surroundings(*AROUND.unpack(data))


@dataclass
class Timing:
    """How the deadlines were kept.

    Attributes:
        work: from the first look at a state to its command [s], period by period.
        age: of the state when its command was ready, on the clock of the states [s].
        late: number of commands that were not ready within a period of the look.
        late_pairs: number of them that came right after another one.
        without: number of periods without a new state.
        late_in_a_row: now.
    """

    work: list[float] = field(default_factory=list)
    age: list[float] = field(default_factory=list)
    late: int = 0
    late_pairs: int = 0
    without: int = 0
    late_in_a_row: int = 0

    def count(self, work: float, age: float, fresh: bool) -> bool:
        """Take in a period; returns whether its command is late."""
        self.work.append(work)
        self.without += not fresh
        late = fresh and work > PERIOD
        if fresh:
            self.age.append(age)
        self.late += late
        self.late_pairs += late and self.late_in_a_row > 0
        self.late_in_a_row = self.late_in_a_row + 1 if late else 0
        return late


class DeploymentLoop:
    """Runs a deployment until it is damped for good, or until the guardian has taken over.

    Args:
        deployment: what decides.
        port: to the robot.
        heart: between this process and the guardian.
        log: of everything in and out.
        person: who is asked.
        write: whether commands are sent; a dry run does all but that.
    """

    def __init__(
        self,
        deployment: Deployment,
        port: G1Port,
        heart: Heartbeat,
        log: RingLog,
        person: Person,
        write: bool = True,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.deployment, self.timing = deployment, Timing()
        self._port, self._heart, self._log, self._person = port, heart, log, person
        self._write, self._clock = write, clock
        self._guardian = Silence()
        self._sent: bytes | None = None
        self._damped_at: float | None = None
        self._stage, self._stage_began = deployment.stage, clock()

    def run(self) -> str | None:
        """Run to the end; returns the cause of the stop. It begins with the first sound state."""
        self._stage_began = self._clock()
        due = self._stage_began + PERIOD
        while True:
            arrivals = self._port.receive(due + PATIENCE)
            begun = self._clock()
            due = begun + PERIOD - (PATIENCE if not arrivals else 0.0)
            for data, arrived in arrivals:
                self._log.write(Kind.STATE, arrived, data)
                self.deployment.take(data, arrived)
            if self._heart.read("latched"):
                return self._guarded()
            if not self.deployment.begun:
                continue
            self._period(begun)
            if self._over():
                return self.deployment.cause

    def _period(self, begun: float) -> None:
        deployment, timing = self.deployment, self.timing
        around = self._surroundings(begun)
        self._log.write(Kind.AROUND, begun, pack_surroundings(around))
        command = deployment.step(around)
        now = self._clock()
        fresh = deployment.missing == 0
        late = timing.count(now - begun, now - deployment.stream.clock.stamp, fresh)
        self._log.write(Kind.COMMAND, now, command)
        if late and self._sent is not None and not deployment.damped:
            # nothing new: what it answers has passed
            command = self._sent
        if self._write:
            self._port.send(command)
        self._sent = command
        self._heart.mark("sent", self._clock())
        self._log.write(Kind.SENT, now, bytes([not late]))

    def _surroundings(self, now: float) -> Surroundings:
        deployment = self.deployment
        if deployment.stage is not self._stage:
            self._stage, self._stage_began = deployment.stage, now
        go, stop, damp = self._person.wishes(self._stage, deployment.asks, now - self._stage_began)
        guarded = self._guardian.look(now, self._heart.read("guarded")) if self._write else 0.0
        strangers = self._port.strangers() if self._write else 0
        return Surroundings(go, stop, damp, self._port.battery(), strangers, guarded, self.timing.late_in_a_row)

    def _over(self) -> bool:
        if not self.deployment.damped:
            return False
        now = self._clock()
        if self._damped_at is None:
            self._damped_at = now
        return now - self._damped_at > DAMPED_FOR

    def _guarded(self) -> str | None:
        """The guardian has the motors: say so, and do not fight for them."""
        why = ASKED if self._heart.read("asked") else SILENT
        self.deployment.damp(f"the guardian has taken over: {why}")
        return self.deployment.cause
