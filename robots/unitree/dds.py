"""The network between a controller and a G1: topics of bytes over cyclonedds, on one interface."""

import time
from collections.abc import Iterator
from typing import Any
from xml.sax.saxutils import quoteattr

from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from robots.checks import require_between
from robots.errors import ConfigError
from robots.unitree.idl import RAW, Request_, Response_

LOOPBACK = "lo"
"""Interface of this machine alone: without multicast, every process a peer by its number."""

MOST_PARTICIPANTS = 30
"""Processes that find each other on one machine without multicast."""

SERVICE = {"rt/api/motion_switcher/request": Request_, "rt/api/motion_switcher/response": Response_}
"""Topics of the on-board service that moves the robot until it is released."""


def configuration(interface: str) -> str:
    """CycloneDDS' configuration for one interface.

    Raises:
        ConfigError: no name.
    """
    if not interface:
        raise ConfigError("interface", interface, f"the name of a network interface, for example eth0 or {LOOPBACK}")
    if interface != LOOPBACK:
        network = f"<General><Interfaces><NetworkInterface name={quoteattr(interface)}/></Interfaces></General>"
        return f"<CycloneDDS><Domain>{network}</Domain></CycloneDDS>"
    network = f"<Interfaces><NetworkInterface name={quoteattr(interface)} multicast='false'/></Interfaces>"
    peers = (
        "<Discovery><Peers><Peer address='127.0.0.1'/></Peers><ParticipantIndex>auto</ParticipantIndex>"
        f"<MaxAutoParticipantIndex>{MOST_PARTICIPANTS}</MaxAutoParticipantIndex></Discovery>"
    )
    general = f"<General>{network}<AllowMulticast>false</AllowMulticast></General>"
    return f"<CycloneDDS><Domain>{general}{peers}</Domain></CycloneDDS>"


class Network:
    """One participant on one interface. Set the process's scheduling before it is made: its threads inherit it.

    Args:
        domain: 0 on the robot; simulators use others, so as not to meet one.
        interface: by its name.

    Raises:
        ConfigError: the domain is not from 0 to 230, or DDS cannot use the interface.
    """

    def __init__(self, domain: int, interface: str) -> None:
        require_between("domain", domain, 0, 230)
        text = configuration(interface)
        try:
            # a process has one configuration of a domain, the first
            self._domain = _domain(domain, text)
            self._participant = DomainParticipant(domain)
        except Exception as error:
            raise ConfigError("interface", interface, f"a network interface that DDS can use ({error})") from error
        self._topics: dict[str, Topic[Any]] = {}

    def writer(self, topic: str) -> "Writer":
        """What sends on one of the robot's topics.

        Raises:
            ConfigError: no such topic.
        """
        return Writer(DataWriter(self._participant, self._topic(topic)))

    def reader(self, topic: str, own: bool = True, depth: int = 1) -> "Reader":
        """What receives on one of the robot's topics.

        Args:
            topic: by its name.
            own: whether what this participant sends itself is received too.
            depth: how many samples wait to be taken; an older one makes room.

        Raises:
            ConfigError: no such topic.
        """
        others = () if own else (Policy.IgnoreLocal.Participant,)
        return Reader(self._participant, self._topic(topic), Qos(Policy.History.KeepLast(depth), *others))

    def _topic(self, name: str) -> Topic[Any]:
        known = {**RAW, **SERVICE}
        if name not in known:
            raise ConfigError("topic", name, "one of " + ", ".join(known))
        if name not in self._topics:
            self._topics[name] = Topic(self._participant, name, known[name])
        return self._topics[name]


_DOMAINS: dict[int, tuple[str, Domain]] = {}


def _domain(domain: int, text: str) -> Domain:
    """The domain of this process, configured once."""
    if domain not in _DOMAINS:
        _DOMAINS[domain] = text, Domain(domain, text)
    before, found = _DOMAINS[domain]
    if before != text:
        raise ConfigError("interface", "another one", "that of the first participant of this process in the domain")
    return found


class Writer:
    """Sends samples of one topic."""

    def __init__(self, writer: DataWriter[Any]) -> None:
        self._writer = writer

    def send(self, data: Any) -> None:
        """Send prepared bytes, or a sample of a topic that has none."""
        kind = self._writer.data_type
        self._writer.write(kind(data) if isinstance(data, bytes) else data)

    @property
    def readers(self) -> int:
        """How many there are that receive it."""
        return len(self._writer.get_matched_subscriptions())


class Reader:
    """Receives samples of one topic.

    Attributes:
        received: how many have come.
    """

    def __init__(self, participant: DomainParticipant, topic: Topic[Any], qos: Qos | None = None) -> None:
        self._reader: DataReader[Any] = DataReader(participant, topic, qos)
        self._raw = topic.data_type in RAW.values()
        self.received = 0

    def take(self) -> Iterator[Any]:
        """All that have come since the last time, oldest first: bytes, or samples of a topic that has none."""
        for sample in self._reader.take(N=64):
            if sample.sample_info.valid_data:
                self.received += 1
                yield sample.data if self._raw else sample

    def newest(self) -> Any:
        """The last of them; ``None`` where none has come."""
        taken = list(self.take())
        return taken[-1] if taken else None

    def wait(self, timeout: float) -> Any:
        """The next one, or ``None`` after ``timeout`` [s]."""
        end = time.monotonic() + timeout
        while (found := self.newest()) is None and time.monotonic() < end:
            time.sleep(1e-4)
        return found

    @property
    def writers(self) -> int:
        """How many there are that send it."""
        return len(self._reader.get_matched_publications())
