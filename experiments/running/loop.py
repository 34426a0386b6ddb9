"""The closed loop: a body, an agent, a world, and observers that are told what happens."""

import time
from collections.abc import Sequence
from typing import Any, Generic, Protocol, TypeVar

from controllers.perception import Detection
from experiments.running.laps import Laps
from robots.messages import RobotState
from robots.ports import Body


class Driver(Protocol):
    """What drives a body: an :class:`controllers.agent.Agent`, or one of its kind for a kinematic plant."""

    @property
    def dt(self) -> float:
        """Control period [s]."""
        ...

    def tick(self, state: RobotState, detections: Sequence[Detection] = ()) -> Any:
        """What it came to for a measured state; its ``command`` is for the body."""
        ...


AgentT = TypeVar("AgentT", bound=Driver)


class World(Protocol):
    """What is around the robot."""

    def detections(self, t: float) -> Sequence[Detection]:
        """What the sensors report at ``t`` [s] that they have not reported before."""
        ...

    def act(self, t: float) -> None:
        """Do to the body what the world does to it from ``t`` [s] on, until the next physics step: pushes, motions."""
        ...


class EmptyWorld:
    """Nothing around the robot."""

    def detections(self, t: float) -> Sequence[Detection]:
        """See :meth:`World.detections`."""
        return ()

    def act(self, t: float) -> None:
        """See :meth:`World.act`."""


class Observer:
    """Is told what happens in a loop. Each method does nothing by itself.

    Attributes:
        ended_by: why it ended the run, where the summary is to tell.
    """

    ended_by: str | None = None

    def began(self, loop: "ClosedLoop[Any]") -> None:
        """The agent was reset; nothing has moved yet."""

    def ticked(self, loop: "ClosedLoop[Any]", state: RobotState, output: Any, seconds: float) -> None:
        """The agent answered ``state`` with ``output`` within ``seconds``; the command was sent."""

    def stepped(self, loop: "ClosedLoop[Any]") -> None:
        """A physics step has passed."""

    def ends(self, loop: "ClosedLoop[Any]") -> bool:
        """Whether this control period was the last one; asked at its end."""
        return False

    def ended(self, loop: "ClosedLoop[Any]") -> None:
        """The run is over."""


class ClosedLoop(Generic[AgentT]):
    """Lets an agent drive a body: measure, tick, send, advance. It keeps nothing of what has passed.

    Args:
        body: what is driven.
        agent: what drives it.
        world: around the body.
        observers: told in their order.
        steps: physics steps of a control period: how often observers are told within it.
        laps: books where the time goes.

    Attributes:
        ticks: control periods that have passed.
        time: since the start, in control periods and steps [s].
    """

    def __init__(
        self,
        body: Body[Any],
        agent: AgentT,
        world: World | None = None,
        observers: Sequence[Observer] = (),
        steps: int = 1,
        laps: Laps | None = None,
    ) -> None:
        self.body, self.agent = body, agent
        self.world = EmptyWorld() if world is None else world
        self.observers = list(observers)
        self.laps = Laps() if laps is None else laps
        self.ticks, self.time = 0, 0.0
        self._steps = steps

    def run(self, duration: float) -> None:
        """Run for ``duration`` [s], or until an observer says that it ends."""
        for _ in range(round(duration / self.agent.dt)):
            if not self.step():
                break
        for observer in self.observers:
            observer.ended(self)

    def step(self) -> bool:
        """One control period; whether another one is to follow."""
        if self.ticks == 0:
            for observer in self.observers:
                observer.began(self)
        self._tick()
        self._advance()
        self.ticks += 1
        self.time = self.ticks * self.agent.dt
        # every one is asked: some look at what happens in order to answer
        return not any([observer.ends(self) for observer in self.observers])

    def _tick(self) -> None:
        book = self.laps.book
        book("rest")
        state = self.body.state()
        book("state")
        # on the clock of the state: a robot's does not begin at zero
        detections = self.world.detections(state.stamp)
        book("world")
        began = time.perf_counter()
        output = self.agent.tick(state, detections)
        elapsed = time.perf_counter() - began
        book("tick")
        self.body.send(output.command)
        for observer in self.observers:
            book("rest")
            observer.ticked(self, state, output, elapsed)

    def _advance(self) -> None:
        """Let a control period pass."""
        began, step = self.time, self.agent.dt / self._steps
        for i in range(self._steps):
            self.world.act(self.time)
            self.laps.book("rest")
            self.body.advance(step)
            self.laps.book("plant")
            self.time = began + (i + 1) * step
            for observer in self.observers:
                observer.stepped(self)
