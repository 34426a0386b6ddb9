"""What a twin is told while it runs: a line each, from a person, another process or a script."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from robots.errors import ConfigError
from sims.twin.faults import FAULTS, Fault, fault_name, read_fault

VERBS = ("lower", "raise", "status", "end", "clear", "fault")
"""What an order may begin with, beside the name of a fault."""


@dataclass(frozen=True, slots=True)
class Order:
    """One order.

    Attributes:
        text: as it was given.
        verb: one of ``VERBS``.
        fault: that is to begin; ``None`` for other verbs.
        cleared: name of the fault that is to end; ``None``: all.
    """

    text: str
    verb: str
    fault: Fault | None = None
    cleared: str | None = None


def read_order(line: str) -> Order:
    """The order of a line.

    Raises:
        ConfigError: no such order, or one of its words is not allowed.
    """
    words = line.split()
    text, verb = " ".join(words), words[0] if words else ""
    if verb == "fault" or verb in FAULTS:
        return Order(text, "fault", read_fault(words[1:] if verb == "fault" else words))
    if verb not in VERBS:
        raise ConfigError("order", verb, "one of " + ", ".join((*VERBS, *FAULTS)))
    if len(words) > (2 if verb == "clear" else 1):
        raise ConfigError(verb, " ".join(words[1:]), "followed by nothing more")
    return Order(text, verb, cleared=fault_name(words[1]) if len(words) > 1 else None)


def read_script(lines: Sequence[str], name: str = "script") -> tuple[tuple[float, Order], ...]:
    """Orders with their times [s], in the order of time; what follows ``#`` is a comment.

    Raises:
        ConfigError: a line has no time at its begin, or no order behind it; names the line.
    """
    found = []
    for i, line in enumerate(lines, 1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        try:
            time = float(words[0])
        except ValueError:
            time = math.nan
        if not 0.0 <= time < math.inf:
            raise ConfigError(f"{name} line {i}", words[0], "a time from 0 on [s], then an order")
        try:
            found.append((time, read_order(" ".join(words[1:]))))
        except ConfigError as error:
            raise ConfigError(f"{name} line {i}: {error.name}", error.value, error.allowed) from error
    return tuple(sorted(found, key=lambda entry: entry[0]))


def load_script(path: Path) -> tuple[tuple[float, Order], ...]:
    """The orders of a file, see :func:`read_script`.

    Raises:
        ConfigError: it cannot be read, or a line of it is wrong.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError("script", str(path), f"a text file that can be read ({error})") from error
    return read_script(text.splitlines(), path.name)
