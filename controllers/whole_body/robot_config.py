"""Settings from a robot's description: its tables below ``[tuning]`` in the place of defaults."""

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any, ClassVar, Protocol, TypeVar

from controllers.whole_body.config import (
    BalanceTuning,
    ContactTuning,
    ControllerConfig,
    FilterTuning,
    TaskTuning,
)
from robots.description import RobotDescription
from robots.errors import ConfigError, DescriptionError
from safety.barriers.rows import FAMILIES
from safety.filters.adaptation import AdaptationTuning
from safety.filters.conditions import FamilyParameters
from safety.filters.filter_kind import FilterKind
from safety.filters.registry import filter_kind
from wbc.dynwbc import DynWbcWeights


class DataclassInstance(Protocol):
    """What :func:`dataclasses.fields` takes: an instance of any dataclass."""

    __dataclass_fields__: ClassVar[dict[str, dataclasses.Field[Any]]]


T = TypeVar("T", bound=DataclassInstance)

TABLES = (
    "tasks",
    "safety",
    "cbf",
    "filters",
    "adaptation",
    "contact",
    "balance",
    "dynwbc",
    "controller",
    "hand_tracking",
    "walking",
    "taichi",
    "lateral_steps",
)
"""Tables below ``[tuning]`` that some part of the project reads."""


def controller_config(robot: RobotDescription, **changes: Any) -> ControllerConfig:
    """The configuration of a robot: defaults, then the tables ``[tuning.*]`` of its description, then ``changes``.

    Args:
        robot: the description; its tables ``tasks``, ``safety``, ``adaptation``, ``contact``, ``dynwbc`` hold fields of
            the classes above, ``controller`` those of :class:`ControllerConfig` itself; ``cbf`` those of the families
            in ``safety`` that are others with the filter ``cbf``, which has no epsilon: its alpha is all that it has
            against a disturbance; ``filters`` a table for each filter that brings parameters of its own, by its name,
            with their values or a table of them for each family.
        changes: fields of :class:`ControllerConfig` that override.

    Raises:
        DescriptionError: the description's tuning names an unknown table or field.
        ConfigError: a value is not allowed.
    """
    if unknown := sorted(set(robot.tuning) - set(TABLES)):
        raise DescriptionError(robot.file, "tuning", unknown, "among " + ", ".join(TABLES))
    parts: dict[str, Any] = {
        "tasks": from_table(TaskTuning, robot, "tasks"),
        "safety": from_table(FilterTuning, robot, "safety"),
        "adaptation": from_table(AdaptationTuning, robot, "adaptation"),
        "contact": from_table(ContactTuning, robot, "contact"),
        "balance": from_table(BalanceTuning, robot, "balance"),
        "dynwbc": from_table(DynWbcWeights, robot, "dynwbc"),
    }
    base = from_table(ControllerConfig, robot, "controller", tuple(parts))
    alone = _with_families(robot, "cbf", parts["safety"])
    name = changes.get("filter", base.filter)
    if name == "cbf":
        parts["safety"] = alone
    parts["safety"] = dataclasses.replace(parts["safety"], own=_own_parameters(robot, filter_kind(name)))
    if name != "issf":
        # what the description says of epsilon is of no other filter
        parts["adaptive"] = False
    return dataclasses.replace(base, **(parts | changes))


def from_table(kind: type[T], robot: RobotDescription, table: str, elsewhere: tuple[str, ...] = ()) -> T:
    """The settings class ``kind`` filled from one table below ``[tuning]``; defaults for what it does not give.

    Args:
        kind: a dataclass all of whose fields have defaults.
        robot: the description.
        table: name of the table; it may be absent.
        elsewhere: fields that have tables of their own.

    Raises:
        DescriptionError: the table has an unknown field.
        ConfigError: a value is not allowed.
    """
    values: dict[str, Any] = dict(robot.tuning.get(table, {}))
    defaults = {f.name: f.default for f in dataclasses.fields(kind) if f.name not in elsewhere}
    _require_known(robot, table, values, defaults)
    for name, default in defaults.items():
        if name in values and isinstance(default, FamilyParameters):
            values[name] = _family_from(robot, f"{table}.{name}", default, values[name])
    return kind(**values)


def _with_families(robot: RobotDescription, table: str, safety: FilterTuning) -> FilterTuning:
    """The filter's settings with the families' parameters of another table in the place of their own."""
    values = robot.tuning.get(table, {})
    _require_known(robot, table, values, FAMILIES)
    changed: dict[str, Any] = {
        f: _family_from(robot, f"{table}.{f}", getattr(safety, f), given) for f, given in values.items()
    }
    return dataclasses.replace(safety, **changed)


def _own_parameters(robot: RobotDescription, kind: FilterKind) -> Any:
    """Parameters that a filter brings along, as the description has them; ``None`` where it has none."""
    values, table = robot.tuning.get("filters", {}).get(kind.name), f"filters.{kind.name}"
    if values is None or kind.parameters is None:
        return None
    fields = [f.name for f in dataclasses.fields(kind.parameters)]
    if isinstance(values, Mapping) and set(values) <= set(FAMILIES):
        for family, part in values.items():
            _require_known(robot, f"{table}.{family}", part, fields)
        return {family: dataclasses.replace(kind.parameters, **part) for family, part in values.items()}
    _require_known(robot, table, values, fields)
    return dataclasses.replace(kind.parameters, **values)


def _family_from(robot: RobotDescription, table: str, default: FamilyParameters, values: Any) -> FamilyParameters:
    """Parameters of a family from their table; ``default`` for what it does not give."""
    _require_known(robot, table, values, [f.name for f in dataclasses.fields(FamilyParameters)])
    try:
        return dataclasses.replace(default, **values)
    except ConfigError as error:
        raise ConfigError(f"{robot.file}: tuning.{table}.{error.name}", error.value, error.allowed) from error


def _require_known(robot: RobotDescription, table: str, values: object, known: Iterable[str]) -> None:
    if not isinstance(values, Mapping):
        raise DescriptionError(robot.file, f"tuning.{table}", values, "a table")
    if unknown := sorted(set(values) - set(known)):
        raise DescriptionError(robot.file, f"tuning.{table}", unknown, "among " + ", ".join(known))
