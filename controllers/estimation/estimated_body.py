"""A body that is measured by its own sensors only: what an agent is given is estimated."""

import time
from collections.abc import Callable

from controllers.estimation.estimator import StateEstimator
from robots.messages import MotorCommand, RobotState, SensorReading
from robots.ports import Body


class EstimatedBody:
    """A body whose state is what an estimator makes of its sensors' readings.

    Attributes:
        estimator: calibrated.
        estimate: the last one; ``None`` before.
        seconds: that it took.
    """

    def __init__(
        self,
        body: Body[MotorCommand],
        read: Callable[[], SensorReading],
        estimator: StateEstimator,
        told: Callable[[RobotState], RobotState] | None = None,
    ) -> None:
        """``body`` is commanded, ``read`` gives what its sensors say now; ``told``: what is made of the estimate."""
        self._body, self._read, self.estimator, self._told = body, read, estimator, told
        self.estimate: RobotState | None = None
        self.seconds = 0.0

    def state(self) -> RobotState:
        """See :meth:`robots.ports.Body.state`."""
        reading = self._read()
        begun = time.perf_counter()
        self.estimate = self.estimator.update(reading)
        self.seconds = time.perf_counter() - begun
        return self.estimate if self._told is None else self._told(self.estimate)

    def send(self, command: MotorCommand) -> None:
        """See :meth:`robots.ports.Body.send`."""
        self._body.send(command)

    def advance(self, dt: float) -> None:
        """See :meth:`robots.ports.Body.advance`."""
        self._body.advance(dt)
