"""The values that a parameter takes in a sweep: a list, a range, or in a random sample an interval."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from experiments.studies.parameters import Parameter
from robots.errors import ConfigError

LARGEST = 10_000
"""Most values of one parameter."""

SYNTAX = "a,b,c; low:high:n, low:high:n:log; or low:high, low:high:log with --sample"
"""How values are written; lists are apart by ``;`` where one value has several entries."""


@dataclass(frozen=True, slots=True)
class Choices:
    """Single values.

    Attributes:
        values: each once, in the order given.
    """

    values: tuple[Any, ...]

    def draw(self, rng: np.random.Generator) -> Any:
        """One of them, all equally likely."""
        return self.values[int(rng.integers(len(self.values)))]


@dataclass(frozen=True, slots=True)
class Interval:
    """All numbers between two.

    Attributes:
        low: the least.
        high: the largest.
        log: whether their logarithm is spread evenly, and not they.
        whole: whether they are whole numbers.
    """

    low: float
    high: float
    log: bool
    whole: bool

    def draw(self, rng: np.random.Generator) -> int | float:
        """A number in it, drawn evenly."""
        u = float(rng.uniform())
        if self.whole and not self.log:
            return int(self.low) + int(u * (self.high - self.low + 1))
        value = self.low * (self.high / self.low) ** u if self.log else self.low + u * (self.high - self.low)
        return round(value) if self.whole else value


Values = Choices | Interval


def parse_values(parameter: Parameter, text: str, sampled: bool = False) -> Values:
    """The values that a text stands for: see ``SYNTAX``.

    Args:
        parameter: of the scenario.
        text: from the command line.
        sampled: whether values are drawn, so that an interval may stand for them.

    Raises:
        ConfigError: one is not of the parameter's type, or the text is none of ``SYNTAX``.
    """
    if ":" in text and parameter.number is not None:
        return _range(parameter, text, sampled)
    parts = [part.strip() for part in text.split(";" if parameter.is_list else ",")]
    return Choices(_distinct([parameter.value(part) for part in parts]))


def _range(parameter: Parameter, text: str, sampled: bool) -> Values:
    parts = text.split(":")
    log = parts[-1] == "log"
    numbers = parts[:-1] if log else parts
    if len(numbers) not in ((2, 3) if sampled else (3,)):
        raise ConfigError(parameter.option, text, SYNTAX)
    low, high = (_number(parameter, part) for part in numbers[:2])
    if not low < high or (log and low <= 0):
        raise ConfigError(parameter.option, text, "from low to high" + (", both above 0" if log else ""))
    if len(numbers) == 2:
        return Interval(low, high, log, parameter.number is int)
    return Choices(_spread(parameter, text, low, high, _count(parameter, numbers[2], text), log))


def _number(parameter: Parameter, text: str) -> float:
    value = parameter.value(text)
    if not isinstance(value, int | float) or not math.isfinite(value):
        raise ConfigError(parameter.option, text, "a finite number")
    return value


def _count(parameter: Parameter, part: str, text: str) -> int:
    if not part.isdecimal() or not 2 <= int(part) <= LARGEST:
        raise ConfigError(parameter.option, text, f"low:high:n with n from 2 to {LARGEST}")
    return int(part)


def _spread(parameter: Parameter, text: str, low: float, high: float, n: int, log: bool) -> tuple[Any, ...]:
    # twelve digits: what a person would have written, 0.3 and not 0.30000000000000004
    points = [float(f"{x:.12g}") for x in (np.geomspace if log else np.linspace)(low, high, n)]
    if parameter.number is not int:
        return _distinct(points)
    if any(x != round(x) for x in points):
        raise ConfigError(parameter.option, text, "a range whose values are whole numbers")
    return _distinct([round(x) for x in points])


def _distinct(values: Sequence[Any]) -> tuple[Any, ...]:
    # by what they look like: tables do not hash, and True is no 1 here
    return tuple({repr(value): value for value in values}.values())
