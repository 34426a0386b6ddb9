"""The robot's states as they come in over the network: which are sound and new, and when they were measured."""

from collections import Counter

from robots.messages import SensorReading
from robots.unitree.g1 import G1Joints
from robots.unitree.messages import StateMessage

PERIOD = 0.002
"""Of the robot's states [s]."""

PULL = 0.02
"""Fraction of what a state comes late by that the clock follows: what the network delays one state by is no time."""

LONGEST_GAP = 0.1
"""After a longer one the clock begins again [s]."""

WRAP = 1 << 32
"""Of the robot's counter."""


class StateClock:
    """When states were measured, on this machine's clock, from the robot's counter and when they came.

    States are measured at even periods and come with the network's jitter. So their stamps go on by whole periods, as
    many as the counter has gone on by, and follow the time at which they come slowly. The counter's unit is not
    documented: it is the step seen most often.

    Attributes:
        stamp: of the last state [s].
        lost: number of states that the counter passed over.
    """

    def __init__(self, period: float = PERIOD) -> None:
        self._period = period
        self._tick: int | None = None
        self._steps: Counter[int] = Counter()
        self.stamp = 0.0
        self.lost = 0

    def step(self, tick: int) -> int:
        """How far the robot's counter ``tick`` is ahead of the last one: 0 for the same state, below 0 for older."""
        if self._tick is None:
            return 1
        ahead = (tick - self._tick) % WRAP
        return ahead if ahead < WRAP // 2 else ahead - WRAP

    def advance(self, tick: int, arrived: float) -> float:
        """The stamp of a state that came at ``arrived`` [s] and whose counter is ahead of the last one."""
        step = self.step(tick)
        if self._tick is None or arrived - self.stamp > LONGEST_GAP:
            self.stamp = max(arrived, self.stamp + self._period if self._tick is not None else arrived)
        else:
            self._steps[step] += 1
            unit = self._steps.most_common(1)[0][0]
            periods = max(1, round(step / unit))
            self.lost += periods - 1
            expected = self.stamp + periods * self._period
            late = arrived - expected
            if late < -self._period:
                # no state is measured after it came: what waited somewhere before it came in one burst
                self.stamp += 0.5 * self._period
            else:
                self.stamp = expected + PULL * min(late, self._period)
        self._tick = tick
        return self.stamp


class StateStream:
    """Takes in states byte by byte; each counts once, and none that is broken or older than the last.

    Attributes:
        joints: of the description, in the robot's slots.
        message: the last sound state, as it came.
        clock: of the states.
        arrived: when the last sound one came [s].
        broken: number of states whose check sum was wrong, or whose length was none.
        repeated: number of states that had come before, or were older than the last.
    """

    def __init__(self, joints: G1Joints) -> None:
        self.joints = joints
        self.message, self._next = StateMessage(), StateMessage()
        self.clock = StateClock()
        self.arrived = -float("inf")
        self.broken = self.repeated = 0

    def take(self, data: bytes, arrived: float) -> SensorReading | None:
        """The reading of a state that came at ``arrived`` [s]; ``None`` where it is broken or no new one."""
        if not self._next.read(data):
            self.broken += 1
            return None
        if self.clock.step(self._next.tick) <= 0:
            self.repeated += 1
            return None
        self.message, self._next = self._next, self.message
        self.arrived = arrived
        return self.joints.reading(self.message, self.clock.advance(self.message.tick, arrived))
