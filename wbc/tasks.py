"""Operational-space tasks of KinWBC: a Jacobian and a commanded task velocity each."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np

from robots.checks import require_positive
from robots.errors import ConfigError
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
    correct,
    evaluate_frames,
)


@dataclass(frozen=True, slots=True)
class TaskGains:
    r"""How task errors become task velocities.

    .. math:: \dot x^{cmd} = \dot x^{ref} + \operatorname{clip}(k\, e) + \ddot x^{ref} / a

    The last term carries a feed-forward acceleration through the velocity-to-acceleration law of DynWBC
    (eq. (15) of Lee et al.), for which :math:`a = K_d + K_p\,dt`.

    Attributes:
        k: error gain [1/s], above 0.
        max_correction: largest norm of the correction ``k e`` [m/s or rad/s], above 0.
        acceleration_gain: a [1/s], above 0.
        max_change: by how much the correction of a frame's position may change from one evaluation to the next [m/s],
            above 0; infinite: by anything. It keeps a target that jumps from becoming a velocity that does.
    """

    k: float
    max_correction: float = 1.0
    acceleration_gain: float = 40.0
    max_change: float = math.inf

    def __post_init__(self) -> None:
        for name in ("k", "max_correction", "acceleration_gain"):
            require_positive(f"task {name}", getattr(self, name))
        if not self.max_change > 0:
            raise ConfigError("task max_change", self.max_change, "a number above 0, or infinity")

    def correction(self, error: Array) -> Array:
        """The correction velocity of an error (m,), its norm clipped."""
        v = self.k * error
        norm = math.sqrt(v @ v)
        return v if norm <= self.max_correction else v * (self.max_correction / norm)


class Task(ABC):
    r"""One task: ``rows`` rows; references are plain attributes, set before each tick.

    Attributes:
        rows: of the Jacobian.
        without_drift: take :math:`\dot J v / a` off the command, for eq. (15) of Lee et al. to give the acceleration
            that was asked for: at the level of velocities it does not know that term. Heeded by the CoM and by poses of
            frames; the kinematics' drift must then be up to date.
    """

    rows: int
    without_drift = False

    def __init__(self, gains: TaskGains) -> None:
        """Keep the gains."""
        self.gains = gains

    @abstractmethod
    def evaluate(self, kin: Kinematics) -> tuple[Array, Array]:
        """Jacobian (rows, nv) and commanded task velocity (rows,) at the current kinematics, world axes."""


class CenterOfMassTask(Task):
    """Centre of mass to ``position`` with feed-forward ``velocity`` and ``acceleration``, each (3,), world."""

    rows = 3

    def __init__(self, gains: TaskGains) -> None:
        """References start at zero; set them."""
        super().__init__(gains)
        self.position = np.zeros(3)
        self.velocity = np.zeros(3)
        self.acceleration = np.zeros(3)

    def evaluate(self, kin: Kinematics) -> tuple[Array, Array]:
        """See :meth:`Task.evaluate`."""
        command = np.empty(3)
        correct(self.position, kin.com, self.gains.k, self.gains.max_correction, command)
        acceleration = self.acceleration - kin.com_drift if self.without_drift else self.acceleration
        command += self.velocity
        command += acceleration / self.gains.acceleration_gain
        return kin.com_jacobian, command


class _Reference:
    """Part of the numbers that a frame's task follows: read as a view, copied when set."""

    def __init__(self, start: int, *shape: int) -> None:
        """``shape`` of the part that begins at ``start``."""
        self._part = slice(start, start + math.prod(shape))
        self._shape = shape

    def __get__(self, task: "FrameTask", owner: type) -> Array:
        return task.references[self._part].reshape(self._shape)

    def __set__(self, task: "FrameTask", value: Any) -> None:
        self.__get__(task, FrameTask)[:] = value


class FrameTask(Task):
    """A frame to a position, an orientation or both: see its three kinds.

    Attributes:
        frame_id: as given by :meth:`Kinematics.frame_id`.
        kind: what of the frame the task is about, see :mod:`wbc.task_kernels`.
        angular_gains: of the orientation; its acceleration gain is that of ``gains``.
        references: shape (24,) what is followed, see :func:`wbc.task_kernels.evaluate_frames`. A stack of tasks keeps
            those of all its tasks in one block.
    """

    kind: int

    def __init__(self, frame_id: int, gains: TaskGains, angular_gains: TaskGains | None = None) -> None:
        """``angular_gains`` are ``gains`` if not given. References start at zero and no turn; set them."""
        super().__init__(gains)
        self.angular_gains = gains if angular_gains is None else angular_gains
        self.frame_id = frame_id
        self.references = np.zeros(24)
        self.references[ROTATION_AT:VELOCITY_AT] = np.eye(3).ravel()

    def gain_row(self) -> Array:
        """Gains (6,) in the order of :func:`wbc.task_kernels.evaluate_frames`."""
        g, turn = self.gains, self.angular_gains
        return np.array([g.k, g.max_correction, turn.k, turn.max_correction, g.acceleration_gain, g.max_change])

    def drift(self, kin: Kinematics) -> Array:
        """What is taken off the feed-forward acceleration (6,)."""
        return kin.frame_drift(self.frame_id) if self.without_drift else np.zeros(6)

    def evaluate(self, kin: Kinematics) -> tuple[Array, Array]:
        """See :meth:`Task.evaluate`; it knows of no evaluation before, so ``max_change`` does not count."""
        jacobian, command = np.empty((self.rows, kin.nv)), np.empty(self.rows)
        table = np.array([[0, self.frame_id, kin.frame_joint(self.frame_id), self.kind]])
        gains = self.gain_row()[None]
        gains[0, 5] = math.inf
        evaluate_frames(
            table,
            gains,
            self.references[None],
            self.drift(kin)[None],
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


class FrameOrientationTask(FrameTask):
    """A frame's axes to ``rotation`` (3, 3) with feed-forward ``angular_velocity`` (3,), world."""

    rows, kind = 3, ORIENTATION
    rotation = _Reference(ROTATION_AT, 3, 3)
    angular_velocity = _Reference(VELOCITY_AT + ANGULAR, 3)


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


class PostureTask(Task):
    """Joints to ``joints`` (nj,); the base is left alone."""

    def __init__(self, nj: int, gains: TaskGains, nv_base: int = 6) -> None:
        """For ``nj`` joints behind a base whose velocity has ``nv_base`` entries: see :class:`Kinematics`."""
        super().__init__(gains)
        self.rows = nj
        self.joints = np.zeros(nj)
        self.nv_base = nv_base
        self._jacobian = np.hstack([np.zeros((nj, nv_base)), np.eye(nj)])

    def evaluate(self, kin: Kinematics) -> tuple[Array, Array]:
        """See :meth:`Task.evaluate`."""
        command = np.empty(self.rows)
        correct(self.joints, kin.q[kin.nq_base :], self.gains.k, self.gains.max_correction, command)
        return self._jacobian, command
