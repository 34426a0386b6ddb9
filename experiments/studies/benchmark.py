"""The papers' test cases, each filter on the same scenes: ``safewbc benchmark``."""

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from importlib import resources
from typing import Any

from experiments.metrics.metric import Metric
from experiments.running.benchmark_loop import (
    FILTERS,
    KNOWN_VELOCITIES,
    PLANTS,
    BenchmarkEpisode,
    BenchmarkRig,
    rig_of,
    scores,
)
from experiments.scenarios.benchmark_case import load_cases
from experiments.studies.benchmark_plants import show_plants
from experiments.studies.case import Case, content_key
from experiments.studies.command import command_line, study_folder
from experiments.studies.sections import Entries, Section, print_sections
from experiments.studies.statistics import spread
from experiments.studies.store import RowStore
from experiments.studies.study_options import BenchmarkOptions
from robots.checks import require_between, require_one_of
from robots.errors import ConfigError

SUITES: dict[str, tuple[str, ...]] = {
    "spark": ("none", "ssa", "ssa-naive", "rssa", "pssa", "sss", "sss-naive", "cbf", "cbf-naive", "issf", "pfm", "sma"),
    "p-ssa": ("ssa-naive", "rssa", "pssa"),
}
"""Filters of the suites; their cases are those of their papers."""

SOURCES = {"spark": "SPARK", "p-ssa": "p-SSA"}
"""What their cases say of where they are from."""

SIZES: dict[tuple[str, str], tuple[int, int]] = {
    ("spark", "smoke"): (6, 200),
    ("spark", "paper"): (60, 200),
    ("p-ssa", "smoke"): (2, 500),
    ("p-ssa", "paper"): (10, 2000),
}
"""Seeds, and steps of an episode at most."""

SCORES = ("J_arm", "J_base", "M_self", "M_env")
"""Of SPARK."""

SPARK_COLUMNS = (
    Metric("filter", "filter"),
    *(column for name in SCORES for column in (Metric(name, name), Metric(f"paper_{name}", "paper"))),
    Metric("success_paper", "success, the paper's rule", "%", 1e2),
    Metric("paper_success", "paper", "%", 1e2),
    Metric("success", "success: all goals, nothing touched", "%", 1e2),
    Metric("success_clear", "of scenes that begin outside the margin", "%", 1e2),
    Metric("steps_in_margin", "steps within the margin", "%", 1e2),
    Metric("steps_in_collision", "in collision", "%", 1e2),
    Metric("least_h", "least h", "mm", 1e3),
    Metric("R_feas", "R_feas"),
    Metric("passed_unsafe", "unsafe inputs passed on", ""),
    Metric("filter_ms", "filter, median", "ms"),
)
PSSA_COLUMNS = (
    Metric("filter", "filter"),
    Metric("J", "J"),
    Metric("C", "C"),
    Metric("S", "S"),
    Metric("R_feas", "R_feas"),
    Metric("goals_reached", "goals reached in an episode"),
    *SPARK_COLUMNS[-7:-4],
    Metric("passed_unsafe", "unsafe inputs passed on", ""),
    Metric("filter_ms", "filter, median", "ms"),
)
COLUMNS = {"spark": SPARK_COLUMNS, "p-ssa": PSSA_COLUMNS}
TORQUE_COLUMNS = (
    Metric("saturated", "physics steps with a motor at its limit", "%", 1e2),
    Metric("unstable", "episodes in which the simulation blew up", "%", 1e2, bad="positive"),
)
"""Further ones where torques move the robot."""


def benchmark(options: BenchmarkOptions) -> int:
    """Run the suite, print a table for each case; returns 0, or 1 where episodes failed.

    Raises:
        SafeWbcError: an option is not allowed; nothing has run then.
    """
    rigs = check_benchmark(options)
    folder = study_folder(options.work.out, f"benchmark-{options.suite}")
    sections = [
        Section(
            title_of(rig, options, plant),
            benchmark_cases(options, rig, plant),
            COLUMNS[options.suite] + (TORQUE_COLUMNS if PLANTS[plant] is not None else ()),
            told,
            partial(summed, papers().get(rig.case.name, {})),
        )
        for plant in options.plants
        for rig in rigs
    ]
    # the suite is a word of its own there
    command = command_line(f"benchmark {options.suite}", replace(options, suite="spark"), folder)
    code = print_sections(sections, f"benchmark {options.suite}", "g1", options.work, folder, command)
    if len(options.plants) > 1:
        store = RowStore(folder)
        rows = [store.read(case) for section in sections for case in section.cases if store.is_done(case)]
        show_plants([row.entries() for row in rows if row.error is None], folder)
    return code


def check_benchmark(options: BenchmarkOptions) -> list[BenchmarkRig]:
    """Check every option before anything runs; returns what each case needs.

    Raises:
        SafeWbcError: one is not allowed.
    """
    require_one_of("velocity", options.velocity, KNOWN_VELOCITIES)
    require_between("jobs", options.work.jobs, 1, 64)
    for name in filters_of(options):
        require_one_of("filters", name, FILTERS)
    for name in options.plants:
        require_one_of("plants", name, tuple(PLANTS))
    if len(set(options.plants)) != len(options.plants) or not options.plants:
        raise ConfigError("plants", " ".join(options.plants), "one at least, each of them once")
    for name in ("seeds", "steps"):
        if (given := getattr(options, name)) is not None:
            require_between(name, given, 1, 100_000)
    require_between("order", options.order, 1, 2 if options.suite == "spark" else 1)
    require_between("first_seed", options.first_seed, 0, 2**31)
    book = load_cases(options.case_file)
    names = options.cases or [
        name
        for name, case in book.cases.items()
        if case.source == SOURCES[options.suite]
        and case.order == options.order
        and case.configuration.base != "walking"
    ]
    return [rig_of(book, name, options.counts) for name in names]


def filters_of(options: BenchmarkOptions) -> Sequence[str]:
    """Names of the filters to run."""
    return options.filters or SUITES[options.suite]


def size_of(options: BenchmarkOptions) -> tuple[int, int]:
    """How many seeds, and how many steps an episode has at most."""
    seeds, steps = SIZES[options.suite, options.size]
    return options.seeds or seeds, options.steps or steps


def title_of(rig: BenchmarkRig, options: BenchmarkOptions, plant: str = "integrator") -> str:
    """Of a case's table."""
    seeds, steps = size_of(options)
    where = "" if plant == "integrator" else f", {plant}"
    return f"{rig.case.name}{where}: {rig.number} obstacles, {seeds} seeds, {steps} steps at most"


def benchmark_cases(options: BenchmarkOptions, rig: BenchmarkRig, plant: str = "integrator") -> list[Case]:
    """An evaluation for each filter and seed of a case on a plant."""
    seeds, steps = size_of(options)
    digest = None if options.case_file is None else options.case_file.read_text(encoding="utf-8")
    found = []
    for name in filters_of(options):
        for seed in range(options.first_seed, options.first_seed + seeds):
            labels = {"case": rig.case.name, "filter": name, "seed": seed, "plant": plant}
            content = {**labels, "steps": steps, "number": rig.number, "velocity": options.velocity, "file": digest}
            how = {"velocity": options.velocity, "plant": plant}
            play = partial(evaluate, options.case_file, rig.case.name, options.counts, name, seed, steps, **how)
            found.append(Case(content_key("benchmark", content), labels, partial(_in_store, play)))
    return found


@cache
def _rig(path: Any, name: str, counts: str) -> BenchmarkRig:
    return rig_of(load_cases(path), name, counts)


def _in_store(play: Callable[[], dict[str, Any]], store: RowStore) -> dict[str, Any]:
    return play()


def evaluate(
    path: Any,
    case: str,
    counts: str,
    name: str,
    seed: int,
    steps: int,
    velocity: str = "none",
    plant: str = "integrator",
) -> dict[str, Any]:
    """Scores of one episode; see :func:`experiments.running.benchmark_loop.scores`."""
    rig = _rig(path, case, counts)
    return scores(rig.case, BenchmarkEpisode(rig, name, seed, velocity, plant).run(steps))


@cache
def papers() -> Mapping[str, Mapping[str, Mapping[str, float]]]:
    """What the SPARK paper prints, by case, filter and score."""
    return tomllib.loads((resources.files("experiments") / "data" / "benchmark_papers.toml").read_text("utf-8"))


AVERAGED = ("J_arm", "J_base", "M_self", "M_env", "J", "C", "S", "R_feas")
"""Shown with the interval of their mean over seeds."""

PLAIN = (
    *("success_paper", "success", "steps_in_margin", "steps_in_collision", "passed_unsafe", "goals_reached"),
    *("saturated", "unstable"),
    "filter_ms_median",
)
"""Shown as their mean."""


def summed(paper: Mapping[str, Mapping[str, float]], rows: Sequence[Entries]) -> list[dict[str, Any]]:
    """A line for each filter: means over the seeds, with what the paper says of it."""
    by_filter: dict[str, list[Entries]] = {}
    for row in rows:
        by_filter.setdefault(row["filter"], []).append(row)
    lines = []
    for name, members in by_filter.items():
        line: dict[str, Any] = {"filter": name}
        for key in AVERAGED:
            line[key] = _interval([row[key] for row in members if row[key] is not None])
        for key in PLAIN:
            line[key] = sum(row[key] for row in members) / len(members)
        line["filter_ms"] = line.pop("filter_ms_median")
        clear = [row["success"] for row in members if not row["starts_in_margin"]]
        line["success_clear"] = sum(clear) / len(clear) if clear else None
        least = [
            h for row in members for h in (row["min_h_obstacle_m"], row["min_h_self_collision_m"]) if h is not None
        ]
        line["least_h"] = min(least)
        lines.append(
            line | {f"paper_{key}": value for key, value in paper.get(name.removesuffix("-naive"), {}).items()}
        )
    return lines


def _interval(values: Sequence[float]) -> str | None:
    """Mean and its interval in words; ``None`` where nothing is defined."""
    if not values:
        return None
    found = spread(values)
    return f"{found.mean:.3f}" if found.low == found.high else f"{found.mean:.3f} [{found.low:.3f}, {found.high:.3f}]"


def told(rows: Sequence[Entries]) -> str:
    """How many scenes begin within the margin, in a sentence."""
    seeds = {row["seed"]: row["starts_in_margin"] for row in rows}
    return f"{sum(seeds.values())} of {len(seeds)} scenes begin within the margin."
