"""A rehearsal in one process, in simulated time: the same deployment and the same twin, without network and clock.

What it cannot show: deadlines, the guardian, and what processes do to each other. What it is for: many seeds at a time,
and tests that are the same on every machine.
"""

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from controllers.deployment.deployment import Deployment
from controllers.deployment.protection import Surroundings
from controllers.deployment.stages import Stage
from experiments.rehearsal.performance import Performance
from robots.unitree.layout import BATTERY, unpacked
from sims.twin.ports import MemoryPorts
from sims.twin.record import Record
from sims.twin.twin import STEP, Twin, TwinConfig

ANSWER = 1
"""Steps from a state to its command: the controller takes up to a millisecond."""

WITHOUT_STATE = 4
"""Steps without a state after which a period counts as one without."""

DWELL, STANDS, RAISES = 0.6, 2.0, 3.0
"""How long a stage lasts before a go; standing; and stopping, before the hoist is raised [s]."""

LONGEST = 600.0
"""Of a rehearsal [s]."""

AFTER_DAMPING = 1.0
"""How long the motors brake before it ends [s]."""


class CountingPorts(MemoryPorts):
    """Ports in memory that count commands of somebody else."""

    def __init__(self) -> None:
        super().__init__("")
        self.strangers = 0

    def send_foreign_command(self, data: bytes | None) -> None:
        """See :class:`sims.twin.ports.Ports`."""
        super().send_foreign_command(data)
        self.strangers += data is not None


class Rehearsal:
    """Twin and deployment, stepped together.

    Args:
        make: makes the deployment, which says what happens to what it is given.
        config: of the twin.
        record: file that the twin's record goes to in the end; kept in memory if not given.
    """

    def __init__(self, make: Callable[[Callable[[str], None]], Deployment], config: TwinConfig, record: Path) -> None:
        self.said: list[tuple[float, str]] = []
        self.orders: list[tuple[float, str]] = []
        self.ports = CountingPorts()
        self.record = Record(record)
        self.deployment = make(self._say)
        self.twin = Twin(self.deployment.robot, config, self.ports, self.ports, record=self.record)
        self._since_state, self._stage, self._stage_began = 0, Stage.ZERO_TORQUE, 0.0
        self._waiting: list[tuple[int, bytes]] = []
        self._steps, self._lowered, self._asked = 0, False, 0.0
        self._charge = self.raised_at = float("nan")

    @property
    def time(self) -> float:
        """Simulated [s]."""
        return self._steps * STEP

    def _say(self, text: str) -> None:
        self.said.append((self.time, text))

    def order(self, line: str) -> None:
        """Tell the twin something."""
        self.orders.append((self.time, line))
        self.twin.obey(line)

    def step(self) -> None:
        """One millisecond."""
        for at, command in self._waiting:
            if at <= self._steps:
                self.ports.inbox.append(command)
        self._waiting = [(at, command) for at, command in self._waiting if at > self._steps]
        self.twin.step(self.time)
        self._steps += 1
        states, self.ports.states = self.ports.states, []
        for data in states:
            self.deployment.take(data, self.time)
        self._since_state = 0 if states else self._since_state + 1
        if self.deployment.begun and (states or self._since_state >= WITHOUT_STATE):
            if not states:
                self._since_state = WITHOUT_STATE - 2
            self._answer()

    def _answer(self) -> None:
        command = self.deployment.step(self._around())
        self._waiting.append((self._steps + ANSWER - 1, command))

    def _around(self) -> Surroundings:
        deployment, t = self.deployment, self.time
        if deployment.stage is not self._stage:
            self._stage, self._stage_began, self._asked = deployment.stage, t, 0.0
        since, go = t - self._stage_began, False
        if deployment.asks and self._stage is not Stage.STOPPING:
            go = since >= max(STANDS if self._stage is Stage.STANDING else DWELL, self._asked)
            self._asked = since + DWELL if go else self._asked
        if self._stage is Stage.LOWERED and not self._lowered:
            self._lowered = True
            self.twin.obey("lower")
        if self._stage is Stage.STOPPING and np.isnan(self.raised_at) and since > RAISES:
            self.raised_at = t
            self.twin.obey("raise")
        for data in self.ports.battery:
            self._charge = float(unpacked(data, BATTERY)["soc"][0])
        self.ports.battery.clear()
        strangers, self.ports.strangers = self.ports.strangers, 0
        return Surroundings(go=go, battery=self._charge, strangers=strangers)

    def run_until(self, met: Callable[[], bool], longest: float = LONGEST) -> bool:
        """Go on until something is so; returns whether it was so within ``longest`` [s]."""
        end = self.time + longest
        while not met():
            if self.time >= end:
                return False
            self.step()
        return True

    def run_to(self, stage: Stage, longest: float = LONGEST) -> bool:
        """Go on to a stage."""
        return self.run_until(lambda: self.deployment.stage in (stage, Stage.DAMPED), longest)

    def run_for(self, seconds: float) -> None:
        """Go on for a time [s]."""
        end = self.time + seconds
        self.run_until(lambda: self.time >= end)

    def finish(self, orders: Iterable[tuple[float, str]] = ()) -> Performance:
        """Go on to latched damping, with orders at times after the task's begin [s]; what came of it."""
        self.run_to(Stage.TASK)
        began = self.time
        for after, line in orders:
            while self.time < began + after and not self.deployment.damped:
                self.step()
            self.order(line)
        self.run_to(Stage.DAMPED)
        self.run_for(AFTER_DAMPING)
        return self.performance()

    def performance(self) -> Performance:
        """What has come of it so far."""
        stream = self.deployment.stream
        figures = {
            "bridged": self.deployment.bridged,
            "lost": stream.clock.lost,
            "broken": stream.broken,
            "repeated": stream.repeated,
        }
        return Performance(self.record.arrays(), self.said, self.orders, figures)
