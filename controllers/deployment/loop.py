"""The loop of a deployment: states from the network in, commands out, in time, with everything logged."""

import contextlib
import logging
import math
import struct
import time
from collections.abc import Callable
from dataclasses import astuple, dataclass, field
from typing import Protocol

from controllers.deployment.deployment import Deployment
from controllers.deployment.heartbeat import Heartbeat, Silence
from controllers.deployment.protection import Surroundings
from controllers.deployment.ring import Kind, RingLog
from controllers.deployment.stages import Stage
from controllers.deployment.watchman import ASKED, SILENCE, SILENT, brake_message
from robots.unitree.body import G1Port
from robots.unitree.stream import PERIOD

LOGGER = logging.getLogger(__name__)

PATIENCE = 0.0015
"""How much longer than a period a state is waited for, before the period counts as one without [s]."""

FIRST_STATE = 1.0
"""How long the first state is waited for [s]."""

AROUND = struct.Struct("<???dqdq")
"""How :class:`Surroundings` are written."""

DAMPED_FOR = 1000
"""Periods with a new state in which the motors are told to brake at least, whatever a person says."""

OFF_AFTER = 2.0
"""After so long without a state a robot that has braked is off [s]."""

DEAF_FOR = 10.0
"""How long motors are told to brake where no state comes; then it is left to the guardian, which goes on [s]."""


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
        work: from the first look at a state to its command, by this machine's clock, period by period [s].
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

    def count(self, work: float, took: float, age: float, fresh: bool) -> bool:
        """Take in a period, which ``took`` so long by the clock of the deadlines; returns whether its command is late.

        Times in s.
        """
        self.work.append(work)
        self.without += not fresh
        late = fresh and took > PERIOD
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
        clock: monotonic, that of the deadlines [s].
        stopwatch: of this machine, by which the work is measured [s].

    Attributes:
        timing: how the deadlines were kept.
        braked: whether the robot was seen to be told to brake until the end.
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
        stopwatch: Callable[[], float] = time.perf_counter,
    ) -> None:
        self.deployment, self.timing, self.braked = deployment, Timing(), False
        self._port, self._heart, self._log, self._person = port, heart, log, person
        self._write, self._clock, self._stopwatch = write, clock, stopwatch
        self._guardian = Silence()
        self._sent: bytes | None = None
        self._work_began = 0.0
        self._braked_periods, self._heard_at = 0, float("nan")
        self._stage, self._stage_began = deployment.stage, clock()

    def run(self) -> str | None:
        """Run to the end, which begins with the first sound state; returns the first cause of the stop.

        Whatever is wrong in here, log and network included, brakes the motors.
        """
        self._stage_began = self._clock()
        due, latest = self._stage_began + PERIOD, self._stage_began + FIRST_STATE
        while not self._over():
            try:
                begun, came = self._take_in(due)
                # without a state the next one has been waited for already
                due = begun + PERIOD - (0.0 if came else PATIENCE)
                if self._heart.read("latched"):
                    return self._guarded()
                if self.deployment.begun:
                    self._period(begun)
                elif begun > latest or any(self._person.wishes(self._stage, False, 0.0)[1:]):
                    self.deployment.damp("no sound state has come since the release, or stopped before it")
                    self._brake()
                    return self.deployment.cause
            except Exception as error:
                first = not self.deployment.damped
                self.deployment.damp(f"{type(error).__name__}: {error}")
                self._brake()
                if first:
                    LOGGER.exception("the loop of the deployment: the motors brake")
        return self.deployment.cause

    def _take_in(self, due: float) -> tuple[float, bool]:
        """Take in what comes until ``due`` and a little longer [s]; returns when it was taken, and if anything came."""
        arrivals = self._port.receive(due + PATIENCE)
        begun, self._work_began = self._clock(), self._stopwatch()
        for data, arrived in arrivals:
            self.deployment.take(data, arrived)
            self._log.write(Kind.STATE, arrived, data)
        return begun, bool(arrivals)

    def _period(self, begun: float) -> None:
        deployment, timing = self.deployment, self.timing
        around = self._surroundings(begun)
        command = deployment.step(around)
        now = self._clock()
        fresh = deployment.missing == 0
        work = self._stopwatch() - self._work_began
        late = timing.count(work, now - begun, now - deployment.stream.clock.stamp, fresh)
        held_back = late and timing.late_in_a_row == 1 and self._sent is not None and not deployment.damped
        # a second one in a row goes out late: motors must not be without anything new for long
        sent = self._sent if held_back and self._sent is not None else command
        # a process that was stopped for so long is not to say anything stiff any more: the guardian has the motors
        if self._write and not self._heart.read("latched") and now - begun < SILENCE:
            self._port.send(sent)
            self._heart.mark("sent", self._clock())
        self._sent = sent
        if fresh and deployment.damped:
            self._braked_periods, self._heard_at = self._braked_periods + 1, now
        self._log.write(Kind.AROUND, begun, pack_surroundings(around))
        self._log.write(Kind.COMMAND, now, command)
        self._log.write(Kind.SENT, now, bytes([not held_back]))

    def _brake(self) -> None:
        """Tell the motors to brake, by nothing but the network; where that fails, the guardian hears of nothing."""
        if not self._write or self._heart.read("latched"):
            return
        robot, message = self.deployment.robot, self.deployment.stream.message
        with contextlib.suppress(Exception):
            self._port.send(brake_message(robot, message.mode_machine))
            self._heart.mark("sent", self._clock())

    def _surroundings(self, now: float) -> Surroundings:
        deployment = self.deployment
        if deployment.stage is not self._stage:
            self._stage, self._stage_began = deployment.stage, now
        go, stop, damp = self._person.wishes(self._stage, deployment.asks, now - self._stage_began)
        guarded = self._guardian.look(now, self._heart.read("guarded")) if self._write else 0.0
        strangers = self._port.strangers() if self._write else 0
        return Surroundings(go, stop, damp, self._port.battery(), strangers, guarded, self.timing.late_in_a_row)

    def _over(self) -> bool:
        """Whether nobody needs its commands any more: a person says so, or the robot is off.

        Where motors were never heard while they were told to brake, it is left to the guardian.
        """
        if not self.deployment.damped:
            return False
        now = self._clock()
        if math.isnan(self._heard_at):
            self._heard_at = now
        self.braked = self._braked_periods >= DAMPED_FOR or not self._write
        silent = now - self._heard_at
        if self.braked:
            return self.deployment.let_go or silent > OFF_AFTER or not self._write
        return silent > DEAF_FOR

    def _guarded(self) -> str | None:
        """The guardian has the motors: say so, and do not fight for them."""
        why = ASKED if self._heart.read("asked") else SILENT
        self.deployment.damp(f"the guardian has taken over: {why}")
        return self.deployment.cause
