"""Where a pushed robot has to step: checked by integrating the pendulum to the landing."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.balance.dcm_plan import DcmPlan, ZmpPhase
from controllers.gaits.footholds import LEFT, RIGHT, Foothold
from controllers.gaits.walking import StepLimits
from controllers.gaits.walking.adjustment import StepAdjustment

OMEGA, SINGLE, DOUBLE = 3.8, 0.6, 0.2
LIMITS = StepLimits(width=0.24, forward=0.35, narrowest=0.1, widest=0.45, turn=0.4)
ZMP_RANGE = (0.05, 0.015)
STANCE = Foothold(0.2, -0.1, 0.4)
ADJUSTMENT = StepAdjustment(LIMITS, OMEGA, ZMP_RANGE, DOUBLE)
LANDING = STANCE.compose(0.16, 0.24, 0.0)


def phases(shift: np.ndarray) -> list[ZmpPhase]:
    """Single support, and two further steps, all footholds after the first moved by ``shift`` (2,), world."""
    third = STANCE.compose(0.32, 0.0, 0.0).point + shift
    second = LANDING.point + shift
    out = [ZmpPhase(STANCE.point, STANCE.point, SINGLE), ZmpPhase(STANCE.point, second, DOUBLE)]
    return [*out, ZmpPhase(second, second, SINGLE), ZmpPhase(second, third, DOUBLE), ZmpPhase(third, third, SINGLE)]


PLAN = DcmPlan(phases(np.zeros(2)), OMEGA)
AT_TOUCHDOWN = PLAN.evaluate(SINGLE).position


@settings(max_examples=60, deadline=None)
@given(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(0.05, 0.55))
def test_the_shifted_plan_is_met_with_a_zmp_in_the_sole(ex: float, ey: float, t: float) -> None:
    """Some constant ZMP within the room takes the DCM to where the plan with shifted footholds has it at landing."""
    dcm = PLAN.evaluate(t).position + STANCE.axes @ [ex, ey]
    remaining = SINGLE - t
    shift = STANCE.axes @ ADJUSTMENT.shift(dcm, STANCE, AT_TOUCHDOWN, remaining)
    growth = np.exp(OMEGA * remaining)
    target = DcmPlan(phases(shift), OMEGA).evaluate(SINGLE).position
    needed = (STANCE.point + (dcm - STANCE.point) * growth - target) / (growth - 1.0) @ STANCE.axes
    assert (np.abs(needed) <= np.array(ZMP_RANGE) + 1e-9).all()


@settings(max_examples=60, deadline=None)
@given(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(0.05, 0.55))
def test_no_smaller_shift_would_do(ex: float, ey: float, t: float) -> None:
    dcm = PLAN.evaluate(t).position + STANCE.axes @ [ex, ey]
    remaining = SINGLE - t
    shift = np.array(ADJUSTMENT.shift(dcm, STANCE, AT_TOUCHDOWN, remaining))
    growth = np.exp(OMEGA * remaining)
    target = DcmPlan(phases(STANCE.axes @ (0.99 * shift)), OMEGA).evaluate(SINGLE).position
    needed = (STANCE.point + (dcm - STANCE.point) * growth - target) / (growth - 1.0) @ STANCE.axes
    assert (np.abs(needed) > np.array(ZMP_RANGE) - 1e-12)[np.abs(shift) > 1e-6].all()


def test_on_the_plan_nothing_moves() -> None:
    for t in (0.0, 0.2, 0.45):
        found, remaining = ADJUSTMENT.adjust(
            PLAN.evaluate(t).position, STANCE, LEFT, LANDING, AT_TOUCHDOWN, SINGLE - t, 0.12
        )
        assert found.point == pytest.approx(LANDING.point, abs=1e-9)
        assert remaining == SINGLE - t


@pytest.mark.parametrize("far", [(0.5, 0.24), (0.1, 0.6), (0.1, 0.02)])
def test_a_foothold_stays_as_planned_as_long_as_nothing_has_to_move(far: tuple[float, float]) -> None:
    """To the last digit, its time too, even one beyond the bounds: these are for footholds that are moved."""
    planned = STANCE.compose(*far, 0.6)
    for error, kept in ((0.0, True), (0.002, True), (0.05, False)):
        dcm = PLAN.evaluate(0.2).position + STANCE.axes @ [0.0, error]
        found, remaining = ADJUSTMENT.adjust(dcm, STANCE, LEFT, planned, AT_TOUCHDOWN, SINGLE - 0.2, 0.12)
        assert (found == planned and remaining == SINGLE - 0.2) is kept


@settings(max_examples=60, deadline=None)
@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(0.0, 0.4), st.sampled_from((LEFT, RIGHT)))
def test_footholds_and_times_stay_in_reach(ex: float, ey: float, t: float, swing: int) -> None:
    side = 1.0 if swing == LEFT else -1.0
    planned = STANCE.compose(0.1, 0.24 * side, 0.0)
    found, remaining = ADJUSTMENT.adjust(
        PLAN.evaluate(t).position + np.array([ex, ey]), STANCE, swing, planned, AT_TOUCHDOWN, SINGLE - t, 0.12
    )
    x, y, _ = STANCE.relative(found)
    assert abs(x) <= 0.35 + 1e-9
    assert 0.1 - 1e-9 <= side * y <= 0.45 + 1e-9
    assert 0.12 - 1e-9 <= remaining <= SINGLE - t + 1e-9


def test_a_push_over_the_standing_foot_is_answered_by_an_earlier_landing() -> None:
    """The feet cannot cross: time is all that is remaining."""
    dcm = PLAN.evaluate(0.1).position + STANCE.axes @ [0.0, -0.06]
    found, remaining = ADJUSTMENT.adjust(dcm, STANCE, LEFT, LANDING, AT_TOUCHDOWN, 0.5, 0.12)
    assert STANCE.relative(found)[1] == pytest.approx(0.1, abs=1e-9)
    assert remaining < 0.3
