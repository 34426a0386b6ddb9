"""A twin's ports on loopback: whether the last state was answered."""

import time

import pytest

pytest.importorskip("cyclonedds", reason="the extra g1 is not installed")

from robots.unitree.dds import LOOPBACK, Network
from robots.unitree.messages import CommandMessage
from sims.twin.dds_ports import DdsPorts
from tests.support.fake_g1 import FakeG1

DOMAIN = 93
"""None that anything else uses."""


def wait_until(ports: DdsPorts, come: int) -> tuple[int, bool]:
    end = time.monotonic() + 10.0
    while (debt := ports.debt())[0] < come and time.monotonic() < end:
        time.sleep(1e-3)
    return debt


def test_a_state_is_owed_a_command_until_one_comes_and_none_is_lost_by_looking() -> None:
    ports, network = DdsPorts(DOMAIN, LOOPBACK), Network(DOMAIN, LOOPBACK)
    writer, command = network.writer("rt/lowcmd"), CommandMessage().sealed()
    end = time.monotonic() + 10.0
    while not writer.readers and time.monotonic() < end:
        time.sleep(1e-3)
    assert ports.debt() == (0, False)
    ports.send_state(FakeG1().state())
    assert ports.debt() == (0, True)
    writer.send(command)
    assert wait_until(ports, 1) == (1, False)
    assert list(ports.commands()) == [command] and list(ports.commands()) == []
    # whose a command is cannot be seen: while somebody else's go out from here none settles a debt
    ports.send_state(FakeG1().state())
    ports.send_foreign_command(command)
    arrived: list[bytes] = []
    while not arrived and time.monotonic() < end:
        arrived += ports.commands()
        time.sleep(1e-3)
    assert arrived and ports.debt() == (1, True)
    ports.send_foreign_command(None)
    writer.send(command)
    assert wait_until(ports, 2) == (2, False)
