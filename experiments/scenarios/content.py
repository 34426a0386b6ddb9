"""Frozen dataclasses to JSON and back, and the key of what they hold; nothing heavy is imported here."""

import dataclasses
import hashlib
import json
import math
import types
import typing
from collections.abc import Callable, Hashable, Mapping
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar

from robots.errors import ConfigError

T = TypeVar("T")

KIND = "kind"
"""Entry of a table that tells which of several dataclasses it holds; the class has it as a class variable."""


class Content:
    """A frozen dataclass whose fields can be written as JSON and read back.

    Fields may be numbers, strings, paths, dataclasses, and tuples, dicts or unions of those. Dataclasses of one union
    are told apart by their class variable ``kind``.
    """

    __dataclass_fields__: ClassVar[dict[str, dataclasses.Field[Any]]]

    def to_json(self) -> dict[str, Any]:
        """The fields in JSON's own types; paths are absolute, so that another working directory finds them."""
        table: dict[str, Any] = to_plain(self)
        return table

    @classmethod
    def from_json(cls, table: Any) -> Self:
        """What :meth:`to_json` gave, back; what it does not give keeps its default.

        Raises:
            ConfigError: a field is unknown, or not of its type; names it and what is allowed.
        """
        return from_plain(cls, table, cls.__name__)

    def files(self) -> list[Path]:
        """Files that fields name: what they hold decides the run too."""
        return sorted(set(_paths(self)))

    def key(self) -> str:
        """Sixteen hexadecimal digits that stand for the content: equal for equal content, whatever the session.

        Of files that fields name the content counts, not the place.

        Raises:
            ConfigError: such a file cannot be read.
        """
        # read back once: 1 and 1.0 are the same setting
        table = from_plain(type(self), to_plain(self), type(self).__name__).to_json()
        text = json.dumps(table, sort_keys=True, separators=(",", ":"), allow_nan=False)
        for path in self.files():
            text = text.replace(json.dumps(str(path.resolve())), json.dumps(file_digest(path)))
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def file_digest(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal digits.

    Raises:
        ConfigError: it cannot be read.
    """
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise ConfigError("file", str(path), f"readable ({error.strerror})") from error


def _paths(value: Any) -> list[Path]:
    if isinstance(value, Path):
        return [value]
    if dataclasses.is_dataclass(value):
        return [p for f in dataclasses.fields(value) for p in _paths(getattr(value, f.name))]
    if isinstance(value, Mapping):
        return [p for item in value.values() for p in _paths(item)]
    return [p for item in value for p in _paths(item)] if isinstance(value, list | tuple) else []


def to_plain(value: Any) -> Any:
    """The value in JSON's own types; a dataclass that has one tells its ``kind``."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        kind = _kind_of(type(value))
        return ({} if kind is None else {KIND: kind}) | {
            f.name: to_plain(getattr(value, f.name)) for f in dataclasses.fields(value)
        }
    if isinstance(value, Mapping):
        return {str(key): to_plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        raise ConfigError("number", value, "finite: JSON has no other")
    return str(value.resolve()) if isinstance(value, Path) else value


def from_plain(kind: type[T], table: Any, name: str) -> T:
    """A dataclass from the table that JSON made of it; what the table does not give keeps its default.

    Args:
        kind: the dataclass.
        table: its fields by name.
        name: what it is, for messages.

    Raises:
        ConfigError: a field is unknown, missing, or not of its type; names it and what is allowed.
    """
    if not isinstance(table, Mapping):
        raise ConfigError(name, table, "a table")
    fields = dataclasses.fields(kind)  # type: ignore[arg-type]
    hints, known = _hints(typing.cast(Hashable, kind)), [f.name for f in fields if f.init]
    given = {key: value for key, value in table.items() if not (key == KIND and value == _kind_of(kind))}
    if unknown := sorted(set(given) - set(known)):
        raise ConfigError(f"{name}.{unknown[0]}", given[unknown[0]], "absent; known are " + ", ".join(known))
    if missing := [f.name for f in fields if f.name not in given and _is_required(f)]:
        raise ConfigError(f"{name}.{missing[0]}", None, "given")
    return kind(**{key: _value(hints[key], value, f"{name}.{key}") for key, value in given.items()})


@cache
def _hints(kind: Hashable) -> dict[str, Any]:
    return typing.get_type_hints(kind)


def _is_required(field: dataclasses.Field[Any]) -> bool:
    return field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING


def _kind_of(kind: type) -> str | None:
    """What tables of this class say under ``kind``; ``None`` for a class that is told by its place."""
    own = dataclasses.is_dataclass(kind) and KIND not in {f.name for f in dataclasses.fields(kind)}
    return getattr(kind, KIND, None) if own else None


def _value(hint: Any, value: Any, name: str) -> Any:
    """The value as the type ``hint`` has it."""
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin is typing.Annotated:
        return _value(inner[0], value, name)
    if origin in READERS:
        return READERS[origin](inner, value, name)
    return (
        from_plain(typing.cast(type, hint), value, name)
        if dataclasses.is_dataclass(hint)
        else _scalar(hint, value, name)
    )


def _literal(allowed: tuple[Any, ...], value: Any, name: str) -> Any:
    if value not in allowed:
        raise ConfigError(name, value, "one of " + ", ".join(map(str, allowed)))
    return value


def _mapping(kinds: tuple[Any, ...], value: Any, name: str) -> dict[Any, Any]:
    if not isinstance(value, Mapping):
        raise ConfigError(name, value, "a table")
    return {_value(kinds[0], k, name): _value(kinds[1], v, f"{name}.{k}") for k, v in value.items()}


def _member_of(kinds: tuple[Any, ...], value: Any, name: str) -> Any:
    """The value as the first of several types that takes it."""
    if value is None and type(None) in kinds:
        return None
    tags = {tag: kind for kind in kinds if isinstance(kind, type) and (tag := _kind_of(kind))}
    if tags and isinstance(value, Mapping):
        if value.get(KIND) not in tags:
            raise ConfigError(f"{name}.{KIND}", value.get(KIND), "one of " + ", ".join(tags))
        return from_plain(tags[value[KIND]], value, name)
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


READERS: dict[Any, Callable[[tuple[Any, ...], Any, str], Any]] = {
    typing.Union: _member_of,
    types.UnionType: _member_of,
    typing.Literal: _literal,
    tuple: _tuple,
    dict: _mapping,
    Mapping: _mapping,
}
"""By the origin of a type with parameters: reads a value of it."""
