"""The tracking study: its figures against signals whose figures are known, and what the estimate is worth."""

import io
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from rich.console import Console

from experiments.benchmarks import pictured
from experiments.benchmarks.crossing import CROSSING, KNOWLEDGE, NOISE, PASSED, TICK, Crossing, crossing_study
from experiments.benchmarks.tracking import (
    TRACKING,
    follow,
    lag,
    print_tracking,
    study_motions,
    track_figures,
    tracking_study,
)
from experiments.scenarios.passing_sphere import DISTANCE, RADIUS
from robots.errors import ConfigError
from robots.messages import Array
from safety.barriers.barrier_set import ObstacleBarrier
from safety.geometry.shapes import Obstacle
from safety.tracking import MODELS, ObstacleTrack, TrackerSettings
from sims.obstacles import CircularMotion, PositionSensor, StraightMotion


def waves(delay: float, count: int = 2000) -> Array:
    t = TICK * np.arange(count) - delay
    return np.column_stack([np.sin(5 * t), np.cos(3 * t), np.sin(7 * t + 1)])


@pytest.mark.parametrize("ticks", [0, 1, 17, 100])
def test_lag_of_a_delayed_signal_is_its_delay(ticks: int) -> None:
    assert lag(waves(0.0), 0.7 * waves(ticks * TICK)) == pytest.approx(ticks * TICK)


def known_series() -> dict[str, Array]:
    """Two seconds, of which the second counts: errors of one and two sigma in position, four in one velocity."""
    n = round(2 / TICK)
    true = np.hstack([waves(0.0, n), waves(0.5, n)])
    error = np.array([0.01, -0.02, 0.0, 0.1, 0.0, -0.4])
    measured = np.arange(n) % 5 == 0
    nan = np.where(measured, 1.0, np.nan)
    settled = np.arange(n) * TICK >= 1
    return {
        "time": np.arange(n) * TICK,
        "true": true,
        "estimate": true + np.where(settled[:, None], error, 9.0),
        "raw": true[:, :3] + np.where(settled[:, None], [0.03, 0.0, 0.04], 9.0),
        "sigma": np.tile([0.01] * 3 + [0.1] * 3, (n, 1)),
        "nees": np.where(settled, 5.0, 99.0),
        "nis": 3 * nan,
        "step": np.tile([0.3, 0.0, 0.4], (n, 1)),
        "rejected": np.arange(n) // 100,
    }


def test_figures_of_a_known_series() -> None:
    figures = track_figures(known_series())
    assert figures["velocity_rmse"] == pytest.approx(np.hypot(0.1, 0.4))
    assert figures["position_rmse_m"] == pytest.approx(np.hypot(0.01, 0.02))
    assert figures["raw_rmse_m"] == pytest.approx(0.05)
    assert figures["velocity_step"] == pytest.approx(0.5)
    assert figures["position_within_3_sigma"] == 1.0
    assert figures["velocity_within_3_sigma"] == pytest.approx(2 / 3)
    assert (figures["nees"], figures["nis"], figures["rejected"]) == (5.0, 3.0, 9)
    assert figures["lag_ms"] == 0.0


def test_followed_series_is_of_the_motion_and_of_the_sensor() -> None:
    motion = CircularMotion(np.ones(3), 0.3, 0.5)
    series = follow(motion, 50.0, TrackerSettings(position_noise=NOISE), 3, 1.5)
    assert len(series["time"]) == round(1.5 / TICK)
    for k in (0, 100, 700):
        t = series["time"][k]
        np.testing.assert_array_equal(series["true"][k], np.concatenate([motion.position(t), motion.velocity(t)]))
    due = ~np.isnan(series["nis"])
    due[0] = True
    assert np.flatnonzero(due).tolist() == list(range(0, 750, 10))
    # the raw position is held from one measurement to the next
    np.testing.assert_array_equal(series["raw"][due].repeat(10, axis=0), series["raw"])
    # with this model the estimated velocity changes by measurements alone: evenly over five ticks, then it is constant
    np.testing.assert_array_equal(series["step"][1:], np.diff(series["estimate"][:, 3:], axis=0))
    steps = series["step"].reshape(75, 10, 3)
    np.testing.assert_allclose(steps[:, 1:5], steps[:, :1].repeat(4, axis=1), rtol=0, atol=1e-12)
    np.testing.assert_allclose(steps[:, 5:], 0.0, atol=1e-12)
    assert (np.abs(steps[1:, 0]).max(axis=1) > 0).all()
    error = series["estimate"][-1] - series["true"][-1]
    assert (np.abs(error) < 5 * series["sigma"][-1]).all()


@pytest.mark.parametrize("model", MODELS)
def test_filtering_beats_the_last_measurement_on_steady_motion(model: str) -> None:
    motion = StraightMotion(np.zeros(3), np.array([0.3, 0.4, 0.0]))
    figures = track_figures(follow(motion, 60.0, TrackerSettings(position_noise=NOISE, model=model), 0, 4.0))
    assert figures["speed_rms"] == pytest.approx(0.5)
    assert figures["position_rmse_m"] < 0.8 * figures["raw_rmse_m"]
    assert figures["velocity_rmse"] < 0.25 * figures["speed_rms"]


def test_the_study_has_a_row_for_every_case_and_repeats_itself() -> None:
    rows = tracking_study(seed=1, rates=(60.0,), duration=1.6)
    cases = [(row["motion"], row["rate_hz"], row["model"]) for row in rows]
    names = ["velocity", "acceleration"]
    assert cases == [(motion, 60.0, model) for motion in study_motions(1) for model in names]
    assert rows == tracking_study(seed=1, rates=(60.0,), duration=1.6)
    assert rows != tracking_study(seed=2, rates=(60.0,), duration=1.6)
    for row in rows:
        assert all(np.isfinite(v) for v in row.values() if not isinstance(v, str))
        assert {column.key for column in TRACKING} <= set(row)


SPEED = 0.5
"""Of the obstacle whose filter is listened to [m/s]."""


def told(velocity: str, monkeypatch: pytest.MonkeyPatch) -> tuple[list[Obstacle], list[Obstacle]]:
    """The obstacle as it is, and as the filter is told, at every tick of a crossing."""
    given: list[Obstacle] = []
    set_obstacles = ObstacleBarrier.set_obstacles

    def spy(self: ObstacleBarrier, obstacles: Sequence[Obstacle]) -> None:
        given.extend(obstacles)
        set_obstacles(self, obstacles)

    with monkeypatch.context() as patch:
        patch.setattr(ObstacleBarrier, "set_obstacles", spy)
        Crossing("none", SPEED, velocity, seed=4).run()
    return given[1::2], given[::2]


@pytest.mark.parametrize("velocity", KNOWLEDGE)
def test_the_filter_is_told_what_it_is_said_to_be_told(velocity: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Against a track of the same measurements: place, radius by the page of the study, velocity."""
    true, believed = told(velocity, monkeypatch)
    sensor, track = PositionSensor(60.0, NOISE, np.random.default_rng([4, 3])), ObstacleTrack()
    assert len(true) == len(believed) == round((DISTANCE + PASSED) / SPEED / TICK)
    for k, (real, seen) in enumerate(zip(true, believed, strict=True)):
        t = k * TICK
        np.testing.assert_allclose(real.position, true[0].position - [0, SPEED * t, 0], rtol=0, atol=1e-12)
        track.measure(sensor.measure(real.position, t), t, t - TICK)
        position, estimated = track.estimate(t)
        np.testing.assert_allclose(seen.position, position, rtol=0, atol=1e-12)
        larger = 3.0 * track.position_sigma(t) if velocity == "estimated + 3 sigma" else 0.0
        assert seen.radius == pytest.approx(RADIUS + larger, rel=1e-12)
        expected = {"zero": np.zeros(3), "true": np.array([0.0, -SPEED, 0.0])}.get(velocity, estimated)
        np.testing.assert_allclose(seen.velocity, expected, rtol=0, atol=1e-12)
    # noise tells the estimate from the truth, so that none of the cases is another one
    assert np.linalg.norm(track.estimate(t)[1] - [0.0, -SPEED, 0.0]) > 1e-3


@pytest.mark.parametrize("name", ["cbf", "issf"])
def test_what_is_known_of_the_velocity_decides_on_the_distance(name: str) -> None:
    distance = {velocity: Crossing(name, 1.0, velocity, seed=0).run()[0] for velocity in KNOWLEDGE}
    # at rest in its eyes, the obstacle gets in as deep as alpha h = -v lets it; the estimate keeps it out
    assert distance["zero"] < -0.03
    assert distance["estimated"] > 0
    assert distance["estimated + 3 sigma"] > 0
    assert distance["true"] > 0


def test_without_a_filter_the_obstacle_goes_through_the_hand() -> None:
    robot_stays = Crossing("none", 1.0, "true", seed=0).run()
    assert robot_stays[0] < -0.05
    assert robot_stays[1] == 0.0


def test_an_unknown_kind_of_knowledge_is_refused() -> None:
    allowed = r"zero, estimated, estimated \+ 3 sigma, true"
    with pytest.raises(ConfigError, match=rf"velocity = 'guessed': must be one of {allowed}"):
        Crossing("cbf", 1.0, "guessed", 0)


def test_the_command_prints_both_tables_and_writes_what_it_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = tracking_study(seed=0, rates=(60.0,), duration=1.2)
    crossings = crossing_study(range(1), speeds=(1.0,), filters=("cbf",))
    monkeypatch.setattr(pictured, "tracking_study", lambda seed: rows)
    monkeypatch.setattr(pictured, "crossing_study", lambda seeds: crossings)
    monkeypatch.setattr(pictured, "tracking_plot", lambda seed: b"a picture")
    assert pictured.tracking(tmp_path / "figures.json") == 0
    written = json.loads((tmp_path / "figures.json").read_text(encoding="utf-8"))
    assert written == {"tracking": rows, "crossing": crossings}
    assert (tmp_path / "figures.png").read_bytes() == b"a picture"
    assert "obstacle tracks" in capsys.readouterr().out
    assert pictured.tracking(None) == 0
    assert [row["velocity"] for row in crossings] == list(KNOWLEDGE)


def test_tables_show_every_figure_in_its_unit() -> None:
    rows = [{c.key: 0.0123 for c in TRACKING} | {"motion": "circular", "model": "velocity"}]
    crossings = [{c.key: 0.0123 for c in CROSSING} | {"filter": "cbf", "velocity": "true"}]
    buffer = io.StringIO()
    print_tracking(Console(file=buffer, width=400), rows, crossings)
    text = buffer.getvalue()
    for column in (*TRACKING, *CROSSING):
        assert column.words in text
        assert not column.unit or f"[{column.unit}]" in text
    for shown in ("circular", "velocity", "cbf", "12.3", "1.23", "0.0123"):
        assert shown in text


def test_the_plot_is_a_picture_with_something_on_it() -> None:
    picture = Image.open(io.BytesIO(pictured.tracking_plot(duration=1.2)))
    assert picture.format == "PNG"
    assert len(np.unique(np.asarray(picture.convert("RGB")).reshape(-1, 3), axis=0)) > 20
