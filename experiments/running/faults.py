"""Faults between a body and the agent."""

from dataclasses import replace

import numpy as np

from robots.messages import MotorCommand, RobotState
from robots.ports import Body


class BrokenEncoder:
    """A body whose first joint's measured position is NaN from some time on."""

    def __init__(self, body: Body[MotorCommand], since: float) -> None:
        """``since``: from this stamp on [s]."""
        self._body, self._since = body, since

    def state(self) -> RobotState:
        """See :meth:`robots.ports.Body.state`."""
        state = self._body.state()
        if state.stamp < self._since:
            return state
        q = state.q.copy()
        q[7] = np.nan
        return replace(state, q=q)

    def send(self, command: MotorCommand) -> None:
        """See :meth:`robots.ports.Body.send`."""
        self._body.send(command)

    def advance(self, dt: float) -> None:
        """See :meth:`robots.ports.Body.advance`."""
        self._body.advance(dt)
