"""The experiments by name: their options, and where their checks and runs are. Each module is imported when needed."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from experiments.recording.recording import RunResult
from experiments.scenarios.options import (
    HandTrackingOptions,
    LateralStepsOptions,
    RunOptions,
    StandOptions,
    TaichiOptions,
    WalkOptions,
)
from experiments.studies.study_options import RandomWalkOptions
from robots.description import RobotDescription
from robots.errors import UnknownNameError

Progress = Callable[[float], None]


@dataclass(frozen=True, slots=True)
class Experiment:
    """One experiment of ``safewbc run``.

    Attributes:
        name: on the command line and in ``summary.json``.
        options: class of its options.
        checker: ``module:function`` below ``experiments`` that checks options and returns the robot.
        runner: ``module:function`` below ``experiments`` that runs with options and progress.
    """

    name: str
    options: type[RunOptions]
    checker: str
    runner: str

    def check(self, options: RunOptions) -> RobotDescription:
        """Check every option before anything is made or written; returns the robot.

        Raises:
            SafeWbcError: an option is not allowed.
        """
        return _function(self.checker)(options)

    def run(self, options: RunOptions, progress: Progress | None = None) -> RunResult:
        """Run it; ``progress`` is called with the simulated time [s] now and then.

        Raises:
            SafeWbcError: an option is not allowed; nothing has run then.
        """
        return _function(self.runner)(options, progress)


def _function(path: str) -> Any:
    module, name = path.split(":")
    return getattr(import_module(f"experiments.{module}"), name)


EXPERIMENTS = (
    Experiment("stand", StandOptions, "running.run:check_options", "scenarios.stand:run_stand"),
    Experiment(
        "hand-tracking",
        HandTrackingOptions,
        "scenarios.hand_tracking:check_hand_tracking",
        "scenarios.hand_tracking:run_hand_tracking",
    ),
    Experiment("taichi", TaichiOptions, "scenarios.taichi:check_taichi", "scenarios.taichi:run_taichi"),
    Experiment(
        "lateral-steps",
        LateralStepsOptions,
        "scenarios.lateral_steps:check_lateral_steps",
        "scenarios.lateral_steps:run_lateral_steps",
    ),
    Experiment("walk", WalkOptions, "scenarios.walk:check_walk", "scenarios.walk:run_walk"),
    Experiment(
        "random-walk",
        RandomWalkOptions,
        "studies.random_walks:check_random_walk",
        "studies.random_walks:run_random_walk",
    ),
)
"""In the order of the command line."""


def experiment_of(options: RunOptions) -> Experiment:
    """The experiment that options belong to."""
    return next(e for e in EXPERIMENTS if type(options) is e.options)


def experiment_called(name: str) -> Experiment:
    """The experiment of this name.

    Raises:
        UnknownNameError: there is none.
    """
    for experiment in EXPERIMENTS:
        if experiment.name == name:
            return experiment
    raise UnknownNameError("experiment", name, [e.name for e in EXPERIMENTS])
