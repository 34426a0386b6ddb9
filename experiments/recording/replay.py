"""A saved run made again from its configuration, and compared with what was saved."""

import dataclasses
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from controllers.whole_body.robot_config import DataclassInstance
from experiments.cli.console import make_console, progress, run_one
from experiments.metrics.balance import versions
from experiments.recording.recording import RunResult, load_result, plain
from experiments.running.warmup import warm_up
from experiments.scenarios.options import ReplayOptions, RunOptions
from experiments.scenarios.registry import experiment_called
from robots.errors import ConfigError

T = TypeVar("T", bound=DataclassInstance)

TIMES = ("tick_ms", "stages")
"""Recorded arrays that hold how long computing took: the only ones that may differ."""


def replay(options: ReplayOptions) -> int:
    """Run a saved run again and print what differs; 0 where nothing does, else 1.

    Raises:
        SafeWbcError: the folder holds no run of this project, or one of its options is not allowed here.
    """
    console = make_console()
    saved = load_result(options.folder)
    settings = saved_options(saved)
    experiment = experiment_called(saved.config["experiment"])
    robot = experiment.check(settings)
    warm_up(console, robot)
    with progress(console, [f"{experiment.name}, {robot.title}"], settings.duration) as advance:
        again = run_one(settings, advance[0])
    differences = array_differences(saved.series, again.series)
    if not differences:
        console.print(f"identical: {len(set(saved.series) - set(TIMES))} arrays, bit by bit")
        return 0
    for line in [*differences, *_reasons(saved, again)]:
        console.print(line)
    console.print(f"not identical: {len(differences)} of {len(set(saved.series) | set(again.series))} arrays differ")
    return 1


def saved_options(result: RunResult) -> RunOptions:
    """The options with which a run was made.

    Raises:
        SafeWbcError: there are none in its configuration, or they are not those of a known experiment.
    """
    for name in ("experiment", "options"):
        if name not in result.config:
            raise ConfigError("config.json", sorted(result.config), f"of a run of safewbc run, with the entry {name!r}")
    kind = experiment_called(result.config["experiment"]).options
    return from_plain(kind, result.config["options"], "options")


def from_plain(kind: type[T], table: Any, name: str) -> T:
    """A dataclass from the table that JSON made of it; what the table does not give keeps its default.

    Fields may be numbers, strings, paths, dataclasses, and tuples, dicts or unions with ``None`` of those.

    Args:
        kind: the dataclass.
        table: its fields by name.
        name: what it is, for messages.

    Raises:
        ConfigError: a field is unknown, or not of its type; names it and what is allowed.
    """
    if not isinstance(table, Mapping):
        raise ConfigError(name, table, "a table")
    hints = typing.get_type_hints(kind)
    known = [f.name for f in dataclasses.fields(kind)]
    if unknown := sorted(set(table) - set(known)):
        raise ConfigError(f"{name}.{unknown[0]}", table[unknown[0]], "absent; known are " + ", ".join(known))
    return kind(**{key: _value(hints[key], value, f"{name}.{key}") for key, value in table.items()})


def _value(hint: Any, value: Any, name: str) -> Any:
    """The value as the type ``hint`` has it."""
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        return _member_of(inner, value, name)
    if origin is typing.Literal:
        if value not in inner:
            raise ConfigError(name, value, "one of " + ", ".join(map(str, inner)))
        return value
    if origin is tuple:
        return _tuple(inner, value, name)
    if origin is dict:
        if not isinstance(value, Mapping):
            raise ConfigError(name, value, "a table")
        return {_value(inner[0], k, name): _value(inner[1], v, f"{name}.{k}") for k, v in value.items()}
    if dataclasses.is_dataclass(hint):
        return from_plain(typing.cast(type, hint), value, name)
    return _scalar(hint, value, name)


def _member_of(kinds: tuple[Any, ...], value: Any, name: str) -> Any:
    """The value as the first of several types that takes it."""
    if value is None and type(None) in kinds:
        return None
    refusals = []
    for kind in kinds:
        if kind is not type(None):
            try:
                return _value(kind, value, name)
            except ConfigError as error:
                refusals.append(error.allowed)
    raise ConfigError(name, value, " or ".join(refusals))


def _tuple(kinds: tuple[Any, ...], value: Any, name: str) -> tuple[Any, ...]:
    if not isinstance(value, list | tuple):
        raise ConfigError(name, value, "a list")
    if len(kinds) == 2 and kinds[1] is Ellipsis:
        kinds = (kinds[0],) * len(value)
    if len(kinds) != len(value):
        raise ConfigError(name, value, f"a list of {len(kinds)}")
    return tuple(_value(k, v, f"{name}[{i}]") for i, (k, v) in enumerate(zip(kinds, value, strict=True)))


def _scalar(kind: type, value: Any, name: str) -> Any:
    """A number, word or path; a whole number may stand for another."""
    if kind is Path and isinstance(value, str):
        return Path(value)
    if kind is float and isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    # bool is a kind of int in Python, but not here
    if isinstance(value, kind) and (kind is bool or not isinstance(value, bool)):
        return value
    raise ConfigError(name, value, f"of type {getattr(kind, '__name__', kind)}")


def array_differences(saved: Mapping[str, NDArray[Any]], again: Mapping[str, NDArray[Any]]) -> list[str]:
    """A line for every array but ``TIMES`` that is not the same bit by bit, by name."""
    lines = []
    for name in sorted((set(saved) | set(again)) - set(TIMES)):
        if name not in saved or name not in again:
            lines.append(f"{name}: only in the {'saved' if name in saved else 'new'} run")
        elif (line := _difference(saved[name], again[name])) is not None:
            lines.append(f"{name}: {line}")
    return lines


def _difference(a: NDArray[Any], b: NDArray[Any]) -> str | None:
    """How two arrays differ; ``None`` where they do not. NaN of the same bits is the same."""
    if a.shape != b.shape or a.dtype != b.dtype:
        return f"{a.dtype} {a.shape} saved, {b.dtype} {b.shape} now"
    if a.tobytes() == b.tobytes():
        return None
    rows = np.array([x.tobytes() != y.tobytes() for x, y in zip(np.atleast_1d(a), np.atleast_1d(b), strict=True)])
    gap = np.abs(a.astype(float) - b.astype(float))
    largest = f"{np.nanmax(gap):.3g}" if np.isfinite(gap).any() else "not a number"
    return f"first differs in row {int(np.argmax(rows))} of {len(rows)}, at most by {largest}"


def _reasons(saved: RunResult, again: RunResult) -> list[str]:
    """What else is not as it was: settings, and versions of packages."""
    now = plain(versions())
    before = saved.summary.get("versions") or {}
    changes = _changes(_flat(plain(saved.config)), _flat(plain(again.config)))
    changes += _changes(_flat(before), _flat(now))
    return [f"changed since: {line}" for line in changes]


def _changes(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    names = sorted(set(before) | set(now))
    return [f"{n}: {before.get(n)} -> {now.get(n)}" for n in names if before.get(n) != now.get(n)]


def _flat(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    out: dict[str, Any] = {}
    for key, value in table.items():
        out |= _flat(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {prefix + key: value}
    return out
