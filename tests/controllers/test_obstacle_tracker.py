"""What becomes of detected obstacles before the filter sees them: tracks by name, and slots."""

from dataclasses import replace

import numpy as np
import pytest

from controllers.obstacle_tracker import ObstacleTracker, TrackingSettings
from controllers.perception import FAR, Detection, ObstacleSlots
from robots.errors import ConfigError
from safety.geometry.shapes import Obstacle
from safety.tracking import MODELS, ObstacleTrack, TrackerSettings

STARTS = (np.array([0.5, 0.1, 0.9]), np.array([-0.4, 0.3, 1.2]))
RATES = (np.array([0.3, -0.1, 0.0]), np.array([0.0, 0.5, 0.2]))
RADII = (0.08, 0.2)
LAST = 0.98
"""Stamp of the last measurement [s]."""


def detection(i: int, position: np.ndarray | None, stamp: float) -> Detection:
    shape = Obstacle.sphere(np.zeros(3) if position is None else position, RADII[i])
    return Detection(f"sphere {i}", stamp, shape, position is not None)


def observed(settings: TrackingSettings | None = None) -> ObstacleTracker:
    tracker = ObstacleTracker(settings)
    for t in np.arange(0.0, LAST + 0.01, 0.02):
        for i, (start, rate) in enumerate(zip(STARTS, RATES, strict=True)):
            assert tracker.observe(detection(i, start + t * rate, float(t)))
    return tracker


def spheres(tracker: ObstacleTracker, stamp: float) -> list[Obstacle]:
    return list(tracker.obstacles(stamp).values())


def packed(obstacle: Obstacle) -> tuple[np.ndarray, float, np.ndarray]:
    return obstacle.position, obstacle.radius, obstacle.velocity


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("ahead", [0.0, 0.004, 0.15])
def test_spheres_are_where_they_move_to_with_their_radius_and_velocity(model: str, ahead: float) -> None:
    obstacles = spheres(observed(TrackingSettings(TrackerSettings(model=model))), LAST + ahead)
    for obstacle, radius, start, rate in zip(obstacles, RADII, STARTS, RATES, strict=True):
        position, size, velocity = packed(obstacle)
        np.testing.assert_allclose(position, start + (LAST + ahead) * rate, rtol=0, atol=1e-4)
        np.testing.assert_allclose(velocity, rate, rtol=0, atol=1e-3)
        assert size == radius


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("kappa", [0.5, 3.0])
def test_kappa_enlarges_by_so_many_standard_deviations(model: str, kappa: float) -> None:
    settings = TrackerSettings(model=model)
    bare, inflated = observed(TrackingSettings(settings)), observed(TrackingSettings(settings, kappa))
    gaps = []
    for ahead in (0.0, 0.05, 0.15):
        pairs = zip(spheres(bare, LAST + ahead), spheres(inflated, LAST + ahead), strict=True)
        for (plain, large), track in zip(pairs, inflated.tracks.values(), strict=True):
            sigma = np.sqrt(np.linalg.eigvalsh(track.covariance(LAST + ahead)[:3, :3])[-1])
            assert large.radius - plain.radius == pytest.approx(kappa * sigma, rel=1e-9)
            np.testing.assert_array_equal(large.position, plain.position)
            np.testing.assert_array_equal(large.velocity, plain.velocity)
        gaps.append(large.radius)
    assert gaps == sorted(set(gaps))


def test_without_velocity_the_spheres_are_in_the_same_place_at_rest() -> None:
    moving, resting = observed(), observed(TrackingSettings(velocity="zero"))
    for a, b in zip(spheres(moving, LAST + 0.1), spheres(resting, LAST + 0.1), strict=True):
        np.testing.assert_array_equal(a.position, b.position)
        np.testing.assert_array_equal(b.velocity, np.zeros(3))
        assert a.velocity.any()


def test_each_sphere_has_a_track_of_its_own() -> None:
    tracker = observed()
    alone = ObstacleTrack()
    for t in np.arange(0.0, LAST + 0.01, 0.02):
        alone.measure(STARTS[1] + t * RATES[1], float(t))
    assert tracker.observe(detection(0, STARTS[0] + (LAST + 0.02) * RATES[0], LAST + 0.02))
    assert not tracker.observe(detection(1, None, LAST + 0.02))
    position, velocity = alone.estimate(LAST + 0.05)
    np.testing.assert_allclose(tracker.obstacles(LAST + 0.05)["sphere 1"].position, position, rtol=0, atol=1e-13)
    np.testing.assert_allclose(tracker.obstacles(LAST + 0.05)["sphere 1"].velocity, velocity, rtol=0, atol=1e-13)


def test_an_outlier_is_not_accepted() -> None:
    tracker = observed()
    before = tracker.obstacles(LAST + 0.05)["sphere 0"]
    assert not tracker.observe(detection(0, STARTS[0] + 5.0, LAST + 0.02))
    np.testing.assert_allclose(tracker.obstacles(LAST + 0.05)["sphere 0"].position, before.position, rtol=0, atol=1e-13)
    assert tracker.tracks["sphere 0"].rejected == 1


def test_a_stale_track_is_a_fault_by_its_number_and_an_error() -> None:
    tracker = observed(TrackingSettings(TrackerSettings(max_age=0.1)))
    assert next(iter(tracker.faults(LAST + 0.1 - 1e-9).values()), None) is None
    tracker.observe(detection(0, STARTS[0] + (LAST + 0.1) * RATES[0], LAST + 0.1))
    fault = next(iter(tracker.faults(LAST + 0.15).values()), None)
    assert fault is not None
    assert "sphere 1 is 0.15 s old, allowed are 0.1 s" in fault
    with pytest.raises(ConfigError, match="age of the obstacle track"):
        tracker.obstacles(LAST + 0.15)


@pytest.mark.parametrize("position", [STARTS[1], STARTS[1] + 50.0, None], ids=["agreeing", "outlier", "missing"])
def test_a_track_from_the_future_is_a_fault_and_an_error(position: np.ndarray | None) -> None:
    """A clock in other units or of another start: such a track would never grow old."""
    tracker = observed()
    # rejected or missing, it moves the track on in time all the same
    tracker.observe(detection(1, position, 1000.0))
    tracker.observe(detection(0, STARTS[0] + RATES[0], 1.0))
    fault = next(iter(tracker.faults(1.0).values()), None)
    assert fault == "track of sphere 1 is 999 s ahead of the clock, allowed are 0.02 s"
    with pytest.raises(ConfigError, match="age of the obstacle track = -999"):
        tracker.obstacles(1.0)


def test_a_track_may_be_ahead_by_as_much_as_clocks_may_differ() -> None:
    tracker = observed(TrackingSettings(TrackerSettings(max_ahead=0.03)))
    assert next(iter(tracker.faults(LAST - 0.03 + 1e-9).values()), None) is None
    for obstacle, start, rate in zip(spheres(tracker, LAST - 0.03 + 1e-9), STARTS, RATES, strict=True):
        np.testing.assert_allclose(obstacle.position, start + LAST * rate, rtol=0, atol=1e-4)
    fault = next(iter(tracker.faults(LAST - 0.03 - 1e-9).values()), None)
    assert fault is not None
    assert "sphere 0 is 0.03 s ahead of the clock, allowed are 0.03 s" in fault
    with pytest.raises(ConfigError, match=r"at most 0\.03 s ahead"):
        tracker.obstacles(LAST - 0.03 - 1e-9)


@pytest.mark.parametrize("stamp", [np.nan, np.inf, -np.inf])
def test_no_track_can_be_used_at_no_time(stamp: float) -> None:
    tracker = observed()
    assert next(iter(tracker.faults(stamp).values()), None) is not None
    with pytest.raises(ConfigError, match="age of the obstacle track"):
        tracker.obstacles(stamp)


@pytest.mark.parametrize("stamp", [np.nan, np.inf, 50.0, -50.0])
def test_a_refused_stamp_leaves_no_trace(stamp: float) -> None:
    """What was asked of a wrong clock was not handed out: the next measurement goes on from what was."""
    asked, other = observed(), observed()
    for tracker in (asked, other):
        tracker.obstacles(LAST)
    with pytest.raises(ConfigError, match="age of the obstacle track"):
        asked.obstacles(stamp)
    for tracker in (asked, other):
        for i in range(2):
            assert tracker.observe(detection(i, STARTS[i] + (LAST + 0.02) * RATES[i] + 0.005, LAST + 0.02))
    for ahead in (0.02, 0.025, 0.1):
        for a, b in zip(spheres(asked, LAST + ahead), spheres(other, LAST + ahead), strict=True):
            np.testing.assert_array_equal(a.position, b.position)
            np.testing.assert_array_equal(a.velocity, b.velocity)


def test_a_measurement_that_came_in_when_it_was_stale_is_refused() -> None:
    """Otherwise its news would wait for a time that no estimate is given for."""
    track, at_once = (observed().tracks["sphere 0"] for _ in range(2))
    z, stamp = STARTS[0] + (LAST + 0.02) * RATES[0] + 0.005, LAST + 0.02
    with pytest.raises(ConfigError, match="time at which a measurement came in = 50"):
        track.measure(z, stamp, 50.0)
    # and the track is as it was: the same measurement, in time, is taken in
    latest = stamp + track.settings.max_age
    assert track.measure(z, stamp, latest)
    assert at_once.measure(z, stamp)
    assert (track.estimate(latest)[0] != at_once.estimate(latest)[0]).all()


def test_an_obstacle_that_is_looked_for_and_never_seen_is_a_fault() -> None:
    tracker = ObstacleTracker()
    assert next(iter(tracker.faults(0.0).values()), None) is None
    assert tracker.obstacles(0.0) == {}
    assert not tracker.observe(detection(0, None, 0.0))
    fault = next(iter(tracker.faults(0.0).values()), None)
    assert fault is not None
    assert "sphere 0 is inf s old" in fault


def test_a_forgotten_obstacle_is_gone_and_may_come_back() -> None:
    tracker = observed()
    tracker.forget("sphere 0")
    tracker.forget("sphere 0")
    assert list(tracker.obstacles(LAST)) == ["sphere 1"]
    assert tracker.observe(detection(0, STARTS[1], LAST))
    np.testing.assert_array_equal(tracker.obstacles(LAST)["sphere 0"].position, STARTS[1])


def test_a_measured_velocity_is_taken_where_that_is_asked_for() -> None:
    shape = Obstacle.sphere(STARTS[0], 0.1, RATES[1])
    for velocity, expected in (("measured", RATES[1]), ("zero", np.zeros(3)), ("estimated", np.zeros(3))):
        tracker = ObstacleTracker(TrackingSettings(velocity=velocity))
        assert tracker.observe(Detection("it", 0.0, shape))
        np.testing.assert_array_equal(tracker.obstacles(0.0)["it"].velocity, expected)


@pytest.mark.parametrize(
    "shape",
    [
        Obstacle.sphere(np.zeros(3), 0.1),
        Obstacle.capsule(np.zeros(3), np.array([0.3, 0.1, 0.0]), 0.1),
        Obstacle.box(np.zeros(3), np.eye(3), np.array([0.1, 0.2, 0.3])),
        Obstacle.half_space(np.zeros(3), np.array([0.0, 0.6, 0.8])),
    ],
    ids=lambda shape: shape.kind,
)
def test_an_enlarged_obstacle_is_nearer_by_its_margin(shape: Obstacle) -> None:
    """Measured along an axis of the shape, where a box has a face."""
    point = np.array([0.0, 0.6, 0.8]) if shape.kind == "half_space" else np.array([0.0, 0.0, 2.0])
    large = shape.enlarged(0.05)
    if shape.kind == "box":
        np.testing.assert_allclose(large.half_sizes - shape.half_sizes, 0.05, rtol=0, atol=1e-15)
    else:
        assert shape.clearance(point) - large.clearance(point) == pytest.approx(0.05, abs=1e-15)
    assert shape.enlarged(0.0) is shape


@pytest.mark.parametrize("kappa", [-1.0, np.nan, np.inf])
def test_kappa_is_checked(kappa: float) -> None:
    with pytest.raises(ConfigError, match="tracker kappa"):
        TrackingSettings(kappa=kappa)


def test_velocity_is_checked() -> None:
    with pytest.raises(ConfigError, match="tracker velocity = 'true': must be one of estimated, zero, measured"):
        TrackingSettings(velocity="true")


def at(x: float) -> Obstacle:
    return Obstacle.sphere(np.array([x, 0.0, 0.0]), 0.1)


def test_empty_slots_hold_what_is_far_away() -> None:
    slots = ObstacleSlots(("sphere", "capsule", "box", "half_space"))
    filled = slots.fill({}, np.zeros(3))
    assert [o.kind for o in filled] == list(slots.kinds)
    assert all(o.clearance(np.zeros(3)) > 0.99 * FAR for o in filled)
    with pytest.raises(ConfigError, match="obstacle kind = 'cone'"):
        ObstacleSlots(("sphere", "cone"))


def test_an_obstacle_keeps_its_slot_while_others_come_and_go() -> None:
    slots, centre = ObstacleSlots(("sphere", "sphere", "sphere")), np.zeros(3)
    slots.fill({"a": at(1.0), "b": at(2.0)}, centre)
    filled = slots.fill({"b": at(2.5), "c": at(3.0)}, centre)
    assert [round(o.position[0], 1) for o in filled] == [3.0, 2.5, 0.0]
    assert filled[2].clearance(centre) > 0.99 * FAR


def test_where_there_are_more_than_slots_the_nearest_count() -> None:
    slots, centre = ObstacleSlots(("sphere", "sphere")), np.zeros(3)
    crowd = {name: at(x) for name, x in (("far", 4.0), ("near", 1.0), ("middle", 2.0))}
    assert sorted(o.position[0] for o in slots.fill(crowd, centre)) == [1.0, 2.0]
    assert slots.left_out == ("far",)
    # one that comes closer takes the place of the furthest
    assert sorted(o.position[0] for o in slots.fill(crowd | {"far": at(0.5)}, centre)) == [0.5, 1.0]
    assert slots.left_out == ("middle",)


def test_a_kind_without_slots_is_left_out() -> None:
    slots = ObstacleSlots(("sphere",))
    slots.fill({"wall": Obstacle.half_space(np.zeros(3), np.array([1.0, 0.0, 0.0])), "ball": at(1.0)}, np.zeros(3))
    assert slots.left_out == ("wall",)


def test_what_was_given_last_is_where_it_goes_on_from() -> None:
    """A measurement changes what is given by no more per tick than its fraction of the blending time."""
    settings, dt, rng = TrackerSettings(gate=1.0), 0.002, np.random.default_rng(0)
    tracker = ObstacleTracker(TrackingSettings(settings))
    at_once = ObstacleTracker(TrackingSettings(replace(settings, blending=0.0)))
    given: list[np.ndarray] = []
    jumps: list[np.ndarray] = []
    for k in range(200):
        t = k * dt
        if k % 10 == 0:
            z = rng.normal(scale=0.005, size=3)
            before = at_once.obstacles(t)["sphere 0"].velocity if k else np.zeros(3)
            for one in (tracker, at_once):
                one.observe(detection(0, z, t))
            jumps.append(at_once.obstacles(t)["sphere 0"].velocity - before)
        given.append(tracker.obstacles(t)["sphere 0"].velocity)
    steps = np.diff(given, axis=0)
    fraction = dt / settings.blending
    # at the tick of the measurement already, and all of it within the blending time
    np.testing.assert_allclose(steps[9::10], fraction * np.array(jumps[1:]), rtol=0, atol=1e-12)
    np.testing.assert_allclose(given[19::10], np.cumsum(jumps, axis=0)[1:], rtol=0, atol=1e-12)
