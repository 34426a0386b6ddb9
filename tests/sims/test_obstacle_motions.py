"""True motions of obstacles against their own derivatives and definitions; the sensor against its statistics."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import binom, chi2

from robots.errors import ConfigError
from robots.messages import Array
from sims.obstacles import (
    BROWNIAN_STEP,
    BrownianMotion,
    CircularMotion,
    ObstacleMotion,
    PositionSensor,
    StopAndGo,
    StraightMotion,
    WaypointMotion,
)

LOW, HIGH = np.array([-0.3, -0.1, 0.8]), np.array([0.2, 0.4, 1.4])
PLACE, PEAK = np.array([0.1, -0.2, 1.0]), np.array([0.4, 0.2, -0.1])


def brownian(seed: int = 0, speed: float = 0.3, low: Array = LOW, high: Array = HIGH) -> BrownianMotion:
    return BrownianMotion(low, high, speed=speed, memory=0.5, seed=seed)


MOTIONS: dict[str, ObstacleMotion] = {
    "passing": StraightMotion(PLACE, PEAK),
    "waypoints": WaypointMotion(np.array([0.2, 1.0, 2.5]), np.array([PLACE, PLACE + PEAK, PLACE])),
    "circular": CircularMotion(PLACE, radius=0.3, speed=0.6, normal=np.array([1.0, -2.0, 0.5])),
    "stop and go": StopAndGo(PLACE, PEAK, going=0.8, resting=0.3),
    "Brownian": brownian(low=np.full(3, -1e3), high=np.full(3, 1e3)),
}


@pytest.mark.parametrize("name", MOTIONS)
def test_velocity_is_the_derivative_of_position(name: str) -> None:
    motion, step = MOTIONS[name], 1e-5
    # inside the intervals of the Brownian velocity, where it is smooth
    for t in BROWNIAN_STEP * (np.random.default_rng(0).integers(1, 1000, size=60) + 0.4):
        difference = (motion.position(t + step) - motion.position(t - step)) / (2 * step)
        np.testing.assert_allclose(motion.velocity(t), difference, rtol=0, atol=1e-7)


@pytest.mark.parametrize("name", MOTIONS)
def test_what_is_returned_is_the_callers(name: str) -> None:
    motion = MOTIONS[name]
    for ask in (motion.position, motion.velocity):
        first = ask(0.7)
        before = first.copy()
        first[:] = 99.0
        np.testing.assert_array_equal(ask(0.7), before)


def test_a_passing_sphere_goes_straight_on() -> None:
    motion = MOTIONS["passing"]
    np.testing.assert_allclose(motion.position(2.5), PLACE + 2.5 * PEAK, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(motion.velocity(2.5), PEAK)


def test_a_circle_keeps_radius_speed_plane_and_sense() -> None:
    motion, normal = MOTIONS["circular"], np.array([1.0, -2.0, 0.5])
    for t in np.linspace(0, 7, 40):
        arm, velocity = motion.position(t) - PLACE, motion.velocity(t)
        assert np.linalg.norm(arm) == pytest.approx(0.3, rel=1e-12)
        assert np.linalg.norm(velocity) == pytest.approx(0.6, rel=1e-12)
        assert arm @ normal == pytest.approx(0.0, abs=1e-12)
        np.testing.assert_allclose(
            np.cross(arm, velocity), 0.3 * 0.6 * normal / np.linalg.norm(normal), rtol=0, atol=1e-12
        )
    period = 2 * np.pi * 0.3 / 0.6
    np.testing.assert_allclose(motion.position(1.0 + period), motion.position(1.0), rtol=0, atol=1e-12)


def test_stop_and_go_rests_where_it_should_and_comes_back() -> None:
    motion, reach = MOTIONS["stop and go"], PLACE + 0.5 * 0.8 * PEAK
    np.testing.assert_array_equal(motion.position(0.0), PLACE)
    np.testing.assert_allclose(motion.velocity(0.4), PEAK, rtol=1e-12)
    np.testing.assert_allclose(motion.velocity(1.5), -PEAK, rtol=1e-12)
    for rest, place in ((0.9, reach), (1.05, reach), (2.0, PLACE), (2.15, PLACE)):
        np.testing.assert_allclose(motion.position(rest), place, rtol=0, atol=1e-15)
        np.testing.assert_allclose(motion.velocity(rest), 0.0, rtol=0, atol=1e-15)
    np.testing.assert_allclose(motion.position(0.3 + 2.2), motion.position(0.3), rtol=0, atol=1e-12)


def test_stop_and_go_starts_and_stops_without_a_jump_of_acceleration() -> None:
    motion, step = MOTIONS["stop and go"], 1e-6
    for change in (0.8, 1.1, 1.9, 2.2):
        for t in (change - step, change + step):
            # v = v_peak sin^2(pi s/T) is below v_peak (pi step/T)^2 so close to rest
            assert np.linalg.norm(motion.velocity(t)) <= np.linalg.norm(PEAK) * (np.pi * step / 0.8) ** 2 * 1.01


def test_brownian_motion_stays_in_its_box_and_bounces() -> None:
    motion, times = brownian(), np.arange(0.0, 60.0, 0.004)
    positions = np.array([motion.position(t) for t in times])
    velocities = np.array([motion.velocity(t) for t in times])
    assert (positions >= LOW).all()
    assert (positions <= HIGH).all()
    # it comes to every wall, and its speed does not change there: the position has no jump
    assert (positions.min(axis=0) < LOW + 0.01).all()
    assert (positions.max(axis=0) > HIGH - 0.01).all()
    fastest = np.abs(velocities).max(axis=0)
    assert (np.abs(np.diff(positions, axis=0)).max(axis=0) <= 0.004 * fastest * 1.1).all()


def test_velocity_of_the_reflected_motion_is_its_derivative_away_from_the_walls() -> None:
    motion, step, checked = brownian(), 1e-6, 0
    for t in BROWNIAN_STEP * (np.arange(0, 4000, 7) + 0.4):
        position = motion.position(t)
        if np.minimum(position - LOW, HIGH - position).min() > 1e-4:
            difference = (motion.position(t + step) - motion.position(t - step)) / (2 * step)
            np.testing.assert_allclose(motion.velocity(t), difference, rtol=0, atol=1e-7)
            checked += 1
    assert checked > 400


def test_brownian_motion_is_a_function_of_seed_and_time_whatever_is_asked_first() -> None:
    times = np.random.default_rng(1).uniform(0, 30, size=50)
    forward, anyhow = brownian(seed=7), brownian(seed=7)
    expected = {t: (forward.position(t), forward.velocity(t)) for t in np.sort(times)}
    for t in times:
        np.testing.assert_array_equal(anyhow.velocity(t), expected[t][1])
        np.testing.assert_array_equal(anyhow.position(t), expected[t][0])
    assert not np.allclose(brownian(seed=8).position(3.0), forward.position(3.0))


def test_brownian_velocity_has_the_spread_and_the_memory_asked_for() -> None:
    """Velocities of many seeds at two times: stationary variance, and correlation exp(-lag / memory)."""
    wide, runs, lag = np.full(3, 1e3), 400, 0.5
    motions = [brownian(seed, low=-wide, high=wide) for seed in range(runs)]
    first, second = (np.array([m.velocity(t) for m in motions]).ravel() / 0.3 for t in (1.0, 1.0 + lag))
    low, high = chi2.ppf([0.005, 0.995], first.size)
    for sample in (first, second):
        assert low < np.sum(sample**2) < high
    # Fisher's transform of a correlation is normal with variance 1/(n - 3)
    gap = np.arctanh(np.corrcoef(first, second)[0, 1]) - np.arctanh(np.exp(-lag / 0.5))
    assert abs(gap) < 2.81 / np.sqrt(first.size - 3)


@pytest.mark.parametrize("t", [-1e-9, np.nan, np.inf])
def test_brownian_motion_has_no_past_and_no_end(t: float) -> None:
    with pytest.raises(ConfigError, match="time of a Brownian motion"):
        brownian().position(t)


BAD: dict[str, tuple[str, Callable[[], object]]] = {
    "order of waypoints": ("waypoint times", lambda: WaypointMotion(np.array([1.0, 0.5]), np.array([PLACE, PEAK]))),
    "number of waypoints": ("waypoints", lambda: WaypointMotion(np.zeros(0), np.zeros((0, 3)))),
    "place of a sphere": ("straight motion start", lambda: StraightMotion(np.zeros(2), PEAK)),
    "radius of a circle": ("circular motion radius", lambda: CircularMotion(PLACE, -1.0, 0.1)),
    "speed of a circle": ("circular motion speed", lambda: CircularMotion(PLACE, 1.0, np.nan)),
    "normal of a circle": ("circular motion normal", lambda: CircularMotion(PLACE, 1.0, 1.0, np.zeros(3))),
    "going": ("stop and go going", lambda: StopAndGo(PLACE, PEAK, 0.0, 1.0)),
    "resting": ("stop and go resting", lambda: StopAndGo(PLACE, PEAK, 1.0, -1.0)),
    "peak": ("stop and go peak", lambda: StopAndGo(PLACE, np.array([0, 0, np.nan]), 1.0, 1.0)),
    "box": ("Brownian motion high", lambda: BrownianMotion(LOW, LOW, 0.1, 1.0, 0)),
    "corner": ("Brownian motion low", lambda: BrownianMotion(np.full(3, -np.inf), HIGH, 0.1, 1.0, 0)),
    "speed": ("Brownian motion speed", lambda: BrownianMotion(LOW, HIGH, 0.0, 1.0, 0)),
    "memory": ("Brownian motion memory", lambda: BrownianMotion(LOW, HIGH, 0.1, 0.0, 0)),
    "rate": ("sensor rate", lambda: sensor(rate=0.0)),
    "noise": ("sensor noise", lambda: sensor(noise=-1.0)),
    "dropout": ("sensor dropout", lambda: sensor(dropout=1.1)),
    "outlier": ("sensor outlier", lambda: sensor(outlier=-0.1)),
    "outlier size": ("sensor outlier_size", lambda: sensor(outlier_size=np.inf)),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_value_is_refused_by_name(case: str) -> None:
    name, make = BAD[case]
    with pytest.raises(ConfigError, match=name):
        make()


def sensor(rate: float = 100.0, noise: float = 0.005, seed: int = 0, **faults: float) -> PositionSensor:
    return PositionSensor(rate, noise, np.random.default_rng(seed), **faults)


def measured(device: PositionSensor, count: int) -> list[Array | None]:
    return [device.measure(PLACE, 0.01 * i) for i in range(count)]


def test_the_sensor_measures_at_its_rate_until_it_is_blind() -> None:
    device = PositionSensor(50.0, 0.0, np.random.default_rng(0), lost_at=1.0)
    seen = [i for i in range(2000) if device.measure(PLACE, 0.001 * i) is not None]
    assert seen == list(range(0, 1000, 20))


def test_noise_has_the_spread_asked_for() -> None:
    errors = np.array(measured(sensor(), 2000)) - PLACE
    low, high = chi2.ppf([0.005, 0.995], errors.size)
    assert low < np.sum(errors**2) / 0.005**2 < high


def test_missing_measurements_and_outliers_come_as_often_as_asked_for() -> None:
    count = 3000
    values = measured(sensor(dropout=0.2, outlier=0.1, outlier_size=0.5), count)
    seen = np.array([v for v in values if v is not None])
    far = np.linalg.norm(seen - PLACE, axis=1) > 0.25
    for found, trials, fraction in ((count - len(seen), count, 0.2), (far.sum(), len(seen), 0.1)):
        low, high = binom.ppf([0.005, 0.995], trials, fraction)
        assert low <= found <= high
    # half a metre in all directions, on top of the noise
    offsets = seen[far] - PLACE
    assert np.abs(np.linalg.norm(offsets, axis=1) - 0.5).max() < 5 * 0.005
    assert (offsets.min(axis=0) < -0.3).all()
    assert (offsets.max(axis=0) > 0.3).all()


def test_faults_leave_the_noise_of_the_rest_as_it_is() -> None:
    clean, faulty = measured(sensor(), 400), measured(sensor(dropout=0.3, outlier=0.2), 400)
    same = [np.array_equal(a, b) for a, b in zip(clean, faulty, strict=True) if b is not None]
    assert 0.6 < np.mean(same) < 1.0
    assert all(v is not None for v in clean)


@pytest.mark.parametrize(("dropout", "outlier"), [(1.0, 0.0), (0.0, 1.0)])
def test_certain_faults_happen_always(dropout: float, outlier: float) -> None:
    for value in measured(sensor(dropout=dropout, outlier=outlier, noise=0.0), 50):
        if dropout:
            assert value is None
        else:
            assert value is not None
            assert np.linalg.norm(value - PLACE) == pytest.approx(0.5, rel=1e-12)


def test_the_sensor_repeats_itself_with_its_seed() -> None:
    first, again = (measured(sensor(seed=3, dropout=0.1, outlier=0.1), 200) for _ in range(2))
    other = measured(sensor(seed=4, dropout=0.1, outlier=0.1), 200)
    for a, b in zip(first, again, strict=True):
        assert (a is None) == (b is None)
        if a is not None:
            np.testing.assert_array_equal(a, b)
    assert not all(a is b or np.array_equal(a, b) for a, b in zip(first, other, strict=True))
