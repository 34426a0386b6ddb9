"""``safewbc sweep``: a scenario over a grid or a random sample of its parameters."""

from experiments.metrics.catalogue import DECLARED_KEYS
from experiments.scenarios.registry import SCENARIOS
from experiments.scenarios.scenario import reference_to
from experiments.studies.case import Study
from experiments.studies.command import command_line, run_study, study_folder
from experiments.studies.grid import Sweep, make_sweep, read_values
from experiments.studies.index import read_study
from experiments.studies.present import present
from experiments.studies.progress import study_console
from experiments.studies.runs import WarmUp
from experiments.studies.sweep_options import SweepOptions
from robots.errors import UnknownNameError


def sweep(options: SweepOptions) -> int:
    """Run what has not been run yet, print the table, write results and report; returns 0, or 1 where runs failed.

    Raises:
        SafeWbcError: an option is not allowed; nothing has run then.
    """
    console, name = study_console(), reference_to(options.scenario)
    with console.status("checking every combination"):
        plan = plan_of(options)
    for note in plan.notes:
        console.print(note)
    folder = study_folder(options.work.out, f"sweep-{options.scenario.name}")
    title = f"Sweep of {name}, {len(plan.cases)} runs"
    command, scenario = command_line(f"sweep {name}", options, folder), options.scenario
    own = () if scenario in SCENARIOS else scenario.metrics
    study = Study(title, plan.cases, WarmUp(scenario().robot), command, own)
    rows = list(run_study(study, options.work, folder))
    return present(read_study(folder), rows, options.metrics)


def plan_of(options: SweepOptions) -> Sweep:
    """The cases that the options ask for.

    Raises:
        SafeWbcError: an option is not allowed, or a metric that is asked for is none of the scenario's.
    """
    if options.scenario in SCENARIOS:  # one from outside may give what it does not declare
        for name in options.metrics:
            if name not in DECLARED_KEYS:
                raise UnknownNameError("metric", name, list(DECLARED_KEYS))
    values = read_values(options.scenario, options.texts(), options.sample is not None)
    return make_sweep(options.scenario(), values, options.sample, options.sample_seed, options.series)
