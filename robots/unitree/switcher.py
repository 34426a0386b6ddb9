"""The motion switcher: the robot's service that moves it until it is released, asked from here, and played here.

Source: unitree_sdk2_python, comm/motion_switcher and rpc/client_base.py; the codes of unitree_sdk2,
motion_switcher_error.hpp and rpc/internal.py.
"""

import json
import time
from typing import Any

from robots.checks import require_one_of, require_positive
from robots.clocks import MACHINE, Clock
from robots.errors import SafeWbcError
from robots.unitree.dds import Network
from robots.unitree.idl import (
    Request_,
    RequestHeader_,
    RequestIdentity_,
    RequestLease_,
    RequestPolicy_,
    Response_,
    ResponseHeader_,
    ResponseStatus_,
)

REQUESTS, ANSWERS = "rt/api/motion_switcher/request", "rt/api/motion_switcher/response"

CHECK_MODE, SELECT_MODE, RELEASE_MODE = 1001, 1002, 1003
"""What the service can be asked."""

NO_BYTES: Any = []
"""Of requests and answers that carry text alone."""

AGAIN = 0.5
"""Time after which a request without an answer is sent once more, with the same id [s]."""

CODES = {
    3102: "the request could not be sent",
    3104: "no answer in time",
    3203: "the service knows no such request",
    7001: "wrong parameter",
    7002: "the service is busy",
    7003: "wrong event",
    7004: "no mode of that name",
    7005: "wrong command",
    7006: "the mode could not be told",
    7007: "the mode could not be selected",
    7008: "the mode could not be released",
}
"""Codes of a refusal, in words."""


class SwitcherError(SafeWbcError):
    """The motion switcher did not do what it was asked.

    Args:
        asked: what it was asked.
        code: of the refusal, see :data:`CODES`.
    """

    def __init__(self, asked: str, code: int) -> None:
        super().__init__(f"motion switcher, {asked}: {CODES.get(code, 'refused')} (code {code})")
        self.asked = asked
        self.code = code

    def __reduce__(self) -> tuple[type, tuple[str, int]]:
        return type(self), (self.asked, self.code)


class SwitcherClient:
    """Asks the robot's motion switcher; every call waits for its answer.

    Args:
        network: on which the robot is.
        timeout: until there is an answer, that of finding the service included [s].
        clock: that ``timeout`` is told by.

    Raises:
        ConfigError: ``timeout`` is not positive.
    """

    def __init__(self, network: Network, timeout: float = 2.0, clock: Clock = MACHINE) -> None:
        require_positive("timeout", timeout)
        self._clock = clock
        self._requests, self._answers = network.writer(REQUESTS), network.reader(ANSWERS, depth=16)
        self._timeout, self._id = timeout, 0

    def mode(self) -> str:
        """Name of what moves the robot, ``ai`` for one; empty where it is released.

        Raises:
            SwitcherError: no answer in time, or a refusal.
        """
        try:
            return str(json.loads(self._ask("CheckMode", CHECK_MODE, {}))["name"])
        except (ValueError, KeyError, TypeError) as error:
            raise SwitcherError("CheckMode", 7006) from error

    def release(self) -> None:
        """Stop what moves the robot: its motors are limp at once, so only where it hangs.

        Raises:
            SwitcherError: no answer in time, or a refusal.
        """
        self._ask("ReleaseMode", RELEASE_MODE, {})

    def select(self, name: str) -> None:
        """Start what moves the robot, by its name: its motors are limp at once, so only where it hangs.

        Raises:
            SwitcherError: no answer in time, or a refusal.
        """
        self._ask(f"SelectMode {name}", SELECT_MODE, {"name": name})

    def _ask(self, asked: str, api: int, parameter: dict[str, Any]) -> str:
        """Send a request; returns the data of the answer with its id."""
        end = self._clock.now() + self._timeout
        while not (self._requests.readers and self._answers.writers):
            if self._clock.now() >= end:
                raise SwitcherError(asked, 3102)
            time.sleep(1e-3)
        self._id = max(self._id + 1, time.monotonic_ns())
        again = 0.0
        while (now := self._clock.now()) < end:
            if now >= again:
                # whether the service has found our reader yet cannot be seen from here: an answer may be lost
                self._requests.send(request(self._id, api, json.dumps(parameter)))
                again = now + AGAIN
            for answer in self._answers.take():
                if answer.header.identity.id == self._id:
                    return _checked(asked, answer)
            time.sleep(1e-3)
        raise SwitcherError(asked, 3104)


def _checked(asked: str, answer: Response_) -> str:
    if answer.header.status.code:
        raise SwitcherError(asked, answer.header.status.code)
    return answer.data


def request(number: int, api: int, parameter: str) -> Request_:
    """A request as it goes out: ``number`` is its id, by which its answer is found."""
    header = RequestHeader_(RequestIdentity_(number, api), RequestLease_(0), RequestPolicy_(0, False))
    return Request_(header, parameter, NO_BYTES)


class SwitcherService:
    """The motion switcher, as who plays the robot has it.

    Attributes:
        name: of what moves the robot now; empty after its release.
        refuses: whether a release is refused.
        selected: how often a mode has been selected.
    """

    def __init__(self, network: Network, name: str = "ai") -> None:
        """On a network, with the mode ``name`` active, the only one there is."""
        require_one_of("name", name, ("ai",))
        self._requests, self._answers = network.reader(REQUESTS, depth=16), network.writer(ANSWERS)
        self._known, self.name, self.refuses, self.selected = name, name, False, 0
        self._last: tuple[int, int, str] | None = None

    def serve(self) -> None:
        """Answer what has come since the last time; one that is asked again is answered as before."""
        for asked in self._requests.take():
            number = asked.header.identity.id
            if self._last is None or self._last[0] != number:
                self._last = (number, *self._answer(asked.header.identity.api_id, asked.parameter))
            _, code, data = self._last
            if not asked.header.policy.noreply:
                header = ResponseHeader_(asked.header.identity, ResponseStatus_(code))
                self._answers.send(Response_(header, data, NO_BYTES))

    def _answer(self, api: int, parameter: str) -> tuple[int, str]:
        """Code and data of an answer."""
        if api == CHECK_MODE:
            return 0, json.dumps({"form": "0", "name": self.name})
        if api == RELEASE_MODE:
            if self.refuses:
                return 7008, ""
            self.name = ""
            return 0, ""
        return self._select(parameter) if api == SELECT_MODE else (3203, "")

    def _select(self, parameter: str) -> tuple[int, str]:
        try:
            name = json.loads(parameter)["name"]
        except (ValueError, KeyError, TypeError):
            return 7001, ""
        if name != self._known:
            return 7004, ""
        self.name = name
        self.selected += 1
        return 0, ""
