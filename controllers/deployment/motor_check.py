"""One motor while the robot hangs: its feed-forward torque goes up and down again, and what the joint makes of it.

For the first session with a robot: a user reports that motors vibrate from 1 to 2 N m of feed-forward torque on (issue
162 of unitree_sdk2_python, unanswered), which is what a torque controller works with all the time.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from robots.checks import require_between, require_non_negative, require_one_of
from robots.description import RobotDescription
from robots.messages import Array, MotorCommand, SensorReading

HOLD, RAMP = 1.0, 4.0
"""At rest before, between and after; up and down [s]."""

LEVELS = 5
"""Steps of torque in the report."""

SMOOTH = 0.05
"""Time constant of the mean of the joint's rate, the rest being vibration [s]."""

PERIOD = 0.002
"""Of the readings [s]."""


@dataclass(frozen=True, slots=True)
class MotorCheckSettings:
    """Which motor, and how.

    Attributes:
        joint: of the description.
        torque: at the top, up to half of the motor's limit [N m].
        low_pass: corner frequency of the torque's low-pass, 0 for none [Hz].
    """

    joint: str = "left_elbow_joint"
    torque: float = 2.0
    low_pass: float = 0.0


class MotorCheck:
    """Commands of the check, and its report.

    Raises:
        ConfigError: no such joint, or a number that is not allowed.
    """

    def __init__(self, robot: RobotDescription, settings: MotorCheckSettings) -> None:
        require_one_of("joint", settings.joint, tuple(robot.joint_names))
        self._joint = robot.joint_names.index(settings.joint)
        limit = 0.5 * float(robot.joint_array("effort")[self._joint])
        require_between("torque", settings.torque, -limit, limit)
        require_non_negative("low_pass", settings.low_pass)
        self.settings, self.duration = settings, 3.0 * HOLD + 2.0 * RAMP
        self._torque, self._mean = 0.0, 0.0
        self._square, self._count = np.zeros(LEVELS + 1), np.zeros(LEVELS + 1)

    def asked(self, since: float) -> float:
        """Torque at a time after the begin [s], before the low-pass [N m]."""
        up = min(1.0, max(0.0, (since - HOLD) / RAMP))
        down = min(1.0, max(0.0, (since - 2.0 * HOLD - RAMP) / RAMP))
        return self.settings.torque * (up - down)

    def command(self, held: MotorCommand, reading: SensorReading, since: float) -> MotorCommand:
        """The command that holds the posture, with the torque of now; the reading goes into the report."""
        wanted, corner = self.asked(since), self.settings.low_pass
        share = 1.0 if corner == 0.0 else 1.0 - math.exp(-2.0 * math.pi * corner * PERIOD)
        self._torque += share * (wanted - self._torque)
        self._observe(reading)
        tau = held.tau.copy()
        tau[self._joint] = self._torque
        return replace(held, tau=tau)

    def _observe(self, reading: SensorReading) -> None:
        rate = float(reading.joint_velocity[self._joint])
        self._mean += PERIOD / SMOOTH * (rate - self._mean)
        top = abs(self.settings.torque)
        level = 0 if top == 0.0 else round(LEVELS * min(1.0, abs(self._torque) / top))
        self._square[level] += (rate - self._mean) ** 2
        self._count[level] += 1

    def report(self) -> list[tuple[float, float]]:
        """Torque [N m] and the root mean square of the joint's vibration there [rad/s], level by level."""
        rms: Array = np.sqrt(self._square / np.maximum(self._count, 1.0))
        return [(self.settings.torque * i / LEVELS, float(r)) for i, r in enumerate(rms)]
