"""Tasks about a frame: its position, its orientation, or both."""

import math
from typing import Any

import numpy as np

from robots.errors import ConfigError, TargetNotSetError
from robots.kinematics import Kinematics
from robots.messages import Array
from wbc.task_kernels import (
    ACCELERATION_AT,
    ANGULAR,
    ORIENTATION,
    POSE,
    POSITION,
    POSITION_AT,
    ROTATION_AT,
    VELOCITY_AT,
    evaluate_frames,
)
from wbc.tasks.task import Task, TaskGains


class _Reference:
    """Part of the numbers that a frame's task follows: read as a view, copied when set."""

    def __init__(self, start: int, *shape: int) -> None:
        """``shape`` of the part that begins at ``start``."""
        self._part = slice(start, start + math.prod(shape))
        self._shape = shape

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, task: "FrameTask", owner: type) -> Array:
        return task.references[self._part].reshape(self._shape)

    def __set__(self, task: "FrameTask", value: Any) -> None:
        self.__get__(task, FrameTask)[:] = task.shaped(self._name, value, *self._shape)


class FrameTask(Task):
    """A frame to a position, an orientation or both: see its three kinds.

    Attributes:
        frame_id: as given by :meth:`Kinematics.frame_id`.
        kind: what of the frame the task is about, see :mod:`wbc.task_kernels`.
        references: shape (24,) what is followed, see :func:`wbc.task_kernels.evaluate_frames`; not numbers where it was
            never set. A stack of tasks keeps those of all its tasks in one block.
    """

    kind: int

    def __init__(
        self,
        frame_id: int,
        gains: TaskGains,
        angular_gains: TaskGains | None = None,
        *,
        name: str = "",
        compensate_bias: bool = False,
    ) -> None:
        """The target is not set, and at rest.

        Args:
            frame_id: as given by :meth:`Kinematics.frame_id`.
            gains: of the position.
            angular_gains: of the orientation; its acceleration gain is that of ``gains``. ``None``: ``gains``.
            name: see :class:`Task`.
            compensate_bias: see :class:`Task`.
        """
        super().__init__(gains, name=name, compensate_bias=compensate_bias)
        self.frame_id = frame_id
        self.references, self._gain_row, self._in_block = np.zeros(24), np.zeros(6), False
        self.references[:VELOCITY_AT] = math.nan
        self.set_gains(gains, angular_gains)

    @property
    def angular_gains(self) -> TaskGains:
        """Gains of the orientation; see :meth:`set_gains`."""
        return self._angular_gains

    def set_gains(self, gains: TaskGains, angular_gains: TaskGains | None = None) -> None:
        """Take other gains from the next evaluation on, of position and orientation; ``None``: the same for both."""
        self._gains, self._angular_gains = gains, gains if angular_gains is None else angular_gains
        g, turn = self._gains, self._angular_gains
        self._gain_row[:] = (
            g.k,
            g.max_correction,
            turn.k,
            turn.max_correction,
            g.acceleration_gain,
            g.max_change,
        )

    @property
    def is_set(self) -> bool:
        """See :attr:`Task.is_set`."""
        first = POSITION_AT if self.kind & POSITION else ROTATION_AT
        last = VELOCITY_AT if self.kind & ORIENTATION else ROTATION_AT
        return not np.isnan(self.references[first:last]).any()

    def move_into(self, references: Array, gains: Array) -> None:
        """Keep references (24,) and gains (6,) in these rows of a block from now on.

        Raises:
            ConfigError: they are kept in another block already.
        """
        if self._in_block:
            raise ConfigError("tasks", self.name, "tasks of no other stack: its references are kept there")
        references[:], gains[:] = self.references, self._gain_row
        self.references, self._gain_row, self._in_block = references, gains, True

    def bias_acceleration(self, kin: Kinematics) -> Array:
        """What is taken off the feed-forward acceleration (6,)."""
        return kin.frame_bias_acceleration(self.frame_id) if self._compensate_bias else np.zeros(6)

    def evaluate(self, kin: Kinematics) -> tuple[Array, Array]:
        """See :meth:`Task.evaluate`; it knows of no evaluation before, so ``max_change`` does not count."""
        if not self.is_set:
            raise TargetNotSetError(self.name)
        jacobian, command = np.empty((self.rows, kin.nv)), np.empty(self.rows)
        table = np.array([[0, self.frame_id, kin.frame_joint(self.frame_id), self.kind]])
        gains = self._gain_row[None].copy()
        gains[0, 5] = math.inf
        evaluate_frames(
            table,
            gains,
            self.references[None],
            self.bias_acceleration(kin)[None],
            kin.frame_transforms,
            kin.world_jacobian,
            kin.support,
            np.zeros((1, 3)),
            jacobian,
            command,
        )
        return jacobian, command


class FramePositionTask(FrameTask):
    """Origin of a frame to ``position`` with feed-forward ``velocity`` and ``acceleration``, each (3,), world."""

    rows, kind = 3, POSITION
    position = _Reference(POSITION_AT, 3)
    velocity = _Reference(VELOCITY_AT, 3)
    acceleration = _Reference(ACCELERATION_AT, 3)

    def set_target(self, position: Array, velocity: Array | None = None, acceleration: Array | None = None) -> None:
        """Go to ``position`` [m]; feed-forward ``velocity`` and ``acceleration`` are 0 if not given."""
        self.position = position
        self.velocity = np.zeros(3) if velocity is None else velocity
        self.acceleration = np.zeros(3) if acceleration is None else acceleration


class FrameOrientationTask(FrameTask):
    """A frame's axes to ``rotation`` (3, 3) with feed-forward ``angular_velocity`` (3,), world."""

    rows, kind = 3, ORIENTATION
    rotation = _Reference(ROTATION_AT, 3, 3)
    angular_velocity = _Reference(VELOCITY_AT + ANGULAR, 3)

    def set_target(self, rotation: Array, angular_velocity: Array | None = None) -> None:
        """Turn to ``rotation``; the feed-forward ``angular_velocity`` [rad/s] is 0 if not given."""
        self.rotation = rotation
        self.angular_velocity = np.zeros(3) if angular_velocity is None else angular_velocity


class FramePoseTask(FrameTask):
    """A frame to ``position`` (3,) and ``rotation`` (3, 3), world.

    Feed-forward ``velocity`` and ``acceleration``, (6,) each, linear first. ``gains`` are those of the position,
    ``angular_gains`` those of the orientation.
    """

    rows, kind = 6, POSE
    position = _Reference(POSITION_AT, 3)
    rotation = _Reference(ROTATION_AT, 3, 3)
    velocity = _Reference(VELOCITY_AT, 6)
    acceleration = _Reference(ACCELERATION_AT, 6)

    def set_target(
        self, position: Array, rotation: Array, velocity: Array | None = None, acceleration: Array | None = None
    ) -> None:
        """Go to ``position`` [m], turn to ``rotation``; ``velocity`` and ``acceleration`` are 0 if not given."""
        self.position, self.rotation = position, rotation
        self.velocity = np.zeros(6) if velocity is None else velocity
        self.acceleration = np.zeros(6) if acceleration is None else acceleration
