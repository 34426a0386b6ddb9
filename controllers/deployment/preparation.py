"""What comes before the first command: connect, check, release the on-board service."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from controllers.deployment.protection import ProtectionLimits
from controllers.deployment.rest import GRAVITY_ERROR
from robots.errors import SafeWbcError
from robots.messages import Array
from robots.unitree.body import G1Port
from robots.unitree.g1 import MODE_MACHINE, G1Joints
from robots.unitree.messages import StateMessage
from robots.unitree.motor_faults import TIMED_OUT, describe_bits
from robots.unitree.stream import PERIOD, StateStream
from robots.unitree.switcher import SwitcherClient, SwitcherError
from wbc.wrench import GRAVITY

CONNECT_TIME = 10.0
"""How long states are waited for [s]."""

CHECKED = 250
"""Sound states in a row that the checks look at."""

OUTSIDE_AT_MOST = 0.1
"""How far a joint may be outside its limits at the start [rad]."""

MOST_BIAS = 0.2
"""Mean rate of the gyro at rest beyond which it is broken, or the robot swings [rad/s]."""

TILT_ERROR = 0.15
"""How far gravity by accelerometer and by the IMU's own filter may differ [rad]."""

RELEASES = 5
"""How often the service is asked to let go."""

QUIET = 0.3
"""How long nobody else must command the motors before we do [s]."""


class NotReadyError(SafeWbcError):
    """The robot is not ready to be driven: nothing has been sent to its motors."""


@dataclass(frozen=True, slots=True)
class Check:
    """One thing that is looked at before the start.

    Attributes:
        name: what.
        met: whether it is as it has to be.
        text: what was found.
        needed: what is allowed, in words.
    """

    name: str
    met: bool
    text: str
    needed: str


def connect(port: G1Port, stream: StateStream, timeout: float = CONNECT_TIME) -> float:
    """Wait for half a second of sound states; returns their rate [1/s].

    Raises:
        NotReadyError: they have not come within ``timeout`` [s].
    """
    stamps: list[float] = []
    clock = port.clock
    end = clock.now() + timeout
    while len(stamps) < CHECKED:
        for data, arrived in port.receive(min(end, clock.now() + 0.1)):
            if stream.take(data, arrived) is not None:
                stamps.append(arrived)
        if clock.now() > end:
            why = f"{len(stamps)} sound states, {stream.broken} broken, in {timeout:g} s"
            raise NotReadyError(f"no robot: {why}; is the interface right, and the robot on?")
    return (len(stamps) - 1) / max(stamps[-1] - stamps[0], 1e-9)


def checks(
    stream: StateStream, rate: float, battery: float, gyro: Array, limits: ProtectionLimits | None = None
) -> list[Check]:
    """What is looked at before the service is released.

    Args:
        stream: connected.
        rate: of its states [1/s].
        battery: charge, NaN where nothing has been heard of it [%].
        gyro: shape (n, 3) rates of some readings [rad/s].
        limits: of protection.
    """
    limits, message, joints = limits or ProtectionLimits(), stream.message, stream.joints
    motors = message.motors[joints.slots]
    heat, bits = motors["temperature"].max(axis=1), motors["motorstate"] & ~np.uint32(TIMED_OUT)
    names = joints.robot.joint_names
    hottest, faulty = int(np.argmax(heat)), int(np.argmax(bits != 0))
    outside, worst = _outside(joints, motors["q"].astype(float))
    mean = float(np.abs(np.mean(gyro, axis=0)).max()) if len(gyro) else float("nan")
    battery_text = "not heard of: look at it" if np.isnan(battery) else f"{battery:g} %"
    return [
        Check(
            "variant",
            message.mode_machine == MODE_MACHINE,
            f"mode_machine {message.mode_machine}",
            f"{MODE_MACHINE}: 29 joints, the waist not locked",
        ),
        Check("rate of states", abs(rate * PERIOD - 1.0) < 0.1, f"{rate:.0f} Hz", "450 to 550 Hz"),
        Check("broken states", stream.broken == 0, f"{stream.broken}", "none"),
        Check("joints", outside <= OUTSIDE_AT_MOST, _where(worst, outside), "inside limits"),
        Check(
            "temperature",
            bool(heat[hottest] < limits.warm),
            f"{names[hottest]} {heat[hottest]} degrees Celsius",
            f"below {limits.warm:g}",
        ),
        Check(
            "motors",
            not bits.any(),
            f"{names[faulty]}: {describe_bits(int(bits[faulty]))}" if bits.any() else "no errors",
            "no errors",
        ),
        Check("battery", not battery < limits.battery, battery_text, f"{limits.battery:g} % or more"),
        _imu_check(message),
        Check("remote", bool(message.remote.any()), "heard" if message.remote.any() else "silent", "heard"),
        Check("gyro", mean < MOST_BIAS, f"{mean:.3f} rad/s in the mean", f"below {MOST_BIAS:g} rad/s: it hangs still"),
    ]


def _imu_check(message: StateMessage) -> Check:
    """Whether gravity is where the IMU's own filter has it, and as large as it is."""
    imu = message.imu[0]
    w, x, y, z = (float(value) for value in imu["quaternion"])
    force = imu["accelerometer"].astype(float)
    up = np.array([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])
    size = float(np.linalg.norm(force))
    angle = math.acos(max(-1.0, min(1.0, float(up @ force) / max(size, 1e-9))))
    met = abs(size - GRAVITY) < GRAVITY_ERROR and angle < TILT_ERROR
    found = f"{size:.2f} m/s^2, {angle:.2f} rad from where its quaternion has it"
    return Check("gravity", met, found, f"within {GRAVITY_ERROR:g} m/s^2 and {TILT_ERROR:g} rad: it hangs still")


def _outside(joints: G1Joints, q: Array) -> tuple[float, str]:
    lower, upper = joints.robot.position_limits
    outside = np.where(np.isfinite(q), np.maximum(lower - q, q - upper), np.inf)
    i = int(np.argmax(outside))
    return float(outside[i]), joints.robot.joint_names[i]


def _where(joint: str, outside: float) -> str:
    """How far the joint that is worst off is outside its limits, or inside [rad]."""
    return (
        f"{joint} {outside:.2f} rad outside" if outside > 0.0 else f"all within limits, {joint} by {-outside:.2f} rad"
    )


def require_met(found: Sequence[Check]) -> None:
    """Raise :class:`NotReadyError` that names every check that is not met."""
    if missed := [f"{c.name}: {c.text}, must be {c.needed}" for c in found if not c.met]:
        raise NotReadyError("; ".join(missed))


def release(
    switcher: SwitcherClient, port: G1Port, say: Callable[[str], None], pause: float = 1.0, quiet: float = QUIET
) -> None:
    """Have the on-board service let go of the motors, and see that nobody else commands them.

    Raises:
        NotReadyError: it does not, or somebody does; says whether the robot may be limp.
    """
    released = ""
    try:
        for _ in range(RELEASES):
            if not (name := switcher.mode()):
                break
            switcher.release()
            released = "; it was released: THE ROBOT IS LIMP"
            say(f"on-board service {name!r} was active, and is released: the robot is limp now")
            port.clock.sleep(pause)
        if name := switcher.mode():
            raise NotReadyError(f"the on-board service {name!r} is active after {RELEASES} releases{released}")
    except SwitcherError as error:
        raise NotReadyError(f"{error}{released}") from error
    port.strangers()
    port.clock.sleep(quiet)
    if count := port.strangers():
        others = f"{count} commands on rt/lowcmd in {quiet:g} s"
        raise NotReadyError(f"somebody else commands the motors: {others}{released}")
