"""When a run is over before its time: after a fall, a stop, or when the simulation breaks down."""

from collections.abc import Callable
from typing import Any

from experiments.metrics.falls import has_fallen
from experiments.recording.outcome import Outcome
from experiments.running.loop import ClosedLoop, Observer
from sims.plant import MujocoPlant

INTERRUPTED = "interrupted"
"""Cause of a stop by a person: what was simulated until then counts."""

UNSTABLE = "the simulation became unstable: try a smaller physics step"
"""Cause of a stop that no robot has; it goes before what the supervisor made of the states that led there."""

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
        self._stands_at = float(plant.true_state().q[2] - plant.sole_corners()[..., 2].mean())

    def ends(self, loop: ClosedLoop[Any]) -> bool:
        """See :meth:`Observer.ends`."""
        plant, agent, began = self._plant, loop.agent, loop.time - loop.agent.dt
        self.outcome.duration = plant.time
        if plant.unstable:
            agent.hold(UNSTABLE)
            return True
        if self.outcome.fell_at is None and has_fallen(plant.true_state().q, plant.sole_corners(), self._stands_at):
            self.outcome.fell_at = plant.time
            self._end = min(self._end, began + POST_ROLL)
        if agent.stop_cause is not None:
            rest = POST_ROLL if agent.gait is None or agent.supervisor.fading else GAIT_POST_ROLL
            self._end = min(self._end, agent.supervisor.stopped_at + rest)
        return loop.time >= self._end - 0.5 * agent.dt


class Interruption(Observer):
    """Ends a run when somebody asks for it, between two control periods."""

    def __init__(self, asked: Callable[[], bool]) -> None:
        """``asked``: whether the run is to end."""
        self._asked = asked

    def ends(self, loop: ClosedLoop[Any]) -> bool:
        """See :meth:`Observer.ends`."""
        if self._asked():
            self.ended_by = INTERRUPTED
        return self.ended_by is not None


class InterruptionAt(Observer):
    """Ends a run where another one was interrupted, so that the two can be compared."""

    def __init__(self, duration: float) -> None:
        """``duration``: of the other run [s]."""
        self._duration = duration

    def ends(self, loop: ClosedLoop[Any]) -> bool:
        """See :meth:`Observer.ends`."""
        if loop.time >= self._duration - 0.5 * loop.agent.dt:
            self.ended_by = INTERRUPTED
        return self.ended_by is not None
