"""Options of the runs: what the command line offers, as dataclasses; nothing heavy is imported here."""

from collections.abc import Sequence
from dataclasses import MISSING, dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from robots.errors import WithoutEffectError


def refuse_without(options: Any, given: bool, names: Sequence[str], needed: str) -> None:
    """Raise :class:`WithoutEffectError` where one of the fields ``names`` is set without what they need, ``given``."""
    for field_ in fields(options):
        value = getattr(options, field_.name)
        usual = field_.default if field_.default_factory is MISSING else field_.default_factory()
        if not given and field_.name in names and value != usual:
            raise WithoutEffectError(field_.name, value, f"left out without {needed}: it has no effect")


@dataclass(frozen=True)
class PlantOptions:
    """How the simulated robot differs from the controller's model."""

    mass_scale: float = 1.0
    """Factor on every mass and inertia of the simulated robot; the controller keeps its nominal model [-]."""
    link_mass: dict[str, float] = field(default_factory=dict)
    """Factor on single bodies' masses, by body name, on top of --mass-scale [-]."""
    com_shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Shift of the torso's centre of mass in its own axes [m m m]."""
    friction: float = 0.8
    """Friction coefficient of soles and ground [-]."""
    joint_friction_scale: float = 1.0
    """Factor on the joints' dry and viscous friction [-]."""
    armature_scale: float = 1.0
    """Factor on the reflected rotor inertias [-]."""
    actuator_delay: float = 0.0
    """Time from command to torque [s]."""
    noise_scale: float = 0.0
    """White sensor noise, as a multiple of what is left behind encoders and a state estimator: joints 0.1 mrad and
    0.01 rad/s, base 0.2 mm, 0.3 mrad, 5 mm/s and 5 mrad/s [-]."""
    physics_dt: float = 0.001
    """Physics step [s]."""


@dataclass(frozen=True)
class SensingOptions:
    """What the controller is told of the robot's state."""

    state: Literal["true", "estimated", "estimated-base", "estimated-forces"] = "true"
    """true: the simulator's own state, with the noise of --noise-scale; estimated: what a state estimator makes of IMU,
    encoders and motor torques alone, with their errors (docs/estimation.md); estimated-base: with the true forces under
    the feet; estimated-forces: forces and contacts estimated, beside the true base."""
    sensor_errors: float = 1.0
    """Only with --state estimated: errors of these sensors, as a multiple of 0.01 rad/s of bias and 5 mrad/s of noise
    of the gyro, 0.05 m/s^2 of both of the accelerometer, 0.1 mrad, 0.02 rad/s and 0.5 N m of noise of each joint
    [-]."""
    gyro_drift: float = 0.0
    """Only with --state estimated: what the gyro's bias moves by in a minute [rad/s]."""
    torque_constant: float = 1.0
    """Only with --state estimated: what the motors take a torque of 1 N m for [N m]."""
    estimator: Literal["invariant", "simple"] = "invariant"
    """Only with --state estimated: filter of the base: the invariant Kalman filter, or a complementary filter with a
    Kalman filter for each axis."""


@dataclass(frozen=True)
class FilterOptions:
    """The safety filter."""

    filter: str = "issf"
    """Safety filter: none, cbf, issf, ecbf, ssa, rssa, pssa, sss, pfm or sma (docs/safety.md)."""
    alpha: float | None = None
    """Slope of the self-collision condition of arms, torso and head; the robot's own tuning if not given. The other
    families (legs, joint limits, obstacles, workspace) are set in the description's [tuning.safety], with cbf in its
    [tuning.cbf] [1/s]."""
    epsilon: float | None = None
    """ISSf parameter of the same condition, smaller is more cautious; the robot's own tuning if not given. The other
    families are set in the description's [tuning.safety] [m s/rad^2]."""
    layer: float | None = None
    """Depth inside the margin over which SSA, r-SSA, p-SSA and SSS become active, all families; 0 for the papers'
    switch at the margin; the robot's own tuning if not given [m, rad]."""
    tuning: Path | None = None
    """File of parameters for any of the families, as `safewbc tune` writes it, for ISSf; --alpha and --epsilon come
    before it. With cbf it takes the place of [tuning.cbf] too."""
    adaptive: bool = False
    """Only with issf: make epsilon of a row smaller while a disturbance is seen to push it in (docs/safety.md)."""


@dataclass(frozen=True)
class OutputOptions:
    """Where results go."""

    out: Path | None = None
    """Folder of the results; runs/<scenario>-<time> if not given."""
    report: bool = True
    """Write report.html."""
    video: bool = True
    """Write video.mp4 where rendering is available."""
    overwrite: bool = False
    """Write over a run that the folder holds already; it is kept until the new one is whole."""


@dataclass(frozen=True)
class DemoOptions:
    """Hand tracking on the G1, 20 % heavier than its model, without and with the safety filter, side by side."""

    robot: str = "g1"
    """Robot: g1, tocabi, or the path of a .toml description with [tuning.hand_tracking] (docs/robots.md)."""
    mass_scale: float = 1.2
    """Factor on every mass of the simulated robot [-]."""
    duration: float = 12.0
    """Simulated time of each run [s]."""
    output: Annotated[OutputOptions, tyro.conf.arg(name="")] = field(default_factory=OutputOptions)


@dataclass(frozen=True)
class BenchOptions:
    """Measure, and print the figures.

    tick: one control tick, stage by stage, over a recorded run of each robot. first: the first tick of a new process,
    with and without warm-up. rows: what a tick costs against the number of barrier rows and of joints. worst: whole
    ticks of each robot among obstacles that jump, spin, race and press, and with targets out of reach: which are late.
    loop: wall time over simulated time of hand tracking and a walk at 500 Hz and 2 kHz, by part. filters: every safety
    filter over the same recorded states of the G1 as 19 spheres, at 31, 219 and 979 barrier rows and 17, 20 and 35
    variables, where the conditions can be met and where they cannot. peers: inverse kinematics with self-collision
    avoidance of the G1, by us, mink and pink; the extra bench installs the others. tracking: how well moving obstacles
    are tracked, and what the estimated velocity is worth to the filter. recovery: how filters leave a start with the
    arms inside the torso. straight: what commands do where arms go straight, with small singular values damped and cut.
    """

    what: tyro.conf.Positional[
        Literal["tick", "first", "rows", "worst", "loop", "filters", "peers", "tracking", "recovery", "straight"]
    ]
    """What to measure."""
    robots: tuple[str, ...] = ("g1", "tocabi")
    """Only with tick, first, rows, worst and loop: robots to measure: g1, tocabi, or paths of .toml descriptions
    with a table [tuning.hand_tracking]."""
    ticks: int | None = None
    """Ticks to measure, at least 100 of tick and peers (5000 if not given), rows (3000 of each size) and worst (100000,
    of all sequences together), 10 of filters (300 of each size if not given) [-]."""
    filter: str = "issf"
    """Only with tick, first, rows, worst and loop: safety filter, as for the runs."""
    filters: tuple[str, ...] | None = None
    """Only with filters: which ones; all if not given."""
    solver: str = "daqp"
    """Only with tick, rows and worst: QP solver of DynWBC: daqp or proxqp."""
    out: Path | None = None
    """Write the figures as JSON to this file too; of tracking, recovery and straight also a plot, as PNG beside it."""


@dataclass(frozen=True)
class ReplayOptions:
    """Run a saved run again by its config.json, and say whether every recorded array but the times is the same.

    Of a deployment, every command is computed again from the log and compared. The exit code is 0 where all are the
    same bit by bit, 1 where not.
    """

    folder: tyro.conf.Positional[Path]
    """Folder of a run: with config.json, summary.json and series.npz; or of a deployment: with log.bin, or that
    file."""
    report: bool = False
    """Only of a deployment: write what was measured, estimated and told, with a page, to the folder run beside its
    log."""
    mcap: Path | None = None
    """Only of a deployment: write its states, commands and events to this MCAP file."""


@dataclass(frozen=True)
class DoctorOptions:
    """Check the installation: imports, solvers, kernels, rendering. With --g1: the way to a robot."""

    g1: bool = False
    """Check what is needed before the first connection to a G1 instead, and listen to it; nothing is sent to its
    motors."""
    interface: str = "eth0"
    """Only with --g1: network interface to the robot; lo for a twin on this machine."""
    domain: int = 0
    """Only with --g1: DDS domain; 0 is the robot's, 1 the twin's [-]."""
