"""The command line ``safewbc``. Commands import what they need when they run, so that ``--help`` is quick."""

import inspect
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, make_dataclass
from importlib import import_module, metadata
from typing import Annotated, Any, Generic, TypeVar, Union

import tyro

from experiments.scenarios.hardware_options import DeployCommon, MotorCheckOptions, RehearseOptions, TwinOptions
from experiments.scenarios.options import (
    BenchOptions,
    DemoOptions,
    DoctorOptions,
    OutputOptions,
    ReplayOptions,
)
from experiments.scenarios.registry import SCENARIOS, own_scenario
from experiments.scenarios.scenario import Scenario
from experiments.studies.pivot import PivotOptions
from experiments.studies.study_options import (
    BenchmarkOptions,
    CorridorOptions,
    EpsilonOptions,
    LocomotionTableOptions,
    PushSearchOptions,
    RandomWalksOptions,
    RobustnessOptions,
    TableOptions,
    TuneOptions,
)
from experiments.studies.sweep_options import SweepOptions, sweep_command
from robots.errors import SafeWbcError

DESCRIPTION = (
    "Whole-body control of humanoid robots, with a safety filter between kinematics and torques. "
    "safewbc --version prints the version."
)

RUN_TEXT = (
    "Run one experiment; writes configuration, summary, time series, report and video. A scenario of one's own is run "
    "as module:Class."
)

USAGE_ERROR = 2
"""Exit code when an option is not allowed."""

S = TypeVar("S", bound=Scenario)


@dataclass(frozen=True)
class RunScenario(Generic[S]):
    """A scenario, and where its results go."""

    scenario: Annotated[S, tyro.conf.arg(name="")]
    output: Annotated[OutputOptions, tyro.conf.arg(name="")] = field(default_factory=OutputOptions)


def subcommand(scenario: type[Scenario], name: str) -> Any:
    """A scenario as tyro sees it, under a name of its own."""
    text = inspect.cleandoc(scenario.__doc__ or "")
    settings = tyro.conf.subcommand(name, default=RunScenario(scenario()), description=text)
    return Annotated[RunScenario[scenario], settings]  # type: ignore[valid-type]


STUDIES = (
    Annotated[CorridorOptions, tyro.conf.subcommand("corridor")],
    Annotated[RandomWalksOptions, tyro.conf.subcommand("random-walks")],
    Annotated[PushSearchOptions, tyro.conf.subcommand("pushes")],
    Annotated[RobustnessOptions, tyro.conf.subcommand("robustness")],
    Annotated[LocomotionTableOptions, tyro.conf.subcommand("locomotion-table")],
)
"""Sets of runs that are made together."""


SUITES = (
    Annotated[BenchmarkOptions, tyro.conf.subcommand("spark", default=BenchmarkOptions("spark"))],
    Annotated[BenchmarkOptions, tyro.conf.subcommand("p-ssa", default=BenchmarkOptions("p-ssa"))],
    Annotated[EpsilonOptions, tyro.conf.subcommand("issf")],
)
"""Benchmarks, by paper."""


@dataclass(frozen=True)
class Benchmark:
    """Test cases and studies of the papers, with the papers' scores and figures beside ours."""

    experiment: Annotated[Union[SUITES], tyro.conf.arg(name="")]  # type: ignore[valid-type]  # noqa: UP007
    """Which one."""


DEPLOYED = ("stand", "taichi", "walk", "hand-tracking")
"""Scenarios that a robot can be told to do."""


class DeployCommand:
    """A task of a robot, ``task``, and how the robot is reached, ``common``."""


def deploy_command() -> Any:
    """The command ``deploy`` as tyro sees it."""
    tasks = [
        Annotated[scenario, tyro.conf.subcommand(scenario.name, description=inspect.cleandoc(scenario.__doc__ or ""))]
        for scenario in SCENARIOS
        if scenario.name in DEPLOYED
    ]
    tasks.append(Annotated[MotorCheckOptions, tyro.conf.subcommand("motor-check")])
    choices: Any = Union[tuple(tasks)]  # noqa: UP007 - made at run time
    return make_dataclass(
        "DeployCommand",
        [
            ("common", Annotated[DeployCommon, tyro.conf.arg(name="")]),
            ("task", Annotated[choices, tyro.conf.arg(name="")]),
        ],
        bases=(DeployCommand,),
        namespace={"__doc__": inspect.cleandoc(DeployCommon.__doc__ or "")},
        frozen=True,
    )


def run_command(own: str | None = None) -> Any:
    """The command ``run`` as tyro sees it; ``own``: ``module:Class`` of a scenario from outside the project."""
    scenarios = [subcommand(scenario, scenario.name) for scenario in SCENARIOS]
    if own is not None:
        scenarios.append(subcommand(own_scenario(own), own))
    choices: Any = Union[(*scenarios, *STUDIES)]
    return make_dataclass(
        "Run",
        [("experiment", Annotated[choices, tyro.conf.arg(name="")])],
        namespace={"__doc__": RUN_TEXT},
        frozen=True,
    )


def command_line(own: str | None = None) -> Any:
    """All commands as tyro sees them; ``own`` as of :func:`run_command`."""
    return (
        Annotated[DemoOptions, tyro.conf.subcommand("demo")]
        | Annotated[run_command(own), tyro.conf.subcommand("run")]
        | Annotated[sweep_command(own), tyro.conf.subcommand("sweep")]
        | Annotated[PivotOptions, tyro.conf.subcommand("pivot")]
        | Annotated[BenchOptions, tyro.conf.subcommand("bench")]
        | Annotated[Benchmark, tyro.conf.subcommand("benchmark")]
        | Annotated[TuneOptions, tyro.conf.subcommand("tune")]
        | Annotated[TableOptions, tyro.conf.subcommand("table")]
        | Annotated[ReplayOptions, tyro.conf.subcommand("replay")]
        | Annotated[DoctorOptions, tyro.conf.subcommand("doctor")]
        | Annotated[TwinOptions, tyro.conf.subcommand("twin")]
        | Annotated[RehearseOptions, tyro.conf.subcommand("rehearse")]
        | Annotated[deploy_command(), tyro.conf.subcommand("deploy")]
    )


def main() -> None:
    """Entry point: parse, run, and turn refusals into a message and exit code 2."""
    if sys.argv[1:] == ["--version"]:
        print(f"safewbc {metadata.version('safewbc')}")
        sys.exit(0)
    try:
        code = dispatch(tyro.cli(command_line(named_in(sys.argv[1:])), prog="safewbc", description=DESCRIPTION))
    except SafeWbcError as error:
        print(f"safewbc: {error}", file=sys.stderr)
        code = USAGE_ERROR
    except KeyboardInterrupt:
        print("safewbc: interrupted", file=sys.stderr)
        code = 130
    sys.exit(code)


def named_in(arguments: Sequence[str]) -> str | None:
    """The ``module:Class`` that ``safewbc run`` or ``sweep`` is asked for, if it is."""
    asked = len(arguments) > 1 and arguments[0] in ("run", "sweep")
    return arguments[1] if asked and ":" in arguments[1] else None


COMMANDS: dict[type, str] = {
    BenchOptions: "benchmarks.tick:bench",
    BenchmarkOptions: "studies.benchmark:benchmark",
    CorridorOptions: "studies.corridor:corridor",
    DemoOptions: "cli.demo:demo",
    EpsilonOptions: "studies.epsilon:epsilon_study",
    LocomotionTableOptions: "studies.locomotion_table:locomotion_table",
    PivotOptions: "studies.pivot:show_pivot",
    PushSearchOptions: "studies.pushes:pushes",
    RandomWalksOptions: "studies.random_walks:random_walks",
    RehearseOptions: "rehearsal.rehearse:rehearse",
    ReplayOptions: "cli.replay:replay",
    RobustnessOptions: "studies.robustness:robustness",
    TableOptions: "studies.results_tables:table",
    TuneOptions: "studies.tune:tune",
    TwinOptions: "cli.twin:twin",
}
"""Where the commands are that are no scenario: ``module:function``, by options."""


def dispatch(command: object) -> int:
    """Run a parsed command; returns the exit code."""
    from experiments.cli.doctor import check_mujoco, doctor

    if isinstance(command, DoctorOptions):
        return doctor(command)
    check_mujoco()
    options: Any = getattr(command, "experiment", command)
    if isinstance(options, RunScenario):
        from experiments.cli.console import run_and_save

        return run_and_save(options.scenario, options.output)
    if isinstance(options, SweepOptions):
        from experiments.studies.sweep import sweep

        return sweep(options)
    if isinstance(options, DeployCommand):
        from experiments.cli.deploy import deploy

        return deploy(options)
    module, name = COMMANDS[type(options)].split(":")
    return int(getattr(import_module(f"experiments.{module}"), name)(options))
