"""The largest epsilon for a known disturbance, against simulation of the scalar system that it is about."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robots.errors import ConfigError
from robots.messages import Array
from safety.filters.robustness import episodes, largest_epsilon, row_disturbance

DT = 0.002
STEPS = 300
SEEDS = st.integers(0, 10**6)


def simulate(alpha: float, epsilon: float, squared: Array, disturbance: Array, start: float) -> Array:
    """h at the end of each period where the condition binds throughout."""
    out, h = [], start
    for s, e in zip(squared, disturbance, strict=True):
        h += DT * (-alpha * h + s / epsilon + e)
        out.append(h)
    return np.array(out)


def drawn(seed: int) -> tuple[Array, Array]:
    """Squared gradients, and a disturbance that pushes in on the whole and changes at all rates."""
    rng = np.random.default_rng(seed)
    squared = rng.uniform(0.02, 0.3) * (1.0 + 0.5 * np.sin(np.arange(STEPS) * rng.uniform(0.0, 0.1)))
    push = (
        rng.uniform(0.0, 0.3) + 0.1 * np.cumsum(rng.normal(size=STEPS)) / np.sqrt(STEPS) + 0.05 * rng.normal(size=STEPS)
    )
    return squared, -push


@given(seed=SEEDS, alpha=st.floats(1.0, 20.0), margin=st.floats(0.0, 0.01), room=st.floats(0.0, 0.05))
def test_it_is_the_largest_that_keeps_the_margin(seed: int, alpha: float, margin: float, room: float) -> None:
    squared, disturbance = drawn(seed)
    best = largest_epsilon(alpha, squared, disturbance, DT, margin, margin + room)
    if math.isinf(best):
        assert (simulate(alpha, 1e12, squared, disturbance, margin + room) >= margin - 1e-9).all()
        return
    assert simulate(alpha, best, squared, disturbance, margin + room).min() == pytest.approx(margin, abs=1e-12)
    assert simulate(alpha, 0.5 * best, squared, disturbance, margin + room).min() >= margin
    assert simulate(alpha, 1.01 * best, squared, disturbance, margin + room).min() < margin


@given(alpha=st.floats(1.0, 20.0), push=st.floats(0.01, 1.0), size=st.floats(0.1, 2.0), margin=st.floats(0.0, 0.01))
def test_a_steady_push_has_the_pointwise_answer(alpha: float, push: float, size: float, margin: float) -> None:
    """|J|^2/epsilon has to make up for the push and hold the margin; with margin 0, epsilon is |J|/|w|."""
    steady = np.ones(STEPS)
    best = largest_epsilon(alpha, size**2 * steady, -push * steady, DT, margin, margin)
    assert best == pytest.approx(size**2 / (push + alpha * margin), rel=1e-9)


def test_a_push_that_ends_before_the_margin_is_reached_asks_for_nothing() -> None:
    push = np.zeros(STEPS)
    push[:10] = -0.1
    assert math.isinf(largest_epsilon(5.0, np.full(STEPS, 0.1), push, DT, 0.0, 0.1))


def test_a_row_that_nothing_moves_cannot_be_kept() -> None:
    assert largest_epsilon(5.0, np.zeros(STEPS), np.full(STEPS, -0.1), DT) == 0.0


@given(seed=SEEDS, alpha=st.floats(1.0, 20.0), epsilon=st.floats(0.2, 20.0))
def test_the_disturbance_is_found_again_from_the_motion(seed: int, alpha: float, epsilon: float) -> None:
    squared, disturbance = drawn(seed)
    h = np.r_[0.02, simulate(alpha, epsilon, squared, disturbance, 0.02)]
    found = row_disturbance(h[:, None], np.r_[squared, squared[-1]][:, None], alpha, epsilon, DT)
    np.testing.assert_allclose(found[:, 0], disturbance, rtol=0, atol=1e-11)


@given(st.lists(st.booleans(), max_size=60), st.integers(0, 5))
def test_episodes_cover_every_sample_that_binds_and_no_long_gap(binding: list[bool], gap: int) -> None:
    mask = np.array(binding, dtype=bool)
    found = episodes(mask, gap)
    covered = np.zeros(mask.size, dtype=bool)
    for part in found:
        assert mask[part.start]
        assert mask[part.stop - 1]
        assert not covered[part].any()
        covered[part] = True
    assert covered[mask].all()
    for one, other in itertools.pairwise(found):
        assert other.start - one.stop > gap
    # within one no run of samples that do not bind is longer than the gap
    for part in found:
        assert np.diff(np.flatnonzero(mask[part])).max(initial=1) <= gap + 1


@pytest.mark.parametrize(
    "change",
    [
        {"alpha": 0.0},
        {"alpha": math.nan},
        {"alpha": 600.0},
        {"dt": 0.0},
        {"margin": -1.0},
        {"start": -0.1},
        {"start": math.inf},
    ],
)
def test_values_that_are_not_allowed_are_refused(change: dict[str, float]) -> None:
    values = {"alpha": 5.0, "dt": DT, "margin": 0.0, "start": 0.0} | change
    with pytest.raises(ConfigError, match=next(iter(change))):
        largest_epsilon(values["alpha"], np.ones(3), np.ones(3), values["dt"], values["margin"], values["start"])
