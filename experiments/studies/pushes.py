"""The strongest push of 0.1 s at the torso that a robot survives: standing, on one leg, walking."""

import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from rich.console import Console

from controllers.gaits.walking import walk_tuning
from experiments.cli.console import results_folder
from experiments.metrics.metric import Metric
from experiments.recording.recording import RunResult, save_result
from experiments.reports.metric_tables import rows_table
from experiments.reports.table import show
from experiments.running.pool import Row, in_parallel
from experiments.running.run import prepare, run
from experiments.running.warmup import warm_up
from experiments.scenarios.options import OutputOptions, PlantOptions
from experiments.scenarios.pushed import SPEED, Pushed
from experiments.scenarios.pushes import DIRECTIONS, PUSH_TIME, Push
from experiments.scenarios.scenario import Scenario
from experiments.scenarios.stand import Stand
from experiments.scenarios.taichi import Taichi
from experiments.studies.study_options import STANCES, PushSearchOptions
from robots.checks import require_between, require_one_of
from robots.errors import ConfigError
from robots.loader import load_robot

AFTER = 4.0
"""A push is survived by a robot that has not fallen this long after its end [s]."""

STANDING_AT, ONE_LEG_AT, WALKING_AT = 2.0, 17.0, 4.0
"""When the robot is pushed [s]; walking begins at one second and has found its rhythm by then."""

PHASES = 4
"""Walking: at how many instants of a step it is pushed."""

STRIDE = 5
"""Steps of the impulse by which the search of the first case goes up until the robot falls."""

SIDES = {"forward": ("forward",), "sideways": ("left", "right")}
"""Pushes of which the worst counts."""

PUSH_COLUMNS = (
    Metric("robot", "robot"),
    Metric("stance", "stance"),
    Metric("direction", "pushed"),
    Metric("mass_scale", "mass"),
    Metric("survived", "survived", "N s/kg"),
    Metric("survived_force", "that is", "N"),
    Metric("first_fall", "falls at", "N s/kg"),
    Metric("weakest", "weakest"),
    Metric("runs", "runs"),
)


@dataclass(frozen=True, slots=True)
class PushCase:
    """One way to be pushed.

    Attributes:
        robot: name or path.
        stance: one of ``STANCES``.
        direction: one of ``DIRECTIONS``.
        time: when the push begins [s].
        mass_scale: of the simulated robot.
    """

    robot: str
    stance: str
    direction: str
    time: float
    mass_scale: float

    @property
    def words(self) -> str:
        """Direction and time, for a table or a folder."""
        return f"{self.direction}, {self.time:g} s"


def pushes(options: PushSearchOptions) -> int:
    """Search, print the table, save configuration and summary of each run; returns 0.

    Raises:
        ConfigError: an option is not allowed; nothing has run then.
    """
    check_pushes(options)
    console = Console(stderr=True, markup=False, soft_wrap=True)
    with results_folder(OutputOptions(out=options.out), "pushes") as folder:
        warm_up(console, load_robot(options.robots[0]))
        rows = list(in_parallel(push_tasks(options, folder), options.jobs, console))
    show(rows_table(rows, PUSH_COLUMNS))
    console.print(f"runs: {folder}")
    return 0


def check_pushes(options: PushSearchOptions) -> None:
    """Check every option before anything runs.

    Raises:
        SafeWbcError: one is not allowed.
    """
    for name, given, allowed in (
        ("stances", options.stances, STANCES),
        ("directions", options.directions, tuple(SIDES)),
    ):
        if not given:
            raise ConfigError(name, given, "at least one of " + ", ".join(allowed))
        for value in given:
            require_one_of(name, value, allowed)
    if not options.robots:
        raise ConfigError("robots", options.robots, "at least one robot")
    require_between("resolution", options.resolution, 1e-3, 1.0)
    require_between("largest", options.largest, options.resolution, 5.0)
    require_between("jobs", options.jobs, 1, 64)
    for robot in options.robots:
        prepare(Stand(robot=robot, plant=PlantOptions(mass_scale=options.mass_scale)))


def push_tasks(options: PushSearchOptions, folder: Path) -> list[Callable[[], Row]]:
    """One search for each robot, stance and direction; those that take longest first."""
    return [
        partial(search, cases(robot, stance, direction, options.mass_scale), direction, options, folder)
        for stance in sorted(options.stances, key=STANCES.index, reverse=True)
        for robot in options.robots
        for direction in options.directions
    ]


def cases(robot: str, stance: str, direction: str, mass_scale: float) -> list[PushCase]:
    """The pushes of which the worst counts: left and right, and while walking at several instants of one step."""
    times = {"standing": [STANDING_AT], "one-leg": [ONE_LEG_AT]}.get(stance)
    if times is None:
        period = walk_tuning(load_robot(robot)).timing.period(SPEED)
        times = [round(WALKING_AT + k * period / PHASES, 3) for k in range(PHASES)]
    pairs = itertools.product(times, SIDES[direction])
    return [PushCase(robot, stance, side, time, mass_scale) for time, side in pairs]


def search(given: Sequence[PushCase], direction: str, options: PushSearchOptions, folder: Path) -> Row:
    """Search among pushes of which the worst counts; returns the line of the table."""
    start, first, count = time.process_time(), given[0], 0
    mass = true_mass(first)

    def survives(case: PushCase, level: int) -> bool:
        nonlocal count
        count += 1
        result = run_case(case, level * options.resolution * mass / PUSH_TIME)
        name = f"{case.stance}-{case.direction}-{case.time:g}-{level * options.resolution:.3f}"
        save_result(result, folder / f"{load_robot(case.robot).name}-mass-{case.mass_scale:g}-{name}", series=False)
        return not result.summary["fell"] and result.summary["stop_cause"] is None

    top = int(options.largest / options.resolution + 1e-9)
    level, weakest = worst_of(given, top, survives)
    return {
        "robot": load_robot(first.robot).name,
        "stance": first.stance,
        "direction": direction,
        "mass_scale": first.mass_scale,
        "survived": level * options.resolution,
        "survived_force": level * options.resolution * mass / PUSH_TIME,
        "first_fall": (level + 1) * options.resolution if level < top else None,
        "weakest": None if weakest is None else weakest.words,
        "runs": count,
        "cpu_s": time.process_time() - start,
    }


def worst_of(
    given: Sequence[PushCase], top: int, survives: Callable[[PushCase, int], bool]
) -> tuple[int, PushCase | None]:
    """The smallest over the cases of the largest level survived, and the case that has it.

    Args:
        given: the cases.
        top: highest level.
        survives: whether a case survives a level.

    Returns:
        Level, and the first case that no other is below; ``None`` where all survive ``top``.
    """
    level, weakest, stride = top, None, STRIDE
    for case in given:
        if (found := largest_survived(partial(survives, case), level, stride)) < level:
            level, weakest = found, case
        # whether the others survive that too: half of it and all of it
        stride = max(STRIDE, -(-level // 2))
    return level, weakest


def largest_survived(survives: Callable[[int], bool], top: int, stride: int = STRIDE) -> int:
    """Largest level survived before the first one that is not.

    Goes up in strides, then bisects: a fall between two levels a stride apart that are both survived is not found.

    Args:
        survives: whether a level from 1 to ``top`` is survived.
        top: highest level to try, 0 or above.
        stride: levels by which it goes up, 1 or above.

    Returns:
        From 0, where even the first is not, to ``top``.
    """
    low = 0
    while low < top:
        high = min(low + stride, top)
        if not survives(high):
            break
        low = high
    else:
        return top
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if survives(middle) else (low, middle)
    return low


def true_mass(case: PushCase) -> float:
    """Mass of the simulated robot [kg]."""
    return case.mass_scale * load_robot(case.robot).total_mass


def run_case(case: PushCase, force: float) -> RunResult:
    """One run with a push of ``force`` [N], which ends ``AFTER`` seconds after it."""
    plant, end = PlantOptions(mass_scale=case.mass_scale), case.time + PUSH_TIME + AFTER
    pushes = (Push(force, DIRECTIONS[case.direction], case.time),)
    if case.stance == "one-leg":
        scenario: Scenario = Taichi(robot=case.robot, duration=end, plant=plant, pushes=pushes)
    else:
        scenario = Pushed(robot=case.robot, duration=end, plant=plant, pushes=pushes, activity=case.stance)
    return run(scenario)
