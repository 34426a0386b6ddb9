"""A deployment's log fed to a deployment again: the same states and wishes in, the same commands out, bit by bit."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from controllers.agent import Agent, AgentOutput
from controllers.deployment.deployment import Deployment
from controllers.deployment.loop import unpack_surroundings
from controllers.deployment.protection import Surroundings
from controllers.deployment.ring import MAGIC, Kind, Record, read_head, read_log
from controllers.perception import Detection
from experiments.running.deployment_tasks import LOG, Built, build, read_task
from robots.errors import ConfigError
from robots.messages import RobotState
from robots.unitree.g1 import MOTOR_NAMES
from robots.unitree.messages import CommandMessage


@dataclass(frozen=True, slots=True)
class DeploymentLog:
    """What was read of a log.

    Attributes:
        path: of the file.
        head: what its first page says.
        records: all whole ones, oldest first.
    """

    path: Path
    head: Mapping[str, Any]
    records: Sequence[Record]

    @property
    def commands(self) -> int:
        """How many were computed."""
        return sum(record.kind is Kind.COMMAND for record in self.records)

    @property
    def overwritten(self) -> bool:
        """Whether the ring has begun again, so that the first records are gone."""
        return bool(self.records) and self.records[0].number != 1

    @property
    def events(self) -> list[tuple[float, str]]:
        """Monotonic times [s] and words of what happened."""
        return [(r.time, r.data.decode("utf-8", "replace")) for r in self.records if r.kind is Kind.EVENT]


def log_in(path: Path) -> Path | None:
    """The log that ``path`` is, or holds as the folder of a deployment; ``None`` where it is neither."""
    found = path / LOG if path.is_dir() else path
    if not found.is_file():
        return None
    with found.open("rb") as file:
        return found if file.read(len(MAGIC)) == MAGIC else None


def read_deployment(path: Path) -> DeploymentLog:
    """Read a log, or the one in a deployment's folder.

    Raises:
        ConfigError: there is none.
    """
    found = log_in(path)
    if found is None:
        raise ConfigError("log", str(path), f"the log of a deployment, or its folder with {LOG}")
    return DeploymentLog(found, read_head(found), read_log(found))


@dataclass(frozen=True, slots=True)
class Period:
    """One period as it was computed again.

    Attributes:
        deployment: after its step.
        agent: that was asked in it; ``None`` where none was.
        output: of that agent.
        around: what was known beside the states.
        begun: monotonic time of the first look at its states, from the log [s].
        done: when its command was ready, likewise [s].
        sent: whether that command was sent, and not the one before once more.
    """

    deployment: Deployment
    agent: Agent | None
    output: AgentOutput | None
    around: Surroundings
    begun: float
    done: float
    sent: bool


@dataclass(frozen=True, slots=True)
class ReplayResult:
    """What a replay came to.

    Attributes:
        periods: number of commands that were computed again and compared.
        different: how many of them are others.
        difference: number of the first of these, from 1 on, and what differs; ``None`` where all are the same.
        overwritten: whether the ring had begun again: nothing can be computed then, and ``periods`` is 0.
        hole: number of the first record missing between others, from which on nothing was compared; ``None`` for none.
        events: monotonic times [s] and words of what happened, from the log.
    """

    periods: int
    different: int
    difference: tuple[int, str] | None
    overwritten: bool
    hole: int | None
    events: Sequence[tuple[float, str]]

    @property
    def same(self) -> bool:
        """Whether there were commands, all of them computed again, and each the same bit by bit."""
        return self.periods > 0 and self.difference is None and self.hole is None


class Watched(Agent):
    """An agent that keeps what its last tick came to: the same agent, seen through another class.

    Attributes:
        output: of the last tick since it was last forgotten; ``None`` where there was none.
    """

    def __init__(self, agent: Agent) -> None:
        self.__dict__ = agent.__dict__
        self.output: AgentOutput | None = None

    def tick(self, state: RobotState, detections: Sequence[Detection] = ()) -> AgentOutput:
        """See :meth:`controllers.agent.Agent.tick`."""
        self.output = super().tick(state, detections)
        return self.output


Watch = Callable[[Period], None]
"""Is told of every period that was computed again."""


def replay_log(path: Path, watch: Watch | None = None) -> ReplayResult:
    """Compute the commands of a log again from its states, and compare them.

    Args:
        path: of the log, or of its folder.
        watch: is told of every period.

    Raises:
        SafeWbcError: it is no log, or its task cannot be made here.
    """
    return replay(log := read_deployment(path), build(read_task(log.head["task"])), watch)


def replay(log: DeploymentLog, built: Built, watch: Watch | None = None) -> ReplayResult:
    """:func:`replay_log` of a log that was read, for its task that was built and has not been used."""
    again = _Again(log, built, watch)
    hole = None
    for i, record in enumerate(() if log.overwritten else log.records):
        if record.number != i + 1:
            hole = i + 1
            break
        again.take(i, record)
    return ReplayResult(again.periods, again.different, again.difference, log.overwritten, hole, log.events)


class _Again:
    """Feeds records to a deployment, and compares."""

    def __init__(self, log: DeploymentLog, built: Built, watch: Watch | None) -> None:
        self._log, self._watch = log, watch
        self._agents = Watched(built.standing), Watched(built.task)
        made = dataclasses.replace(built, standing=self._agents[0], task=self._agents[1])
        self._deployment = made.deployment(lambda text: None)
        if log.head["options"]["dry_run"]:
            self._deployment.begin_dry()
        self._around, self._begun, self._command = Surroundings(), 0.0, b""
        self.periods = self.different = 0
        self.difference: tuple[int, str] | None = None

    def take(self, i: int, record: Record) -> None:
        """Take in a record; ``i``: its place."""
        if record.kind is Kind.STATE:
            self._deployment.take(record.data, record.time)
        elif record.kind is Kind.AROUND:
            for agent in self._agents:
                agent.output = None
            self._around, self._begun = unpack_surroundings(record.data), record.time
            self._command = self._deployment.step(self._around)
        elif record.kind is Kind.COMMAND:
            self._compare(record)
            if self._watch is not None:
                self._watch(self._period(i, record))

    def _compare(self, record: Record) -> None:
        self.periods += 1
        if self._command != record.data:
            self.different += 1
            if self.difference is None:
                self.difference = self.periods, describe(record.data, self._command)

    def _period(self, i: int, record: Record) -> Period:
        agent = next((a for a in self._agents if a.output is not None), None)
        after = self._log.records[i + 1] if i + 1 < len(self._log.records) else None
        sent = after is None or after.kind is not Kind.SENT or after.data != b"\0"
        output = None if agent is None else agent.output
        return Period(self._deployment, agent, output, self._around, self._begun, record.time, sent)


def describe(saved: bytes, again: bytes) -> str:
    """How two commands differ, in words."""
    a, b = CommandMessage(), CommandMessage()
    if len(saved) != a.size or len(again) != b.size:
        return f"{len(saved)} bytes in the log, {len(again)} now"
    a.read(saved)
    b.read(again)
    pairs: list[tuple[str, Any, Any]] = [
        (name, getattr(a, name), getattr(b, name)) for name in ("mode_pr", "mode_machine")
    ]
    for slot, joint in enumerate(MOTOR_NAMES):
        pairs.append((f"mode of {joint}", a.enabled(slot), b.enabled(slot)))
        for field in ("q", "dq", "tau", "kp", "kd"):
            pairs.append((f"{field} of {joint}", a.motors[field][slot], b.motors[field][slot]))
    found = [(name, x, y) for name, x, y in pairs if x != y]
    if not found:
        return "bytes beside the motors' numbers"
    name, x, y = found[0]
    more = f"; {len(found) - 1} more differ" if len(found) > 1 else ""
    return f"{name}: {x:.9g} in the log, {y:.9g} now{more}"
