"""The task of the centre of mass."""

import numpy as np

from robots.errors import TargetNotSetError
from robots.kinematics import Kinematics
from robots.messages import Array
from wbc.task_kernels import correct
from wbc.tasks.task import Task, TaskGains


class CenterOfMassTask(Task):
    """Centre of mass to ``position`` with feed-forward ``velocity`` and ``acceleration``, each (3,), world."""

    rows = 3

    def __init__(self, gains: TaskGains, *, name: str = "", compensate_bias: bool = False) -> None:
        """The target is not set, and at rest."""
        super().__init__(gains, name=name, compensate_bias=compensate_bias)
        self._position: Array | None = None
        self._velocity, self._acceleration = np.zeros(3), np.zeros(3)

    def set_target(self, position: Array, velocity: Array | None = None, acceleration: Array | None = None) -> None:
        """Go to ``position`` (3,) [m]; feed-forward ``velocity`` and ``acceleration`` (3,) are 0 if not given.

        The arrays are kept, not copied.
        """
        # most often those of the last tick, with other numbers
        if position is not self._position:
            self._position = self.shaped("position", position, 3)
        if velocity is not self._velocity:
            self._velocity = np.zeros(3) if velocity is None else self.shaped("velocity", velocity, 3)
        if acceleration is not self._acceleration:
            self._acceleration = np.zeros(3) if acceleration is None else self.shaped("acceleration", acceleration, 3)

    @property
    def is_set(self) -> bool:
        """See :attr:`Task.is_set`."""
        return self._position is not None

    @property
    def position(self) -> Array:
        """Where to go (3,) [m]."""
        if self._position is None:
            raise TargetNotSetError(self.name)
        return self._position

    @position.setter
    def position(self, value: Array) -> None:
        self._position = self.shaped("position", value, 3)

    @property
    def velocity(self) -> Array:
        """Feed-forward velocity (3,) [m/s]."""
        return self._velocity

    @velocity.setter
    def velocity(self, value: Array) -> None:
        self._velocity = self.shaped("velocity", value, 3)

    @property
    def acceleration(self) -> Array:
        """Feed-forward acceleration (3,) [m/s^2]."""
        return self._acceleration

    @acceleration.setter
    def acceleration(self, value: Array) -> None:
        self._acceleration = self.shaped("acceleration", value, 3)

    def evaluate(self, kin: Kinematics) -> tuple[Array, Array]:
        """See :meth:`Task.evaluate`."""
        if self._position is None:
            raise TargetNotSetError(self.name)
        command, gains = np.empty(3), self._gains
        correct(self._position, kin.com, gains.k, gains.max_correction, command)
        acceleration = self._acceleration - kin.com_bias_acceleration if self._compensate_bias else self._acceleration
        command += self._velocity
        command += acceleration / gains.acceleration_gain
        return kin.com_jacobian, command
