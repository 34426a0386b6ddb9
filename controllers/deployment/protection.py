"""What is watched while a robot is driven, and what each fault leads to.

Limits of temperature, battery and rates follow the manufacturer's (unitree_sdk2, robot/g1/common/terminations.hpp),
with the lower of two where sources differ in which sensor is which. Tilt, height and rates of the base are the
supervisor's, in simulation too (:mod:`controllers.motion_limits`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from controllers.deployment.stages import DAMP_BITS
from robots.errors import ConfigError
from robots.messages import Array, SensorReading
from robots.unitree.g1 import MODE_MACHINE, G1Joints
from robots.unitree.messages import StateMessage
from robots.unitree.motor_faults import TIMED_OUT, describe_bits


class Reaction(IntEnum):
    """What a fault leads to; a later one is stronger."""

    NONE = 0
    HOLD = 1
    """The task ends, balance is kept; before the robot stands by itself, the motors brake."""
    FADE = 2
    """Set-points held, then faded out to damping: see :class:`controllers.supervisor.Supervisor`."""
    DAMP = 3
    """The motors brake at once."""


@dataclass(frozen=True, slots=True)
class ProtectionLimits:
    """Limits of a G1.

    Attributes:
        warm: of a motor's casing or winding, whichever is hotter, beyond which the task ends [degrees Celsius].
        hot: beyond which the motors only brake [degrees Celsius].
        joint_rate: beyond which the motors only brake [rad/s].
        battery: below which the task ends [%].
        remote_silent: without anything from the remote, after which the task ends [s].
        guardian_silent: without a sign of the guardian, as watched, after which the motors only brake [s].
        jump: of a joint from one state to the next beyond what its limit of speed allows [rad].
        set_point_jump: of a set-point from one command to the next beyond what the joint's limit of speed allows, where
            its gain is not zero [rad].
        torque_jump: of a feed-forward torque from one command to the next, as a fraction of its limit.
    """

    warm: float = 80.0
    hot: float = 85.0
    joint_rate: float = 10.0
    battery: float = 20.0
    remote_silent: float = 3.0
    guardian_silent: float = 0.02
    jump: float = 0.2
    set_point_jump: float = 0.1
    torque_jump: float = 1.5


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What is known beside the robot's states.

    Attributes:
        go: a person's go at the keyboard.
        stop: likewise.
        damp: likewise.
        battery: charge, NaN where nothing has been heard of it [%].
        strangers: commands of others since the last period.
        guardian_age: time since the guardian's last sign [s].
        late: commands in a row that were not ready in time.
    """

    go: bool = False
    stop: bool = False
    damp: bool = False
    battery: float = float("nan")
    strangers: int = 0
    guardian_age: float = 0.0
    late: int = 0


LATE_IN_A_ROW = 25
"""Commands in a row that were not ready within a period, after which the motors fade out: 50 ms or more."""


@dataclass(frozen=True, slots=True)
class Rule:
    """One thing that is watched.

    Attributes:
        name: in the log.
        reaction: what it leads to.
        periods: for how many periods in a row it has to be so.
        limit: in words.
        of_state: whether it looks at the robot's state: then only new ones count.
    """

    name: str
    reaction: Reaction
    periods: int
    limit: str
    of_state: bool = True


SECOND = 500
"""Periods in a second."""

RULES = (
    Rule("person", Reaction.DAMP, 1, "L2 + B at the remote, d at the keyboard", False),
    Rule("stranger", Reaction.DAMP, 1, "a command on rt/lowcmd that is not ours", False),
    Rule("variant", Reaction.DAMP, 2, "mode_machine is not 5 any more"),
    Rule("guardian", Reaction.DAMP, 1, "no sign of the guardian for 20 ms", False),
    Rule("motor error", Reaction.DAMP, 2, "a bit of motorstate of a leg or the waist"),
    Rule("hot motor", Reaction.DAMP, 2, "85 degrees Celsius of casing or winding"),
    Rule("joint rate", Reaction.DAMP, 2, "10 rad/s of a joint"),
    Rule("late", Reaction.FADE, 1, "25 commands in a row not ready within 2 ms", False),
    Rule("gyro", Reaction.FADE, 50, "the same to the last bit, for 100 ms"),
    Rule("accelerometer", Reaction.FADE, 50, "the same to the last bit, for 100 ms"),
    Rule("arm motor error", Reaction.HOLD, 2, "a bit of motorstate of an arm"),
    Rule("warm motor", Reaction.HOLD, SECOND, "80 degrees Celsius of casing or winding"),
    Rule("battery", Reaction.HOLD, SECOND, "below 20 %", False),
    Rule("remote", Reaction.HOLD, 3 * SECOND, "nothing from the remote, for 3 s"),
)
"""What is watched beside the states themselves; see the table in docs/hardware.md."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """What protection came to: the strongest reaction, and its cause in words."""

    reaction: Reaction
    cause: str


SOUND = Verdict(Reaction.NONE, "")


class Protection:
    """Watches a robot's states and surroundings, period by period."""

    def __init__(self, joints: G1Joints, limits: ProtectionLimits | None = None) -> None:
        self._joints, self.limits = joints, limits or ProtectionLimits()
        names = joints.robot.joint_names
        self._is_arm = np.array([any(part in name for part in ("shoulder", "elbow", "wrist")) for name in names])
        self._in_a_row = dict.fromkeys((rule.name for rule in RULES), 0)
        self._said: dict[str, bytes] = {}
        self._commanded = False
        self._checks: dict[str, Callable[[StateMessage, Surroundings], str]] = {
            "person": self._person,
            "stranger": self._stranger,
            "variant": self._variant,
            "guardian": self._guardian,
            "motor error": self._motor_error,
            "hot motor": lambda m, s: self._heat(m, self.limits.hot),
            "joint rate": self._rate,
            "late": self._late,
            "arm motor error": self._arm_error,
            "warm motor": lambda m, s: self._heat(m, self.limits.warm),
            "battery": self._battery,
            "remote": self._remote,
            "gyro": lambda m, s: self._stuck(m, "gyroscope"),
            "accelerometer": lambda m, s: self._stuck(m, "accelerometer"),
        }
        if set(self._checks) != set(self._in_a_row):
            raise ConfigError("rules", sorted(set(self._checks) ^ set(self._in_a_row)), "one check each")

    def inspect(self, message: StateMessage, around: Surroundings, commanded: bool, fresh: bool = True) -> Verdict:
        """What the last sound state and the surroundings come to; call it once a period.

        Args:
            message: the last sound state.
            around: the robot.
            commanded: whether the motors have been told something for half a second: before, that they wait for it is
                no fault.
            fresh: whether the state is a new one, and was believed; a rule of the state waits for one.
        """
        self._commanded = commanded
        verdict = SOUND
        for rule in RULES:
            if rule.of_state and not fresh:
                continue
            cause = self._checks[rule.name](message, around)
            self._in_a_row[rule.name] = self._in_a_row[rule.name] + 1 if cause else 0
            if self._in_a_row[rule.name] >= rule.periods and rule.reaction > verdict.reaction:
                verdict = Verdict(rule.reaction, f"{rule.name}: {cause}")
        return verdict

    def _person(self, message: StateMessage, around: Surroundings) -> str:
        if around.damp:
            return "d at the keyboard"
        return "L2 + B at the remote" if message.buttons & DAMP_BITS == DAMP_BITS else ""

    def _stranger(self, message: StateMessage, around: Surroundings) -> str:
        return f"{around.strangers} commands on rt/lowcmd that are not ours" if around.strangers else ""

    def _variant(self, message: StateMessage, around: Surroundings) -> str:
        return "" if message.mode_machine == MODE_MACHINE else f"mode_machine is {message.mode_machine}"

    def _guardian(self, message: StateMessage, around: Surroundings) -> str:
        if around.guardian_age <= self.limits.guardian_silent:
            return ""
        return f"no sign of the guardian for {1e3 * around.guardian_age:.0f} ms"

    def _motor_error(self, message: StateMessage, around: Surroundings) -> str:
        return self._error_of(message, ~self._is_arm)

    def _arm_error(self, message: StateMessage, around: Surroundings) -> str:
        return self._error_of(message, self._is_arm)

    def _error_of(self, message: StateMessage, which: Array) -> str:
        bits = message.motors["motorstate"][self._joints.slots]
        if not self._commanded:
            bits = bits & ~np.uint32(TIMED_OUT)
        if not (bits[which]).any():
            return ""
        i = int(np.flatnonzero((bits != 0) & which)[0])
        return f"{self._joints.robot.joint_names[i]}: {describe_bits(int(bits[i]))}"

    def _heat(self, message: StateMessage, limit: float) -> str:
        heat = message.motors["temperature"][self._joints.slots].max(axis=1)
        i = int(np.argmax(heat))
        return "" if heat[i] < limit else f"{self._joints.robot.joint_names[i]} has {heat[i]} degrees Celsius"

    def _rate(self, message: StateMessage, around: Surroundings) -> str:
        rates = np.abs(message.motors["dq"][self._joints.slots])
        i = int(np.argmax(rates))
        fast = rates[i] > self.limits.joint_rate
        return f"{self._joints.robot.joint_names[i]} turns at {rates[i]:.1f} rad/s" if fast else ""

    def _late(self, message: StateMessage, around: Surroundings) -> str:
        return f"{around.late} commands in a row not ready in time" if around.late >= LATE_IN_A_ROW else ""

    def _battery(self, message: StateMessage, around: Surroundings) -> str:
        return f"{around.battery:g} %" if around.battery < self.limits.battery else ""

    def _remote(self, message: StateMessage, around: Surroundings) -> str:
        return "" if message.remote.any() else "nothing comes from the remote"

    def _stuck(self, message: StateMessage, field: str) -> str:
        now = message.imu[0][field].tobytes()
        same, self._said[field] = now == self._said.get(field), now
        return "it stands still" if same else ""


class ReadingCheck:
    """Finds readings that cannot be: numbers that are none, joints that jump.

    Attributes:
        lost: shape (nj,) joints whose position is not to be believed.
    """

    def __init__(self, joints: G1Joints, limits: ProtectionLimits | None = None) -> None:
        self._names = joints.robot.joint_names
        self._speed = joints.robot.joint_array("velocity")
        self._jump = (limits or ProtectionLimits()).jump
        self._last: SensorReading | None = None
        self.lost = np.zeros(len(self._names), dtype=bool)

    def inspect(self, reading: SensorReading) -> str | None:
        """What cannot be in a reading, in words; ``None`` where all is well, and it is the one to compare with next."""
        for name in ("joint_position", "joint_velocity", "torque"):
            values = getattr(reading, name)
            finite = np.isfinite(values)
            if not finite.all():
                i = int(np.argmin(finite))
                self.lost[:] = ~finite & (name == "joint_position")
                return f"{name.replace('_', ' ')} of {self._names[i]} is {values[i]:g}"
        for name in ("gyro", "accelerometer"):
            if not np.isfinite(getattr(reading, name)).all():
                return f"{name} is not finite"
        if (last := self._last) is not None:
            dt = reading.stamp - last.stamp
            moved = np.abs(reading.joint_position - last.joint_position)
            self.lost[:] = moved > self._jump + dt * self._speed
            if self.lost.any():
                i = int(np.argmax(moved))
                return f"position of {self._names[i]} jumps by {moved[i]:.2f} rad in {1e3 * dt:.1f} ms"
        self._last = reading
        return None
