"""Checks of numbers that come from outside, shared by every configuration class."""

import math

import numpy as np

from robots.errors import ConfigError


def require_finite(name: str, value: float) -> None:
    """Raise :class:`ConfigError` unless ``value`` is a finite number."""
    if not (isinstance(value, int | float) and math.isfinite(value)):
        raise ConfigError(name, value, "a finite number")


def require_positive(name: str, value: float) -> None:
    """Raise :class:`ConfigError` unless ``value`` is finite and above zero."""
    if not (isinstance(value, int | float) and math.isfinite(value) and value > 0):
        raise ConfigError(name, value, "a finite number above 0")


def require_non_negative(name: str, value: float) -> None:
    """Raise :class:`ConfigError` unless ``value`` is finite and not below zero."""
    if not (isinstance(value, int | float) and math.isfinite(value) and value >= 0):
        raise ConfigError(name, value, "a finite number, 0 or above")


def require_between(name: str, value: float, low: float, high: float) -> None:
    """Raise :class:`ConfigError` unless ``low <= value <= high``."""
    if not (isinstance(value, int | float) and math.isfinite(value) and low <= value <= high):
        raise ConfigError(name, value, f"a number from {low:g} to {high:g}")


def require_one_of(name: str, value: str, known: tuple[str, ...]) -> None:
    """Raise :class:`ConfigError` unless ``value`` is one of ``known``."""
    if value not in known:
        raise ConfigError(name, value, "one of " + ", ".join(known))


def all_finite(*arrays: np.ndarray) -> bool:
    """Whether every entry of every array is finite: any NaN or infinity makes the sum one."""
    return all(math.isfinite(float(x.sum())) for x in arrays)
