"""Many random walks side by side: who falls, and when."""

from collections.abc import Sequence

from experiments.metrics.catalogue import column
from experiments.metrics.metric import Metric
from experiments.running.run import prepare
from experiments.scenarios.random_walk import RandomWalk
from experiments.studies.case import Case
from experiments.studies.command import command_line, study_folder
from experiments.studies.runs import run_case
from experiments.studies.sections import Entries, Section, print_sections
from experiments.studies.study_options import RandomWalksOptions
from robots.checks import require_between

RANDOM_WALK_COLUMNS = (
    Metric("seed", "seed"),
    Metric("ended", "fell"),
    Metric("drawn_mass", "mass"),
    Metric("drawn_links", "links' factor"),
    Metric("drawn_friction", "friction"),
    Metric("drawn_noise", "noise"),
    Metric("drawn_delay_ms", "delay", "ms"),
    Metric("drawn_commands", "commands"),
    Metric("drawn_pushes", "pushes, N s/kg"),
    column("zmp_inside_fraction", "ZMP inside"),
    column("min_h_self_collision_m", "min h self-collision"),
    column("qp_failures", "QP failures"),
)


def random_walks(options: RandomWalksOptions) -> int:
    """Run them all, print who falls and what was drawn; returns 0, or 1 where runs failed.

    Raises:
        SafeWbcError: an option is not allowed; nothing has run then.
    """
    check_random_walks(options)
    folder = study_folder(options.work.out, "random-walks")
    section = Section("", random_walk_cases(options), RANDOM_WALK_COLUMNS, falls)
    command = command_line("run random-walks", options, folder)
    return print_sections([section], "random walks", options.robot, options.work, folder, command)


def check_random_walks(options: RandomWalksOptions) -> None:
    """Check every option before anything runs.

    Raises:
        SafeWbcError: one is not allowed.
    """
    require_between("runs", options.runs, 1, 100_000)
    require_between("jobs", options.work.jobs, 1, 64)
    prepare(_one(options, options.first_seed))


def _one(options: RandomWalksOptions, seed: int) -> RandomWalk:
    return RandomWalk(robot=options.robot, duration=options.duration, seed=seed)


def random_walk_cases(options: RandomWalksOptions, below: str = "") -> list[Case]:
    """A case for each seed; its run is saved in a folder of the study, ``below`` another."""
    seeds = range(options.first_seed, options.first_seed + options.runs)
    return [run_case(_one(options, s), {"seed": s}, f"{below}random-walk-{s}", series=False) for s in seeds]


def falls(rows: Sequence[Entries]) -> str:
    """Who fell or was stopped, in a sentence."""
    down = [r for r in rows if r["ended"] != "no"]
    named = ", ".join(f"{r['seed']} ({r['ended']})" for r in down)
    fraction = f"{len(down)} of {len(rows)} fell or were stopped ({100 * len(down) / len(rows):.3g} %)"
    return fraction + (f": seed {named}." if down else ".")
