"""The path of the swinging foot: ends, smoothness, and being sent elsewhere."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.gaits.walking.swing_path import SwingPath
from controllers.motions.quintic import Quintic

START = np.array([0.1, 0.2, 0.0, 0.3])
TARGET = np.array([0.4, 0.1, 0.01, 0.5])


def rows(swing: SwingPath, t: float) -> np.ndarray:
    """Position, velocity, acceleration of x, y, height, yaw: shape (3, 4)."""
    motion = swing.evaluate(t)
    return np.column_stack([np.array(motion[:3]), motion[3:]])


def path() -> SwingPath:
    return SwingPath(START, TARGET, apex=0.06, duration=0.6)


def test_a_quintic_meets_both_ends() -> None:
    rng = np.random.default_rng(0)
    p, v, a, end = rng.normal(size=(4, 3))
    curve = Quintic(np.array([p, v, a]), end, 0.7)
    for found, wanted in zip(curve.evaluate(0.0), (p, v, a), strict=True):
        assert found == pytest.approx(wanted, abs=1e-12)
    for found, wanted in zip(curve.evaluate(0.7 - 1e-12), (end, 0 * end, 0 * end), strict=True):
        assert found == pytest.approx(wanted, abs=1e-7)


def test_rates_are_those_of_the_path() -> None:
    swing, step = path(), 1e-6
    for t in np.linspace(0.01, 0.59, 23):
        _, velocity, acceleration = rows(swing, t)
        before, after = rows(swing, t - step), rows(swing, t + step)
        assert velocity == pytest.approx((after[0] - before[0]) / (2 * step), abs=1e-7)
        assert acceleration == pytest.approx((after[1] - before[1]) / (2 * step), abs=1e-5)


def test_the_foot_starts_and_lands_at_rest_and_clears_the_ground() -> None:
    swing = path()
    for t, place in ((0.0, START), (0.6, TARGET)):
        position, velocity, acceleration = rows(swing, t)
        assert position == pytest.approx(place, abs=1e-12)
        assert velocity == pytest.approx(np.zeros(4), abs=1e-9)
        assert acceleration == pytest.approx(np.zeros(4), abs=1e-7)
    heights = [rows(swing, t)[0][2] for t in np.linspace(0, 0.6, 601)]
    assert max(heights) == pytest.approx(0.07, abs=1e-6)
    assert np.all(np.diff(heights[:270]) > -1e-12)
    assert np.all(np.diff(heights[271:]) < 1e-12)


def test_the_foot_comes_down_straight() -> None:
    """Over its last stretch it does not move over the ground."""
    swing = path()
    assert rows(swing, SwingPath.ARRIVAL * 0.6)[0][[0, 1, 3]] == pytest.approx(TARGET[[0, 1, 3]], abs=1e-12)


@settings(max_examples=50, deadline=None)
@given(st.floats(0.02, 0.45), st.floats(0.13, 0.6), st.integers(0, 1000))
def test_sent_elsewhere_it_goes_on_smoothly_and_arrives(t: float, left: float, seed: int) -> None:
    swing = path()
    other = TARGET + np.array([1.0, 1.0, 0.0, 1.0]) * np.random.default_rng(seed).uniform(-0.1, 0.1, 4)
    before = rows(swing, t)
    swing = swing.redirected(other, t, left)
    for found, wanted in zip(rows(swing, t), before, strict=True):
        assert found == pytest.approx(wanted, abs=1e-9)
    position, velocity, _ = rows(swing, t + left)
    assert position == pytest.approx(other, abs=1e-9)
    assert velocity == pytest.approx(np.zeros(4), abs=1e-7)
    steps = np.array([rows(swing, s)[1] for s in np.linspace(t, t + left, 400)])
    # no jump of the velocity anywhere
    assert np.abs(np.diff(steps, axis=0)).max() < 0.3


def test_sent_to_where_it_goes_anyway_nothing_changes() -> None:
    swing, plain = path(), path()
    swing = swing.redirected(TARGET, 0.2, 0.4)
    for t in np.linspace(0.2, 0.6, 50):
        assert rows(swing, t)[0] == pytest.approx(rows(plain, t)[0], abs=1e-9)


def test_a_path_that_is_sent_elsewhere_is_another_one() -> None:
    """The first one does not change, at no time and in nothing that it says of itself."""
    swing, times = path(), np.linspace(0.0, 0.7, 50)
    before = [rows(swing, t) for t in times]
    other = swing.redirected(TARGET + np.array([0.1, -0.1, 0.0, 0.2]), 0.2, 0.2)
    assert other.duration == pytest.approx(0.4)
    assert swing.duration == 0.6
    np.testing.assert_array_equal(swing.target, TARGET)
    np.testing.assert_array_equal([rows(swing, t) for t in times], before)
