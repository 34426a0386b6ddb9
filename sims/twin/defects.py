"""What is wrong with the robot itself now: its encoders, motors, IMU, battery, remote, and who pushes it."""

import numpy as np
from numpy.typing import NDArray

from robots.messages import Array
from robots.unitree.g1 import MODE_MACHINE, MOTOR_NAMES
from robots.unitree.remote import Remote
from sims.twin.faults import Fault

WARM = 35.0
"""Temperature of a motor's casing and winding [degrees Celsius]."""

HEATING = 20.0
"""How fast a motor becomes hot or cold [K/s]."""

FULL = 90
"""What is left in the battery [%]."""

HELD = 0.3
"""How long a button is held [s]."""

WAIST_LOCKED = 6
"""``mode_machine`` of a robot of 29 joints with its waist fixed. Source: Unitree's page on basic services."""

OF_MOTORS = {"encoder": 0.0, "hot": WARM, "motor-error": 0.0}
"""Faults of one motor, and what there is without them."""

LASTING = (
    *("battery", "waist-locked", "imu-stuck", "gyro-step", "torque-constant", "stick", "remote-lost"),
    "switcher-refuses",
)
"""Faults of the whole robot that last until they are cleared; a second one takes the place of the first."""

PASSING = ("foreign-writer", "push", "remote")
"""Faults that end by themselves, and may overlap."""


class Defects:
    """Begins and ends the faults of the robot itself; arrays are in the motors' order.

    Attributes:
        temperature: shape (29,) of casing and winding [degrees Celsius].
    """

    names = (*OF_MOTORS, *LASTING, *PASSING)
    """Of the faults that begin here."""

    def __init__(self) -> None:
        self._motors = {name: np.full(len(MOTOR_NAMES), usual) for name, usual in OF_MOTORS.items()}
        self._lasting: dict[str, Fault] = {}
        self._passing: list[tuple[Fault, float]] = []
        self.temperature = np.full(len(MOTOR_NAMES), WARM)
        self._time = 0.0

    def begin(self, fault: Fault, t: float) -> None:
        """Begin a fault, one of ``names``, at ``t`` [s]."""
        if fault.name in OF_MOTORS:
            self._motors[fault.name][MOTOR_NAMES.index(fault.word(0))] = fault.number(1)
        elif fault.name in LASTING:
            self._lasting[fault.name] = fault
        else:
            self._passing.append((fault, t + (HELD if fault.name == "remote" else fault.number(-1))))

    def clear(self, name: str | None = None) -> None:
        """End a fault, or all of them; motors that are hot cool down as fast as they were heated."""
        for fault, usual in OF_MOTORS.items():
            if name in (None, fault):
                self._motors[fault][:] = usual
        self._lasting = {n: fault for n, fault in self._lasting.items() if name not in (None, n)}
        self._passing = [(fault, end) for fault, end in self._passing if name not in (None, fault.name)]

    def advance(self, t: float) -> None:
        """Let time pass until ``t`` [s]: motors become hot or cold, and what passes ends."""
        change = HEATING * (t - self._time)
        self._time = t
        self.temperature += np.clip(self._motors["hot"] - self.temperature, -change, change)
        if self._passing:
            self._passing = [(fault, end) for fault, end in self._passing if t < end]

    def _has(self, name: str) -> list[Fault]:
        """Those of this name that pass and have not ended."""
        return [fault for fault, _ in self._passing if fault.name == name]

    @property
    def encoder(self) -> Array:
        """What the encoders say too much (29,) [rad]."""
        return 2.0 * np.pi * self._motors["encoder"]

    @property
    def errors(self) -> NDArray[np.uint32]:
        """Bits of ``motorstate`` (29,)."""
        return self._motors["motor-error"].astype(np.uint32)

    @property
    def battery(self) -> int:
        """What is left in it [%]."""
        fault = self._lasting.get("battery")
        return FULL if fault is None else int(fault.number(0))

    @property
    def mode_machine(self) -> int:
        """The variant that the robot reports."""
        return WAIST_LOCKED if "waist-locked" in self._lasting else MODE_MACHINE

    @property
    def imu_stuck(self) -> bool:
        """Whether the IMU in the pelvis says the same for ever."""
        return "imu-stuck" in self._lasting

    @property
    def gyro_step(self) -> float:
        """What the gyro in the pelvis says too much about its x axis [rad/s]."""
        fault = self._lasting.get("gyro-step")
        return 0.0 if fault is None else fault.number(0)

    @property
    def torque_constant(self) -> float | None:
        """What the motors take a torque of 1 N m for; ``None``: as it is without the fault [N m]."""
        fault = self._lasting.get("torque-constant")
        return None if fault is None else fault.number(0)

    @property
    def switcher_refuses(self) -> bool:
        """Whether the release of the robot's own service is refused."""
        return "switcher-refuses" in self._lasting

    @property
    def foreign(self) -> bool:
        """Whether another one writes commands."""
        return bool(self._has("foreign-writer"))

    @property
    def push(self) -> Array:
        """Force of all pushes, world axes (3,) [N]."""
        return np.sum([np.zeros(3), *(np.array(fault.values[:3], float) for fault in self._has("push"))], axis=0)

    @property
    def remote(self) -> Remote:
        """What a person holds, and does with it."""
        pressed = frozenset(str(button) for fault in self._has("remote") for button in fault.values)
        stick = self._lasting.get("stick")
        lx, ly, rx = (0.0, 0.0, 0.0) if stick is None else (stick.number(i) for i in range(3))
        return Remote(pressed, (lx, ly), (rx, 0.0), "remote-lost" not in self._lasting)
