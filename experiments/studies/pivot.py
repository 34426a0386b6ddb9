"""``safewbc pivot``: a metric of a finished or half-finished study by one or two of its parameters."""

from dataclasses import dataclass
from pathlib import Path

import tyro


@dataclass(frozen=True)
class PivotOptions:
    """Show one metric of a study by one or two of its parameters; of a study that is under way, of what is done."""

    folder: tyro.conf.Positional[Path]
    """Folder of the study."""
    rows: str
    """Parameter whose values are the lines."""
    metric: str
    """Name of a metric, as in results.parquet."""
    columns: str | None = None
    """Parameter whose values are the columns."""
    write_results: bool = False
    """Write results.parquet of what is done, too; a study writes it only when all is done."""
    statistic: str = "mean"
    """What a cell holds of the runs that share both values: mean, min, max, median or count."""


def show_pivot(options: PivotOptions) -> int:
    """Print the pivot; returns 0.

    Raises:
        SafeWbcError: it is no folder of a study, or a name is not known.
    """
    from experiments.reports.table import show
    from experiments.studies.index import read_study
    from experiments.studies.results_file import write_results
    from experiments.studies.tables import pivot

    names = [name and name.replace("-", "_") for name in (options.rows, options.columns)]
    study = read_study(options.folder)
    rows = study.rows()
    if options.write_results:
        write_results(rows, options.folder)
    show(pivot(rows, str(names[0]), names[1], options.metric, options.statistic, study.metrics))
    return 0
