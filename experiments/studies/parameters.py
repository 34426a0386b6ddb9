"""The parameters of a scenario: its fields, nested ones too, by the names that the command line has for them."""

import dataclasses
import types
import typing
from collections.abc import Hashable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import tyro

from robots.errors import ConfigError

T = TypeVar("T")

FALSE_TRUE = {"false": False, "no": False, "true": True, "yes": True}
"""Words for a switch."""

SEED = "seed"
"""The parameter over which tables give mean and spread."""

NONE = "none"
"""Word for a value that is not given, and for an empty list."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One field of a scenario, or of a group of fields within it.

    Attributes:
        name: unique in the scenario; the option is ``--name`` with dashes.
        path: of the field, from the scenario down.
        kind: its type.
    """

    name: str
    path: tuple[str, ...]
    kind: Any

    @property
    def option(self) -> str:
        """On the command line."""
        return "--" + self.name.replace("_", "-")

    @property
    def is_list(self) -> bool:
        """Whether one value of it holds several entries."""
        return any(typing.get_origin(kind) in (tuple, dict) for kind in members(self.kind))

    @property
    def number(self) -> type | None:
        """``int`` or ``float`` for a number, else ``None``."""
        return next((kind for kind in members(self.kind) if kind in (int, float)), None)

    def value(self, text: str) -> Any:
        """The value that a text stands for.

        Raises:
            ConfigError: it is none of this parameter's type.
        """
        refusals = []
        for kind in members(self.kind):
            try:
                return _read(kind, text)
            except ValueError:
                refusals.append(describe(kind))
        raise ConfigError(self.option, text, " or ".join(refusals))


def members(kind: Any) -> tuple[Any, ...]:
    """The types of a union, or the one type; ``None`` first, since its word could be read as another's."""
    if typing.get_origin(kind) in (typing.Union, types.UnionType):
        return tuple(sorted(typing.get_args(kind), key=lambda k: k is not types.NoneType))
    return (kind,)


def _read(kind: Any, text: str) -> Any:
    """The text as this type; ``ValueError`` where it is none."""
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if kind is types.NoneType:
        return {NONE: None}[text] if text == NONE else _refuse()
    if kind is bool:
        return FALSE_TRUE[text] if text in FALSE_TRUE else _refuse()
    if origin is typing.Literal:
        return next((value for value in inner if str(value) == text), None) or _refuse()
    if origin is tuple:
        return _read_tuple(inner, _entries(text, inner[0]))
    if origin is dict:
        pairs = (entry.partition("=") for entry in _entries(text, str))
        return {_read(inner[0], name): _read(inner[1], value) for name, _, value in pairs}
    return kind(text) if kind in (int, float, str, Path) and text else _refuse()


def _read_tuple(inner: tuple[Any, ...], entries: list[str]) -> tuple[Any, ...]:
    kinds = inner[:1] * len(entries) if inner[1:] == (Ellipsis,) else inner
    if len(kinds) != len(entries):
        raise ValueError
    return tuple(_read(kind, entry) for kind, entry in zip(kinds, entries, strict=True))


def _entries(text: str, kind: Any) -> list[str]:
    """The entries of one value: apart by spaces, numbers by commas too."""
    if text == NONE:
        return []
    return (text.replace(",", " ") if kind in (int, float) else text).split()


def _refuse() -> Any:
    raise ValueError


def describe(kind: Any) -> str:
    """A type in words, as one may type it."""
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin is typing.Literal:
        return "one of " + ", ".join(map(str, inner))
    if origin is tuple:
        count = "some" if inner[1:] == (Ellipsis,) else str(len(inner))
        return f"{count} entries, each {describe(inner[0])}"
    if origin is dict:
        return f"entries name=value, each value {describe(inner[1])}"
    words = {int: "a whole number", float: "a number", str: "a word", Path: "a path", types.NoneType: NONE}
    return "true or false" if kind is bool else words.get(kind, str(kind))


def parameters(scenario: type) -> Mapping[str, Parameter]:
    """The parameters of a class of scenarios by name: numbers, words, and lists of them.

    Fields that the command line does not show are none, nor is where results go.
    """
    return _found(typing.cast(Hashable, scenario))


@cache
def _found(scenario: Any) -> Mapping[str, Parameter]:
    found = {p.name: p for p in _parameters(scenario, (), "")}
    return types.MappingProxyType({name: p for name, p in found.items() if p.path[0] != "output"})


def _parameters(kind: type, path: tuple[str, ...], prefix: str) -> Iterator[Parameter]:
    hints = typing.get_type_hints(kind, include_extras=True)
    for field in dataclasses.fields(kind):
        hint, marks = _without_marks(hints[field.name])
        if tyro.conf.Suppress in marks:
            continue
        if dataclasses.is_dataclass(hint):
            # a group named "" has its options beside those of the scenario
            inner = prefix if any(getattr(m, "name", None) == "" for m in marks) else f"{prefix}{field.name}."
            yield from _parameters(typing.cast(type, hint), (*path, field.name), inner)
        else:
            yield Parameter(prefix + field.name, (*path, field.name), hint)


def _without_marks(hint: Any) -> tuple[Any, tuple[Any, ...]]:
    """A type, and what it is annotated with."""
    if typing.get_origin(hint) is not typing.Annotated:
        return hint, ()
    inner, *marks = typing.get_args(hint)
    return inner, tuple(marks)


def with_values(scenario: T, values: Mapping[str, Any]) -> T:
    """The scenario with these values of its parameters.

    Raises:
        SafeWbcError: the scenario refuses one of them.
    """
    known = parameters(type(scenario))
    for name, value in values.items():
        scenario = _replaced(scenario, known[name].path, value)
    return scenario


def value_of(scenario: object, parameter: Parameter) -> Any:
    """The value of a parameter."""
    for name in parameter.path:
        scenario = getattr(scenario, name)
    return scenario


def _replaced(part: Any, path: tuple[str, ...], value: Any) -> Any:
    name, *rest = path
    return dataclasses.replace(part, **{name: _replaced(getattr(part, name), tuple(rest), value) if rest else value})
