"""What a person sees of a study: its table on the terminal, and ``report.html``."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from urllib.parse import quote

from experiments.metrics.metric import Metric
from experiments.reports.page import PlotPart, write_page
from experiments.reports.table import Cell, Column, Table, show
from experiments.reports.table import Row as Line
from experiments.studies.case import Row
from experiments.studies.command import tell_failures
from experiments.studies.index import StudyFolder
from experiments.studies.plots import numeric_parameters, plot_over
from experiments.studies.progress import study_console
from experiments.studies.statistics import varied
from experiments.studies.tables import chosen_metrics, label_text, study_table

PLOT_CAPTION = "Mean over everything else, and its 95 % bootstrap interval; dashed where the parameter has no effect."


def present(study: StudyFolder, rows: Sequence[Row], asked: Sequence[str] = ()) -> int:
    """Print the table and write the report; returns 0, or 1 where rows failed.

    Raises:
        SafeWbcError: a metric is not known, or the report cannot be written.
    """
    metrics = chosen_metrics(rows, asked, study.metrics)
    if metrics:
        show(study_table(rows, metrics, study.title))
    path = write_study_report(study, rows, metrics)
    study_console().print(f"report:  {path}")
    return tell_failures(list(rows), study.folder)


def write_study_report(study: StudyFolder, rows: Sequence[Row], metrics: Sequence[Metric]) -> Path:
    """Write ``report.html``: table, plots over every parameter that is a number, failures, and all rows with links.

    Raises:
        ConfigError: it cannot be written.
    """
    over = numeric_parameters(rows) if metrics else []
    return write_page(
        study.folder / "report.html",
        "study.html.jinja",
        title=study.title,
        lead="This makes it again, or goes on with it where it was cut short:",
        note="",
        command=study.command,
        table=study_table(rows, metrics) if metrics else None,
        plots=[PlotPart(f"Over {name}", plot_over(rows, name, metrics), PLOT_CAPTION) for name in over],
        failures=[(_words(row), row.error) for row in rows if row.error is not None],
        rows=_rows_table(rows, metrics),
    )


def _words(row: Row) -> str:
    return ", ".join(f"{name} {label_text(value)}" for name, value in row.labels.items())


def _rows_table(rows: Sequence[Row], metrics: Sequence[Metric]) -> Table:
    """Every row with its parameters, metrics, the folder of its run, and how to make the run again."""
    names = list(varied(rows))
    columns = [*(Column(name, words=True) for name in names), *(Column(m.words, m.unit) for m in metrics)]
    stopped = any(row.stop_cause is not None for row in rows)
    columns += [Column("stopped because", words=True)] if stopped else []
    columns += [Column("run", words=True), Column("again, from the folder of the study", words=True)]
    lines = []
    for row in rows:
        cells = [Cell(label_text(row.labels.get(name))) for name in names]
        values = [row.metrics.get(m.key) for m in metrics]
        cells += [Cell(m.text(v), m.is_bad(v)) for m, v in zip(metrics, values, strict=True)]
        cells += [Cell(row.stop_cause or "-", bad=row.stop_cause is not None)] if stopped else []
        lines.append(Line((*cells, *_links(row))))
    return Table(tuple(columns), tuple(lines))


def _links(row: Row) -> Iterator[Cell]:
    if row.error is not None:
        yield Cell("failed", bad=True)
    elif row.folder is not None:
        yield Cell(row.folder, link=f"{quote(row.folder)}/")
        yield Cell(f"safewbc replay {row.folder}")
