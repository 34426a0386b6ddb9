"""How a track hands out what a measurement changes: evenly, soon, and with the uncertainty that this has."""

from dataclasses import replace

import numpy as np
import pytest
from filterpy.common import Q_continuous_white_noise as white_noise

from robots.errors import ConfigError
from robots.messages import Array
from safety.tracking import MODELS, ObstacleTrack, TrackerSettings, _transition

BLENDING, PERIOD, TICK = TrackerSettings().blending, 1 / 60, 0.002
SETTINGS = TrackerSettings(position_noise=0.005, blending=BLENDING, gate=1.0)


@pytest.fixture(params=MODELS)
def settings(request: pytest.FixtureRequest) -> TrackerSettings:
    return replace(SETTINGS, model=str(request.param))


def state(track: ObstacleTrack, stamp: float) -> Array:
    return np.concatenate(track.estimate(stamp))


def pair(settings: TrackerSettings, count: int = 40, seed: int = 0) -> tuple[ObstacleTrack, ObstacleTrack, float]:
    """A track that blends and one that does not after the same noisy measurements; stamp of the last."""
    rng = np.random.default_rng(seed)
    tracks = ObstacleTrack(settings), ObstacleTrack(replace(settings, blending=0.0))
    for i in range(count):
        z = np.array([0.4, -0.1, 0.2]) * i * PERIOD + rng.normal(scale=settings.position_noise, size=3)
        for track in tracks:
            track.measure(z, i * PERIOD)
    return *tracks, (count - 1) * PERIOD


@pytest.mark.parametrize("latency", [0.0, 0.03])
def test_a_measurement_moves_the_estimate_without_a_step(settings: TrackerSettings, latency: float) -> None:
    track, _, last = pair(settings)
    stamp = last + PERIOD
    now = stamp + latency
    before, covariance = state(track, now), track.covariance(now)
    assert track.measure(np.array([0.3, 0.1, 0.1]), stamp, now)
    np.testing.assert_allclose(state(track, now), before, rtol=0, atol=1e-12)
    np.testing.assert_allclose(track.covariance(now), covariance, rtol=0, atol=1e-12)
    # and it is no step later either: what the news is worth comes in proportion to the time
    at_once, _, _ = pair(replace(settings, blending=0.0))
    at_once.measure(np.array([0.3, 0.1, 0.1]), stamp)
    for fraction in (0.25, 0.5, 0.75, 1.0):
        t = now + fraction * BLENDING
        old, _, _ = pair(settings)
        expected = (1 - fraction) * state(old, t) + fraction * state(at_once, t)
        np.testing.assert_allclose(state(track, t), expected, rtol=0, atol=1e-12)


def test_afterwards_it_is_the_filter_s_own_estimate(settings: TrackerSettings) -> None:
    track, at_once, last = pair(settings)
    for ahead in (BLENDING, 0.012, 0.1):
        np.testing.assert_allclose(state(track, last + ahead), state(at_once, last + ahead), rtol=0, atol=1e-12)
        np.testing.assert_allclose(track.covariance(last + ahead), at_once.covariance(last + ahead), rtol=1e-9)


def test_missing_measurements_do_not_hold_it_up(settings: TrackerSettings) -> None:
    (one, _, last), (many, _, _) = pair(settings), pair(settings)
    for i in range(1, 8):
        t = last + i * BLENDING / 8
        many.measure(None, t)
        np.testing.assert_allclose(state(many, t), state(one, t), rtol=0, atol=1e-12)
        np.testing.assert_allclose(many.covariance(t), one.covariance(t), rtol=1e-9, atol=1e-15)


def test_a_controller_has_its_news_half_the_blending_less_half_a_tick_later() -> None:
    """The delay of the response to news is that of its centre, ticks included: at most 5 ms at 500 Hz."""
    track, at_once, last = pair(SETTINGS, count=200)
    stamp = last + PERIOD
    for t in (track, at_once):
        assert t.measure(state(t, stamp)[:3] + 0.05, stamp, stamp - TICK)
    ticks = stamp + TICK * np.arange(-1, 8)
    velocity = np.array([state(track, t)[3] for t in ticks])
    jump = state(at_once, stamp)[3] - velocity[0]
    assert velocity[-1] - velocity[0] == pytest.approx(jump, rel=1e-9)
    delay = np.sum(np.diff(velocity) / jump * (ticks[1:] - stamp))
    assert delay == pytest.approx((BLENDING - TICK) / 2, abs=1e-9)
    assert delay <= 0.005 + 1e-12


@pytest.mark.parametrize("period", [1 / 60, 0.005])
def test_the_covariance_is_that_of_the_error(settings: TrackerSettings, period: float) -> None:
    """Over many motions and noises of the filter's own model; at 5 ms measurements overtake each other."""
    rng, count, steps = np.random.default_rng(3), 3000, 12
    order = 2 if settings.model == "constant_velocity" else 3
    density = settings.acceleration_noise if order == 2 else settings.jerk_noise
    transition, noise = _transition(period, order), white_noise(order, period, density**2)
    root = np.linalg.cholesky(noise + 1e-18 * np.eye(order))
    spread = (settings.position_noise, settings.initial_speed, settings.initial_acceleration)[:order]
    # three axes of a track are three independent targets
    truth = np.array(spread)[:, None, None] * rng.normal(size=(order, count, 3))
    truth[0] = 0.0
    tracks = [ObstacleTrack(settings) for _ in range(count)]
    for k in range(steps):
        if k:
            truth = np.einsum("ij,jnk->ink", transition, truth)
            truth += np.einsum("ij,jnk->ink", root, rng.normal(size=truth.shape))
        seen = truth[0] + settings.position_noise * rng.normal(size=(count, 3))
        for track, z in zip(tracks, seen, strict=True):
            track.measure(z, k * period)
    for fraction in (0.0, 0.3):
        t = (steps - 1) * period + fraction * BLENDING
        ahead, extra = _transition(fraction * BLENDING, order), white_noise(order, fraction * BLENDING, density**2)
        later = np.einsum("ij,jnk->ink", ahead, truth)
        later += np.einsum(
            "ij,jnk->ink", np.linalg.cholesky(extra + 1e-18 * np.eye(order)), rng.normal(size=truth.shape)
        )
        error = np.array([state(track, t) for track in tracks]) - np.concatenate([later[0], later[1]], axis=1)
        variance = np.square(error).reshape(count, 2, 3).mean(axis=(0, 2))
        guaranteed = np.diag(tracks[0].covariance(t))[[0, 3]]
        # 9000 samples: five standard deviations of their variance
        np.testing.assert_allclose(variance, guaranteed, rtol=5 * np.sqrt(2 / (3 * count)))


def test_a_restart_is_handed_out_at_once() -> None:
    track = ObstacleTrack(replace(SETTINGS, gate=0.99999))
    for i in range(30):
        track.measure(np.zeros(3), i * PERIOD)
    for i in range(30, 35):
        track.measure(np.array([2.0, 0.0, 0.0]), i * PERIOD)
    assert track.restarts == 1
    assert track.estimate(34 * PERIOD)[0][0] == pytest.approx(2.0, abs=0.01)


@pytest.mark.parametrize("value", [-0.001, float("nan"), float("inf")])
def test_bad_times_are_refused(value: float) -> None:
    with pytest.raises(ConfigError, match="tracker blending"):
        replace(SETTINGS, blending=value)
    if value != -0.001:
        with pytest.raises(ConfigError, match="came in"):
            ObstacleTrack(SETTINGS).measure(np.zeros(3), 0.0, value)
