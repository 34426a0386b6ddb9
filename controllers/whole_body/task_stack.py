"""Tasks with a priority, a role and a name, in one solver."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from itertools import groupby

import numpy as np

from robots.checks import require_finite, require_one_of, require_positive
from robots.errors import ConfigError, UnknownNameError
from robots.messages import Array, Indices
from wbc.kinwbc import KinWbc
from wbc.tasks import Task

ROLES = ("feet", "balance", "hands", "other")
"""What a task is for: the safety filter has a weight for each of the first three, by which it leaves them alone."""


class Priority(IntEnum):
    """Priorities of the tasks that every robot has; lower numbers first, with room between them."""

    FEET = 10
    COM = 20
    BASE = 30
    TORSO = 40
    HANDS = 50
    POSTURE = 60


@dataclass(frozen=True, slots=True)
class PlacedTask:
    """A task and its place.

    Attributes:
        task: found by its name.
        role: one of ``ROLES``.
        priority: lower numbers first; tasks of the same number share a level.
        damped_below: below which singular values of its level are damped, above 0 [as its rows]; the largest one of a
            level counts.

    Raises:
        ConfigError: a value is not allowed.
    """

    task: Task
    role: str
    priority: float
    damped_below: float = 0.1

    def __post_init__(self) -> None:
        if not isinstance(self.task, Task):
            raise ConfigError("placed task", self.task, "a Task")
        require_one_of(f"role of task {self.task.name}", self.role, ROLES)
        require_finite(f"priority of task {self.task.name}", self.priority)
        require_positive(f"damped_below of task {self.task.name}", self.damped_below)


class TaskStack:
    """Tasks in their levels, given back by name, and their rows by role.

    Args:
        nv: size of the velocity.
        placed: tasks in any order, each name once.
        sigma_min: cut-off of singular values, where they are cut.
        damped: whether small singular values are damped, see :mod:`wbc.damped_priorities`, or cut.

    Raises:
        ConfigError: two tasks have the same name, or a task stands in more than one place.
    """

    def __init__(self, nv: int, placed: Sequence[PlacedTask], sigma_min: float, damped: bool) -> None:
        names = [p.task.name for p in placed]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ConfigError("names of tasks", twice, "given to one task each")
        self._tasks = {p.task.name: p.task for p in placed}
        ordered = sorted(placed, key=lambda p: p.priority)
        self._levels = [[p.task for p in level] for _, level in groupby(ordered, key=lambda p: p.priority)]
        self._damped_below = {p.task.name: p.damped_below for p in placed}
        self._kinwbc = KinWbc(nv, self._levels, sigma_min, self._thresholds() if damped else None)
        starts = np.cumsum([0, *(p.task.rows for p in ordered)])
        place = {p.task.name: np.arange(a, a + p.task.rows) for p, a in zip(ordered, starts[:-1], strict=True)}
        self._rows = {role: _selection([place[p.task.name] for p in placed if p.role == role]) for role in ROLES}

    def __getitem__(self, name: str) -> Task:
        """The task of a name.

        Raises:
            UnknownNameError: there is none.
        """
        if name not in self._tasks:
            raise UnknownNameError("task", name, list(self._tasks))
        return self._tasks[name]

    def __contains__(self, name: object) -> bool:
        """Whether there is a task of this name."""
        return name in self._tasks

    @property
    def names(self) -> tuple[str, ...]:
        """Of all tasks."""
        return tuple(self._tasks)

    @property
    def kinwbc(self) -> KinWbc:
        """The solver, with the tasks in their levels."""
        return self._kinwbc

    def rows(self, role: str) -> Array | None:
        """Jacobians (k, nv) of a role's tasks, as evaluated last, in the order they were given; ``None`` for none.

        A view where they stand one below the other.
        """
        selection = self._rows[role]
        return None if selection is None else self._kinwbc.jacobian[selection]

    def is_contiguous(self, role: str) -> bool:
        """Whether :meth:`rows` gives the same view every time."""
        return not isinstance(self._rows[role], np.ndarray)

    def set_singular(self, sigma_min: float, damped: bool, damped_below: Mapping[str, float]) -> None:
        """Treat small singular values in another way.

        Args:
            sigma_min: cut-off, where they are cut.
            damped: whether they are damped.
            damped_below: other thresholds, by name of the task.

        Raises:
            ConfigError: a number is not above 0.
        """
        self._damped_below |= damped_below
        self._kinwbc.set_thresholds(sigma_min, self._thresholds() if damped else None)

    def _thresholds(self) -> list[float]:
        return [max(self._damped_below[task.name] for task in level) for level in self._levels]


def _selection(places: Sequence[Indices]) -> slice | Indices | None:
    """Rows at these places: a slice where they follow each other, so that reading them copies nothing."""
    if not places:
        return None
    rows = np.concatenate(places)
    if (np.diff(rows) == 1).all():
        return slice(int(rows[0]), int(rows[-1]) + 1)
    return rows
