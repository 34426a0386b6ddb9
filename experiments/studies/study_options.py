"""Options of the studies, which are made of many runs; nothing heavy is imported here."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from experiments.studies.work import WorkOptions

SECTIONS = ("taichi", "lateral-steps", "walks", "speed", "pushes", "obstacle", "random-walks", "ticks")
"""Sections of the locomotion table, in the order in which they are made."""

STANCES = ("standing", "one-leg", "walking")
"""What a robot does when it is pushed."""


@dataclass(frozen=True)
class TableOptions:
    """Make every run that a page of the documentation quotes, and print its tables.

    Some minutes on two cores.
    """

    what: tyro.conf.Positional[Literal["results", "safety", "friction", "estimation"]] = "results"
    """Which page's: docs/results.md, docs/safety.md or docs/estimation.md; friction: what docs/safety.md says of dry
    friction."""
    work: Annotated[WorkOptions, tyro.conf.arg(name="")] = field(default_factory=WorkOptions)


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
    report: bool = True
    """Write report.html."""
    work: Annotated[WorkOptions, tyro.conf.arg(name="")] = field(default_factory=WorkOptions)


@dataclass(frozen=True)
class RandomWalksOptions:
    """Many random walks side by side: who falls, and when. --seed of `run random-walk` makes one of them again."""

    robot: str = "g1"
    """Robot: g1, tocabi, or the path of a .toml description."""
    runs: int = 50
    """How many, with seeds from --first-seed on [-]."""
    first_seed: int = 0
    """Seed of the first one [-]."""
    duration: float = 20.0
    """Simulated time of each [s]."""
    work: Annotated[WorkOptions, tyro.conf.arg(name="")] = field(default_factory=WorkOptions)


@dataclass(frozen=True)
class PushSearchOptions:
    """How strong a push of 0.1 s at the torso the robot survives: not fallen four seconds after it."""

    robots: tuple[str, ...] = ("g1", "tocabi")
    """Robots: g1, tocabi, or paths of .toml descriptions."""
    stances: tuple[str, ...] = STANCES
    """What they do: standing, one-leg (TAICHI, pushed at 17 s) or walking (0.2 m/s forward)."""
    directions: tuple[str, ...] = ("forward", "sideways")
    """Where to: forward or sideways; sideways is the weaker of left and right."""
    mass_scale: float = 1.0
    """Factor on every mass of the simulated robot; the controller keeps its nominal model [-]."""
    resolution: float = 0.02
    """Step of the impulses that are tried, per mass of the simulated robot [N s/kg]."""
    largest: float = 0.6
    """Largest impulse that is tried, per mass of the simulated robot [N s/kg]."""
    work: Annotated[WorkOptions, tyro.conf.arg(name="")] = field(default_factory=WorkOptions)


@dataclass(frozen=True)
class LocomotionTableOptions:
    """Make every run that the page on locomotion quotes, and print its tables.

    About three quarters of an hour on two cores.
    """

    only: tuple[str, ...] = SECTIONS
    """Sections to make: taichi, lateral-steps, walks, speed, pushes, obstacle, random-walks, ticks."""
    quick: bool = False
    """Fewer and shorter runs, to see that all is well: some minutes."""
    series: bool = True
    """Keep the time series of every run but those of speed, pushes and random-walks: some 2 GB. Configuration and
    summary are always kept."""
    work: Annotated[WorkOptions, tyro.conf.arg(name="")] = field(default_factory=WorkOptions)


@dataclass(frozen=True)
class TuneOptions:
    """Choose alpha and epsilon of every constraint family from the disturbance that reaches it.

    Runs a set of scenarios on the robot at the edges of what it is to withstand, measures what it does beyond what the
    filter asked of it, row by row, and takes the largest epsilon for which every barrier keeps its margin. Every run
    takes the file that is written, tuning.toml in the folder of the study: --tuning FILE.
    """

    robot: str = "g1"
    """Robot: g1, tocabi, or the path of a .toml description."""
    masses: tuple[float, float] = (0.8, 1.3)
    """Factors on all masses, the least and the largest to withstand [-]."""
    joint_friction: tuple[float, float] = (0.0, 2.0)
    """Factors on the joints' dry and viscous friction, the least and the largest to withstand [-]."""
    payload: float = 1.0
    """Mass in each hand that the model does not know of [kg]."""
    delay: float = 0.004
    """Time from command to torque [s]."""
    margin: float = 0.004
    """Distance to keep under all of that [m]; motions that are not among the scenarios take half of it."""
    margin_angle: float = 0.01
    """The same of joint limits [rad]."""
    alphas: tuple[float, ...] = (3.0, 5.0, 8.5)
    """Slopes to try; one above what motors can follow without overshoot, a quarter of their bandwidth, is left out
    [1/s]."""
    rounds: int = 6
    """Most rounds of runs: the first tries every slope, each further one makes sure of what was proposed [-]."""
    only: tuple[str, ...] = ()
    """Families to tune, the others stay as they are: joint_limit, self_collision, leg_collision, obstacle, workspace;
    all if not given."""
    start: Path | None = None
    """File of parameters to start from; the robot's own if not given."""
    work: Annotated[WorkOptions, tyro.conf.arg(name="")] = field(default_factory=WorkOptions)


@dataclass(frozen=True)
class RobustnessOptions:
    """Random runs with the hands and feet in conflict: how often a true barrier falls below zero, and the hands' error.

    Targets in the torso, circles through it, hands that change places, a sphere that passes them, side steps and walks,
    other ones than those that the parameters were tuned with. Of each seed everything is drawn: mass x0.8 to 1.3 (of
    robots that walk 0.85 to 1.25), friction of the joints x0 to 2, delay 0 to 4 ms, 0 to 1 kg in each hand; radius,
    speed, height and side of the sphere. Side steps differ from those of tuning in robot and seed only.
    """

    robots: tuple[str, ...] = ("g1", "tocabi")
    """Robots: g1, tocabi, or paths of .toml descriptions."""
    parameters: tuple[str, ...] = ("before", "own")
    """Sets of parameters to compare: own (the robot's), before (alpha 5 and epsilon 2 and the other guesses that came
    before tuning, g1 and tocabi only), adaptive (those of before, epsilon adapted while running), own-adaptive (the
    robot's, adapted likewise), or paths of files as `safewbc tune` writes them."""
    scenarios: tuple[str, ...] = ("target", "circles", "cross", "obstacle", "steps")
    """What happens: target, circles, cross, obstacle, steps."""
    seeds: int = 20
    """How many, from --first-seed on [-]."""
    first_seed: int = 1
    """The first one; the runs of tuning have seed 0 [-]."""
    work: Annotated[WorkOptions, tyro.conf.arg(name="")] = field(default_factory=WorkOptions)


@dataclass(frozen=True)
class BenchmarkOptions:
    """Test cases of the papers, every filter on the same scenes, with the papers' scores and figures beside them.

    The robot is an integrator at 100 Hz, as in both papers: it does what the filter says, and bodies pass through each
    other; or it is moved by torques (--plants). A scene follows from its seed as SPARK draws it.
    """

    suite: tyro.conf.Suppress[str] = "spark"
    """spark: tables 2 and 3 of its paper; p-ssa: figures 5 and 6 of its paper."""
    size: Literal["smoke", "paper"] = "smoke"
    """smoke: some minutes on two cores; paper: as many seeds and steps as the paper has."""
    cases: tuple[str, ...] = ()
    """Names of cases; all of the paper's of --order if not given."""
    order: int = 1
    """1: cases in which the robot is moved by velocities; 2: by accelerations, SPARK's only."""
    filters: tuple[str, ...] = ()
    """Filters: none, ssa, rssa, pssa, sss, cbf, issf, pfm, sma; ssa-naive, sss-naive, cbf-naive, issf-naive pass the
    nominal velocity on where they have no solution, as in the papers. Those of the suite if not given."""
    seeds: int | None = None
    """How many, from --first-seed on; by the size if not given [-]."""
    first_seed: int = 0
    """The first one [-]."""
    steps: int | None = None
    """Of an episode at most; by the size if not given [-]."""
    counts: Literal["code", "paper"] = "code"
    """Numbers of obstacles: those of SPARK's code, or those of its paper's table 9."""
    plants: tuple[str, ...] = ("integrator",)
    """What commands move: integrator, as in the papers; torque: motors at torque level on a base that is held or
    driven, with friction in the joints; torque-heavy: the same, 20 % heavier than the controller knows. Of several a
    last table and a plot say what each filter keeps of what it does on an integrator."""
    velocity: str = "none"
    """What filters are told of the obstacles' velocity: none, as in SPARK's first order, or true."""
    case_file: Path | None = None
    """File of cases of one's own, as experiments/data/benchmark_cases.toml."""
    work: Annotated[WorkOptions, tyro.conf.arg(name="")] = field(default_factory=WorkOptions)


@dataclass(frozen=True)
class EpsilonOptions:
    """CBF, eCBF and ISSf-CBF over alpha and epsilon at full dynamics: section 5.2.2 of Lee et al.

    Hand circles through the torso by a robot that is heavier than its model, whose joints have no dry friction, half of
    theirs, or all of it, and at several control rates.
    """

    size: Literal["smoke", "paper"] = "smoke"
    """smoke: a few values, 5 s each; paper: all of the paper's, smaller epsilons, 12 s each."""
    robots: tuple[str, ...] = ("tocabi", "g1")
    """Robots: g1, tocabi, or paths of .toml descriptions with [tuning.hand_tracking]."""
    alphas: tuple[float, ...] = ()
    """Slopes; by the size if not given [1/s]."""
    epsilons: tuple[float, ...] = ()
    """ISSf parameters; by the size if not given [m s/rad^2]."""
    friction: tuple[float, ...] = ()
    """Factors on the joints' dry and viscous friction; by the size if not given [-]."""
    rates: tuple[float, ...] = ()
    """Control rates; all but the first one with the last friction only; by the size if not given [Hz]."""
    mass_scale: float = 1.2
    """Factor on every mass of the simulated robot [-]."""
    duration: float | None = None
    """Simulated time of each run; by the size if not given [s]."""
    work: Annotated[WorkOptions, tyro.conf.arg(name="")] = field(default_factory=WorkOptions)
