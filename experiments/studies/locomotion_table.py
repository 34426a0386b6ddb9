"""The tables of the page on locomotion: every run that it quotes, made anew."""

from collections.abc import Iterator, Sequence

from experiments.running.run import prepare
from experiments.scenarios.scenario import Scenario
from experiments.studies.command import command_line, study_folder
from experiments.studies.locomotion_tables import chosen_tables
from experiments.studies.runs import Run
from experiments.studies.sections import Section, print_sections
from experiments.studies.study_options import SECTIONS, LocomotionTableOptions
from robots.checks import require_between, require_one_of
from robots.errors import ConfigError


def locomotion_table(options: LocomotionTableOptions) -> int:
    """Make every run of the chosen sections, print their tables; returns 0, or 1 where runs failed.

    Times of a tick are measured after all else, by one process alone.

    Raises:
        SafeWbcError: an option is not allowed; nothing has run then.
    """
    check_locomotion_table(options)
    sections = chosen_tables(options)
    # half an hour later would be a bad time to refuse one
    for scenario in scenarios_of(sections):
        prepare(scenario)
    folder = study_folder(options.work.out, "locomotion-table")
    command = command_line("run locomotion-table", options, folder)
    return print_sections(sections, "tables on locomotion", "g1", options.work, folder, command)


def check_locomotion_table(options: LocomotionTableOptions) -> None:
    """Check every option.

    Raises:
        ConfigError: one is not allowed.
    """
    if not options.only:
        raise ConfigError("only", options.only, "at least one of " + ", ".join(SECTIONS))
    for name in options.only:
        require_one_of("only", name, SECTIONS)
    require_between("jobs", options.work.jobs, 1, 64)


def scenarios_of(sections: Sequence[Section]) -> Iterator[Scenario]:
    """The scenarios of all cases that are one run each."""
    for section in sections:
        for case in section.cases:
            if isinstance(case.evaluate, Run) and isinstance(case.evaluate.scenario, Scenario):
                yield case.evaluate.scenario
