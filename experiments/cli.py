"""The command line ``safewbc``. Commands import what they need when they run, so that ``--help`` is quick."""

import sys
from dataclasses import dataclass
from importlib import metadata
from typing import Annotated

import tyro

from experiments.options import (
    BenchOptions,
    CorridorOptions,
    DemoOptions,
    DoctorOptions,
    HandTrackingOptions,
    StandOptions,
    TableOptions,
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
    | Annotated[CorridorOptions, tyro.conf.subcommand("corridor")]
)


@dataclass(frozen=True)
class Run:
    """Run one experiment; writes configuration, summary, time series, report and video."""

    experiment: Annotated[Experiment, tyro.conf.arg(name="")]


Command = (
    Annotated[DemoOptions, tyro.conf.subcommand("demo")]
    | Annotated[Run, tyro.conf.subcommand("run")]
    | Annotated[BenchOptions, tyro.conf.subcommand("bench")]
    | Annotated[TableOptions, tyro.conf.subcommand("table")]
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


def dispatch(command: object) -> int:
    """Run a parsed command; returns the exit code."""
    from experiments.doctor import check_mujoco, doctor

    if isinstance(command, DoctorOptions):
        return doctor()
    check_mujoco()
    if isinstance(command, BenchOptions):
        from experiments.bench import bench

        return bench(command)
    if isinstance(command, DemoOptions):
        from experiments.demo import demo

        return demo(command)
    if isinstance(command, TableOptions):
        from experiments.table import table

        return table(command)
    assert isinstance(command, Run)
    if isinstance(command.experiment, CorridorOptions):
        from experiments.corridor import corridor

        return corridor(command.experiment)
    from experiments.console import run_and_save

    return run_and_save(command.experiment)
