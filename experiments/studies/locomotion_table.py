"""The tables of the page on locomotion: every run that it quotes, made anew."""

from collections.abc import Sequence

from rich.console import Console

from experiments.cli.console import results_folder
from experiments.reports.metric_tables import rows_table
from experiments.reports.table import show
from experiments.running.pool import Row, RunTask, in_parallel
from experiments.running.run import prepare
from experiments.running.warmup import warm_up
from experiments.scenarios.options import OutputOptions
from experiments.studies.locomotion_tables import StudyTable, chosen_tables
from experiments.studies.study_options import SECTIONS, LocomotionTableOptions
from robots.checks import require_between, require_one_of
from robots.errors import ConfigError
from robots.loader import load_robot


def locomotion_table(options: LocomotionTableOptions) -> int:
    """Make every run of the chosen sections, print their tables, save the runs; returns 0.

    Times of a tick are measured after all else, by one process alone.

    Raises:
        SafeWbcError: an option is not allowed; nothing has run then.
    """
    check_locomotion_table(options)
    console = Console(stderr=True, markup=False, soft_wrap=True)
    with results_folder(OutputOptions(out=options.out), "locomotion-table") as folder:
        tables = chosen_tables(options, folder)
        _check_runs(tables)
        # once, here: otherwise every process would compile the same kernels
        warm_up(console, load_robot("g1"))
        shared = [table for table in tables if not table.alone]
        done = in_parallel([task for table in shared for task in table.tasks], options.jobs, console)
        for table in shared:
            _print_table(table, [next(done) for _ in table.tasks], console)
        # to its end: the processes then go
        list(done)
        for table in tables:
            if table.alone:
                _print_table(table, list(in_parallel(table.tasks, 1, console)), console)
    console.print(f"runs: {folder}")
    return 0


def check_locomotion_table(options: LocomotionTableOptions) -> None:
    """Check every option.

    Raises:
        ConfigError: one is not allowed.
    """
    if not options.only:
        raise ConfigError("only", options.only, "at least one of " + ", ".join(SECTIONS))
    for name in options.only:
        require_one_of("only", name, SECTIONS)
    require_between("jobs", options.jobs, 1, 64)


def _check_runs(tables: Sequence[StudyTable]) -> None:
    """Every run's options, before the first one: half an hour later would be a bad time to refuse one."""
    for table in tables:
        for task in table.tasks:
            if isinstance(task, RunTask):
                prepare(task.options)


def _print_table(table: StudyTable, rows: Sequence[Row], console: Console) -> None:
    show(rows_table(rows, table.columns, table.title, "" if table.note is None else table.note(rows)))
    seconds = sum(r["cpu_s"] for r in rows)
    console.print(f"{table.title}: {len(rows)} lines, {seconds:.0f} s of processor time")
