"""Parameters of the safety filter in a file of their own: what ``safewbc tune`` writes and every run accepts."""

import dataclasses
import math
import os
import tempfile
import tomllib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from controllers.whole_body.config import FilterTuning
from robots.errors import ConfigError
from safety.barriers.rows import FAMILIES
from safety.filters.conditions import FamilyParameters

PARAMETERS = tuple(f.name for f in dataclasses.fields(FamilyParameters))
"""What may stand in the table of a family."""

TABLES = ("tuned", "safety")
"""Tables of a file."""


@dataclass(frozen=True, slots=True)
class Tuning:
    """Parameters of constraint families, and how they were found.

    Attributes:
        families: parameters by name, by family of ``FAMILIES``; what is absent stays as it is.
        tuned: how they were found, in TOML's own types: ``robot`` among them, where they are for one robot only.

    Raises:
        ConfigError: a family or a parameter is not known, or a value is not allowed.
    """

    families: Mapping[str, Mapping[str, float]]
    tuned: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if unknown := sorted(set(self.families) - set(FAMILIES)):
            raise ConfigError("safety", unknown, "among " + ", ".join(FAMILIES))
        for family, values in self.families.items():
            _check_family(family, values)

    def applied(self, safety: FilterTuning) -> FilterTuning:
        """Settings of the filter with these parameters in the place of their own."""
        changed = {f: dataclasses.replace(getattr(safety, f), **v) for f, v in self.families.items()}
        return dataclasses.replace(safety, **changed)


def _check_family(family: str, values: object) -> None:
    name = f"safety.{family}"
    if not isinstance(values, Mapping):
        raise ConfigError(name, values, "a table")
    if unknown := sorted(set(values) - set(PARAMETERS)):
        raise ConfigError(name, unknown, "among " + ", ".join(PARAMETERS))
    for key, value in values.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ConfigError(f"{name}.{key}", value, "a number")
    try:
        FamilyParameters(**values)
    except ConfigError as error:
        raise ConfigError(f"{name}.{error.name}", error.value, error.allowed) from error


def read_tuning(path: Path, robot: str) -> Tuning:
    """The parameters in a file.

    Args:
        path: of the file.
        robot: name of the robot that they are meant for.

    Raises:
        ConfigError: the file cannot be read, is no TOML, was made for another robot, names something unknown, or a
            value is not allowed.
    """
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError("tuning", str(path), f"a file that can be read ({error.strerror})") from error
    except ValueError as error:
        raise ConfigError("tuning", str(path), f"a TOML file with tables [safety.<family>] ({error})") from error
    if unknown := sorted(set(tables) - set(TABLES)):
        raise ConfigError(f"{path}: tables", unknown, "among " + ", ".join(TABLES))
    for table in TABLES:
        if not isinstance(tables.get(table, {}), dict):
            raise ConfigError(f"{path}: {table}", tables[table], "a table")
    tuned = tables.get("tuned", {})
    if tuned.get("robot", robot) != robot:
        raise ConfigError(f"{path}: tuned.robot", tuned["robot"], f"{robot!r}, the robot that runs")
    try:
        return Tuning(tables.get("safety", {}), tuned)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error.name}", error.value, error.allowed) from error


def write_tuning(path: Path, tuning: Tuning) -> None:
    """Write a file that :func:`read_tuning` reads, whole or not at all.

    Raises:
        ConfigError: it cannot be written, or what was written is not what is read again; ``tuned`` holds something else
            than numbers, strings and lists of them. The file that was there is left.
    """
    lines = ["# alpha [1/s] and epsilon of the safety filter's constraint families, as `safewbc tune` found them", ""]
    lines += ["[tuned]", *(f"{key} = {_literal(key, value)}" for key, value in tuning.tuned.items())]
    for family, values in tuning.families.items():
        lines += ["", f"[safety.{family}]", *(f"{key} = {_literal(key, value)}" for key, value in values.items())]
    try:
        _replace(path, "\n".join(lines) + "\n", tuning)
    except (OSError, ValueError) as error:
        raise ConfigError("tuning file", str(path), f"a file that can be written ({error})") from error


def _replace(path: Path, text: str, tuning: Tuning) -> None:
    """Write beside the file, read it again, then take its place: a reader sees the old text or the new one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        written = tomllib.loads(Path(name).read_text(encoding="utf-8"))
        if (written["tuned"], written.get("safety", {})) != (_plain(tuning.tuned), _plain(tuning.families)):
            raise ValueError("its text means something else")
        # a temporary file is its owner's alone
        Path(name).chmod(0o644)
        Path(name).replace(path)
    except BaseException:
        with suppress(OSError):
            Path(name).unlink()
        raise


def _plain(value: Any) -> Any:
    """A value as TOML gives it back."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value


def _literal(key: str, value: Any) -> str:
    """A value in TOML."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(int(value))
    if isinstance(value, float) and math.isfinite(value):
        # numpy's own would write its type as well
        return repr(float(value))
    if isinstance(value, str):
        return '"' + "".join(_escaped(c) for c in value) + '"'
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_literal(key, item) for item in value) + "]"
    raise ConfigError(f"tuned.{key}", value, "a finite number, a string or a list of these")


def _escaped(character: str) -> str:
    """A character within a basic string of TOML, which holds no quotes, backslashes and control characters."""
    if character in '"\\' or character < " " or character == "\x7f":
        return f"\\u{ord(character):04X}"
    return character
