"""Pictures and films of runs."""

import io
from collections.abc import Iterator
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from experiments.recording.recording import (
    Recording,
    smallest_self_collision,
)
from experiments.reports.media import FAR, INSIDE, NEUTRAL, RAMP, barrier_colours, key_frames, make_video
from robots.description import RobotDescription
from sims.rendering import rendering_problem, video_problem
from tests.support.made_runs import ROBOTS, made_run


@pytest.fixture(scope="module")
def pair() -> list[Recording]:
    """The same motion twice, once without a filter, which ends early."""
    return [made_run(filter="none", ticks=25), made_run(plant={"mass_scale": 1.2})]


@pytest.fixture
def no_rendering(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("MUJOCO_GL", "disable")
    for check in (rendering_problem, video_problem):
        check.cache_clear()
    yield
    for check in (rendering_problem, video_problem):
        check.cache_clear()


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)
def test_bodies_have_the_colour_of_their_smallest_barrier(robot: RobotDescription) -> None:
    names = [shape.name for shape in robot.collisions]
    h = np.full(len(robot.self_collision_pairs), 1.0)
    far = barrier_colours(robot, h)
    paired = {name for pair in robot.self_collision_pairs for name in pair}
    for name, colour in zip(names, far, strict=True):
        np.testing.assert_array_equal(colour, RAMP[-1] if name in paired else NEUTRAL)
    h[0] = -1e-6
    near = barrier_colours(robot, h)
    red = {name for name, colour in zip(names, near, strict=True) if tuple(colour) == INSIDE}
    assert red == set(robot.self_collision_pairs[0])


def test_colours_run_from_blue_to_orange_and_jump_to_red() -> None:
    robot = ROBOTS["g1"]
    index = [shape.name for shape in robot.collisions].index(robot.self_collision_pairs[0][0])

    def colour(value: float) -> np.ndarray:
        h = np.ones(len(robot.self_collision_pairs))
        h[0] = value
        return barrier_colours(robot, h)[index]

    np.testing.assert_allclose(colour(FAR), RAMP[3], atol=1e-15)
    np.testing.assert_allclose(colour(FAR / 3), RAMP[1], atol=1e-15)
    np.testing.assert_allclose(colour(FAR / 6), 0.5 * (RAMP[0] + RAMP[1]), atol=1e-15)
    np.testing.assert_allclose(colour(0.0), RAMP[0], atol=1e-15)
    assert tuple(colour(-1e-9)) == INSIDE
    assert tuple(colour(np.nan)) == INSIDE


@pytest.mark.rendering
def test_key_frames_hold_the_smallest_barrier() -> None:
    result = made_run(ticks=100)
    frames = key_frames(result)
    times = [t for t, _ in frames]
    worst = result.series["step_time"][np.argmin(smallest_self_collision(result))]
    assert len(frames) == 4
    assert times == sorted(times)
    # the tick that was running when it happened
    assert any(t <= worst < t + 0.01 for t in times)
    sizes = {Image.open(io.BytesIO(png)).size for _, png in frames}
    assert sizes == {(420, 480)}


@pytest.mark.rendering
@pytest.mark.parametrize(("ticks", "count"), [(0, 0), (1, 1), (3, 3)])
def test_short_runs_have_fewer_key_frames(ticks: int, count: int) -> None:
    assert len(key_frames(made_run(ticks=ticks))) == count


@pytest.mark.rendering
def test_a_film_lasts_as_long_as_the_longest_run(pair: list[Recording], tmp_path: Path) -> None:
    path = make_video(pair, tmp_path / "film.mp4", fps=10)
    assert path is not None
    frames, _ = imageio_ffmpeg.count_frames_and_secs(str(path))
    assert frames == 4  # at 0.0, 0.1, 0.2 and 0.3 s of 0.39 s
    assert next(imageio_ffmpeg.read_frames(str(path)))["source_size"] == (960, 544)


@pytest.mark.usefixtures("no_rendering")
def test_without_rendering_there_are_no_pictures(tmp_path: Path) -> None:
    result = made_run(ticks=5)
    assert key_frames(result) == []
    assert make_video([result], tmp_path / "film.mp4") is None
    assert not (tmp_path / "film.mp4").exists()
