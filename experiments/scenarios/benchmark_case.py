"""Test cases of the benchmarks as data: which joints move, what is in the way, where hands and base are to go."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

from experiments.scenarios.content import from_plain, to_plain
from robots.checks import require_between, require_non_negative, require_one_of, require_positive
from robots.errors import ConfigError, UnknownNameError

BASES = ("fixed", "planar", "walking")
"""What carries the upper body: nothing that moves, a planar base, or our walk."""

MOTIONS = ("still", "spark", "brownian", "circle")
"""How obstacles move; see :mod:`experiments.scenarios.benchmark_motions`."""

HANDS = ("left", "right")

Place = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Configuration:
    """What of the robot moves.

    Attributes:
        name: as in the papers.
        base: one of ``BASES``.
        joints: names of the joints that move, in the benchmark's order.
        hands: which of them get goals.
    """

    name: str
    base: str
    joints: tuple[str, ...]
    hands: tuple[str, ...] = HANDS

    def __post_init__(self) -> None:
        require_one_of("base", self.base, BASES)
        for hand in self.hands:
            require_one_of("hands", hand, HANDS)


@dataclass(frozen=True, slots=True)
class ObstacleDraw:
    """Spheres around the robot, drawn into a box.

    Attributes:
        number: of them.
        paper_number: of them as the paper has it.
        low: corner of the box, world [m].
        high: the other corner [m].
        keep_out: least distance of one surface to another [m].
        robot_keep_out: least distance of a surface to those of the robot at the start [m].
        radius: [m].
        motion: one of ``MOTIONS``.
        speed: of the motion: ``spark`` in metres a control step, ``brownian`` in m/sqrt(s) for each axis, ``circle`` in
            m/s.
    """

    number: int
    paper_number: int
    low: Place
    high: Place
    keep_out: float
    robot_keep_out: float = 0.0
    radius: float = 0.05
    motion: str = "still"
    speed: float = 0.0

    def __post_init__(self) -> None:
        for name in ("number", "paper_number"):
            require_between(name, getattr(self, name), 0, 1000)
        for name in ("keep_out", "robot_keep_out", "speed"):
            require_non_negative(name, getattr(self, name))
        require_positive("radius", self.radius)
        require_one_of("motion", self.motion, MOTIONS)
        _check_box("obstacles", self.low, self.high)


@dataclass(frozen=True, slots=True)
class GoalDraw:
    """Goals of hands and base, drawn into boxes.

    Attributes:
        left_low: corner of the box of the left hand's goal, axes of the base, with which it moves [m].
        left_high: the other corner [m].
        right_low: likewise of the right hand's [m].
        right_high: likewise [m].
        base_low: corner (x, y) of the base's goals [m]; ``None``: the base has none.
        base_high: the other corner [m].
        hand_keep_out: least distance of a hand's goal to the centres of obstacles at the start [m].
        base_keep_out: the same of the base's, level [m].
        hand_size: distance from which on a hand has reached its goal [m].
        base_size: the same of the base, level [m].
        respawn: whether new ones are drawn once all are reached; the episode is done then otherwise.
    """

    left_low: Place
    left_high: Place
    right_low: Place
    right_high: Place
    base_low: tuple[float, float] | None = None
    base_high: tuple[float, float] | None = None
    hand_keep_out: float = 0.1
    base_keep_out: float = 0.1
    hand_size: float = 0.05
    base_size: float = 0.1
    respawn: bool = False

    def __post_init__(self) -> None:
        for name in ("hand_keep_out", "base_keep_out"):
            require_non_negative(name, getattr(self, name))
        for name in ("hand_size", "base_size"):
            require_positive(name, getattr(self, name))
        _check_box("goals of the left hand", self.left_low, self.left_high)
        _check_box("goals of the right hand", self.right_low, self.right_high)
        if (self.base_low is None) != (self.base_high is None):
            raise ConfigError("base_low and base_high", (self.base_low, self.base_high), "both given, or neither")
        if self.base_low is not None and self.base_high is not None:
            _check_box("goals of the base", self.base_low, self.base_high)


@dataclass(frozen=True, slots=True)
class FilterTable:
    """Parameters of filters, for obstacles and the robot's own bodies alike.

    Attributes:
        eta: rate of SSA and its kin, above 0 [m/s].
        slope: lambda of SSS, above 0 [1/s].
        alpha: of the CBF and ISSf-CBF (lambda in SPARK), above 0 [1/s].
        epsilon: of ISSf-CBF, above 0.
        push_cartesian: c of PFM, above 0 [m/s].
        push_joint: c of SMA, above 0 [rad/s].
        slack_weight: of squared violations in r-SSA, above 0 [s/m squared].
    """

    eta: float = 0.5
    slope: float = 10.0
    alpha: float = 10.0
    epsilon: float = 5.0
    push_cartesian: float = 0.1
    push_joint: float = 40.0
    slack_weight: float = 10.0

    def __post_init__(self) -> None:
        for name in self.__slots__:
            require_positive(name, getattr(self, name))


@dataclass(frozen=True, slots=True)
class BenchmarkCase:
    """One test case.

    Attributes:
        name: as in its paper.
        configuration: what moves.
        order: 1: the robot is moved by velocities; 2: by accelerations.
        obstacles: around it.
        goals: of hands and base.
        margin: distance to obstacles that is to be kept [m].
        self_margin: the same of the robot's own bodies [m].
        source: whose case it is.
        parameters: of filters.
    """

    name: str
    configuration: Configuration
    order: int
    obstacles: ObstacleDraw
    goals: GoalDraw
    margin: float = 0.1
    self_margin: float = 0.01
    source: str = "ours"
    parameters: FilterTable = field(default_factory=FilterTable)

    def __post_init__(self) -> None:
        require_between("order", self.order, 1, 2)
        for name in ("margin", "self_margin"):
            require_non_negative(name, getattr(self, name))
        if self.configuration.base == "fixed" and self.goals.base_low is not None:
            raise ConfigError("goals.base_low", self.goals.base_low, f"absent: {self.configuration.name} has no base")


@dataclass(frozen=True, slots=True)
class KeepOut:
    """A sphere of the robot that obstacles are not drawn into, and that nothing else is checked against.

    Attributes:
        body: that carries it.
        center: in the body's axes [m].
        radius: [m].
    """

    body: str
    center: Place
    radius: float


@dataclass(frozen=True, slots=True)
class BenchmarkRobot:
    """The robot of the cases, and how it stands at their start.

    Attributes:
        description: name of a description, or its path.
        collision_model: see :func:`robots.collision_models.with_collision_model`.
        base_height: of the base's origin [m].
        joints: angles by the joints' names; the others are 0 [rad].
    """

    description: str
    collision_model: str
    base_height: float
    joints: Mapping[str, float]


@dataclass(frozen=True)
class CaseBook:
    """Cases of a file.

    Attributes:
        robot: of all of them.
        keep_out: further spheres of the robot.
        cases: by name, in the order of the file.
    """

    robot: BenchmarkRobot
    keep_out: tuple[KeepOut, ...]
    cases: Mapping[str, BenchmarkCase]

    def case(self, name: str) -> BenchmarkCase:
        """The case of a name.

        Raises:
            UnknownNameError: there is none.
        """
        if name not in self.cases:
            raise UnknownNameError("case", name, list(self.cases))
        return self.cases[name]


def load_cases(path: Path | None = None) -> CaseBook:
    """Cases of a file; the project's own, those of the papers, if none is given.

    Raises:
        ConfigError: the file cannot be read, or something in it is not allowed; names the case and the entry.
    """
    source = resources.files("experiments") / "data" / "benchmark_cases.toml" if path is None else path
    try:
        table = tomllib.loads(source.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError("cases", str(path), f"readable ({error.strerror})") from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError("cases", str(path), f"a TOML file in UTF-8 ({error})") from error
    known = ("robot", "keep_out", "joints", "configuration", "case")
    if unknown := sorted(set(table) - set(known)):
        raise ConfigError(f"cases: {unknown[0]}", table[unknown[0]], "absent; known are " + ", ".join(known))
    configurations = _configurations(table)
    cases: dict[str, BenchmarkCase] = {}
    whole: dict[str, dict[str, Any]] = {}
    for number, entry in enumerate(table.get("case", []), 1):
        name = str(entry.get("name", f"number {number}"))
        if name in whole:
            raise ConfigError("case", name, "in the file once")
        whole[name] = _completed(entry, name, whole)
        cases[name] = _case(whole[name], name, configurations)
    robot = from_plain(BenchmarkRobot, table.get("robot", {}), "robot")
    spheres = tuple(from_plain(KeepOut, t, f"keep_out {i}") for i, t in enumerate(table.get("keep_out", []), 1))
    return CaseBook(robot, spheres, cases)


def _configurations(table: Mapping[str, Any]) -> dict[str, Configuration]:
    """Configurations by name, with the names of joints in the place of those of their groups."""
    groups: Mapping[str, list[str]] = table.get("joints", {})
    found = {}
    for number, entry in enumerate(table.get("configuration", []), 1):
        for group in (named := entry.get("joints", [])):
            if group not in groups:
                raise ConfigError(f"configuration {number}.joints", group, "one of " + ", ".join(groups))
        whole = entry | {"joints": [joint for group in named for joint in groups[group]]}
        made = from_plain(Configuration, whole, f"configuration {number}")
        found[made.name] = made
    return found


def _completed(entry: Mapping[str, Any], name: str, earlier: Mapping[str, dict[str, Any]]) -> dict[str, Any]:
    """The entry with what it takes from the case that it is like."""
    own = {key: value for key, value in entry.items() if key != "like"}
    if "like" not in entry:
        return own
    if entry["like"] not in earlier:
        raise ConfigError(f"case {name}.like", entry["like"], "one of the cases above: " + ", ".join(earlier))
    whole = dict(earlier[entry["like"]])
    for key, value in own.items():
        whole[key] = whole[key] | value if isinstance(value, Mapping) and key in whole else value
    return whole


def _case(table: Mapping[str, Any], name: str, configurations: Mapping[str, Configuration]) -> BenchmarkCase:
    chosen = str(table.get("configuration"))
    if chosen not in configurations:
        raise ConfigError(f"case {name}.configuration", chosen, "one of " + ", ".join(configurations))
    try:
        return from_plain(BenchmarkCase, {**table, "configuration": to_plain(configurations[chosen])}, f"case {name}")
    except ConfigError as error:
        if error.name.startswith("case "):
            raise
        raise ConfigError(f"case {name}: {error.name}", error.value, error.allowed) from error


def _check_box(name: str, low: tuple[float, ...], high: tuple[float, ...]) -> None:
    if any(a > b for a, b in zip(low, high, strict=True)):
        raise ConfigError(f"box of {name}", (low, high), "a corner, and one that is nowhere below it")
