"""The command line ``safewbc``. Commands import what they need when they run, so that ``--help`` is quick."""

import sys
from dataclasses import dataclass
from importlib import import_module, metadata
from typing import Annotated, Any

import tyro

from experiments.scenarios.options import (
    BenchOptions,
    CorridorOptions,
    DemoOptions,
    DoctorOptions,
    HandTrackingOptions,
    LateralStepsOptions,
    ReplayOptions,
    StandOptions,
    TableOptions,
    TaichiOptions,
    WalkOptions,
)
from experiments.studies.study_options import (
    LocomotionTableOptions,
    PushSearchOptions,
    RandomWalkOptions,
    RandomWalksOptions,
    RobustnessOptions,
    TuneOptions,
)
from robots.errors import SafeWbcError

DESCRIPTION = (
    "Whole-body control of humanoid robots, with a safety filter between kinematics and torques. "
    "safewbc --version prints the version."
)

USAGE_ERROR = 2
"""Exit code when an option is not allowed."""

Experiment = (
    Annotated[StandOptions, tyro.conf.subcommand("stand")]
    | Annotated[HandTrackingOptions, tyro.conf.subcommand("hand-tracking")]
    | Annotated[TaichiOptions, tyro.conf.subcommand("taichi")]
    | Annotated[LateralStepsOptions, tyro.conf.subcommand("lateral-steps")]
    | Annotated[WalkOptions, tyro.conf.subcommand("walk")]
    | Annotated[CorridorOptions, tyro.conf.subcommand("corridor")]
    | Annotated[RandomWalkOptions, tyro.conf.subcommand("random-walk")]
    | Annotated[RandomWalksOptions, tyro.conf.subcommand("random-walks")]
    | Annotated[PushSearchOptions, tyro.conf.subcommand("pushes")]
    | Annotated[RobustnessOptions, tyro.conf.subcommand("robustness")]
    | Annotated[LocomotionTableOptions, tyro.conf.subcommand("locomotion-table")]
)


@dataclass(frozen=True)
class Run:
    """Run one experiment; writes configuration, summary, time series, report and video."""

    experiment: Annotated[Experiment, tyro.conf.arg(name="")]


Command = (
    Annotated[DemoOptions, tyro.conf.subcommand("demo")]
    | Annotated[Run, tyro.conf.subcommand("run")]
    | Annotated[BenchOptions, tyro.conf.subcommand("bench")]
    | Annotated[TuneOptions, tyro.conf.subcommand("tune")]
    | Annotated[TableOptions, tyro.conf.subcommand("table")]
    | Annotated[ReplayOptions, tyro.conf.subcommand("replay")]
    | Annotated[DoctorOptions, tyro.conf.subcommand("doctor")]
)


def main() -> None:
    """Entry point: parse, run, and turn refusals into a message and exit code 2."""
    if sys.argv[1:] == ["--version"]:
        print(f"safewbc {metadata.version('safewbc')}")
        sys.exit(0)
    command = tyro.cli(Command, prog="safewbc", description=DESCRIPTION)
    try:
        code = dispatch(command)
    except SafeWbcError as error:
        print(f"safewbc: {error}", file=sys.stderr)
        code = USAGE_ERROR
    except KeyboardInterrupt:
        print("safewbc: interrupted", file=sys.stderr)
        code = 130
    sys.exit(code)


COMMANDS: dict[type, str] = {
    BenchOptions: "benchmarks.tick:bench",
    CorridorOptions: "studies.corridor:corridor",
    DemoOptions: "cli.demo:demo",
    LocomotionTableOptions: "studies.locomotion_table:locomotion_table",
    PushSearchOptions: "studies.pushes:pushes",
    RandomWalksOptions: "studies.random_walks:random_walks",
    ReplayOptions: "recording.replay:replay",
    RobustnessOptions: "studies.robustness:robustness",
    TableOptions: "studies.results_tables:table",
    TuneOptions: "studies.tune:tune",
}
"""Where the commands are that are no scenario: ``module:function``, by options."""


def dispatch(command: object) -> int:
    """Run a parsed command; returns the exit code."""
    from experiments.cli.doctor import check_mujoco, doctor

    if isinstance(command, DoctorOptions):
        return doctor()
    check_mujoco()
    options: Any = command.experiment if isinstance(command, Run) else command
    module, name = COMMANDS.get(type(options), "cli.console:run_and_save").split(":")
    return int(getattr(import_module(f"experiments.{module}"), name)(options))
