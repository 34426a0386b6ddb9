"""Tasks of several priority levels in one block of rows, evaluated together."""

from collections.abc import Sequence

import numpy as np

from robots.errors import ConfigError, TargetNotSetError
from robots.kinematics import Kinematics
from robots.messages import Array, Indices
from wbc.task_kernels import evaluate_frames
from wbc.tasks import FrameTask, Task

Level = tuple[Array, Array]
"""Jacobian (m, nv) and commanded velocity (m,) of one priority level."""


class TaskBlock:
    """Rows of all tasks, level after level, in arrays that are made once.

    Tasks about frames keep their references and gains here, and one compiled pass evaluates them all; others are asked
    by :meth:`wbc.tasks.Task.evaluate`.

    Attributes:
        jacobian: shape (m, nv), overwritten by each evaluation, like ``command``.
        command: shape (m,).
        levels: the rows of each level, as views.
        sizes: shape (l,) how many rows each has.
    """

    def __init__(self, nv: int, levels: Sequence[Sequence[Task]]) -> None:
        """Lay out the rows of the tasks of each level; ``nv``: size of the velocity.

        Raises:
            ConfigError: a task stands in more than one place, of this block or another one.
        """
        tasks = [task for level in levels for task in level]
        if len({id(task) for task in tasks}) < len(tasks):
            names = [type(task).__name__ for task in tasks]
            raise ConfigError("tasks", names, "each in one place of one level")
        self.sizes = np.array([sum(task.rows for task in level) for level in levels], dtype=np.int64)
        total = int(self.sizes.sum())
        self.jacobian, self.command = np.zeros((total, nv)), np.zeros(total)
        ends = np.cumsum(self.sizes)
        self.levels: list[Level] = [
            (self.jacobian[end - size : end], self.command[end - size : end])
            for end, size in zip(ends, self.sizes, strict=True)
        ]
        self._starts = np.cumsum([0] + [task.rows for task in tasks])[:-1]
        self._tasks = tasks
        # those not yet known to have a target
        self._unset: tuple[Task, ...] = tuple(tasks)
        self._others = [
            (self.jacobian[start : start + task.rows], self.command[start : start + task.rows], task)
            for start, task in zip(self._starts, tasks, strict=True)
            if not isinstance(task, FrameTask)
        ]
        self._frames = [task for task in tasks if isinstance(task, FrameTask)]
        self._references, self._bias = np.zeros((len(self._frames), 24)), np.zeros((len(self._frames), 6))
        self._corrections = np.zeros((len(self._frames), 3))
        self._gains = np.zeros((len(self._frames), 6))
        for i, frame in enumerate(self._frames):
            frame.move_into(self._references[i], self._gains[i])
        self._compensated = [(i, frame) for i, frame in enumerate(self._frames) if frame.compensate_bias]
        self._table: Indices = np.zeros((0, 4), dtype=np.int64)

    def evaluate(self, kin: Kinematics) -> list[Level]:
        """The levels at the current kinematics; views that the next call overwrites.

        Raises:
            TargetNotSetError: the target of a task was never set.
        """
        if self._unset:
            self._require_targets()
        if len(self._table) < len(self._frames):
            self._table = self._make_table(kin)
        for i, frame in self._compensated:
            self._bias[i] = frame.bias_acceleration(kin)
        evaluate_frames(
            self._table,
            self._gains,
            self._references,
            self._bias,
            kin.frame_transforms,
            kin.world_jacobian,
            kin.support,
            self._corrections,
            self.jacobian,
            self.command,
        )
        for jacobian, command, task in self._others:
            jacobian[:], command[:] = task.evaluate(kin)
        return self.levels

    def _require_targets(self) -> None:
        self._unset = tuple(task for task in self._unset if not task.is_set)
        if self._unset:
            raise TargetNotSetError(self._unset[0].name)

    def _make_table(self, kin: Kinematics) -> Indices:
        placed = [(s, t) for s, t in zip(self._starts, self._tasks, strict=True) if isinstance(t, FrameTask)]
        return np.array([(s, t.frame_id, kin.frame_joint(t.frame_id), t.kind) for s, t in placed], dtype=np.int64)

    def reset(self) -> None:
        """Forget the last evaluation: the next corrections start from zero where their change is bounded."""
        self._corrections[:] = 0.0
