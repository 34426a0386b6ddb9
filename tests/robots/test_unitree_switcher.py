"""The motion switcher over loopback: mode, release, refusals, answers by their ids; the battery's bytes."""

import json
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="the extra g1 is not installed")

from cyclonedds.idl import make_idl_struct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import array, byte, int16, int32, uint16, uint32

from robots.errors import ConfigError
from robots.unitree import idl
from robots.unitree.dds import LOOPBACK, Network
from robots.unitree.layout import BATTERY, IMU, packed, unpacked
from robots.unitree.switcher import (
    ANSWERS,
    CODES,
    REQUESTS,
    SwitcherClient,
    SwitcherError,
    SwitcherService,
    request,
)

DOMAIN = 85
"""None that anything else uses."""


@pytest.fixture(scope="module")
def network() -> Network:
    return Network(DOMAIN, LOOPBACK)


@contextmanager
def served(service: SwitcherService) -> Iterator[SwitcherService]:
    """A service that is looked after by a thread."""
    done = threading.Event()

    def serve() -> None:
        while not done.is_set():
            service.serve()
            time.sleep(0.002)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield service
    finally:
        done.set()
        thread.join()


def test_a_service_is_asked_released_and_selected_again(network: Network) -> None:
    with served(SwitcherService(network)) as service:
        client = SwitcherClient(network, 10.0)
        assert client.mode() == "ai"
        client.release()
        assert client.mode() == service.name == ""
        client.release()
        client.select("ai")
        assert client.mode() == "ai" and service.selected == 1


def test_refusals_come_with_their_code_in_words(network: Network) -> None:
    with served(SwitcherService(network)) as service:
        client = SwitcherClient(network, 10.0)
        service.refuses = True
        with pytest.raises(SwitcherError, match=r"ReleaseMode: the mode could not be released \(code 7008\)") as caught:
            client.release()
        assert caught.value.code == 7008 and client.mode() == "ai"
        with pytest.raises(SwitcherError, match="7004"):
            client.select("dance")


def test_without_a_service_a_call_ends_by_its_time() -> None:
    client = SwitcherClient(Network(DOMAIN + 1, LOOPBACK), 0.2)
    with pytest.raises(SwitcherError, match="3102"):
        client.mode()


def test_a_service_that_does_not_answer_is_told_from_none(network: Network) -> None:
    service = SwitcherService(network)
    client = SwitcherClient(network, 0.3)
    with pytest.raises(SwitcherError, match="no answer in time"):
        client.mode()
    assert service.name == "ai"


def test_an_answer_counts_by_its_id_and_a_request_is_carried_out_once(network: Network) -> None:
    service = SwitcherService(network)
    requests, answers = network.writer(REQUESTS), network.reader(ANSWERS, depth=16)

    def asked(number: int, api: int, parameter: str = "{}") -> idl.Response_:
        requests.send(request(number, api, parameter))
        end = time.monotonic() + 10.0
        while time.monotonic() < end:
            service.serve()
            for answer in answers.take():
                return answer
        raise AssertionError

    for _ in range(2):
        answer = asked(70, 1002, '{"name": "ai"}')
        assert (answer.header.identity.id, answer.header.identity.api_id, answer.header.status.code) == (70, 1002, 0)
    assert service.selected == 1
    assert json.loads(asked(71, 1001).data) == {"form": "0", "name": "ai"}
    for number, (api, parameter, code) in enumerate(
        [(1002, "no json", 7001), (1002, "{}", 7001), (1002, "[1]", 7001), (9, "", 3203)], start=72
    ):
        assert asked(number, api, parameter).header.status.code == code and code in CODES


def test_an_answer_to_somebody_else_is_not_taken(network: Network) -> None:
    """A service that answers every request under another id first, with an error."""
    service = SwitcherService(network)
    answers = network.writer(ANSWERS)
    requests = network.reader(REQUESTS, depth=16)
    done = threading.Event()

    def serve() -> None:
        while not done.is_set():
            for asked in requests.take():
                other = request(asked.header.identity.id - 1, 1001, "").header.identity
                answers.send(idl.Response_(idl.ResponseHeader_(other, idl.ResponseStatus_(7002)), "", []))
                service.serve()
            time.sleep(0.002)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        assert SwitcherClient(network, 10.0).mode() == "ai"
    finally:
        done.set()
        thread.join()


def test_a_time_out_that_is_none_is_refused(network: Network) -> None:
    with pytest.raises(ConfigError, match="timeout"):
        SwitcherClient(network, 0.0)


def test_the_batterys_bytes_are_those_of_its_fields() -> None:
    """Against cyclonedds' own encoder."""
    fields = {
        **dict.fromkeys(("version_high", "version_low", "fn"), byte),
        "cell_vol": array[uint16, 40],
        "bmsvoltage": array[uint32, 3],
        "current": int32,
        **dict.fromkeys(("soc", "soh"), byte),
        "temperature": array[int16, 12],
        **dict.fromkeys(("cycle", "manufacturer_date"), uint16),
        "bmsstate": array[uint32, 5],
        "reserve": array[uint32, 3],
    }
    kind = final(make_idl_struct("BmsState_", "unitree_hg.msg.dds_.BmsState_", fields))
    assert idl.type_hash(kind) == idl.type_hash(idl.BmsState_)
    rng, battery = np.random.default_rng(0), np.zeros(1, BATTERY)
    for name in fields:
        battery[name] = rng.integers(1, 100, battery[name].shape)
    plain = {name: v.tolist() if (v := battery[0][name]).shape else int(v) for name in fields}
    assert bytes(kind(**plain).serialize()) == packed(battery)
    assert unpacked(packed(battery), BATTERY) == battery


def test_messages_that_are_too_short_are_refused() -> None:
    whole = packed(np.zeros(1, IMU))
    assert unpacked(whole + b"\0\0", IMU)["temperature"] == 0
    for data in (b"", whole[:-1], b"\1\1" + whole[2:]):
        with pytest.raises(ConfigError, match="message"):
            unpacked(data, IMU)


def test_a_reader_may_leave_out_what_its_own_participant_sends(network: Network) -> None:
    other = Network(DOMAIN, LOOPBACK)
    writer, stranger = network.writer("rt/secondary_imu"), other.writer("rt/secondary_imu")
    reader, every = network.reader("rt/secondary_imu", own=False, depth=8), network.reader("rt/secondary_imu", depth=8)
    end = time.monotonic() + 10.0
    while not (every.writers == 2 and reader.writers == 1 and stranger.readers == 2):
        assert time.monotonic() < end
        time.sleep(0.005)
    imu = np.zeros(1, IMU)
    for temperature, sender in ((1, writer), (2, stranger), (3, writer), (4, stranger)):
        imu["temperature"] = temperature
        sender.send(packed(imu))
    heard: dict[str, list[int]] = {"others": [], "all": []}
    while not (len(heard["others"]) >= 2 and len(heard["all"]) >= 4):
        assert time.monotonic() < end
        for name, source in (("others", reader), ("all", every)):
            heard[name] += [int(unpacked(data, IMU)["temperature"][0]) for data in source.take()]
    assert heard["others"] == [2, 4] and sorted(heard["all"]) == [1, 2, 3, 4]
