"""Whether a robot is at rest, and what its sensors say then."""

import numpy as np

from robots.messages import Array, SensorReading
from wbc.wrench import GRAVITY

LONG, SHORT = 1000, 125
"""Readings in a row without motion that a calibration takes, and over which feet have to carry the robot."""

STILL_RATE, TURNING = 0.1, 0.05
"""Largest difference of two rates of the gyro at rest, per axis, and largest mean rate, which would be its bias
[rad/s]."""

CALM_RATE = 0.4
"""Largest difference of two rates while a robot is set down [rad/s]."""

GRAVITY_ERROR = 0.5
"""By how much the mean specific force at rest may differ from g in length [m/s^2]."""


class RestWatch:
    """Remembers the last readings."""

    def __init__(self) -> None:
        self._rates, self._forces = np.zeros((LONG, 3)), np.zeros((LONG, 3))
        self._recent: list[SensorReading] = []
        self._count = 0

    def add(self, reading: SensorReading) -> None:
        """Take in a reading."""
        place = self._count % LONG
        self._rates[place], self._forces[place] = reading.gyro, reading.accelerometer
        self._count += 1
        self._recent.append(reading)
        if len(self._recent) > SHORT:
            del self._recent[0]

    def restart(self) -> None:
        """Forget all."""
        self._count = 0
        self._recent.clear()

    @property
    def full(self) -> bool:
        """Whether there are enough for a calibration."""
        return self._count >= LONG

    def describe_motion(self) -> str:
        """What moves, or cannot be, in words; empty where the robot was at rest all the time."""
        differ = float(np.ptp(self._rates, axis=0).max())
        if not differ < STILL_RATE:
            return f"the gyro's rates differ by {differ:.2f} rad/s"
        mean = float(np.abs(self.bias()).max())
        if not mean < TURNING:
            return f"the robot turns at {mean:.2f} rad/s, or the gyro is broken"
        force = float(np.linalg.norm(self._forces.mean(axis=0)))
        if not abs(force - GRAVITY) < GRAVITY_ERROR:
            return f"the accelerometer says {force:.2f} m/s^2, which is not gravity"
        return ""

    def bias(self) -> Array:
        """Mean rate (3,) [rad/s]."""
        return np.asarray(self._rates.mean(axis=0))

    def recent(self) -> list[SensorReading]:
        """The last of them, ``SHORT`` at most."""
        return list(self._recent)

    def calm(self) -> bool:
        """Whether there was little motion in the last ``SHORT`` readings."""
        rates = np.array([reading.gyro for reading in self._recent])
        return len(rates) == SHORT and bool(np.ptp(rates, axis=0).max() < CALM_RATE)
