"""Chooses alpha and epsilon of the safety filter from the disturbance that the robot's own runs show."""

import math
from typing import Any

from controllers.whole_body.config import FilterTuning
from controllers.whole_body.robot_config import controller_config
from controllers.whole_body.tuning_file import Tuning, read_tuning, write_tuning
from experiments.recording.recording import GUARANTEED
from experiments.reports.table import Column, Row, Table, show
from experiments.running.run import prepare
from experiments.studies.command import command_line, study_folder
from experiments.studies.progress import study_console
from experiments.studies.study_options import TuneOptions
from experiments.studies.tuner import Choice, Tuner
from experiments.studies.tuning_rounds import TuningRounds
from experiments.studies.tuning_scenarios import TuningRun, posture_ratios, tuning_runs
from robots.checks import require_between, require_positive
from robots.description import RobotDescription
from robots.errors import ConfigError, DescriptionError
from robots.loader import load_robot

OVERSHOOT = 0.25
"""Largest alpha times the motors' time constant and delay.

A velocity followed with time constant T makes the condition :math:`T \\ddot h + \\dot h + \\alpha h = 0`: h does not
overshoot 0 for :math:`\\alpha T \\le 1/4`."""


def tune(options: TuneOptions) -> int:
    """Tune, print what was found, write the file; returns 0 where every family that was met keeps its margin, else 1.

    Raises:
        SafeWbcError: an option is not allowed; nothing has run then.
    """
    robot = check_tune(options)
    return tune_with(robot, possible_runs(robot, options), options)


def tune_with(robot: RobotDescription, runs: list[TuningRun], options: TuneOptions) -> int:
    """:func:`tune` with runs to choose from; the options are checked."""
    folder = study_folder(options.work.out, "tune")
    before = start_choices(robot, options)
    alphas = slopes(robot, options)
    rounds = TuningRounds(robot, options, folder, command_line("tune", options, folder))
    chosen = Tuner(runs, alphas, posture_ratios(robot), options, rounds).run(before)
    tuning = Tuning(
        {family: {"alpha": c.alpha, "epsilon": c.epsilon} for family, c in chosen.items()},
        provenance(robot, runs, options, chosen),
    )
    write_tuning(folder / "tuning.toml", tuning)
    show(choice_table(robot, before, chosen))
    study_console().print(f"parameters: {folder / 'tuning.toml'}")
    return 1 if any(c.note.startswith("margin missed") for c in chosen.values()) else 0


def check_tune(options: TuneOptions) -> RobotDescription:
    """Check every option before anything runs; returns the robot.

    Raises:
        SafeWbcError: one is not allowed, or none of the scenarios fits the robot's description.
    """
    for name in ("masses", "joint_friction"):
        low, high = getattr(options, name)
        require_between(name, low, 0.0, high)
    require_between("payload", options.payload, 0.0, 5.0)
    require_between("delay", options.delay, 0.0, 0.02)
    require_positive("margin", options.margin)
    require_positive("margin_angle", options.margin_angle)
    for alpha in options.alphas:
        require_positive("alphas", alpha)
    require_between("rounds", options.rounds, 1, 20)
    require_between("jobs", options.work.jobs, 1, 64)
    if unknown := sorted(set(options.only) - set(GUARANTEED)):
        raise ConfigError("only", unknown, "among " + ", ".join(GUARANTEED))
    robot = load_robot(options.robot)
    if not slopes(robot, options):
        highest = OVERSHOOT / lag(robot, options.delay)
        raise ConfigError(
            "alphas", options.alphas, f"with one of at most {highest:.3g} 1/s, which the motors can follow"
        )
    start_choices(robot, options)
    possible_runs(robot, options)
    return robot


def lag(robot: RobotDescription, delay: float) -> float:
    """Time in which the robot takes on a velocity it is told: that of eq. (15) of Lee et al., and the delay [s]."""
    config = controller_config(robot)
    return 1.0 / (config.dynwbc.kd + config.dynwbc.kp * config.dt) + delay


def slopes(robot: RobotDescription, options: TuneOptions) -> list[float]:
    """The alphas that the motors can follow, rising."""
    return sorted(a for a in set(options.alphas) if a * lag(robot, options.delay) <= OVERSHOOT)


def start_choices(robot: RobotDescription, options: TuneOptions) -> dict[str, Choice]:
    """The parameters to start from, of every family."""
    safety: FilterTuning = controller_config(robot).safety
    if options.start is not None:
        if not options.start.is_file():
            raise ConfigError("start", str(options.start), "a file of parameters as `safewbc tune` writes it")
        safety = read_tuning(options.start, robot.name).applied(safety)
    return {f: Choice(getattr(safety, f).alpha, getattr(safety, f).epsilon) for f in GUARANTEED}


def possible_runs(robot: RobotDescription, options: TuneOptions) -> list[TuningRun]:
    """The runs that the robot's description has what it needs for.

    Raises:
        SafeWbcError: none of them.
    """
    possible, refusal = [], None
    for run in tuning_runs(robot, options):
        try:
            prepare(run.options)
        except DescriptionError as error:
            refusal = error
        else:
            possible.append(run)
    if not possible and refusal is not None:
        raise refusal
    return possible


def provenance(
    robot: RobotDescription, runs: list[TuningRun], options: TuneOptions, chosen: dict[str, Choice]
) -> dict[str, Any]:
    """What the parameters were tuned for, in TOML's types."""
    tuned = set(options.only or GUARANTEED)
    names = sorted(run.name for run in runs if tuned & set(run.families))
    told: dict[str, Any] = {
        "robot": robot.name,
        "masses": list(options.masses),
        "joint_friction": list(options.joint_friction),
        "payload_kg": options.payload,
        "delay_s": options.delay,
        "margin_m": options.margin,
        "margin_rad": options.margin_angle,
        "alphas": slopes(robot, options),
        "seeds": [0],
        "runs": names,
    }
    for family, choice in chosen.items():
        told[f"{family}_note"] = choice.note
        if math.isfinite(choice.least):
            told[f"{family}_least"] = round(choice.least, 6)
    return told


def choice_table(robot: RobotDescription, before: dict[str, Choice], chosen: dict[str, Choice]) -> Table:
    """Parameters before and after, and what they were found from."""
    words, numbers = {"family", "in", ""}, ("alpha", "epsilon", "push", "room at rest", "least h")
    headings = ("family", "before: alpha, epsilon", *numbers, "in", "")
    rows = (Row((family, *_cells(family, before[family], choice))) for family, choice in chosen.items())
    return Table(tuple(Column(h, words=h in words) for h in headings), tuple(rows), robot.title)


def _cells(family: str, old: Choice, new: Choice) -> tuple[str, ...]:
    unit, factor = ("rad", 1.0) if family == "joint_limit" else ("mm", 1e3)
    return (
        f"{old.alpha:.3g}, {old.epsilon:.3g}",
        f"{new.alpha:.3g}",
        f"{new.epsilon:.3g}",
        _number(new.push, 1.0, "rad/s" if unit == "rad" else "m/s"),
        _number(new.room, factor, unit),
        _number(new.least, factor, unit),
        new.where,
        new.note,
    )


def _number(value: float, factor: float, unit: str) -> str:
    return f"{factor * value:.3g} {unit}" if math.isfinite(value) else "-"
