"""The task of all joints."""

import numpy as np

from robots.errors import TargetNotSetError
from robots.kinematics import Kinematics
from robots.messages import Array
from wbc.task_kernels import correct
from wbc.tasks.task import Task, TaskGains


class PostureTask(Task):
    """Joints to ``joints`` (nj,); the base is left alone."""

    def __init__(self, nj: int, gains: TaskGains, nv_base: int = 6, *, name: str = "") -> None:
        """For ``nj`` joints behind a base whose velocity has ``nv_base`` entries: see :class:`Kinematics`."""
        super().__init__(gains, name=name)
        self.rows = nj
        self.nv_base = nv_base
        self._joints: Array | None = None
        self._jacobian = np.hstack([np.zeros((nj, nv_base)), np.eye(nj)])

    def set_target(self, joints: Array) -> None:
        """Go to ``joints`` (nj,) [rad]; the array is kept, not copied."""
        # most often that of the last tick, with other numbers
        if joints is not self._joints:
            self._joints = self.shaped("joints", joints, self.rows)

    @property
    def is_set(self) -> bool:
        """See :attr:`Task.is_set`."""
        return self._joints is not None

    @property
    def joints(self) -> Array:
        """Where to go (nj,) [rad]."""
        if self._joints is None:
            raise TargetNotSetError(self.name)
        return self._joints

    @joints.setter
    def joints(self, value: Array) -> None:
        self._joints = self.shaped("joints", value, self.rows)

    def evaluate(self, kin: Kinematics) -> tuple[Array, Array]:
        """See :meth:`Task.evaluate`."""
        if self._joints is None:
            raise TargetNotSetError(self.name)
        command = np.empty(self.rows)
        correct(self._joints, kin.q[kin.nq_base :], self._gains.k, self._gains.max_correction, command)
        return self._jacobian, command
