"""Kinematic plant: a robot that does what it is told, at velocity or at acceleration level; nothing collides in it."""

from typing import Protocol

import numpy as np

from robots.checks import all_finite, require_positive
from robots.errors import ConfigError
from robots.messages import Array, RobotState


class KinematicModel(Protocol):
    """What the plant needs of a robot; :class:`robots.kinematics.Kinematics` has it."""

    nq: int
    nv: int

    def integrate(self, q: Array, v: Array, dt: float) -> Array:
        """Configuration (nq,) after moving at ``v`` (nv,) for ``dt`` [s]."""
        ...


class KinematicPlant:
    r"""Explicit integration of a command that is held over a step.

    First order, the command is the velocity:

    .. math:: q \leftarrow q \oplus u\,dt

    Exact for a constant command, on the group of a floating or planar base too: the base moves along a screw. Second
    order, the command is the acceleration, and the step is semi-implicit (the *new* velocity moves the robot):

    .. math:: v \leftarrow v + u\,dt, \quad q \leftarrow q \oplus v\,dt

    Under a constant acceleration q is then ahead of the exact parabola by :math:`u\,t\,dt/2`.

    Bodies pass through each other and through obstacles: penetration is there to be measured.

    Attributes:
        order: 1 or 2.
        q: shape (nq,) configuration.
        v: shape (nv,) velocity that the last step moved with [m/s, rad/s].
        time: since the start [s].
    """

    def __init__(self, model: KinematicModel, q0: Array, order: int = 1) -> None:
        """Start at rest.

        Args:
            model: the robot.
            q0: shape (nq,) configuration to start from; copied.
            order: 1: commands are velocities; 2: accelerations.

        Raises:
            ConfigError: another order, or ``q0`` has another shape or is not finite.
        """
        if order not in (1, 2):
            raise ConfigError("order", order, "1 (velocity) or 2 (acceleration)")
        if np.shape(q0) != (model.nq,) or not all_finite(q0):
            raise ConfigError("q0", q0, f"{model.nq} finite numbers")
        self._model = model
        self.order = order
        self.q = np.array(q0, dtype=float)
        self.v = np.zeros(model.nv)
        self.time = 0.0
        self._command = np.zeros(model.nv)

    def state(self) -> RobotState:
        """See :meth:`robots.ports.Body.state`: exact; there are no motors to have a torque."""
        return RobotState(self.q, self.v, np.empty(0), self.time)

    def send(self, command: Array) -> None:
        """See :meth:`robots.ports.Body.send`: ``command`` (nv,) is a velocity or an acceleration, by the order."""
        self._command = command

    def advance(self, dt: float) -> None:
        """See :meth:`robots.ports.Body.advance`; :meth:`step` under the last command."""
        self.step(self._command, dt)

    def step(self, command: Array, dt: float) -> None:
        """Move on by ``dt`` [s] under ``command`` (nv,): velocity or acceleration, by the plant's order.

        Raises:
            ConfigError: ``dt`` is not above 0, or the command has another shape or is not finite.
        """
        require_positive("dt", dt)
        if np.shape(command) != (self._model.nv,) or not all_finite(command):
            raise ConfigError("command", command, f"{self._model.nv} finite numbers")
        # new arrays: whoever kept the last ones may go on using them
        self.v = np.array(command, dtype=float) if self.order == 1 else self.v + dt * command
        self.q = self._model.integrate(self.q, self.v, dt)
        self.time += dt
