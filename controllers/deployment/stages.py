"""Stages of a deployment, in order: what the motors are told in each, and what ends it."""

from dataclasses import dataclass
from enum import StrEnum

from robots.unitree.remote import button_bits


class Stage(StrEnum):
    """Where a deployment is."""

    CONNECT = "connect"
    CHECKS = "checks"
    RELEASE = "release"
    ZERO_TORQUE = "zero torque"
    DAMPING = "damping"
    POSTURE = "posture while hung"
    CALIBRATION = "calibration"
    HUNG = "hung under control"
    LOWERED = "lowered"
    STANDING = "standing"
    TASK = "task"
    STOPPING = "stopping"
    DAMPED = "latched damping"


@dataclass(frozen=True, slots=True)
class StageRow:
    """One stage of the table.

    Attributes:
        stage: which one.
        motors: what they are told.
        person: what the person at the robot does or sees.
        ends: what ends it, and leads to the next one.
        asks: whether a person's go is among that.
    """

    stage: Stage
    motors: str
    person: str
    ends: str
    asks: bool


STAGES = (
    StageRow(Stage.CONNECT, "nothing", "waits", "states come in, soundly, for half a second", False),
    StageRow(Stage.CHECKS, "nothing", "reads what is checked", "every check is met, and go", True),
    StageRow(
        Stage.RELEASE,
        "nothing; the on-board service lets go of them, and the robot hangs limp",
        "sees that it hangs",
        "no service is active, and nobody else commands the motors",
        False,
    ),
    StageRow(Stage.ZERO_TORQUE, "on, with all gains and torques zero", "moves a limb by hand", "go", True),
    StageRow(Stage.DAMPING, "to brake", "feels that limbs resist", "go", True),
    StageRow(Stage.POSTURE, "to go to the task's posture in 4 s, and hold it", "steadies the robot", "go", True),
    StageRow(
        Stage.CALIBRATION,
        "to hold the posture",
        "lets the robot hang still",
        "two seconds without motion: the gyro's bias is known",
        False,
    ),
    StageRow(
        Stage.HUNG,
        "to hold the posture; the controller computes beside it, and nothing of that is sent",
        "reads the times of the ticks",
        "go",
        True,
    ),
    StageRow(
        Stage.LOWERED,
        "to hold the posture",
        "says go, then lowers the hoist",
        "go, and then feet that carry more than half of the weight for a quarter of a second, with little motion",
        True,
    ),
    StageRow(Stage.STANDING, "what the controller says: the robot stands by itself", "sees that it stands", "go", True),
    StageRow(Stage.TASK, "what the controller says", "watches", "its time is over, or stop", False),
    StageRow(
        Stage.STOPPING,
        "what the controller says: the task comes to rest, balance is kept",
        "raises the hoist",
        "the feet carry nothing any more for a quarter of a second; or less than half, and go",
        True,
    ),
    StageRow(
        Stage.DAMPED,
        "to brake, for good",
        "switches the robot off",
        "no states come any more, for 2 s; or go, and 2 s have passed: nobody commands the motors then",
        True,
    ),
)
"""The table; a fault leads from any stage to stopping or to latched damping, see
:mod:`controllers.deployment.protection`."""

BUTTONS = (
    ("A", "go: on to the next stage, where the stage asks for it"),
    ("select", "stop: the task ends, the robot comes to rest and keeps its balance; before it stands, damping"),
    ("L2 + B", "damp, at once and for good, whatever the controller does"),
)
"""What the remote's buttons do."""

KEYS = (("Enter", "go"), ("s", "stop"), ("d", "damp"))
"""The same on a keyboard, each with Enter."""


DAMP_BITS = button_bits("L2", "B")
"""Of the remote's buttons: damp."""


def row_of(stage: Stage) -> StageRow:
    """What the table says of a stage."""
    return next(row for row in STAGES if row.stage is stage)


def explain(stage: Stage) -> str:
    """What a person at the robot is told when a stage begins, in a line."""
    row = row_of(stage)
    return f"  motors are told {row.motors}; the person {row.person}; it ends when: {row.ends}"
