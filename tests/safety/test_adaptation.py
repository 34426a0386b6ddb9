"""Epsilon that follows the disturbance: its bounds whatever is measured, its value under a steady push, stability."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robots.errors import ConfigError
from robots.messages import Array
from safety.barriers.rows import FAMILIES, BarrierRows
from safety.filters.adaptation import AdaptationTuning, EpsilonAdapter
from safety.filters.conditions import BarrierParameters, FamilyParameters
from safety.filters.safety_filter import FilterStatus, SafetyFilter
from tests.support.rows import rows_of

DT = 0.002
PARAMETERS = BarrierParameters(
    self_collision=FamilyParameters(5.0, 4.0),
    obstacle=FamilyParameters(5.0, 8.0),
    joint_limit=FamilyParameters(5.0, 2.0),
)
ANY = st.floats(allow_nan=True, allow_infinity=True)


def rows(jac: Array, family: str = "self_collision") -> BarrierRows:
    return rows_of(np.full(len(jac), 0.01), jac, family=family)


def steady(push: float, jac: Array, ticks: int, tuning: AdaptationTuning) -> float:
    """epsilon of one row after ``ticks`` in which the robot falls short of what it is told by ``push`` along it."""
    adapter = EpsilonAdapter(PARAMETERS, tuning, DT)
    for _ in range(ticks):
        adapter.told(push * jac / (jac @ jac))
        epsilon = adapter.epsilon(rows(jac[None]), np.zeros(jac.size))
    return float(epsilon[0])


@given(
    jac=st.lists(st.lists(ANY, min_size=3, max_size=3), min_size=2, max_size=2),
    velocities=st.lists(st.lists(ANY, min_size=3, max_size=3), min_size=1, max_size=8),
    least=st.floats(0.01, 1.0),
)
def test_epsilon_stays_between_its_ends_whatever_is_measured(
    jac: list[list[float]], velocities: list[list[float]], least: float
) -> None:
    adapter = EpsilonAdapter(PARAMETERS, AdaptationTuning(least=least), DT)
    family = np.array([FAMILIES.index("obstacle"), FAMILIES.index("joint_limit")])
    most = np.array([8.0, 2.0])
    given_rows = BarrierRows(np.zeros(2), np.array(jac), np.zeros(2), family)
    for velocity in velocities:
        with np.errstate(all="ignore"):
            epsilon = adapter.epsilon(given_rows, np.array(velocity))
        assert (epsilon >= least * most).all()
        assert (epsilon <= most).all()
        adapter.told(np.zeros(3))
    # and numbers that were none do not stay behind
    adapter.told(np.zeros(3))
    sound = BarrierRows(np.zeros(2), np.ones((2, 3)), np.zeros(2), family)
    with np.errstate(all="ignore"):
        for _ in range(3):
            epsilon = adapter.epsilon(sound, np.zeros(3))
    assert np.isfinite(epsilon).all()


@settings(max_examples=20)
@given(push=st.floats(0.001, 0.2), size=st.floats(0.1, 2.0))
def test_a_steady_push_is_made_up_for(push: float, size: float) -> None:
    """|J|^2/epsilon becomes |J|^2/epsilon_max + push, so that nothing of the room at rest is lost to it."""
    jac, tuning = size * np.array([0.6, 0.0, 0.8]), AdaptationTuning(time=0.02, least=1e-6)
    epsilon = steady(push, jac, 500, tuning)
    assert size**2 / epsilon == pytest.approx(size**2 / 4.0 + push, rel=1e-9)


def test_a_push_away_from_the_limit_changes_nothing() -> None:
    assert steady(-0.2, np.array([0.3, 0.0, 0.1]), 500, AdaptationTuning()) == 4.0


def test_the_estimate_rises_with_its_time_constant() -> None:
    jac, time = np.array([1.0, 0.0]), 0.2
    for ticks in (1, 50, 100):
        epsilon = steady(0.1, jac, ticks, AdaptationTuning(time, 1e-6))
        assert 1.0 / epsilon - 0.25 == pytest.approx(0.1 * -math.expm1(-ticks * DT / time), rel=1e-9)


@settings(max_examples=15)
@given(lag=st.floats(0.01, 0.05), time=st.floats(0.05, 0.2), size=st.floats(0.1, 1.0), push=st.floats(0.0, 0.05))
def test_with_motors_that_lag_the_loop_settles(lag: float, time: float, size: float, push: float) -> None:
    """A row held at its limit by motors of a time constant, pushed in steadily: h ends where no push would leave it."""
    adapter = EpsilonAdapter(PARAMETERS, AdaptationTuning(time, 1e-9), DT)
    alpha = min(5.0, 0.2 / (lag + time))
    jac, h, v = np.array([[size]]), size**2 / (4.0 * alpha), 0.0
    heights = []
    for _ in range(round(15.0 * (lag + time + 1.0 / alpha) / DT)):
        epsilon = adapter.epsilon(rows(jac), np.array([v - push / size]))[0]
        told = (-alpha * h + size**2 / epsilon) / size
        adapter.told(np.array([told]))
        v += DT / lag * (told - v)
        h += DT * (size * v - push)
        heights.append(h)
    assert heights[-1] == pytest.approx(size**2 / (4.0 * alpha), rel=1e-3)
    assert np.ptp(heights[-200:]) < 1e-3 * heights[-1]


def lagging_loop(filtered: Array, lag: float, time: float, dt: float) -> Array:
    """Estimates of the push, shape (n,), on a row held at h = 0 by motors that lag; ``filtered`` (n,) is the push after
    the adapter's filter, as it would be without the motors' lag."""
    adapter, jac = EpsilonAdapter(PARAMETERS, AdaptationTuning(time, 1e-9), dt), np.array([[1.0]])
    fraction = -math.expm1(-dt / time)
    before = np.r_[0.0, filtered[:-1]]
    pushes = before + (filtered - before) / fraction
    v = 0.25
    estimates: list[Array] = []
    for push in pushes.tolist():
        adapter.told(np.array([0.25 + (estimates[-1] if estimates else 0.0)]))
        estimates.append(1.0 / adapter.epsilon(rows(jac), np.array([v - push]))[0] - 0.25)
        v += -math.expm1(-dt / lag) * (0.25 + estimates[-1] - v)
    return np.array(estimates)


@pytest.mark.parametrize(("lag", "time"), [(0.1, 0.01), (0.1, 0.03), (0.05, 0.05), (0.02, 0.2)])
def test_lag_raises_the_estimate_by_a_known_factor_in_the_mean_square_and_its_peak_by_more(
    lag: float, time: float
) -> None:
    dt, bias, size = 2e-4, 10.0, 0.2
    n = settled = round(20.0 * max(lag, time) / dt)
    factor, frequency = 1.0 + lag / time, 1.0 / math.sqrt(lag * time)
    sine = size * np.sin(frequency * dt * np.arange(settled + n))
    raised = lagging_loop(bias + sine, lag, time, dt) - bias
    assert raised[settled:].std() / sine[settled:].std() == pytest.approx(factor, rel=0.02)
    # the push that raises the last estimate most: the signs of the impulse response, backwards
    response = np.real(_impulse_response(lag, time, dt * np.arange(n)))
    worst = np.r_[np.zeros(settled), size * np.sign(response[::-1])]
    raised = lagging_loop(bias + worst, lag, time, dt)[settled:] - bias
    peak = raised.max() / size
    assert peak == pytest.approx(1.0 + dt * np.abs(response).sum(), rel=0.02)
    assert factor < peak < 1.0 + 2.0 * lag / time
    assert np.square(raised).sum() < factor**2 * np.square(worst).sum()


def _impulse_response(lag: float, time: float, t: Array) -> Array:
    """Of lag s / (lag time s^2 + time s + 1), which the loop adds to the push."""
    a, b = np.roots([lag * time, time, 1.0]).astype(complex)
    return np.asarray((a * np.exp(a * t) - b * np.exp(b * t)) / (time * (a - b)))


def test_a_joint_that_friction_holds_is_told_more_until_the_lower_end() -> None:
    adapter, jac = EpsilonAdapter(PARAMETERS, AdaptationTuning(0.05, 0.1), DT), np.array([[0.3]])
    told, seen = [], []
    for _ in range(3000):
        epsilon = adapter.epsilon(rows(jac), np.zeros(1))[0]
        told.append((-5.0 * 0.001 + 0.09 / epsilon) / 0.3)
        seen.append(epsilon)
        adapter.told(np.array([told[-1]]))
    assert (np.diff(told) >= -1e-12).all()
    assert seen[-1] == pytest.approx(0.4)


def test_reset_forgets() -> None:
    adapter, jac = EpsilonAdapter(PARAMETERS, AdaptationTuning(), DT), np.array([[0.3, 0.1]])
    for _ in range(100):
        adapter.epsilon(rows(jac), np.zeros(2))
        adapter.told(np.ones(2))
    assert adapter.epsilon(rows(jac), np.zeros(2))[0] < 4.0
    adapter.reset()
    assert adapter.epsilon(rows(jac), np.zeros(2))[0] == 4.0


def test_the_filter_takes_the_epsilon_of_the_tick() -> None:
    jac, epsilon = np.array([[0.5, 0.0], [0.0, 0.2]]), np.array([0.5, 4.0])
    one = SafetyFilter("issf", 2, PARAMETERS, np.full(2, 10.0))
    result = one.apply(rows(jac), np.array([-5.0, -5.0]), epsilon=epsilon)
    np.testing.assert_allclose(jac @ result.v, -5.0 * 0.01 + np.vecdot(jac, jac) / epsilon, atol=1e-9)
    # and the next tick its own again
    result = one.apply(rows(jac), np.array([-5.0, -5.0]))
    np.testing.assert_allclose(jac @ result.v, -5.0 * 0.01 + np.vecdot(jac, jac) / 4.0, atol=1e-9)


@pytest.mark.parametrize("bad", [np.ones(3), np.array([1.0, 0.0]), np.array([1.0, -1.0]), np.array([1.0, np.nan])])
def test_an_epsilon_that_cannot_be_is_refused(bad: Array) -> None:
    result = SafetyFilter("issf", 2, PARAMETERS, np.ones(2)).apply(rows(np.eye(2)), np.zeros(2), epsilon=bad)
    assert result.status == FilterStatus.FAILED
    assert "epsilon" in result.cause
    np.testing.assert_array_equal(result.v, 0.0)


@pytest.mark.parametrize("change", [{"time": 0.0}, {"time": math.nan}, {"least": 0.0}, {"least": 1.5}])
def test_settings_that_are_not_allowed_are_refused(change: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=f"adaptation {next(iter(change))}"):
        AdaptationTuning(**change)
