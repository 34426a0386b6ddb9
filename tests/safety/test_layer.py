"""The boundary layer of SSA and its kin: what it asks for, its continuity, and what a bounded error does to it."""

import numpy as np
import pytest

from robots.messages import Array
from safety.barriers.rows import FAMILIES, BarrierRows
from safety.filters.conditions import SET_MARGINS, BarrierParameters, FamilyParameters, RowParameters, cbf, ssa, sss

ETA, LAYER, MARGIN, SLOPE = 0.3, 0.02, 0.05, 8.0


def of_rows(n: int, layer: float = LAYER) -> RowParameters:
    values = FamilyParameters(alpha=SLOPE, eta=ETA, layer=layer, margin=MARGIN, slope=SLOPE)
    return BarrierParameters(**dict.fromkeys(FAMILIES, values)).of_rows(np.zeros(n, dtype=np.intp))


def rows_at(h: Array) -> BarrierRows:
    rng = np.random.default_rng(1)
    return BarrierRows(h, rng.normal(size=(h.size, 3)), rng.normal(size=h.size), np.zeros(h.size, dtype=np.intp))


def test_it_asks_for_all_from_its_depth_on_and_for_less_above() -> None:
    h = np.linspace(-0.1, 0.2, 601)
    rows = rows_at(h)
    spaces = ssa(rows, of_rows(h.size))
    asked = spaces.b + rows.dh_dt
    assert spaces.active.all()
    np.testing.assert_allclose(asked[h <= MARGIN - LAYER], ETA, rtol=1e-12)
    np.testing.assert_allclose(np.interp(MARGIN, h, asked), 0.0, atol=1e-12)
    # nowhere more than what the paper asks for, and never a step
    assert (asked <= ETA + 1e-12).all()
    np.testing.assert_array_less(np.abs(np.diff(asked)), ETA / LAYER * np.diff(h) + 1e-12)


def test_without_a_layer_it_is_the_papers_switch() -> None:
    h = np.array([MARGIN - 1e-9, MARGIN, MARGIN + 1e-9, MARGIN - LAYER])
    rows = rows_at(h)
    spaces = ssa(rows, of_rows(4, layer=0.0))
    assert spaces.active.tolist() == [True, True, False, True]
    np.testing.assert_allclose(spaces.b + rows.dh_dt, ETA, rtol=1e-12)


def test_families_with_and_without_a_layer_stand_side_by_side() -> None:
    own = BarrierParameters(
        self_collision=FamilyParameters(eta=ETA, layer=LAYER), obstacle=FamilyParameters(eta=ETA, layer=0.0)
    )
    family = np.array([FAMILIES.index("self_collision"), FAMILIES.index("obstacle")], dtype=np.intp)
    rows = BarrierRows(np.array([0.1, 0.1]), np.ones((2, 3)), np.zeros(2), family)
    spaces = ssa(rows, own.of_rows(family, SET_MARGINS))
    assert spaces.active.tolist() == [True, False]
    assert spaces.b[0] == pytest.approx(ETA * (SET_MARGINS["self_collision"] - 0.1) / LAYER)


def test_sss_with_a_layer_is_a_cbf_with_its_margin() -> None:
    rows = rows_at(np.linspace(-0.1, 0.2, 31))
    with_layer, control = sss(rows, of_rows(31)), cbf(rows, of_rows(31))
    np.testing.assert_allclose(with_layer.b, control.b, rtol=0, atol=1e-14)
    assert with_layer.active.all()


@pytest.mark.parametrize("fraction", [0.0, 0.3, 0.9])
@pytest.mark.parametrize("start", [0.3, MARGIN, MARGIN - LAYER, -0.1])
def test_an_error_of_the_rate_costs_no_more_than_its_share_of_the_layer(start: float, fraction: float) -> None:
    """The rate is as low as the condition lets it be, less an error of delta = fraction * eta, in fine steps."""
    dt, delta = 5e-4, fraction * ETA
    lowest = MARGIN - fraction * LAYER
    slowest = max(0.0, (MARGIN - LAYER - start) / (ETA - delta)) if start < MARGIN - LAYER else 0.0
    h, below_layer = start, 0.0
    for k in range(12000):
        rows = BarrierRows(np.array([h]), np.ones((1, 1)), np.zeros(1), np.zeros(1, dtype=np.intp))
        h += dt * (float(ssa(rows, of_rows(1)).b[0]) - delta)
        if start >= lowest:
            assert h >= lowest - 1e-12
        if h < MARGIN - LAYER:
            below_layer = (k + 1) * dt
    assert below_layer <= slowest + 2 * dt
    assert h == pytest.approx(lowest, abs=1e-6)
