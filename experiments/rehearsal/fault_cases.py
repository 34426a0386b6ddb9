"""The faults of a rehearsal: what is done, and what has to come of it."""

from dataclasses import dataclass
from enum import StrEnum


class Expected(StrEnum):
    """What a fault has to lead to."""

    GOES_ON = "goes on"
    """The task goes on to its end."""
    HOLD = "hold"
    """The task ends, and the robot keeps its balance on both feet until the hoist takes it."""
    FADE = "fade"
    """Motors are held, fade out within two seconds, and are damped."""
    DAMP = "damp"
    """Motors brake at once, and are damped."""
    GUARDIAN = "guardian damps"
    """The same, by the guardian."""
    DRIVES_DAMP = "drives damp"
    """Nobody commands the motors any more, and they damp by themselves."""
    DRIVES_HOLD = "drives hold"
    """Nobody commands the motors any more, and they hold the last command."""
    NOT_READY = "not ready"
    """The motors are told nothing at all."""


@dataclass(frozen=True, slots=True)
class FaultCase:
    """One fault.

    Attributes:
        name: of the case.
        orders: to the twin, one after the other; or to a process: ``kill``, ``stop``, ``slow`` the controller,
            ``kill guardian``.
        expected: what has to come of it.
        cause: what the cause has to contain; empty where there is none.
        within: from the fault to the first sign of the reaction [s].
        brakes: from that to the motors' braking, where they have to [s].
        twin: options of the twin.
    """

    name: str
    orders: tuple[str, ...]
    expected: Expected
    cause: str = ""
    within: float = 0.1
    brakes: float = 0.02
    twin: tuple[str, ...] = ()


FADED = 2.1
"""How long motors may take to fade out [s]."""

MISSING = "no new sound state"

FAULT_CASES = (
    FaultCase("state stream stops", ("state-stop",), Expected.FADE, MISSING, 0.03, FADED),
    FaultCase("one state lost", ("state-lost 1",), Expected.GOES_ON),
    FaultCase("three states lost", ("state-lost 3",), Expected.GOES_ON),
    FaultCase("states 6 ms late", ("state-late 6",), Expected.GOES_ON),
    FaultCase("three states twice", ("state-repeated 3",), Expected.GOES_ON),
    FaultCase("two states out of order", ("state-swapped",), Expected.GOES_ON),
    FaultCase("one wrong check sum", ("state-crc 1",), Expected.GOES_ON),
    FaultCase("wrong check sums", ("state-crc 500",), Expected.FADE, "wrong check sum", 0.03, FADED),
    FaultCase("NaN in one state", ("state-nan 1 left_knee",), Expected.GOES_ON),
    FaultCase("NaN in every state", ("state-nan 500 left_knee",), Expected.FADE, "left_knee", 0.03, FADED),
    FaultCase("encoder of a leg jumps a turn", ("encoder left_knee 1",), Expected.FADE, "left_knee", 0.03, FADED),
    FaultCase(
        "encoder of an arm jumps back a turn", ("encoder right_elbow -1",), Expected.FADE, "right_elbow", 0.03, FADED
    ),
    FaultCase("motor of a leg gets warm", ("hot left_knee 82",), Expected.HOLD, "left_knee", 4.0),
    FaultCase("motor of a leg gets hot", ("hot left_knee 120",), Expected.DAMP, "left_knee", 4.0),
    FaultCase("error of a leg's motor", ("motor-error left_knee 0x1",), Expected.DAMP, "overcurrent", 0.03),
    FaultCase("error of an arm's motor", ("motor-error left_elbow 0x20",), Expected.HOLD, "left_elbow", 0.03),
    FaultCase("battery low", ("battery 15",), Expected.HOLD, "battery", 2.5),
    # two writers fight: motors brake for good when the other one has gone
    FaultCase("foreign writer", ("foreign-writer 1",), Expected.DAMP, "not ours", 0.03, 1.1),
    FaultCase("waist locks itself", ("waist-locked",), Expected.DAMP, "mode_machine", 0.03),
    FaultCase("IMU stuck", ("imu-stuck",), Expected.FADE, "stands still", 0.2, FADED),
    FaultCase("gyro's bias steps by 0.05 rad/s", ("gyro-step 0.05",), Expected.GOES_ON),
    FaultCase("network 4 ms slow, 1 ms uneven, loses 5 %", ("network 4 1 5",), Expected.GOES_ON),
    FaultCase("torque constant 10 % low", ("torque-constant 0.9",), Expected.GOES_ON),
    FaultCase("torque constant 10 % high", ("torque-constant 1.1",), Expected.GOES_ON),
    FaultCase("push of 60 N", ("push 0 60 0 0.1",), Expected.GOES_ON),
    FaultCase("push that topples", ("push 0 500 0 0.5",), Expected.DAMP, "", 2.0),
    FaultCase("remote: L2 + B", ("remote L2 B",), Expected.DAMP, "L2 + B", 0.03),
    FaultCase("remote: select", ("remote select",), Expected.HOLD, "stop", 0.03),
    FaultCase("remote lost", ("remote-lost",), Expected.HOLD, "remote", 3.2),
)
"""Faults that the twin plays while a task is done."""

PROCESS_CASES = (
    FaultCase("controller killed", ("kill",), Expected.GUARDIAN, "", 0.03),
    FaultCase("controller stopped", ("stop",), Expected.GUARDIAN, "", 0.03),
    FaultCase("controller slow, one tick of 20 ms", ("slow",), Expected.GUARDIAN, "", 0.03),
    # what its memory leaves with may keep the machine busy for long enough that states are missed first
    FaultCase("guardian killed", ("kill guardian",), Expected.DAMP, "", 0.05),
    FaultCase("both killed", ("kill both",), Expected.DRIVES_HOLD, twin=("--on-timeout", "hold")),
    FaultCase("both killed, drives damp", ("kill both",), Expected.DRIVES_DAMP, "", 0.2, twin=("--on-timeout", "damp")),
)
"""Faults of the processes."""

BEFORE_CASES = (
    FaultCase("waist locked", ("waist-locked",), Expected.NOT_READY, "variant", 15.0),
    FaultCase("on-board service not released", ("switcher-refuses",), Expected.NOT_READY, "released", 15.0),
    FaultCase("foreign writer", ("foreign-writer 60",), Expected.NOT_READY, "somebody else", 15.0),
    FaultCase("battery low", ("battery 15",), Expected.NOT_READY, "battery", 15.0),
    FaultCase("remote off", ("remote-lost",), Expected.NOT_READY, "remote", 15.0),
    FaultCase("motor error", ("motor-error left_knee 0x1",), Expected.NOT_READY, "left_knee", 15.0),
    FaultCase("no robot", ("state-stop",), Expected.NOT_READY, "no robot", 15.0),
)
"""Faults that are there before the deployment begins."""
