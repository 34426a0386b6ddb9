"""Options of the runs: what the command line offers, as dataclasses; nothing heavy is imported here."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro


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
    """Folder of the results; runs/<experiment>-<time> if not given."""
    report: bool = True
    """Write report.html."""
    video: bool = True
    """Write video.mp4 where rendering is available."""


@dataclass(frozen=True)
class RunOptions:
    """What every run has."""

    robot: str = "g1"
    """Robot: g1, tocabi, or the path of a .toml description."""
    duration: float = 10.0
    """Simulated time [s]."""
    control_rate: float = 500.0
    """Control frequency; its period must be a whole number of physics steps [Hz]."""
    seed: int = 0
    """Seed of everything random: the sensor noise of --noise-scale and, with --obstacle, that of the obstacle's
    sensor [-]."""
    nan_at: float | None = None
    """Turn one measured joint position into NaN from this time on, to see the controlled stop [s]."""
    singular: str | None = None
    """What inverse kinematics does with small singular values: damped, so that velocities do not jump, or cut, as in
    the paper (docs/controller.md); the robot's own tuning if not given."""
    plant: Annotated[PlantOptions, tyro.conf.arg(name="")] = field(default_factory=PlantOptions)
    safety: Annotated[FilterOptions, tyro.conf.arg(name="")] = field(default_factory=FilterOptions)
    output: Annotated[OutputOptions, tyro.conf.arg(name="")] = field(default_factory=OutputOptions)


@dataclass(frozen=True)
class StandOptions(RunOptions):
    """Stand still on both feet."""


@dataclass(frozen=True)
class HandTrackingOptions(RunOptions):
    """Both hands follow references while the robot stands: circles through the torso, targets in it or beyond reach."""

    duration: float = 12.0
    """Simulated time [s]."""
    motion: str = "circles"
    """Hand motion: circles (3D circles through the torso), beyond-reach (targets 30 cm out of reach), target (both in
    one jump to --target), cross (each to where the other was) or hold."""
    target: tuple[float, float, float] = (0.0, 0.03, 0.0)
    """Only with --motion target: where the left hand is sent, from the origin of the torso's frame in the world's axes;
    the right one mirrors it [m m m]."""
    obstacle: bool = False
    """A sphere of 8 cm radius passes through where the hands start, from left to right at 0.25 m/s. Best with
    --motion hold: circles and beyond-reach have taken the hands elsewhere when it arrives, after two to three
    seconds."""
    obstacle_rate: float = 60.0
    """Only with --obstacle: how often its position is measured; its velocity comes from a Kalman filter [Hz]."""
    obstacle_noise: float = 0.005
    """Only with --obstacle: standard deviation of each measured coordinate [m]."""
    obstacle_velocity: str = "estimated"
    """Only with --obstacle: what the filter is told of its velocity: estimated, zero or true, to compare."""
    obstacle_kappa: float = 0.0
    """Only with --obstacle: by how many standard deviations of its estimated position it is taken as larger [-]."""
    obstacle_lost_at: float | None = None
    """Only with --obstacle: it is not seen any more from this time on, to see the controlled stop [s]."""


@dataclass(frozen=True)
class TaichiOptions(RunOptions):
    """Stand on the left leg while both hands go to far targets.

    The CoM goes over the left foot in 10 s; then the right foot is up for 10 s, and comes down again.
    """

    duration: float = 30.0
    """Simulated time [s]."""
    torque: str = "full"
    """What the motors are told: full; pd-only (no torque of DynWBC, only joint PD); gravity (gravity compensation and
    joint PD: no wrench tracking, no contact wrench cone)."""
    load_estimate: bool = False
    """Estimate the robot's mass from the forces under its feet; the controller's model then follows."""
    push: tuple[str, ...] = ()
    """Pushes of 0.1 s at the torso: N,direction,time, with forward, left, backward, right or degrees from the world's
    x axis; for example 60,left,17.5."""


@dataclass(frozen=True)
class LateralStepsOptions(RunOptions):
    """Side steps whose nominal footholds lie so close that the feet would collide."""

    duration: float = 16.0
    """Simulated time [s]."""
    load_estimate: bool = True
    """Estimate the robot's mass from the forces under its feet; the controller's model then follows."""


@dataclass(frozen=True)
class WalkOptions(RunOptions):
    """Walk at a commanded velocity of the body, or by a script of commands.

    The robot stands for the first second, and is told to stop 3 s before the end.
    Without a script and with --vx 0 --vy 0 --wz 0 it steps on the spot.
    """

    duration: float = 20.0
    """Simulated time, above 4 s [s]."""
    vx: float = 0.2
    """Velocity forward [m/s]."""
    vy: float = 0.0
    """Velocity to the left [m/s]."""
    wz: float = 0.0
    """Turning to the left [rad/s]."""
    script: Path | None = None
    """File of commands, one a line: time [s], vx [m/s], vy [m/s], wz [rad/s]; or time and the word stop, or step (on
    the spot). Each holds until the next; # begins a comment. Takes the place of --vx --vy --wz."""
    hands: bool = False
    """Hold the hands in front of the body, as tasks; otherwise the arms keep their posture."""
    load_estimate: bool = True
    """Estimate the robot's mass from the forces under its feet; the controller's model then follows."""
    push: tuple[str, ...] = ()
    """Pushes of 0.1 s at the torso: N,direction,time, with forward, left, backward, right or degrees from the world's
    x axis; for example 80,left,5."""
    obstacle: str = "none"
    """A sphere of 8 cm radius to the left of the way at the height of the left hand, 4 cm into where the hand goes:
    none, static, or moving (towards the robot at 0.25 m/s); only on a straight walk forward."""


@dataclass(frozen=True)
class CorridorOptions:
    """Filters side by side where conditions conflict: boards close about a hand, a sphere comes to the elbow.

    A G1 on a fixed base, moved by velocities at 100 Hz: it does exactly what the filter says.
    """

    filters: tuple[str, ...] = ("ssa-naive", "ssa", "rssa", "pssa", "cbf", "issf")
    """Filters to run: ssa-naive (passes the nominal velocity on where it has no solution), none, cbf, issf, ssa, rssa,
    pssa, sss, pfm, sma."""
    duration: float = 12.0
    """Simulated time; the scene takes 12 s [s]."""
    seed: int | None = None
    """Moves goals and sphere by some millimetres; without it everything is where it was designed to be [-]."""
    weight: float = 10.0
    """Weight Q_s of the squared violations in r-SSA [rad^2/m^2]."""
    margins: str = "shared"
    """shared: every filter keeps 5 cm to obstacles and 1 cm between bodies; own: CBF and ISSf-CBF none, as in their own
    paper."""
    gap: float = 0.14
    """Distance of the boards once they have closed; the hand's sphere takes 0.10 m of it, and needs 0.20 m to keep
    5 cm to either board [m]."""
    out: Path | None = None
    """Folder of the results; runs/corridor-<time> if not given."""
    report: bool = True
    """Write report.html."""


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
class TableOptions:
    """Make every run that a page of the documentation quotes, and print its tables.

    Some minutes on two cores.
    """

    what: tyro.conf.Positional[Literal["results", "safety", "friction"]] = "results"
    """Which page's: docs/results.md or docs/safety.md; friction: what docs/safety.md says of dry friction."""
    jobs: int = 2
    """Runs at a time [-]."""
    out: Path | None = None
    """Folder of the runs, each in a folder of its own; runs/table-<time> if not given."""


@dataclass(frozen=True)
class ReplayOptions:
    """Run a saved run again by its config.json, and say whether every recorded array but the times is the same.

    The exit code is 0 where all are the same bit by bit, 1 where not.
    """

    folder: tyro.conf.Positional[Path]
    """Folder of a run: with config.json, summary.json and series.npz."""


@dataclass(frozen=True)
class DoctorOptions:
    """Check the installation: imports, solvers, kernels, rendering."""
