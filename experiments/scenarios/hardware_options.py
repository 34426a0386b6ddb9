"""Options of what has to do with a real robot: its twin. Nothing heavy is imported here."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro


@dataclass(frozen=True)
class TwinOptions:
    """Play a G1 over DDS in real time, hanging from a hoist, until it is told to end.

    Orders come from standard input, a line each: lower, raise, status, end, clear [FAULT], or a fault by its name. What
    is carried out is printed with the simulated time.
    """

    robot: tyro.conf.Positional[Literal["g1"]]
    """Robot to play."""
    domain: int = 1
    """DDS domain, 1 to 230; 0 is the robot's."""
    interface: str = "lo"
    """Network interface; lo for this machine alone."""
    mass_scale: float = 1.0
    """Factor on every mass and inertia of the played robot; the controller keeps its nominal model [-]."""
    friction: float = 0.8
    """Friction coefficient of soles and ground [-]."""
    sensor_errors: float = 1.0
    """Errors of the sensors, as a multiple of 0.01 rad/s of bias and 5 mrad/s of noise of the gyro, 0.05 m/s^2 of both
    of the accelerometer, 0.1 mrad, 0.02 rad/s and 0.5 N m of noise of each joint [-]."""
    gyro_drift: float = 0.0
    """What the gyro's bias moves by in a minute [rad/s]."""
    torque_constant: float = 1.0
    """What the motors take a torque of 1 N m for [N m]."""
    seed: int = 0
    """Seed of errors, noise and losses."""
    on_timeout: Literal["hold", "damp"] = "hold"
    """What the motors do when commands stop: hold the last one, or damp."""
    motor_timeout: float = 0.1
    """Time without a command after which they do [s]."""
    script: Path | None = None
    """File of orders, a line each, its time before it [s]."""
    record: Path | None = None
    """Write what was true to this .npz file."""
    duration: float | None = None
    """Simulated time after which it ends; never if not given [s]."""
    cpu: int | None = None
    """Core to run on; any if not given."""
    clock: Path | None = None
    """Make a clock in this file, and wait for everybody who goes by it: a deployment with the same --clock."""


@dataclass(frozen=True)
class DeployCommon:
    """Drive a Unitree G1 over DDS: see docs/hardware.md, and never without a hoist.

    Each stage waits for a person: A at the remote, or Enter. select or s: stop. L2 + B or d: damp.
    """

    robot: tyro.conf.Positional[Literal["g1"]]
    """Robot to drive."""
    interface: str
    """Network interface to the robot, for example eth0; lo for a twin on this machine."""
    domain: int = 0
    """DDS domain; 0 is the robot's, 1 the twin's."""
    yes: bool = False
    """Go on from stage to stage without a person; only on lo, where no robot is."""
    dry_run: bool = False
    """All but writing: connect, check, calibrate, and compute ticks for ten seconds; nothing is sent or released."""
    out: Path | None = None
    """Folder of log and summary; runs/deploy-<task>-<time> if not given."""
    log_seconds: float = 300.0
    """What the ring of the log holds, about 1.7 MB a second [s]."""
    cpu: int | None = None
    """Core for the controller; any if not given."""
    clock: Path | None = None
    """Go by the clock of a twin that waits, by its file, instead of by this machine's; only on lo."""


@dataclass(frozen=True)
class MotorCheckOptions:
    """One motor while the robot hangs: its feed-forward torque goes up and down, and vibration is measured."""

    joint: str = "left_elbow_joint"
    """Joint of the description."""
    torque: float = 2.0
    """At the top, up to half of the motor's limit [N m]."""
    low_pass: float = 0.0
    """Corner frequency of a low-pass of the torque; 0 for none [Hz]."""


@dataclass(frozen=True)
class RehearseOptions:
    """Rehearse a deployment against a twin, and print what came of it: a row for each rehearsal.

    stand, hands, taichi, walk, turns, fast: the tasks, each with as many twins as --seeds says, whose mass is 1, 1.2,
    0.9 of the model's in turn, and whose gyro's bias is constant or drifts. faults: every fault, while the robot does
    each task of --during. before: faults that are there before the start. kills: the controller killed, and stopped, at
    instants drawn from the seeds. Twin, controller and guardian are processes that talk over DDS on this machine, in
    real time. With --lockstep the same processes go by the twin's clock, which waits for them: what a machine that is
    slow, or shared, cannot show in real time, but no deadlines. With --in-process one process in simulated time, which
    shows neither deadlines nor the guardian.
    """

    robot: tyro.conf.Positional[Literal["g1"]]
    """Robot to rehearse with."""
    what: tyro.conf.Positional[
        tuple[
            Literal["stand", "hands", "taichi", "walk", "turns", "fast", "tasks", "faults", "before", "kills", "short"],
            ...,
        ]
    ]
    """What to rehearse; tasks: all of them; short: standing, and one fault, in a minute."""
    seeds: int = 1
    """Twins of each task, and instants of kills [-]."""
    during: tuple[Literal["stand", "walk"], ...] = ("stand", "walk")
    """Only with faults: tasks that they come into."""
    fault: tuple[str, ...] = ()
    """Only with faults and before: those whose names hold one of these; all if not given."""
    in_process: bool = False
    """In one process and simulated time; tasks and faults of the twin only."""
    lockstep: bool = False
    """Processes by the twin's clock, which waits for them."""
    jobs: int = 1
    """Only with --in-process or --lockstep: rehearsals side by side [-]."""
    domain: int = 1
    """DDS domain, 1 to 230."""
    out: Path | None = None
    """Folder of the results; runs/rehearsal-<time> if not given. What it holds already is not done again."""
