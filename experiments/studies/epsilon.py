"""What alpha and epsilon do to CBF, eCBF and ISSf-CBF at full dynamics: ``safewbc benchmark issf``.

Section 5.2.2 of Lee et al.: hand circles through the torso by a robot that is heavier than its model, over alpha and
epsilon; here over the dry friction of the joints and the control rate too.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.metrics.metric import Metric
from experiments.recording.recording import Recording, smallest_self_collision
from experiments.recording.store import add_file
from experiments.running.run import prepare
from experiments.scenarios.hand_tracking import HandTracking
from experiments.scenarios.options import FilterOptions, PlantOptions
from experiments.studies.case import Case, Row
from experiments.studies.command import command_line, study_folder
from experiments.studies.progress import study_console
from experiments.studies.runs import run_case
from experiments.studies.sections import Entries, Section, print_sections
from experiments.studies.store import RowStore
from experiments.studies.study_options import EpsilonOptions
from robots.checks import require_between, require_positive
from robots.errors import ConfigError

if TYPE_CHECKING:
    from experiments.reports.plots.epsilon import Panel

PLOT = "collisions.png"
"""File of the plot beside the rows."""

PAPER_ALPHAS = (1.0, *(5.0 * i for i in range(1, 11)))
PAPER_EPSILONS = (10.0, 20.0, 30.0)

ECBF_ABOVE = 20.0
"""Slopes up to which the paper leaves the eCBF out, since the hands stay far from their reference [1/s]."""

NEAR = 0.01
"""A barrier below which jitter is counted [m]."""


@dataclass(frozen=True, slots=True)
class Grid:
    """Values of a size: slopes [1/s], epsilons, factors on friction, control rates [Hz], seconds of a run."""

    alphas: tuple[float, ...]
    epsilons: tuple[float, ...]
    frictions: tuple[float, ...]
    rates: tuple[float, ...]
    duration: float


GRIDS = {
    "smoke": Grid((1.0, 10.0, 30.0, 50.0), (1.0, 10.0), (0.0, 1.0), (500.0,), 5.0),
    "paper": Grid(PAPER_ALPHAS, (0.5, 1.0, 2.0, 5.0, *PAPER_EPSILONS), (0.0, 0.5, 1.0), (500.0, 1000.0, 2000.0), 12.0),
}
"""By size. Rates other than the first one are run with the last friction."""

FIGURES = (
    Metric("collision_ratio", "collisions left", "%", 1e2),
    Metric("min_h_self_collision_m", "least h", "mm", 1e3),
    Metric("jitter", "jitter near the boundary, RMS jerk", "rad/s^3"),
    Metric("hand_rmse_outside_conflict_m", "hand error outside the conflict", "mm", 1e3),
    Metric("margin_self_collision_m", "least room above the running bound", "mm", 1e3),
)
"""What each run is shown by, block after block."""


@dataclass(frozen=True, slots=True)
class Setup:
    """A robot, a factor on its joints' friction, and a control rate [Hz]."""

    robot: str
    friction: float
    rate: float

    @property
    def title(self) -> str:
        """In words."""
        return f"{self.robot}, joint friction x{self.friction:g}, {self.rate:g} Hz"


@dataclass(frozen=True, slots=True)
class Variant:
    """A filter with its parameters; the slope is ``None`` for no filter."""

    filter: str
    alpha: float | None = None
    epsilon: float | None = None

    @property
    def column(self) -> str:
        """Name of its column."""
        return self.filter if self.epsilon is None else f"{self.filter} {self.epsilon:g}"


def epsilon_study(options: EpsilonOptions) -> int:
    """Make all runs, print a table for each set-up, draw them; returns 0, or 1 where runs failed.

    Raises:
        SafeWbcError: an option is not allowed; nothing has run then.
    """
    grid = check_epsilon(options)
    folder = study_folder(options.work.out, "benchmark-issf")
    columns = columns_of(grid)
    sections = [
        Section(setup.title, list(cases_of(setup, grid, options)), columns, told, blocks) for setup in setups(options)
    ]
    for setup in setups(options):
        prepare(scenario_of(setup, Variant("issf", grid.alphas[0], grid.epsilons[0]), options, grid))
    command = command_line("benchmark issf", options, folder)
    code = print_sections(sections, "benchmark issf", options.robots[0], options.work, folder, command)
    _draw(folder, sections)
    return code


def check_epsilon(options: EpsilonOptions) -> Grid:
    """Check every option; returns the grid that it asks for.

    Raises:
        ConfigError: one is not allowed.
    """
    if not options.robots:
        raise ConfigError("robots", options.robots, "at least one")
    require_between("jobs", options.work.jobs, 1, 64)
    require_positive("mass_scale", options.mass_scale)
    usual = GRIDS[options.size]
    grid = Grid(
        options.alphas or usual.alphas,
        options.epsilons or usual.epsilons,
        options.friction or usual.frictions,
        options.rates or usual.rates,
        usual.duration if options.duration is None else options.duration,
    )
    for name, values in (("alphas", grid.alphas), ("epsilons", grid.epsilons)):
        for value in values:
            require_positive(name, value)
    for value in grid.frictions:
        require_between("friction", value, 0.0, 10.0)
    for value in grid.rates:
        require_between("rates", value, 50.0, 10_000.0)
    require_between("duration", grid.duration, 0.1, 120.0)
    return grid


def setups(options: EpsilonOptions) -> list[Setup]:
    """All set-ups: every friction at the first rate, and every other rate with the last friction."""
    grid = check_epsilon(options)
    first, *others = grid.rates
    chosen = [(friction, first) for friction in grid.frictions] + [(grid.frictions[-1], rate) for rate in others]
    return [Setup(robot, friction, rate) for robot in options.robots for friction, rate in chosen]


def variants(grid: Grid) -> Iterator[Variant]:
    """All filters with their parameters."""
    yield Variant("none")
    for alpha in grid.alphas:
        yield Variant("cbf", alpha)
        if alpha > ECBF_ABOVE:
            yield Variant("ecbf", alpha)
        for epsilon in grid.epsilons:
            yield Variant("issf", alpha, epsilon)


def scenario_of(setup: Setup, variant: Variant, options: EpsilonOptions, grid: Grid) -> HandTracking:
    """The run of a filter in a set-up."""
    return HandTracking(
        robot=setup.robot,
        duration=grid.duration,
        control_rate=setup.rate,
        plant=PlantOptions(
            mass_scale=options.mass_scale,
            joint_friction_scale=setup.friction,
            physics_dt=min(0.001, 1.0 / setup.rate),
        ),
        safety=FilterOptions(filter=variant.filter, alpha=variant.alpha, epsilon=variant.epsilon),
    )


def cases_of(setup: Setup, grid: Grid, options: EpsilonOptions) -> Iterator[Case]:
    """A run for each filter and its parameters."""
    for variant in variants(grid):
        labels = {
            "robot": setup.robot,
            "friction": setup.friction,
            "rate": setup.rate,
            "filter": variant.filter,
            "column": variant.column,
            "alpha": variant.alpha,
            "epsilon": variant.epsilon,
        }
        yield run_case(scenario_of(setup, variant, options, grid), labels, None, series=False, measure=measure)


def measure(result: Recording) -> dict[str, Any]:
    """What a run is judged by: ``FIGURES``, and how it ended."""
    known = {**result.summary, "jitter": jitter(result)}
    return {key: known[key] for key in (*(figure.key for figure in FIGURES), "fell", "stop_cause")}


def jitter(result: Recording) -> float | None:
    """RMS jerk of the filtered velocities of joints while a self-collision barrier is below ``NEAR`` [rad/s^3].

    ``None`` where it never is.
    """
    v = result.series["v_safe"][:, 6:]
    h = smallest_self_collision(result)
    dt = 1.0 / float(result.config["scenario"]["control_rate"])
    steps = len(h) // max(len(v), 1)
    near = h[:: max(steps, 1)][: len(v)] < NEAR
    jerk = np.diff(v, 2, axis=0) / dt**2
    chosen = jerk[near[1:-1] & np.isfinite(jerk).all(axis=1)]
    return float(np.sqrt(np.mean(chosen**2))) if chosen.size else None


def columns_of(grid: Grid) -> tuple[Metric, ...]:
    """Of the table of a set-up: a figure and a slope a line, a filter a column."""
    names = dict.fromkeys(v.column for v in variants(grid) if v.alpha is not None)
    ordered = sorted(names, key=lambda name: ("cbf", "ecbf", "issf").index(name.split()[0]))
    titles = {name: name.replace("issf ", "issf, epsilon ") for name in ordered}
    return (Metric("figure", "figure"), Metric("alpha", "alpha"), *(Metric(name, titles[name]) for name in ordered))


def blocks(rows: Sequence[Entries]) -> list[dict[str, Any]]:
    """A line for each figure and slope, with the text of each filter's value."""
    found = []
    for figure in FIGURES:
        for alpha in dict.fromkeys(row["alpha"] for row in rows if row["alpha"] is not None):
            line: dict[str, Any] = {"figure": f"{figure.words} [{figure.unit}]", "alpha": alpha}
            line |= {row["column"]: figure.text(row[figure.key]) for row in rows if row["alpha"] == alpha}
            found.append(line)
    return found


def told(rows: Sequence[Entries]) -> str:
    """What is left without a filter, and where robots fell, in a sentence."""
    bare = [row["collision_ratio"] for row in rows if row["filter"] == "none"]
    fell = sum(bool(row["fell"]) for row in rows)
    words = f"Without a filter {1e2 * bare[0]:.0f} % are left" if bare and bare[0] is not None else "Without a filter -"
    return f"{words}. {fell} of {len(rows)} runs fell."


def _draw(folder: Path, sections: Sequence[Section]) -> None:
    """Write ``collisions.png``: collisions left over alpha, a panel for each set-up."""
    from experiments.reports.plots.epsilon import collisions_plot

    store = RowStore(folder)
    panels = [panel_of(s.title, [store.read(case) for case in s.cases if store.is_done(case)]) for s in sections]
    data = collisions_plot(panels)
    add_file(folder, PLOT, lambda path: path.write_bytes(data))
    study_console().print(f"plot:    {folder / PLOT}")


def panel_of(title: str, rows: Sequence[Row]) -> "Panel":
    """What is drawn of a set-up."""
    from experiments.reports.plots.epsilon import Panel

    lines: dict[str, list[tuple[float, float]]] = {}
    for row in rows:
        alpha, ratio = row.labels["alpha"], row.metrics.get("collision_ratio")
        if alpha is not None and ratio is not None:
            lines.setdefault(str(row.labels["column"]), []).append((alpha, ratio))
    return Panel(title, lines)
