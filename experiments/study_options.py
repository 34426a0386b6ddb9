"""Options of the studies, which are made of many runs; nothing heavy is imported here."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from experiments.options import PlantOptions, RunOptions

SECTIONS = ("taichi", "lateral-steps", "walks", "speed", "pushes", "obstacle", "random-walks", "ticks")
"""Sections of the locomotion table, in the order in which they are made."""

STANCES = ("standing", "one-leg", "walking")
"""What a robot does when it is pushed."""


@dataclass(frozen=True)
class RandomWalkOptions(RunOptions):
    """Walk with everything drawn from --seed: masses, friction, sensor noise, delay, commands, pushes."""

    duration: float = 20.0
    """Simulated time [s]."""
    plant: Annotated[PlantOptions, tyro.conf.Suppress] = field(default_factory=PlantOptions)
    """Drawn from the seed: not an option."""


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
    jobs: int = 2
    """Runs at a time [-]."""
    out: Path | None = None
    """Folder with configuration and summary of each run; runs/random-walks-<time> if not given."""


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
    jobs: int = 2
    """Runs at a time [-]."""
    out: Path | None = None
    """Folder with configuration and summary of each run; runs/pushes-<time> if not given."""


@dataclass(frozen=True)
class LocomotionTableOptions:
    """Make every run that the page on locomotion quotes, and print its tables as Markdown.

    About three quarters of an hour on two cores.
    """

    only: tuple[str, ...] = SECTIONS
    """Sections to make: taichi, lateral-steps, walks, speed, pushes, obstacle, random-walks, ticks."""
    quick: bool = False
    """Fewer and shorter runs, to see that all is well: some minutes."""
    series: bool = True
    """Keep the time series of every run but those of speed, pushes and random-walks: some 2 GB. Configuration and
    summary are always kept."""
    jobs: int = 2
    """Runs at a time [-]."""
    out: Path | None = None
    """Folder of the runs, each in a folder of its own; runs/locomotion-table-<time> if not given."""
