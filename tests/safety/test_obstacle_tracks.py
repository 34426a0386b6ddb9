"""Obstacles and the Kalman filters that track them: models, estimates, consistency, refusals."""

from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest
from filterpy.common import Q_continuous_white_noise as white_noise
from scipy.linalg import expm, solve_discrete_are
from scipy.stats import binom, chi2

from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array
from robots.pinocchio_model import standing_configuration
from safety.barriers.barrier_set import BarrierSet, CollisionBodies, ObstacleBarrier
from safety.geometry.shapes import Obstacle
from safety.tracking import MODELS, ObstacleTrack, TrackerSettings, _transition

SETTINGS = TrackerSettings(position_noise=0.01, acceleration_noise=0.5, initial_speed=0.8, max_age=0.2, blending=0.0)
"""Measurements count at once; how they are fed in is tested in ``test_blending``."""

POSITION, VELOCITY = np.array([1.0, -2.0, 0.5]), np.array([0.3, 0.1, -0.2])


def settings_of(model: str) -> TrackerSettings:
    return replace(SETTINGS, model=model)


def order_of(settings: TrackerSettings) -> int:
    return {"constant_velocity": 2, "constant_acceleration": 3}[settings.model]


def density_of(settings: TrackerSettings) -> float:
    return settings.acceleration_noise if settings.model == "constant_velocity" else settings.jerk_noise


def van_loan(dt: float, density: float, order: int) -> tuple[Array, Array]:
    """Transition and noise (3 order, 3 order) of white noise on that derivative, by the matrix exponential."""
    n = 3 * order
    a, noise = np.kron(np.eye(order, k=1), np.eye(3)), np.zeros((n, n))
    noise[-3:, -3:] = density**2 * np.eye(3)
    block = expm(np.block([[-a, noise], [np.zeros((n, n)), a.T]]) * dt)
    transition = block[n:, n:].T
    return transition, transition @ block[:n, n:]


class TextbookFilter:
    """The Kalman filter of all three axes at once, in the form of the textbooks; no gate."""

    def __init__(self, settings: TrackerSettings) -> None:
        self.settings, self.order = settings, order_of(settings)
        self.x, self.covariance, self.time = np.zeros(3 * self.order), np.zeros((0, 0)), 0.0
        self.see = np.eye(3, 3 * self.order)
        self.noise = settings.position_noise**2 * np.eye(3)

    def measure(self, z: Array | None, stamp: float) -> float:
        """Take in a measurement; returns its squared Mahalanobis distance."""
        if not self.covariance.size:
            s = self.settings
            spread = (s.position_noise, s.initial_speed, s.initial_acceleration)[: self.order]
            self.x[:3], self.covariance, self.time = z, np.diag(np.repeat(spread, 3) ** 2), stamp
            return 0.0
        transition, process = van_loan(stamp - self.time, density_of(self.settings), self.order)
        self.x, self.covariance = transition @ self.x, transition @ self.covariance @ transition.T + process
        self.time = stamp
        if z is None:
            return 0.0
        innovation, spread = z - self.see @ self.x, self.see @ self.covariance @ self.see.T + self.noise
        gain = self.covariance @ self.see.T @ np.linalg.inv(spread)
        self.x = self.x + gain @ innovation
        self.covariance = (np.eye(self.x.size) - gain @ self.see) @ self.covariance
        return float(innovation @ np.linalg.solve(spread, innovation))


@pytest.fixture(params=MODELS)
def settings(request: pytest.FixtureRequest) -> TrackerSettings:
    return settings_of(str(request.param))


def irregular_stamps(rng: np.random.Generator, count: int) -> Array:
    return 5.0 + np.cumsum(rng.uniform(0.001, 0.08, size=count))


def state(track: ObstacleTrack, stamp: float) -> Array:
    return np.concatenate(track.estimate(stamp))


def followed(settings: TrackerSettings, count: int = 60, period: float = 0.02) -> tuple[ObstacleTrack, float]:
    """A track of a target at constant velocity without noise, and the stamp of its last measurement."""
    track = ObstacleTrack(settings)
    for i in range(count):
        assert track.measure(POSITION + i * period * VELOCITY, i * period)
    return track, (count - 1) * period


@pytest.mark.parametrize("order", [2, 3])
@pytest.mark.parametrize("dt", [1e-3, 0.04, 0.7])
def test_transition_and_noise_are_those_of_the_continuous_model(dt: float, order: int) -> None:
    transition, noise = van_loan(dt, 0.7, order)
    np.testing.assert_allclose(np.kron(_transition(dt, order), np.eye(3)), transition, rtol=0, atol=1e-14)
    np.testing.assert_allclose(np.kron(white_noise(order, dt, 0.7**2), np.eye(3)), noise, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("order", [2, 3])
def test_two_steps_are_one(order: int) -> None:
    for first, second in ((0.01, 0.02), (0.3, 0.001), (1.0, 1.0)):
        f, whole = _transition(second, order), first + second
        np.testing.assert_allclose(f @ _transition(first, order), _transition(whole, order), rtol=0, atol=1e-15)
        chained = f @ white_noise(order, first, 0.9**2) @ f.T + white_noise(order, second, 0.9**2)
        np.testing.assert_allclose(chained, white_noise(order, whole, 0.9**2), rtol=1e-13, atol=1e-18)


@pytest.mark.parametrize("order", [2, 3])
def test_no_time_no_noise(order: int) -> None:
    np.testing.assert_array_equal(_transition(0.0, order), np.eye(order))
    assert not white_noise(order, 0.0, 1.0).any()


def test_missing_measurements_are_prediction(settings: TrackerSettings) -> None:
    (one, last), (many, _) = followed(settings), followed(settings)
    for stamp in (0.001, 0.05, 0.0501, 0.1):
        assert not many.measure(None, last + stamp)
        assert many.age(last + stamp) == pytest.approx(stamp)
    for ahead in (0.1, 0.15):
        np.testing.assert_allclose(many.covariance(last + ahead), one.covariance(last + ahead), rtol=1e-12, atol=1e-16)
        np.testing.assert_allclose(state(many, last + ahead), state(one, last + ahead), rtol=0, atol=1e-14)
    assert (many.accepted, many.rejected) == (one.accepted, one.rejected)
    # and so they change nothing for the next measurement either
    for track in (one, many):
        assert track.measure(POSITION + (last + 0.16) * VELOCITY, last + 0.16)
    np.testing.assert_allclose(state(many, last + 0.2), state(one, last + 0.2), rtol=0, atol=1e-13)


def test_a_target_that_stays_unseen_goes_stale(settings: TrackerSettings) -> None:
    track, last = followed(settings)
    sigmas = [track.position_sigma(last + 0.01 * i) for i in range(30)]
    for i in range(1, 30):
        track.measure(None, last + 0.01 * i)
        assert track.position_sigma(last + 0.01 * i) == pytest.approx(sigmas[i], rel=1e-12)
    with pytest.raises(ConfigError, match="age of the obstacle track"):
        track.estimate(last + 0.29)
    # its uncertainty still has a value, and it grows
    assert (np.diff(sigmas) > 0).all()


def test_missing_measurements_before_the_first_start_no_track(settings: TrackerSettings) -> None:
    track = ObstacleTrack(settings)
    assert not track.measure(None, 3.0)
    with pytest.raises(ConfigError, match="age of the obstacle track = inf"):
        track.estimate(3.0)
    assert track.measure(POSITION, 3.1)
    np.testing.assert_array_equal(track.estimate(3.1)[0], POSITION)


def test_track_is_the_textbook_filter(settings: TrackerSettings) -> None:
    rng = np.random.default_rng(0)
    track, book = ObstacleTrack(replace(settings, gate=1.0)), TextbookFilter(settings)
    for i, stamp in enumerate(irregular_stamps(rng, 60)):
        measured = None if i % 7 == 6 else POSITION + stamp * VELOCITY + rng.normal(scale=0.01, size=3)
        distance = book.measure(measured, stamp)
        assert track.measure(measured, stamp) == (measured is not None)
        np.testing.assert_allclose(state(track, stamp) if measured is not None else book.x[:6], book.x[:6], atol=1e-10)
        np.testing.assert_allclose(track.covariance(stamp), book.covariance, rtol=0, atol=1e-10)
        if i and measured is not None:
            assert track.nis == pytest.approx(distance, rel=1e-8)
    transition, process = van_loan(0.13, density_of(settings), order_of(settings))
    ahead = transition @ book.covariance @ transition.T + process
    np.testing.assert_allclose(track.covariance(stamp + 0.13), ahead, rtol=0, atol=1e-10)
    largest = np.linalg.eigvalsh(ahead[:3, :3])[-1]
    assert track.position_sigma(stamp + 0.13) == pytest.approx(np.sqrt(largest), rel=1e-8)
    np.testing.assert_allclose(state(track, stamp + 0.13), (transition @ book.x)[:6], rtol=0, atol=1e-9)


def test_covariance_stays_symmetric_and_positive(settings: TrackerSettings) -> None:
    rng = np.random.default_rng(3)
    track, stamp = ObstacleTrack(replace(settings, position_noise=1e-6)), 0.0
    for _ in range(2000):
        # intervals over seven decades, and two measurements of one instant
        stamp += rng.choice([0.0, 1e-6, 1e-3, 0.1, 10.0])
        track.measure(rng.normal(size=3), stamp)
        covariance = track.covariance(stamp)
        np.testing.assert_array_equal(covariance, covariance.T)
        scale = np.sqrt(np.diag(covariance))
        assert (scale > 0).all()
        assert np.linalg.eigvalsh(covariance / np.outer(scale, scale))[0] > -1e-12


def test_constant_velocity_is_found_exactly_from_exact_positions(settings: TrackerSettings) -> None:
    track, errors = ObstacleTrack(settings), []
    for stamp in irregular_stamps(np.random.default_rng(1), 400):
        truth = POSITION + stamp * VELOCITY
        track.measure(truth, stamp)
        errors.append(np.linalg.norm(state(track, stamp) - np.concatenate([truth, VELOCITY])))
    assert errors[0] == pytest.approx(np.linalg.norm(VELOCITY))
    assert errors[-1] < 1e-9
    assert track.rejected == 0
    position, velocity = track.estimate(stamp)
    ahead, same = track.estimate(stamp + 0.15)
    np.testing.assert_allclose(ahead, position + 0.15 * velocity, rtol=0, atol=1e-9)
    np.testing.assert_allclose(same, velocity, rtol=0, atol=1e-9)


def accelerated(settings: TrackerSettings, acceleration: Array, period: float) -> tuple[Array, Array]:
    """Errors of position and velocity once a target at constant acceleration is followed."""
    track = ObstacleTrack(replace(settings, gate=1.0))
    for i in range(800):
        t = i * period
        track.measure(0.5 * t**2 * acceleration, t)
    position, velocity = track.estimate(t)
    return position - 0.5 * t**2 * acceleration, velocity - t * acceleration


def test_constant_acceleration_is_followed_without_bias_by_its_model() -> None:
    acceleration = np.array([2.0, -1.0, 0.5])
    position, velocity = accelerated(settings_of("constant_acceleration"), acceleration, 0.02)
    np.testing.assert_allclose(position, 0.0, rtol=0, atol=1e-9)
    np.testing.assert_allclose(velocity, 0.0, rtol=0, atol=1e-9)


def test_constant_velocity_lags_behind_acceleration_as_its_steady_gain_says() -> None:
    r"""With steady gains k, e+ = (I - k H)(F e + [dt^2/2; dt] a): the fixed point is the lag, in closed form."""
    settings, acceleration, period = settings_of("constant_velocity"), np.array([2.0, -1.0, 0.5]), 0.02
    f, see = np.array([[1.0, period], [0.0, 1.0]]), np.array([[1.0, 0.0]])
    process = settings.acceleration_noise**2 * np.array([[period**3 / 3, period**2 / 2], [period**2 / 2, period]])
    prior = solve_discrete_are(f.T, see.T, process, np.array([[settings.position_noise**2]]))
    gain = prior @ see.T / (prior[0, 0] + settings.position_noise**2)
    kept = np.eye(2) - gain @ see
    fixed = np.linalg.solve(np.eye(2) - kept @ f, kept @ [period**2 / 2, period])
    position, velocity = accelerated(settings, acceleration, period)
    np.testing.assert_allclose(position, -fixed[0] * acceleration, rtol=1e-6)
    np.testing.assert_allclose(velocity, -fixed[1] * acceleration, rtol=1e-6)
    assert fixed[1] > 0.02


def normalised_error(rng: np.random.Generator, count: int, settings: TrackerSettings) -> tuple[float, float, Array]:
    """Squared error over covariance, last squared innovation, and error, of a target that follows the model."""
    stamps, track, order = irregular_stamps(rng, count), ObstacleTrack(replace(settings, gate=1.0)), order_of(settings)
    spread = (1.0, settings.initial_speed, settings.initial_acceleration)[:order]
    truth = rng.normal(size=3 * order) * np.repeat(spread, 3)
    last = stamps[0]
    for stamp in stamps:
        transition, process = van_loan(stamp - last, density_of(settings), order)
        kick = np.linalg.cholesky(process) @ rng.normal(size=truth.size) if stamp > last else np.zeros(truth.size)
        truth, last = transition @ truth + kick, stamp
        track.measure(truth[:3] + rng.normal(scale=settings.position_noise, size=3), stamp)
    error = state(track, last) - truth[:6]
    return float(error @ np.linalg.solve(track.covariance(last)[:6, :6], error)), track.nis, error


@pytest.mark.parametrize("count", [1, 2, 5, 20])
def test_errors_and_innovations_are_as_large_as_the_covariance_says(count: int, settings: TrackerSettings) -> None:
    rng, runs = np.random.default_rng(2), 100
    results = [normalised_error(rng, count, settings) for _ in range(runs)]
    low, high = chi2.ppf([0.005, 0.995], 6 * runs)
    assert low < sum(nees for nees, _, _ in results) < high
    if count > 1:
        low, high = chi2.ppf([0.005, 0.995], 3 * runs)
        assert low < sum(nis for _, nis, _ in results) < high
    # each axis and derivative without bias: the mean error within three and a half of its own standard deviations
    errors = np.array([error for _, _, error in results])
    assert (np.abs(errors.mean(axis=0)) < 3.5 * errors.std(axis=0) / np.sqrt(runs)).all()


def test_the_gate_turns_away_the_share_of_good_measurements_that_it_says() -> None:
    """Fresh tracks of targets that follow the model: the count of rejections of the second measurement is binomial."""
    rng, gate, runs = np.random.default_rng(4), 0.9, 3000
    settings, rejected = replace(SETTINGS, gate=gate), 0
    for _ in range(runs):
        track, velocity = ObstacleTrack(settings), rng.normal(scale=settings.initial_speed, size=3)
        track.measure(rng.normal(scale=settings.position_noise, size=3), 0.0)
        kick = np.linalg.cholesky(white_noise(2, 0.05, settings.acceleration_noise**2))[0, 0] * rng.normal(size=3)
        track.measure(0.05 * velocity + kick + rng.normal(scale=settings.position_noise, size=3), 0.05)
        rejected += track.rejected
    low, high = binom.ppf([0.005, 0.995], runs, 1 - gate)
    assert low <= rejected <= high


@pytest.mark.parametrize("gate", [0.5, 0.999, 1 - 1e-9])
def test_the_gate_is_the_chi_square_quantile(gate: float) -> None:
    assert ObstacleTrack(replace(SETTINGS, gate=gate))._threshold == pytest.approx(chi2.ppf(gate, 3), rel=1e-6)


def test_one_outlier_changes_nothing_beyond_prediction(settings: TrackerSettings) -> None:
    (hit, last), (spared, _) = followed(settings), followed(settings)
    assert not hit.measure(POSITION + np.array([0.0, 0.5, 0.0]), last + 0.02)
    assert not spared.measure(None, last + 0.02)
    assert (hit.rejected, hit.accepted, hit.restarts) == (1, spared.accepted, 0)
    assert hit.nis > chi2.ppf(settings.gate, 3)
    assert hit.age(last + 0.02) == spared.age(last + 0.02) == pytest.approx(0.02)
    for stamp in (last + 0.02, last + 0.1):
        np.testing.assert_array_equal(state(hit, stamp), state(spared, stamp))
        np.testing.assert_array_equal(hit.covariance(stamp), spared.covariance(stamp))
    for track in (hit, spared):
        assert track.measure(POSITION + (last + 0.04) * VELOCITY, last + 0.04)
    np.testing.assert_array_equal(state(hit, last + 0.1), state(spared, last + 0.1))


def test_outliers_here_and_there_never_restart_a_track(settings: TrackerSettings) -> None:
    track, last = followed(settings)
    for i in range(1, 101):
        t = last + 0.02 * i
        good = i % settings.max_rejections == 0
        assert track.measure(POSITION + t * VELOCITY + (0.0 if good else 0.5), t) == good
    assert (track.rejected, track.restarts) == (80, 0)
    np.testing.assert_allclose(track.estimate(t)[1], VELOCITY, atol=1e-6)


@pytest.mark.parametrize("limit", [1, 2, 5])
def test_a_real_jump_is_followed(limit: int, settings: TrackerSettings) -> None:
    track, last = followed(replace(settings, max_rejections=limit))
    before, moved = track.accepted, np.array([0.5, 0.0, -0.2])
    for i in range(1, limit + 1):
        t = last + 0.02 * i
        assert track.measure(POSITION + moved + t * VELOCITY, t) == (i == limit)
    assert (track.rejected, track.accepted, track.restarts) == (limit - 1, before + 1, 1)
    assert track.age(t) == 0.0
    # it is what a new track makes of the same measurements
    fresh = ObstacleTrack(replace(settings, gate=1.0))
    for i in range(1, limit + 1):
        fresh.measure(POSITION + moved + (last + 0.02 * i) * VELOCITY, last + 0.02 * i)
    np.testing.assert_array_equal(state(track, t), state(fresh, t))
    np.testing.assert_array_equal(track.covariance(t), fresh.covariance(t))
    assert track.measure(POSITION + moved + (t + 0.02) * VELOCITY, t + 0.02)


def test_a_target_faster_than_expected_is_caught_up_with(settings: TrackerSettings) -> None:
    """Ten times the initial speed: all is outside the gate at first, and the restart finds the velocity."""
    velocity, track = np.array([10 * settings.initial_speed, 0.0, 0.0]), ObstacleTrack(settings)
    for i in range(60):
        track.measure(i * 0.02 * velocity, i * 0.02)
    assert track.restarts > 0
    np.testing.assert_allclose(track.estimate(59 * 0.02)[1], velocity, rtol=1e-3, atol=1e-6)


def test_two_measurements_of_one_instant_are_both_used(settings: TrackerSettings) -> None:
    track = ObstacleTrack(settings)
    track.measure(np.zeros(3), 1.0)
    track.measure(np.full(3, 0.02), 1.0)
    np.testing.assert_allclose(track.estimate(1.0)[0], 0.01, rtol=1e-12)
    np.testing.assert_allclose(np.diag(track.covariance(1.0))[:3], settings.position_noise**2 / 2, rtol=1e-12)


def test_estimating_leaves_the_track_as_it_is(settings: TrackerSettings) -> None:
    track, twin = ObstacleTrack(settings), ObstacleTrack(settings)
    for i in range(10):
        measured = POSITION + 0.03 * i * VELOCITY
        for t in (track, twin):
            t.measure(measured, 0.03 * i)
        measured += 1e3
        for ahead in (0.0, 0.02, 0.19):
            track.position_sigma(0.03 * i + ahead)
            for array in (*track.estimate(0.03 * i + ahead), track.covariance(0.03 * i + ahead)):
                array[:] = 1e3
    np.testing.assert_array_equal(track.covariance(0.3), twin.covariance(0.3))
    np.testing.assert_array_equal(state(track, 0.3), state(twin, 0.3))


def test_a_stamp_before_the_last_measurement_gives_the_estimate_there(settings: TrackerSettings) -> None:
    track, last = followed(settings)
    np.testing.assert_array_equal(state(track, last - 0.01), state(track, last))
    np.testing.assert_array_equal(track.covariance(last - 0.01), track.covariance(last))


def test_a_track_far_beyond_the_stamp_is_refused_until_the_stamp_gets_there(settings: TrackerSettings) -> None:
    track, last = followed(settings)
    for stamp in (last - settings.max_ahead - 1e-6, last - 1000.0, -np.inf):
        with pytest.raises(ConfigError, match=r"age of the obstacle track = -.*: must be .*at most 0.02 s ahead"):
            track.estimate(stamp)
    expected = state(track, last)
    track.measure(None, last + 0.1)
    assert track.fault(last) == "0.1 s ahead of the clock, allowed are 0.02 s"
    with pytest.raises(ConfigError, match=r"age of the obstacle track = -0\.1"):
        track.estimate(last)
    assert track.fault(last + 0.1) is None
    np.testing.assert_allclose(state(track, last + 0.1)[:3], expected[:3] + 0.1 * VELOCITY, rtol=0, atol=1e-3)


def test_a_track_without_measurement_has_no_estimate(settings: TrackerSettings) -> None:
    track = ObstacleTrack(settings)
    with pytest.raises(ConfigError, match="age of the obstacle track = inf"):
        track.estimate(0.0)
    for ask in (track.covariance, track.position_sigma):
        with pytest.raises(ConfigError, match="measured at least once"):
            ask(0.0)


def test_a_stale_track_is_refused_until_it_is_measured_again() -> None:
    track = ObstacleTrack(SETTINGS)
    track.measure(POSITION, 1.0)
    track.estimate(1.0 + SETTINGS.max_age - 1e-9)
    for stamp in (1.0 + SETTINGS.max_age + 1e-9, 100.0, np.inf, np.nan):
        with pytest.raises(ConfigError, match=r"age of the obstacle track = .*: must be at most 0.2 s"):
            track.estimate(stamp)
    track.measure(POSITION, 2.0)
    track.estimate(2.1)


def test_rejected_measurements_do_not_keep_a_track_fresh() -> None:
    track = ObstacleTrack(SETTINGS)
    for i in range(10):
        track.measure(POSITION, 0.02 * i)
    for i in range(1, 4):
        track.measure(POSITION + 5.0, 0.18 + 0.1 * i)
    with pytest.raises(ConfigError, match="age of the obstacle track"):
        track.estimate(0.48)


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
    before, covariance = state(track, 1.1), track.covariance(1.1)
    with pytest.raises(ConfigError, match=r"measured position|measurement stamp"):
        track.measure(*BAD_MEASUREMENTS[case])
    np.testing.assert_array_equal(state(track, 1.1), before)
    np.testing.assert_array_equal(track.covariance(1.1), covariance)
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
    barrier = ObstacleBarrier(bodies, ["sphere"])
    rows = BarrierSet(kin, bodies, [barrier])
    track, start = ObstacleTrack(), np.array([0.8, 0.1, 0.9])
    for i in range(200):
        track.measure(start + 0.002 * i * VELOCITY, 0.002 * i)
    position, velocity = track.estimate(0.4)
    barrier.set_obstacles([Obstacle.sphere(position, 0.1, velocity)])
    dh_dt = rows.evaluate(kin).dh_dt.copy()
    step, h = 1e-6, []
    for sign in (1, -1):
        barrier.set_obstacles([Obstacle.sphere(track.estimate(0.4)[0] + sign * step * VELOCITY, 0.1)])
        h.append(rows.evaluate(kin).h.copy())
    np.testing.assert_allclose(dh_dt, (h[0] - h[1]) / (2 * step), rtol=0, atol=1e-3)
    assert np.abs(dh_dt).max() > 0.1


@pytest.mark.parametrize(
    "name",
    [
        "position_noise",
        "acceleration_noise",
        "initial_speed",
        "max_age",
        "jerk_noise",
        "initial_acceleration",
        "max_ahead",
    ],
)
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_tracker_settings_that_are_not_positive_are_refused_by_name(name: str, value: float) -> None:
    with pytest.raises(ConfigError, match=f"tracker {name} = "):
        replace(SETTINGS, **{name: value})


@pytest.mark.parametrize(
    ("name", "value"),
    [("model", "constant_jerk"), ("model", "")]
    + [("gate", x) for x in (0.0, -0.1, 1.1, np.nan, "high")]
    + [("max_rejections", x) for x in (0, -1, 2.5, np.nan)],
)
def test_other_tracker_settings_are_checked_by_name(name: str, value: object) -> None:
    with pytest.raises(ConfigError, match=f"tracker {name} = "):
        replace(SETTINGS, **{name: value})


@pytest.mark.parametrize("radius", [0.0, -0.1, np.nan, np.inf])
def test_an_obstacle_without_size_is_refused(radius: float) -> None:
    with pytest.raises(ConfigError, match="obstacle radius"):
        Obstacle.sphere(np.zeros(3), radius)


@pytest.mark.parametrize("value", [np.zeros(2), np.array([0, 0, np.nan]), np.array([0, np.inf, 0]), 0.0])
def test_an_obstacle_that_is_nowhere_is_refused(value: Array) -> None:
    with pytest.raises(ConfigError, match="obstacle position"):
        Obstacle.sphere(value, 0.1)
    with pytest.raises(ConfigError, match="obstacle velocity"):
        Obstacle.sphere(np.zeros(3), 0.1, value)


def test_an_obstacle_keeps_its_place_when_the_callers_array_moves_on() -> None:
    place = np.zeros(3)
    sphere = Obstacle.sphere(place, 0.1)
    place += 1.0
    assert not sphere.position.any()
    with pytest.raises(FrozenInstanceError):
        sphere.radius = 1.0


def test_an_obstacle_may_be_given_as_lists() -> None:
    obstacle = Obstacle.capsule([0, 0, 0], [0, 0, 1], 0.1)
    np.testing.assert_array_equal(obstacle.end - obstacle.position, [0.0, 0.0, 1.0])
