"""When a run is over before its time: after a fall, a stop, or when the simulation breaks down."""

import numpy as np

from experiments.recording.outcome import Outcome
from experiments.running.loop import ClosedLoop, Observer
from robots.messages import Array
from sims.plant import MujocoPlant

FALL_TILT = np.cos(np.deg2rad(60.0))
"""Cosine of the base's tilt from which the robot counts as fallen."""

FALL_HEIGHT = 0.6
"""Share of its first height below which the base counts as fallen."""

POST_ROLL = 0.5
"""Time that is still simulated after a fall or a stop [s]."""

GAIT_POST_ROLL = 4.0
"""The same after a stop that leaves it to a gait to come to rest on both feet [s]."""


class Ending(Observer):
    """Ends a run shortly after a fall or a stop.

    Attributes:
        outcome: so far.
    """

    def __init__(self, plant: MujocoPlant) -> None:
        self._plant = plant
        self.outcome = Outcome(None, 0.0)
        self._end = float("inf")
        self._start_height = float(plant.true_state().q[2])

    def ends(self, loop: ClosedLoop) -> bool:
        """See :meth:`Observer.ends`."""
        plant, agent, began = self._plant, loop.agent, loop.time - loop.agent.dt
        self.outcome.duration = plant.time
        if plant.unstable:
            agent.hold("the simulation became unstable: try a smaller physics step", plant.time)
            return True
        if self.outcome.fell_at is None and self._has_fallen(plant.true_state().q):
            self.outcome.fell_at = plant.time
            self._end = min(self._end, began + POST_ROLL)
        if agent.stop_cause is not None:
            rest = POST_ROLL if agent.gait is None or agent.supervisor.fading else GAIT_POST_ROLL
            self._end = min(self._end, agent.supervisor.stopped_at + rest)
        return loop.time >= self._end - 0.5 * agent.dt

    def _has_fallen(self, q: Array) -> bool:
        upright = 1 - 2 * (q[3] * q[3] + q[4] * q[4])
        return bool(upright < FALL_TILT or q[2] < FALL_HEIGHT * self._start_height)
