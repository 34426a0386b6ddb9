"""Compiled passes of a filter against plain numpy."""

import numpy as np
import pytest

from safety.filters.filter_kernels import ease, metric, survey, tally
from wbc.qp import UNBOUNDED


@pytest.mark.parametrize("shape", [(0, 3), (1, 1), (40, 7), (979, 20)])
def test_the_survey_is_numpys(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    n, nv = shape
    for beyond in (False, True):
        h, dh_dt, A, b, v = (rng.normal(size=s) for s in (n, n, shape, n, nv))
        limit = np.abs(v).max() * (0.5 if beyond else 2.0)
        violated = np.empty(n, dtype=bool)
        total, least = survey(h, dh_dt, A, b, v, np.full(nv, -limit), np.full(nv, limit), violated)
        room = A @ v - b
        assert total == pytest.approx(h.sum() + dh_dt.sum() + (A**2).sum() + (b**2).sum() + v.sum(), abs=1e-9)
        np.testing.assert_array_equal(violated, room < 0)
        expected = -np.inf if beyond else room.min(initial=np.inf)
        assert least == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e308])
def test_the_survey_finds_every_number_that_cannot_be_used(value: float) -> None:
    rng = np.random.default_rng(1)
    for place in range(4):
        for _ in range(20):
            parts = [rng.normal(size=s) for s in (30, 30, (30, 5), 30, 5)]
            chosen = parts[(2, 3)[place % 2]] if value == 1e308 else parts[(0, 1, 2, 3)[place]]
            chosen.flat[rng.integers(chosen.size)] = value
            assert not np.isfinite(survey(*parts, np.full(5, -9.0), np.full(5, 9.0), np.empty(30, dtype=bool))[0])
    parts = [rng.normal(size=s) for s in (30, 30, (30, 5), 30, 5)]
    for bound, finite in ((UNBOUNDED, False), (-UNBOUNDED, True)):
        parts[3][7] = bound
        total, _ = survey(*parts, np.full(5, -9.0), np.full(5, 9.0), np.empty(30, dtype=bool))
        assert np.isfinite(total) == finite


def test_a_condition_without_a_number_has_no_least_room() -> None:
    rng = np.random.default_rng(2)
    for place in range(10):
        A, b, v = rng.normal(size=(10, 4)), rng.normal(size=10), rng.normal(size=4)
        A[place, 2] = np.nan
        least = survey(b, b, A, b, v, np.full(4, -9.0), np.full(4, 9.0), np.empty(10, dtype=bool))[1]
        assert np.isnan(least)


@pytest.mark.parametrize("rows", [(0, 0, 0), (12, 8, 6), (3, 0, 1)])
def test_the_metric_is_numpys(rows: tuple[int, int, int]) -> None:
    rng = np.random.default_rng(3)
    for weights in ((1e3, 1e3, 1e2), (0.0, 5.0, 0.0), (0.0, 0.0, 0.0)):
        jacobians, v, hessian = [rng.normal(size=(k, 9)) for k in rows], rng.normal(size=9), np.empty((9, 9))
        expected = np.eye(9) + sum(w * J.T @ J for w, J in zip(weights, jacobians, strict=True))
        total = metric(*jacobians, *weights, v, hessian)
        np.testing.assert_allclose(hessian, expected, rtol=1e-12, atol=1e-10)
        np.testing.assert_array_equal(hessian, hessian.T)
        assert total == pytest.approx(expected.sum() + v @ expected @ v, rel=1e-9)


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e200])
def test_a_metric_that_cannot_be_used_is_found(value: float) -> None:
    rng = np.random.default_rng(4)
    for place in range(4):
        parts = [*(rng.normal(size=(6, 9)) for _ in range(3)), rng.normal(size=9)]
        parts[place].flat[5] = value
        assert not np.isfinite(metric(*parts[:3], 1.0, 2.0, 3.0, parts[3], np.empty((9, 9))))


def test_the_tally_is_numpys() -> None:
    rng = np.random.default_rng(5)
    assert tally(np.zeros(0), 0.1) == (-1, np.inf, 0)
    for i in range(60):
        room = rng.integers(-3, 4, 25).astype(float)
        if i % 3 == 1:
            room[rng.integers(25, size=2)] = np.nan
        if i % 4 == 1:
            room[rng.integers(25, size=2)] = -np.inf
        worst, least, count = tally(room, 0.5)
        assert worst == room.argmin()
        np.testing.assert_equal(least, room[worst])
        assert count == np.count_nonzero(~(room >= 0.5))


def test_what_is_asked_for_while_rows_are_lost_is_numpys() -> None:
    rng = np.random.default_rng(21)
    for held_back in (True, False):
        n, nv, dt = 60, 9, 0.002
        h, dh_dt, A = rng.normal(scale=0.05, size=n), rng.normal(size=n), rng.normal(size=(n, nv))
        b, at_zero, last = rng.normal(size=n), rng.normal(size=n), rng.normal(size=nv)
        depth, speed, acceleration = (rng.uniform(0.01, 1.0, n) for _ in range(3))
        lost = (h < 0) & (rng.random(n) < 0.8)
        reached = A @ last + acceleration * dt
        if not held_back:
            b[~lost] = reached[~lost] - 1.0
        fraction = np.clip(-h / depth, 0.0, 1.0)
        bounded = np.minimum(np.maximum(b, fraction * speed - dh_dt), at_zero + speed)
        resting = np.minimum(bounded, np.maximum(reached, -dh_dt))
        expected = (1.0 - fraction) * resting + fraction * np.minimum(bounded, reached)
        expected[~lost] = np.minimum(b, np.maximum(reached, -dh_dt))[~lost]
        theta, out = np.full(n, np.nan), np.full(n, np.nan)
        said = ease(h, dh_dt, lost, A, b, at_zero, last, depth, speed, acceleration, dt, theta, out)
        assert said == held_back
        np.testing.assert_allclose(out, expected, rtol=0, atol=1e-12)
        np.testing.assert_allclose(theta, np.where(lost, fraction, 0.0), rtol=0, atol=1e-15)


def test_what_weighs_nothing_need_not_be_numbers() -> None:
    v, hessian = np.ones(4), np.empty((4, 4))
    nothing, numbers = np.full((2, 4), np.nan), np.eye(4)[:1]
    assert np.isfinite(metric(numbers, nothing, nothing, 3.0, 0.0, 0.0, v, hessian))
    np.testing.assert_allclose(hessian, np.eye(4) + 3.0 * numbers.T @ numbers, rtol=0, atol=1e-12)
    assert not np.isfinite(metric(numbers, nothing, nothing, 3.0, 1.0, 0.0, v, hessian))
