"""``safewbc doctor --g1``: what is needed before the first connection to a G1. The motors are told nothing."""

import os
import socket
import struct
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from importlib import metadata
from importlib.util import find_spec
from typing import TYPE_CHECKING, Literal

import numpy as np
from rich.console import Console

from controllers.deployment.realtime import CONTROLLER_PRIORITY, schedule
from robots.errors import ConfigError
from robots.loader import load_robot
from robots.messages import Array
from robots.unitree.g1 import MODE_MACHINE, G1Joints
from robots.unitree.layout import BATTERY, unpacked
from robots.unitree.stream import PERIOD, WRAP, StateStream

if TYPE_CHECKING:
    from robots.unitree.dds import Network

STATES, COMMANDS, BATTERIES = "rt/lowstate", "rt/lowcmd", "rt/lf/bmsstate"
TOPICS = (STATES, "rt/secondary_imu", BATTERIES)
"""That a robot sends by itself."""

FIND, LISTEN = 5.0, 2.0
"""How long the robot is looked for, and then listened to [s]."""

VARIANTS = {4: "23 joints", MODE_MACHINE: "29 joints", 6: "29 joints, the waist locked"}
"""What ``mode_machine`` means."""

MOST_DRIFT = 0.01
"""By how much of it a period of the robot may differ from 2 ms by this machine's clock [-]."""

ROBOT_NETWORK = "192.168.123."
"""Beginning of the addresses on the robot's Ethernet."""

SIOCGIFADDR = 0x8915
"""Request of Linux for an interface's address."""

Mark = Literal["ok", "FAIL", "note"]
COLOURS = {"ok": "green", "FAIL": "red", "note": "yellow"}


@dataclass(frozen=True, slots=True)
class Finding:
    """One line: whether it is as it has to be, what was looked at, and what was found."""

    mark: Mark
    name: str
    text: str


def doctor_g1(interface: str, domain: int, console: Console) -> int:
    """Look at this machine and at the robot, and print what is found; 1 where something that is needed is not there."""
    failed = False
    with console.status("listening to the robot"):
        for found in findings(interface, domain):
            failed |= found.mark == "FAIL"
            console.print(f"[{COLOURS[found.mark]}]{found.mark}[/]{'':{5 - len(found.mark)}}{found.name:<18} ", end="")
            console.print(found.text, markup=False)
    return 1 if failed else 0


def findings(interface: str, domain: int) -> Iterator[Finding]:
    """Everything that is looked at, in its order; ends where the rest cannot be."""
    if find_spec("cyclonedds") is None:
        yield Finding("FAIL", "cyclonedds", "not installed: pip install 'safewbc[g1]'")
        return
    yield Finding("ok", "cyclonedds", f"version {metadata.version('cyclonedds')}")
    yield (network_card := _interface(interface))
    yield _scheduling()
    if network_card.mark == "FAIL":
        return
    from robots.unitree.dds import Network
    from robots.unitree.idl import RAW, type_hash

    types = {kind.__name__: type_hash(kind)[:8] for kind in RAW.values()}
    yield Finding("note", "type hashes", ", ".join(f"{name} {digits}" for name, digits in types.items()))
    try:
        network = Network(domain, interface)
    except ConfigError as error:
        yield Finding("FAIL", "network", str(error))
        return
    heard = listen(network)
    yield from _topics(heard)
    if heard.states:
        yield from _robot(heard)
    yield from _commanded(network, heard)


def _interface(name: str) -> Finding:
    """Whether there is such an interface, and its address."""
    known = [known for _, known in socket.if_nameindex()]
    if name not in known:
        return Finding("FAIL", "interface", f"no {name!r} on this machine, which has " + ", ".join(known))
    address = address_of(name)
    if address is None:
        return Finding("FAIL", "interface", f"{name} has no IPv4 address: give it one of {ROBOT_NETWORK}0/24")
    if address.startswith(("127.", ROBOT_NETWORK)):
        return Finding("ok", "interface", f"{name}, {address}")
    return Finding("note", "interface", f"{name}, {address}: the robot's own network is {ROBOT_NETWORK}0/24")


def address_of(interface: str) -> str | None:
    """The IPv4 address of an interface; ``None`` where it has none."""
    from fcntl import ioctl

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asked:
        try:
            answer = ioctl(asked.fileno(), SIOCGIFADDR, struct.pack("256s", interface.encode()[:15]))
        except OSError:
            return None
    return socket.inet_ntoa(answer[20:24])


def _scheduling() -> Finding:
    """Whether a controller may run in real time here; this process goes on as it was."""
    if not hasattr(os, "sched_getscheduler"):
        return Finding("note", "scheduling", "no real-time class on this system: ticks will be late now and then")
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    text = schedule(CONTROLLER_PRIORITY)
    permitted = os.sched_getscheduler(0) == os.SCHED_FIFO
    os.sched_setscheduler(0, *before)
    return Finding("ok" if permitted else "note", "scheduling", text + (" is permitted" if permitted else ""))


@dataclass
class Heard:
    """What came in while listening.

    Attributes:
        counts: number of messages by topic.
        writers: number of writers by topic.
        states: bytes of each, and the monotonic time at which it was taken [s].
        charge: of the battery, NaN where nothing was heard of it [%].
    """

    counts: dict[str, int]
    writers: dict[str, int]
    states: list[tuple[bytes, float]] = field(default_factory=list)
    charge: float = float("nan")


def listen(network: "Network") -> Heard:
    """Look for the robot for at most ``FIND``, then listen for ``LISTEN``."""
    readers = {topic: network.reader(topic, own=topic != COMMANDS, depth=64) for topic in (*TOPICS, COMMANDS)}
    end = time.monotonic() + FIND
    while not readers[STATES].writers and time.monotonic() < end:
        time.sleep(0.01)
    heard = Heard(dict.fromkeys(readers, 0), {})
    for reader in readers.values():
        reader.newest()
    end = time.monotonic() + LISTEN
    while (now := time.monotonic()) < end:
        for topic, reader in readers.items():
            for data in reader.take():
                heard.counts[topic] += 1
                if topic == STATES:
                    heard.states.append((data, now))
                elif topic == BATTERIES:
                    heard.charge = float(unpacked(data, BATTERY)["soc"][0])
        time.sleep(1e-4)
    heard.writers = {topic: reader.writers for topic, reader in readers.items()}
    return heard


def _topics(heard: Heard) -> Iterator[Finding]:
    """What a robot sends by itself, and how often."""
    for topic in TOPICS:
        count, writers = heard.counts[topic], heard.writers[topic]
        text = f"{count / LISTEN:.4g} Hz, {_counted(writers, 'writer')}"
        if not count:
            why = (
                "is the robot on, and are interface and domain right?" if topic == STATES else "the robot does without"
            )
            yield Finding("FAIL" if topic == STATES else "note", topic, f"{text}: {why}")
        elif topic == STATES and writers > 1:
            yield Finding("FAIL", topic, f"{text}: more than one robot, or somebody who plays one")
        else:
            yield Finding("ok", topic, text)


def _robot(heard: Heard) -> Iterator[Finding]:
    """What the states say: the checks that come before every deployment, and the robot's clock."""
    from controllers.deployment.preparation import checks

    stream, gyro, ticks = StateStream(G1Joints(load_robot("g1"))), [], []
    for data, arrived in heard.states:
        if (reading := stream.take(data, arrived)) is not None:
            gyro.append(reading.gyro)
            ticks.append((stream.message.tick, arrived))
    rate = len(ticks) / LISTEN
    for check in checks(stream, rate, heard.charge, np.array(gyro)):
        text = check.text
        if check.name == "variant":
            text += f": {VARIANTS.get(stream.message.mode_machine, 'a variant that is not known here')}"
        elif check.name == "broken states":
            text += f" of {len(heard.states)} with a wrong check sum or length"
        yield Finding(
            "ok" if check.met else "FAIL", check.name, text + ("" if check.met else f"; must be {check.needed}")
        )
    if len(ticks) > 2:
        yield clock_of(np.array(ticks))


def clock_of(ticks: Array) -> Finding:
    """The robot's counter against this machine's clock.

    Args:
        ticks: shape (n, 2), n above 2: the counter of a sound state, and when it came [s].
    """
    steps = np.diff(ticks[:, 0]) % WRAP
    unit = float(steps.min())
    periods = np.concatenate([[0.0], np.cumsum(steps)]) / unit
    arrived = ticks[:, 1] - ticks[0, 1]
    slope, begin = np.polyfit(periods, arrived, 1)
    off = arrived - (begin + slope * periods)
    spread = float(off.std())
    sure = spread / (PERIOD * periods.std() * np.sqrt(len(periods)))
    drift = 1e6 * (slope / PERIOD - 1.0)
    lost = round(periods[-1]) + 1 - len(ticks)
    text = (
        f"{1.0 / slope:.2f} states a second by its counter, which goes on by {unit:g} a state; periods {drift:+.0f} ± "
        f"{1e6 * sure:.0f} ppm of 2 ms here; jitter {1e3 * spread:.2f} ms, at most {1e3 * np.abs(off).max():.2f} ms; "
        f"{lost} lost"
    )
    if abs(slope / PERIOD - 1.0) < MOST_DRIFT:
        return Finding("ok", "clock", text)
    wrong = "slower" if slope > PERIOD else "faster"
    reason = (
        f"{wrong} than 2 ms by more than {100 * MOST_DRIFT:g} %: is this machine busy, or the twin not in real time?"
    )
    return Finding("FAIL", "clock", f"{text}: {reason}")


def _commanded(network: "Network", heard: Heard) -> Iterator[Finding]:
    """Who has the motors: the on-board service, or somebody else."""
    from robots.unitree.switcher import SwitcherClient, SwitcherError

    count, writers = heard.counts[COMMANDS], heard.writers[COMMANDS]
    told = f"{_counted(writers, 'other writer')}, {_counted(count, 'command')} in {LISTEN:g} s"
    try:
        mode = SwitcherClient(network).mode()
    except SwitcherError as error:
        why = "no motion switcher is found" if error.code == 3102 else str(error)
        yield Finding("FAIL", "on-board service", why)
        yield Finding("note" if writers or count else "ok", COMMANDS, told)
        return
    if mode:
        yield Finding(
            "ok", "on-board service", f"{mode!r} has the motors; a deployment releases it while the robot hangs"
        )
    else:
        yield Finding("note", "on-board service", "released: nothing holds the robot but who commands it")
    if not (writers or count):
        yield Finding("ok", COMMANDS, told)
    elif mode:
        yield Finding(
            "note", COMMANDS, f"{told}: the on-board service's own, as long as there is none after its release"
        )
    else:
        yield Finding("FAIL", COMMANDS, f"{told}: somebody else commands the motors; end that first")


def _counted(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"
