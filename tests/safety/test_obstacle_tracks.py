"""Obstacles and the Kalman filters that track them: models, estimates, consistency, refusals."""

from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.stats import chi2

from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array
from robots.pinocchio_model import standing_configuration
from safety.barriers import BarrierSet, CollisionBodies, ObstacleBarrier
from safety.obstacles import Obstacle
from safety.tracking import ObstacleTrack, TrackerSettings, _process_noise, _transition

SETTINGS = TrackerSettings(position_noise=0.01, acceleration_noise=0.5, initial_speed=0.8, max_age=0.2)
POSITION, VELOCITY = np.array([1.0, -2.0, 0.5]), np.array([0.3, 0.1, -0.2])


def van_loan(dt: float, density: float) -> tuple[Array, Array]:
    """Transition and noise (6, 6) of xdd = white noise, by the matrix exponential of the continuous model."""
    a, noise = np.zeros((6, 6)), np.zeros((6, 6))
    a[:3, 3:] = np.eye(3)
    noise[3:, 3:] = density**2 * np.eye(3)
    block = expm(np.block([[-a, noise], [np.zeros((6, 6)), a.T]]) * dt)
    transition = block[6:, 6:].T
    return transition, transition @ block[:6, 6:]


def irregular_stamps(rng: np.random.Generator, count: int) -> Array:
    return 5.0 + np.cumsum(rng.uniform(0.001, 0.08, size=count))


@pytest.mark.parametrize("dt", [1e-3, 0.04, 0.7])
def test_transition_and_noise_are_those_of_the_continuous_model(dt: float) -> None:
    transition, noise = van_loan(dt, 0.7)
    np.testing.assert_allclose(_transition(dt), transition, rtol=0, atol=1e-14)
    np.testing.assert_allclose(_process_noise(dt, 0.7), noise, rtol=1e-10, atol=1e-15)


def test_two_steps_are_one() -> None:
    for first, second in ((0.01, 0.02), (0.3, 0.001), (1.0, 1.0)):
        f = _transition(second)
        np.testing.assert_allclose(f @ _transition(first), _transition(first + second), rtol=0, atol=1e-15)
        chained = f @ _process_noise(first, 0.9) @ f.T + _process_noise(second, 0.9)
        np.testing.assert_allclose(chained, _process_noise(first + second, 0.9), rtol=1e-13, atol=1e-18)


def test_no_time_no_noise() -> None:
    np.testing.assert_array_equal(_transition(0.0), np.eye(6))
    assert not _process_noise(0.0, 1.0).any()


def test_prediction_over_irregular_steps_is_one_step() -> None:
    one, many = ObstacleTrack(SETTINGS), ObstacleTrack(SETTINGS)
    for track in (one, many):
        track.measure(POSITION, 0.0)
        track.measure(POSITION + 0.1 * VELOCITY, 0.1)
    one._advance(0.2)
    for stamp in (0.101, 0.15, 0.1501, 0.2):
        many._advance(stamp)
    np.testing.assert_allclose(many.covariance, one.covariance, rtol=1e-12, atol=1e-16)
    np.testing.assert_allclose(np.concatenate(many.estimate(0.2)), np.concatenate(one.estimate(0.2)), atol=1e-14)


def test_track_is_the_textbook_filter() -> None:
    rng = np.random.default_rng(0)
    track, x, covariance, last = ObstacleTrack(SETTINGS), np.zeros(6), np.zeros((6, 6)), 0.0
    see = np.hstack([np.eye(3), np.zeros((3, 3))])
    noise = SETTINGS.position_noise**2 * np.eye(3)
    for i, stamp in enumerate(irregular_stamps(rng, 40)):
        measured = POSITION + stamp * VELOCITY + rng.normal(scale=0.01, size=3)
        track.measure(measured, stamp)
        if i == 0:
            x[:3], covariance = measured, np.diag([1e-4] * 3 + [0.64] * 3)
        else:
            transition, process = van_loan(stamp - last, SETTINGS.acceleration_noise)
            x, covariance = transition @ x, transition @ covariance @ transition.T + process
            gain = covariance @ see.T @ np.linalg.inv(see @ covariance @ see.T + noise)
            x, covariance = x + gain @ (measured - see @ x), (np.eye(6) - gain @ see) @ covariance
        last = stamp
        np.testing.assert_allclose(np.concatenate(track.estimate(stamp)), x, rtol=0, atol=1e-10)
        np.testing.assert_allclose(track.covariance, covariance, rtol=0, atol=1e-10)


def test_constant_velocity_is_found_exactly_from_exact_positions() -> None:
    track, errors = ObstacleTrack(SETTINGS), []
    for stamp in irregular_stamps(np.random.default_rng(1), 400):
        truth = POSITION + stamp * VELOCITY
        track.measure(truth, stamp)
        position, velocity = track.estimate(stamp)
        errors.append(np.linalg.norm(position - truth) + np.linalg.norm(velocity - VELOCITY))
        ahead, same = track.estimate(stamp + 0.15)
        np.testing.assert_allclose(ahead, position + 0.15 * velocity, rtol=0, atol=1e-13)
        np.testing.assert_array_equal(same, velocity)
    assert errors[0] == pytest.approx(np.linalg.norm(VELOCITY))
    assert errors[-1] < 1e-9


def normalised_error(rng: np.random.Generator, count: int) -> tuple[float, Array]:
    """Squared error over covariance after ``count`` measurements of a target that follows the model, and its error."""
    stamps, track = irregular_stamps(rng, count), ObstacleTrack(SETTINGS)
    truth = np.concatenate([rng.normal(size=3), rng.normal(scale=SETTINGS.initial_speed, size=3)])
    last = stamps[0]
    for stamp in stamps:
        transition, process = _transition(stamp - last), _process_noise(stamp - last, SETTINGS.acceleration_noise)
        kick = np.linalg.cholesky(process) @ rng.normal(size=6) if stamp > last else np.zeros(6)
        truth, last = transition @ truth + kick, stamp
        track.measure(truth[:3] + rng.normal(scale=SETTINGS.position_noise, size=3), stamp)
    error = np.concatenate(track.estimate(last)) - truth
    return float(error @ np.linalg.solve(track.covariance, error)), error


@pytest.mark.parametrize("count", [1, 2, 5, 20])
def test_errors_are_as_large_as_the_covariance_says(count: int) -> None:
    rng, runs = np.random.default_rng(2), 100
    results = [normalised_error(rng, count) for _ in range(runs)]
    total = sum(squared for squared, _ in results)
    low, high = chi2.ppf([0.005, 0.995], 6 * runs)
    assert low < total < high
    # each axis and derivative without bias: the mean error within three of its own standard deviations
    errors = np.array([error for _, error in results])
    assert (np.abs(errors.mean(axis=0)) < 3.5 * errors.std(axis=0) / np.sqrt(runs)).all()


def test_two_measurements_of_one_instant_are_both_used() -> None:
    track = ObstacleTrack(SETTINGS)
    track.measure(np.zeros(3), 1.0)
    track.measure(np.full(3, 0.02), 1.0)
    np.testing.assert_allclose(track.estimate(1.0)[0], 0.01, rtol=1e-12)
    np.testing.assert_allclose(np.diag(track.covariance)[:3], SETTINGS.position_noise**2 / 2, rtol=1e-12)


def test_estimating_leaves_the_track_as_it_is() -> None:
    track, twin = ObstacleTrack(SETTINGS), ObstacleTrack(SETTINGS)
    for i in range(10):
        for t in (track, twin):
            t.measure(POSITION + 0.03 * i * VELOCITY, 0.03 * i)
        for ahead in (0.0, 0.02, 0.19):
            position, velocity = track.estimate(0.03 * i + ahead)
            position += 1e3
            velocity += 1e3
        covariance = track.covariance
        covariance += 1e3
    np.testing.assert_array_equal(track.covariance, twin.covariance)
    np.testing.assert_array_equal(np.concatenate(track.estimate(0.3)), np.concatenate(twin.estimate(0.3)))


def test_a_track_without_measurement_has_no_estimate() -> None:
    track = ObstacleTrack(SETTINGS)
    with pytest.raises(ConfigError, match="age of the obstacle track = inf"):
        track.estimate(0.0)
    with pytest.raises(ConfigError, match="measured at least once"):
        _ = track.covariance


def test_a_stale_track_is_refused_until_it_is_measured_again() -> None:
    track = ObstacleTrack(SETTINGS)
    track.measure(POSITION, 1.0)
    track.estimate(1.0 + SETTINGS.max_age - 1e-9)
    for stamp in (1.0 + SETTINGS.max_age + 1e-9, 100.0, np.inf, np.nan):
        with pytest.raises(ConfigError, match=r"age of the obstacle track = .*: must be at most 0.2 s"):
            track.estimate(stamp)
    track.measure(POSITION, 2.0)
    track.estimate(2.1)


BAD_MEASUREMENTS = {
    "nan": (np.array([0.0, np.nan, 0.0]), 2.0),
    "infinite": (np.array([np.inf, 0.0, 0.0]), 2.0),
    "two numbers": (np.zeros(2), 2.0),
    "a column": (np.zeros((3, 1)), 2.0),
    "backwards": (np.zeros(3), 0.99),
    "no stamp": (np.zeros(3), np.nan),
    "never": (np.zeros(3), np.inf),
}


@pytest.mark.parametrize("case", BAD_MEASUREMENTS)
def test_a_bad_measurement_is_refused_and_the_track_unharmed(case: str) -> None:
    track = ObstacleTrack(SETTINGS)
    track.measure(POSITION, 0.9)
    track.measure(POSITION, 1.0)
    before, covariance = np.concatenate(track.estimate(1.1)), track.covariance
    with pytest.raises(ConfigError, match=r"measured position|measurement stamp"):
        track.measure(*BAD_MEASUREMENTS[case])
    np.testing.assert_array_equal(np.concatenate(track.estimate(1.1)), before)
    np.testing.assert_array_equal(track.covariance, covariance)
    track.measure(POSITION, 1.05)


@pytest.mark.parametrize("case", ["nan", "no stamp", "never"])
def test_a_bad_first_measurement_starts_no_track(case: str) -> None:
    track = ObstacleTrack(SETTINGS)
    with pytest.raises(ConfigError):
        track.measure(*BAD_MEASUREMENTS[case])
    with pytest.raises(ConfigError):
        track.estimate(2.0)


def test_a_tracked_obstacle_feeds_its_barrier() -> None:
    kin = Kinematics(load_robot("g1"))
    kin.update_geometry(standing_configuration(kin.robot))
    bodies = CollisionBodies(kin)
    barrier = ObstacleBarrier(bodies, 1)
    rows = BarrierSet(kin, bodies, [barrier])
    track, start = ObstacleTrack(), np.array([0.8, 0.1, 0.9])
    for i in range(200):
        track.measure(start + 0.002 * i * VELOCITY, 0.002 * i)
    position, velocity = track.estimate(0.4)
    barrier.set_obstacles([Obstacle.sphere(position, 0.1, velocity)])
    drift = rows.evaluate(kin).drift.copy()
    step, h = 1e-6, []
    for sign in (1, -1):
        barrier.set_obstacles([Obstacle.sphere(track.estimate(0.4)[0] + sign * step * VELOCITY, 0.1)])
        h.append(rows.evaluate(kin).h.copy())
    np.testing.assert_allclose(drift, (h[0] - h[1]) / (2 * step), rtol=0, atol=1e-3)
    assert np.abs(drift).max() > 0.1


@pytest.mark.parametrize("name", ["position_noise", "acceleration_noise", "initial_speed", "max_age"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_tracker_settings_that_are_not_positive_are_refused_by_name(name: str, value: float) -> None:
    with pytest.raises(ConfigError, match=f"tracker {name} = "):
        replace(SETTINGS, **{name: value})


@pytest.mark.parametrize("radius", [0.0, -0.1, np.nan, np.inf])
def test_an_obstacle_without_size_is_refused(radius: float) -> None:
    with pytest.raises(ConfigError, match="obstacle radius"):
        Obstacle.sphere(np.zeros(3), radius)


@pytest.mark.parametrize("name", ["start", "end", "velocity", "spin"])
@pytest.mark.parametrize("value", [np.zeros(2), np.array([0, 0, np.nan]), np.array([0, np.inf, 0]), 0.0])
def test_an_obstacle_that_is_nowhere_is_refused(name: str, value: Array) -> None:
    with pytest.raises(ConfigError, match=f"obstacle {name}"):
        Obstacle(**{"start": np.zeros(3), "end": np.zeros(3), "radius": 0.1} | {name: value})


def test_an_obstacle_keeps_its_place_when_the_callers_array_moves_on() -> None:
    place = np.zeros(3)
    sphere = Obstacle.sphere(place, 0.1)
    place += 1.0
    assert not sphere.start.any()
    assert not sphere.end.any()
    with pytest.raises(FrozenInstanceError):
        sphere.radius = 1.0


def test_an_obstacle_may_be_given_as_lists() -> None:
    obstacle = Obstacle([0, 0, 0], [0, 0, 1], 0.1)
    np.testing.assert_array_equal(obstacle.end - obstacle.start, [0.0, 0.0, 1.0])
