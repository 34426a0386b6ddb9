"""What comes between a body and the agent: a broken encoder, an estimate of which a part is the truth."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from robots.messages import MotorCommand, RobotState
from robots.ports import Body
from sims.plant import MujocoPlant


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


def partly(kind: str, plant: MujocoPlant) -> Callable[[RobotState], RobotState]:
    """What of an estimate the agent is told.

    Args:
        kind: ``estimated``: all of it; ``estimated-base``: with the true forces under the feet, and no contacts;
            ``estimated-forces``: its forces and contacts, beside the true base.
        plant: that knows the truth.
    """

    def with_true_forces(state: RobotState) -> RobotState:
        return replace(state, foot_forces=plant.true_state().foot_forces, contact=None)

    def with_true_base(state: RobotState) -> RobotState:
        true = plant.true_state()
        return replace(state, q=true.q, v=true.v)

    kinds = {"estimated-base": with_true_forces, "estimated-forces": with_true_base}
    return kinds.get(kind, lambda state: state)
