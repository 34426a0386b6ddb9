"""Filters in one scene side by side: their figures of merit, as a terminal and a page show them."""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from numpy.typing import NDArray

from experiments.metrics.metric import Metric
from experiments.metrics.scores import TOUCH
from experiments.reports.table import Cell, Column, Row, Table

FIGURES = (
    Metric("J", "J"),
    Metric("C", "C"),
    Metric("S", "S"),
    Metric("S_environment", "S, obstacles"),
    Metric("S_self", "S, own bodies"),
    Metric("feasible_rate", "R_feas", "%", 1e2),
    Metric("infeasible_ticks", "infeasible ticks"),
    Metric("phi_hand_max_m", "largest hand phi", "mm", 1e3),
    Metric("min_h_hand_m", "nearest hand", "mm", 1e3, "negative"),
    Metric("min_h_obstacle_m", "nearest body", "mm", 1e3, "negative"),
    Metric("min_h_self_collision_m", "own bodies", "mm", 1e3, "negative"),
    Metric("min_joint_limit_rad", "room to limits", "rad", bad="negative"),
    Metric("collision_ticks", "collision ticks", bad="positive"),
    Metric("violation_mean", "violation", "m/s"),
    Metric("excess_mean", "excess", "m/s"),
    Metric("switches_per_s", "switches", "1/s"),
    Metric("jump_rms", "jumps", "rad/s"),
    Metric("filter_ms_median", "filter, median", "ms"),
)
"""In the order to show them."""

LEGEND = (
    "J: tracking of the goals, [P14]. C: how little conditions were violated where they were, [P15]. S: how little of "
    "a margin was used where it was entered, [P16]. All three: 1 is best. R_feas: fraction of ticks without violation, "
    "[P17]. Infeasible ticks: no velocity met all conditions (for SSA and its kin those of SSA). phi = d_min - d, with "
    "5 cm for obstacles and 1 cm for own bodies (with --margins own CBF and ISSf-CBF only guarantee d >= 0, which is "
    "phi <= 5 cm). Nearest hand, nearest body: smallest distance to an obstacle. Own bodies: smallest distance between "
    "two. Violation: sum over all conditions, mean over ticks. Excess: root of the sum of its squares, less what p-SSA "
    "would have at the same state, mean. Switches: pairs that enter or leave a margin. Jumps: largest change of a "
    "joint's velocity from tick to tick, RMS. [P n]: equations of Chen, Sun and Liu's paper on p-SSA. S averages over "
    "the pairs inside a margin, so a body pressed into one board may score better than one between both: read it with "
    "the smallest distances."
)


class FilterRun(Protocol):
    """What is shown of one filter's run; see docs/output.md for the figures and the series."""

    @property
    def name(self) -> str:
        """By which the filter was asked for."""

    @property
    def title(self) -> str:
        """For people."""

    @property
    def summary(self) -> Mapping[str, Any]:
        """Figures of merit."""

    @property
    def series(self) -> Mapping[str, NDArray[Any]]:
        """Arrays with a row per tick."""

    @property
    def explanation(self) -> str:
        """The conflicts, in words."""


def corridor_table(runs: Sequence[FilterRun], headings: Sequence[str], caption: str = "") -> Table:
    """The figures of runs side by side, each under a heading of its own."""
    rows = (Row((f.words, *(figure_cell(f, run.summary[f.key]) for run in runs)), f.unit) for f in FIGURES)
    return Table((Column("", words=True), *map(Column, headings)), tuple(rows), caption=caption)


def figure_cell(figure: Metric, value: Any) -> Cell:
    """One figure of one run; ``none`` where there was nothing to score, and no overlap that is only rounding."""
    if value is None and figure.key[0] in "CS":
        return Cell("none")
    if figure.bad == "negative" and -TOUCH <= value < 0:
        value = 0.0
    text = f"{value * figure.factor:.1f}" if figure.unit == "mm" else figure.text(value)
    return Cell(text, figure.is_bad(value))
