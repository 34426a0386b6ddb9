"""Rehearsals as tables."""

from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console

from experiments.metrics.metric import Metric
from experiments.reports.metric_tables import rows_table
from experiments.reports.table import show

TASK_COLUMNS = (
    Metric("task", "task"),
    Metric("how", "played"),
    Metric("seed", "seed"),
    Metric("mass_scale", "mass"),
    Metric("drift", "drift of the gyro's bias", "rad/s/min"),
    Metric("upright", "upright to the end", bad="false"),
    Metric("safe", "every true h above 0", bad="false"),
    Metric("cause", "ended"),
    Metric("way_m", "way", "m"),
    Metric("min_h_self_collision", "min true h, self-collision", "mm", 1e3),
    Metric("min_h_leg_collision", "legs", "mm", 1e3),
    Metric("min_h_joint_limit", "joint limits", "mrad", 1e3),
    Metric("real_time_factor", "real-time factor", ""),
    Metric("late", "late ticks"),
    Metric("late_pairs", "in a row"),
    Metric("periods", "of"),
    Metric("work_median_ms", "work, median", "ms"),
    Metric("work_p99_ms", "p99", "ms"),
    Metric("work_max_ms", "max", "ms"),
    Metric("age_p99_ms", "age of the state, p99", "ms"),
    Metric("again", "played again"),
)

FAULT_COLUMNS = (
    Metric("during", "while"),
    Metric("fault", "fault"),
    Metric("expected", "expected"),
    Metric("as_expected", "as expected", bad="false"),
    Metric("reacts_s", "reacts after", "ms", 1e3),
    Metric("brakes_s", "motors brake after", "ms", 1e3),
    Metric("cause", "cause"),
    Metric("end", "end"),
    Metric("again", "played again"),
)


def show_rows(console: Console, rows: Sequence[Mapping[str, Any]]) -> None:
    """Print tasks and faults, each as a table."""
    tasks, faults = [row for row in rows if "task" in row], [row for row in rows if "fault" in row]
    if tasks:
        timed = any("periods" in row for row in tasks)
        columns = TASK_COLUMNS if timed else TASK_COLUMNS[:12]
        show(rows_table(tasks, columns, f"{len(tasks)} rehearsals of tasks"), console)
    if faults:
        met = sum(bool(row["as_expected"]) for row in faults)
        show(rows_table(faults, FAULT_COLUMNS, f"{len(faults)} faults, {met} as expected"), console)
