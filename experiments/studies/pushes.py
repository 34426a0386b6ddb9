"""The strongest push of 0.1 s at the torso that a robot survives: standing, on one leg, walking."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from controllers.gaits.walking import walk_tuning
from experiments.metrics.metric import Metric
from experiments.running.run import prepare
from experiments.scenarios.options import PlantOptions
from experiments.scenarios.pushed import SPEED, Pushed
from experiments.scenarios.pushes import DIRECTIONS, PUSH_TIME, Push
from experiments.scenarios.scenario import Scenario
from experiments.scenarios.stand import Stand
from experiments.scenarios.taichi import Taichi
from experiments.studies.case import Case, content_key
from experiments.studies.command import command_line, study_folder
from experiments.studies.runs import run_case
from experiments.studies.search import Bracket, largest_that_holds
from experiments.studies.sections import Entries, Section, print_sections
from experiments.studies.store import RowStore, sound
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
    """Search, and print the table; returns 0, or 1 where a search failed.

    Raises:
        ConfigError: an option is not allowed; nothing has run then.
    """
    check_pushes(options)
    folder = study_folder(options.work.out, "pushes")
    section = Section("", push_cases(options), PUSH_COLUMNS)
    command = command_line("run pushes", options, folder)
    return print_sections([section], "pushes", options.robots[0], options.work, folder, command)


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
    require_between("jobs", options.work.jobs, 1, 64)
    for robot in options.robots:
        prepare(Stand(robot=robot, plant=PlantOptions(mass_scale=options.mass_scale)))


def push_cases(options: PushSearchOptions, below: str = "") -> list[Case]:
    """One search for each robot, stance and direction, those that take longest first; runs ``below`` another folder."""
    return [
        PushSearch(robot, stance, direction, options.mass_scale, options.resolution, options.largest, below).case()
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


@dataclass(frozen=True, slots=True)
class PushSearch:
    """Searches the strongest push in one direction that a robot survives, among pushes of which the worst counts.

    Attributes:
        robot: name, or path of a description.
        stance: one of ``STANCES``.
        direction: one of ``SIDES``.
        mass_scale: of the simulated robot.
        resolution: step of the impulses, per mass of the simulated robot [N s/kg].
        largest: largest impulse, likewise [N s/kg].
        below: folder of the runs, below that of the study.
    """

    robot: str
    stance: str
    direction: str
    mass_scale: float
    resolution: float
    largest: float
    below: str

    def __call__(self, store: RowStore) -> Entries:
        """Search; every run is a row of its own. Returns what the line of the table shows."""
        tried: list[Entries] = []

        def survives(case: PushCase, level: int) -> bool:
            tried.append(sound(store.obtain(self.run(case, level))))
            return not tried[-1]["fell"] and tried[-1]["stop_cause"] is None

        top = int(self.largest / self.resolution + 1e-9)
        level, weakest = worst_of(self.pushes(), top, survives)
        return {
            "survived": level * self.resolution,
            "survived_force": self.force(level),
            "first_fall": (level + 1) * self.resolution if level < top else None,
            "weakest": None if weakest is None else weakest.words,
            "runs": len(tried),
            "cpu_s": sum(entries["cpu_s"] for entries in tried),
        }

    def pushes(self) -> list[PushCase]:
        """Those of which the worst counts."""
        return cases(self.robot, self.stance, self.direction, self.mass_scale)

    def force(self, level: int) -> float:
        """Force of the push of a level of the grid [N]."""
        return level * self.resolution * true_mass(self.pushes()[0]) / PUSH_TIME

    def run(self, case: PushCase, level: int) -> Case:
        """The run with the push of a level of the grid."""
        name = f"{case.stance}-{case.direction}-{case.time:g}-{level * self.resolution:.3f}"
        folder = f"{self.below}{load_robot(case.robot).name}-mass-{case.mass_scale:g}-{name}"
        labels = {"direction": case.direction, "time": case.time, "impulse": level * self.resolution}
        return run_case(pushed(case, self.force(level)), labels, folder, series=False)

    def case(self) -> Case:
        """The search as a case."""
        content = [[self.run(case, 1).key for case in self.pushes()], self.resolution, self.largest, STRIDE]
        labels = {
            "robot": load_robot(self.robot).name,
            "stance": self.stance,
            "direction": self.direction,
            "mass_scale": self.mass_scale,
        }
        return Case(content_key("push", content), labels, self)


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
        if (found := largest_that_holds(partial(survives, case), Bracket(level, stride, stride))) < level:
            level, weakest = found, case
        # whether the others survive that too: half of it and all of it
        stride = max(STRIDE, -(-level // 2))
    return level, weakest


def true_mass(case: PushCase) -> float:
    """Mass of the simulated robot [kg]."""
    return case.mass_scale * load_robot(case.robot).total_mass


def pushed(case: PushCase, force: float) -> Scenario:
    """The scenario with a push of ``force`` [N], which ends ``AFTER`` seconds after it."""
    plant, end = PlantOptions(mass_scale=case.mass_scale), case.time + PUSH_TIME + AFTER
    pushes = (Push(force, DIRECTIONS[case.direction], case.time),)
    if case.stance == "one-leg":
        return Taichi(robot=case.robot, duration=end, plant=plant, pushes=pushes)
    return Pushed(robot=case.robot, duration=end, plant=plant, pushes=pushes, activity=case.stance)
