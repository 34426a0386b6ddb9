"""Parameters that a filter registered from outside brings along: a frozen dataclass of numbers, one for each family."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from robots.checks import require_finite
from robots.errors import ConfigError
from robots.messages import Array, Indices
from safety.barriers.rows import FAMILIES


def check_default(defaults: Any) -> None:
    """Check the parameters that a filter has where none are given.

    Raises:
        ConfigError: they are no instance of a frozen dataclass, or a field is no finite number.
    """
    if isinstance(defaults, type) or not dataclasses.is_dataclass(defaults):
        raise ConfigError("own parameters of a filter", defaults, "an instance of a frozen dataclass of numbers")
    if not vars(type(defaults))["__dataclass_params__"].frozen:
        raise ConfigError(
            "own parameters of a filter", type(defaults).__name__, "a frozen dataclass: they are read once"
        )
    for field in dataclasses.fields(defaults):
        require_finite(f"{type(defaults).__name__}.{field.name}", getattr(defaults, field.name))


def check_given(given: Any) -> None:
    """Check parameters of a filter that is not known yet.

    Raises:
        ConfigError: they are neither one instance of a frozen dataclass of numbers nor instances by family.
    """
    if given is None:
        return
    if isinstance(given, Mapping):
        require_families(given)
    for part in given.values() if isinstance(given, Mapping) else (given,):
        check_default(part)


def require_families(parts: Mapping[str, Any]) -> None:
    """Raise :class:`ConfigError` unless all keys are names of families."""
    if unknown := sorted(set(parts) - set(FAMILIES)):
        raise ConfigError("own parameters", unknown, "by family, among " + ", ".join(FAMILIES))


def by_family(defaults: Any, given: Any) -> dict[str, Any]:
    """The parameters of each family.

    Args:
        defaults: the filter's; ``None``: it has none of its own.
        given: one instance for all families, or instances by family; ``None``: the defaults.

    Raises:
        ConfigError: given are others than the filter's, or those of no known family.
    """
    if given is None:
        return {} if defaults is None else dict.fromkeys(FAMILIES, defaults)
    if defaults is None:
        raise ConfigError("own parameters", given, "left out: this filter has none")
    parts = dict(given) if isinstance(given, Mapping) else dict.fromkeys(FAMILIES, given)
    require_families(parts)
    for family, part in parts.items():
        if type(part) is not type(defaults):
            raise ConfigError(f"own parameters of {family}", part, f"a {type(defaults).__name__}")
        check_default(part)
    return dict.fromkeys(FAMILIES, defaults) | parts


def of_rows(defaults: Any, given: Any, family: Indices) -> Mapping[str, Array]:
    """Each parameter row by row, shape (n,), by its name; arguments as of :func:`by_family`."""
    parts = by_family(defaults, given)
    if not parts:
        return {}
    names = [field.name for field in dataclasses.fields(defaults)]
    return {n: np.array([getattr(parts[f], n) for f in FAMILIES], dtype=float)[family] for n in names}
