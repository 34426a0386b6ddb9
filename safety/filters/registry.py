"""The filters by name: which condition and which resolution each is made of."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from safety.barriers.rows import BarrierRows, HalfSpaces
from safety.filters.conditions import NO_MARGINS, SET_MARGINS, RowParameters, cbf, issf_cbf, ssa, sss, worst_row

Condition = Callable[[BarrierRows, RowParameters], HalfSpaces]


@dataclass(frozen=True, slots=True)
class FilterKind:
    """What makes one filter differ from another.

    Attributes:
        name: in configurations.
        title: in texts and figures.
        condition: half-spaces of the rows; ``None``: no condition.
        resolution: ``qp``, ``slack_qp``, ``two_phase``, ``push_cartesian`` or ``push_joint``; ``none``: pass through.
        source: paper and equations.
        margins: margin by family where the parameters give none.
        orders: relative degrees it is defined for: 1, input velocity; 2, input acceleration.
    """

    name: str
    title: str
    condition: Condition | None
    resolution: str
    source: str
    margins: Mapping[str, float]
    orders: tuple[int, ...] = (1, 2)


LEE = "Lee et al., Safety-Critical Whole-Body Control for Humanoid Robots via ISSf-CBFs"
PSSA = "p-SSA paper"
SPARK = "SPARK"

KINDS: dict[str, FilterKind] = {
    kind.name: kind
    for kind in (
        FilterKind("none", "no filter", None, "none", f"baseline w/o-CBF of {LEE}", NO_MARGINS),
        FilterKind("cbf", "CBF", cbf, "qp", f"{LEE}, eqs. (5), (31), (33); {SPARK}, eq. (6)", NO_MARGINS),
        FilterKind("issf", "ISSf-CBF", issf_cbf, "qp", f"{LEE}, eqs. (32), (33)", NO_MARGINS),
        FilterKind("ecbf", "eCBF", cbf, "qp", f"{LEE}, eqs. (54), (55)", NO_MARGINS, (2,)),
        FilterKind("ssa", "SSA", ssa, "qp", f"{PSSA}, eq. (9); {SPARK}, eq. (5)", SET_MARGINS),
        FilterKind("rssa", "r-SSA", ssa, "slack_qp", f"{PSSA}, eq. (10)", SET_MARGINS),
        FilterKind("pssa", "p-SSA", ssa, "two_phase", f"{PSSA}, eqs. (12), (13)", SET_MARGINS),
        FilterKind("sss", "SSS", sss, "qp", f"{SPARK}, eq. (7)", SET_MARGINS),
        FilterKind("pfm", "PFM", worst_row, "push_cartesian", f"{SPARK}, eqs. (8)-(10)", SET_MARGINS),
        FilterKind("sma", "SMA", worst_row, "push_joint", f"{SPARK}, eqs. (12), (13)", SET_MARGINS),
    )
}
"""All filters by name."""

FILTERS = tuple(KINDS)

CONDITIONS: dict[str, Condition] = {kind.name: kind.condition for kind in KINDS.values() if kind.condition}
