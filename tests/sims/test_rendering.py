import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest

from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array
from robots.pinocchio_model import standing_configuration
from sims import rendering
from sims.rendering import (
    TILE,
    Camera,
    Image,
    RenderingError,
    RobotRenderer,
    rendering_problem,
    video_problem,
    write_video,
)

ROOT = Path(__file__).resolve().parents[2]
WIDTH, HEIGHT = 320, 240
FIELD_OF_VIEW = np.radians(45.0)  # vertical, MuJoCo's default
RED, BLUE = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)


@pytest.fixture(scope="module")
def robot() -> RobotDescription:
    return load_robot("g1")


@pytest.fixture(scope="module")
def renderer(robot: RobotDescription) -> Iterator[RobotRenderer]:
    with RobotRenderer(robot, WIDTH, HEIGHT) as made:
        yield made


@pytest.fixture
def fresh_check() -> Iterator[None]:
    rendering_problem.cache_clear()
    video_problem.cache_clear()
    yield
    rendering_problem.cache_clear()
    video_problem.cache_clear()


def painted(robot: RobotDescription, colour: tuple[float, ...], others: tuple[float, ...], *names: str) -> Array:
    return np.array([colour if not names or s.name in names else others for s in robot.collisions])


def is_red(image: Image) -> np.ndarray:
    r, g, b = (image[..., k].astype(int) for k in range(3))
    return (r > 2 * g) & (r > 2 * b)


def is_green(image: Image) -> np.ndarray:
    r, g, b = (image[..., k].astype(int) for k in range(3))
    return (g > 1.5 * r) & (g > 1.2 * b)


def pixel(point: Array, camera: Camera, robot_height: float) -> tuple[int, int]:
    """Row and column of a point in the world, by the pinhole model."""
    azimuth, elevation = np.radians([camera.azimuth, camera.elevation])
    forward = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
    up = np.cross(right, forward)
    assert camera.look_at is not None
    centre = np.array([*camera.look_at, camera.height * robot_height])
    ray = point - (centre - camera.distance * robot_height * forward)
    focal = 0.5 * HEIGHT / np.tan(0.5 * FIELD_OF_VIEW)
    column = 0.5 * WIDTH + focal * (ray @ right) / (ray @ forward)
    row = 0.5 * HEIGHT - focal * (ray @ up) / (ray @ forward)
    return int(row), int(column)


def standing_height(robot: RobotDescription) -> float:
    kinematics = Kinematics(robot)
    kinematics.update_geometry(standing_configuration(robot))
    tops = []
    for shape in robot.collisions:
        rotation, position = kinematics.frame_placement(kinematics.frame_id(shape.body))
        middle = position + rotation @ (0.5 * (shape.start + shape.end))
        tops.append(middle[2] + shape.radius + 0.5 * np.linalg.norm(shape.end - shape.start))
    return max(tops)


@pytest.mark.rendering
def test_an_image_has_the_size_asked_for(renderer: RobotRenderer) -> None:
    image = renderer.image(standing_configuration(renderer.robot))
    assert image.shape == (HEIGHT, WIDTH, 3)
    assert image.dtype == np.uint8


@pytest.mark.rendering
def test_an_image_does_not_depend_on_the_one_before(robot: RobotDescription) -> None:
    q = standing_configuration(robot)
    far = q.copy()
    far[:2] += 7.3
    with RobotRenderer(robot, WIDTH, HEIGHT) as fresh:
        first = fresh.image(q)
        np.testing.assert_array_equal(fresh.image(q), first)
        fresh.image(far, painted(robot, RED, RED), Camera(azimuth=90.0), np.ones((1, 3)))
        np.testing.assert_array_equal(fresh.image(q), first)


@pytest.mark.rendering
def test_a_moved_joint_changes_the_image(renderer: RobotRenderer) -> None:
    q = standing_configuration(renderer.robot)
    moved = q.copy()
    moved[7 + renderer.robot.joint_names.index("left_elbow_joint")] -= 0.8
    assert (renderer.image(q) != renderer.image(moved)).any(axis=2).sum() > 100


@pytest.mark.rendering
def test_the_colours_asked_for_are_in_the_image(renderer: RobotRenderer) -> None:
    robot, q = renderer.robot, standing_configuration(renderer.robot)
    assert is_red(renderer.image(q, painted(robot, RED, RED))).sum() > 0.04 * WIDTH * HEIGHT
    assert not is_red(renderer.image(q, painted(robot, BLUE, BLUE))).any()
    assert not is_red(renderer.image(q)).any()


@pytest.mark.rendering
@pytest.mark.parametrize("yaw", [0.0, 0.5])
def test_a_body_is_drawn_where_pinocchio_places_it(renderer: RobotRenderer, yaw: float) -> None:
    robot = renderer.robot
    q = standing_configuration(robot)
    q[:2] = 0.1, -0.05
    q[3:7] = 0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)
    shape = next(s for s in robot.collisions if s.name == "left_hand")
    kinematics = Kinematics(robot)
    kinematics.update_geometry(q)
    rotation, position = kinematics.frame_placement(kinematics.frame_id(shape.body))
    centre = position + rotation @ (0.5 * (shape.start + shape.end))
    camera = Camera(look_at=(0.0, 0.0))
    red = is_red(renderer.image(q, painted(robot, RED, BLUE, "left_hand"), camera))
    row, column = pixel(centre, camera, standing_height(robot))
    assert red[row, column]
    assert red.sum() < 0.03 * red.size


@pytest.mark.rendering
def test_the_default_view_follows_the_base(renderer: RobotRenderer) -> None:
    q = standing_configuration(renderer.robot)
    far = q.copy()
    far[:2] += 2.0
    colours = painted(renderer.robot, RED, RED)
    here, there = (is_red(renderer.image(x, colours)) for x in (q, far))
    # graphics compute in single precision: here and there a pixel on the outline may flip
    assert (here != there).sum() < 0.001 * here.sum()
    fixed = Camera(look_at=(0.0, 0.0))
    assert is_red(renderer.image(q, colours, fixed)).any()
    assert (is_red(renderer.image(far, colours, fixed)) != here).sum() > 0.5 * here.sum()


@pytest.mark.rendering
@pytest.mark.parametrize("look_at", [(0.0, 0.0), (0.13, -0.07), (3.26, 7.9), (-41.4, 12.3)])
def test_the_floor_s_tiles_stay_where_they_are(renderer: RobotRenderer, look_at: tuple[float, float]) -> None:
    """Dark and light by turns, a quarter of a metre wide, with a corner in the origin, wherever the camera goes."""
    away = standing_configuration(renderer.robot)
    away[2] = -3.0  # out of the way
    camera = Camera(azimuth=70.0, elevation=-60.0, distance=1.2, look_at=look_at, height=0.0)
    brightness = renderer.image(away, camera=camera).astype(float).mean(axis=2)
    corner = np.floor(np.array(look_at) / TILE)
    tiles = [corner + np.array([i, j]) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    places = [np.array([*(TILE * (tile + 0.5)), 0.0]) for tile in tiles]
    seen = np.array([brightness[pixel(p, camera, standing_height(renderer.robot))] for p in places])
    even = np.array([tile.sum() % 2 == 0 for tile in tiles])
    dark, light = seen[even], seen[~even]
    assert light.min() - dark.max() > 15
    assert max(np.ptp(dark), np.ptp(light)) < 5


@pytest.mark.rendering
def test_a_marker_is_drawn_at_its_point(renderer: RobotRenderer) -> None:
    q = standing_configuration(renderer.robot)
    camera = Camera(look_at=(0.0, 0.0))
    point = np.array([0.5, 0.5, 0.3])
    green = is_green(renderer.image(q, camera=camera, markers=point[None]))
    row, column = pixel(point, camera, standing_height(renderer.robot))
    assert green[row, column]
    assert not is_green(renderer.image(q, camera=camera)).any()


@pytest.mark.rendering
def test_more_markers_than_the_scene_holds_are_refused(renderer: RobotRenderer) -> None:
    with pytest.raises(ConfigError, match="markers"):
        renderer.image(standing_configuration(renderer.robot), markers=np.zeros((1000, 3)))


@pytest.mark.rendering
def test_two_renderers_do_not_disturb_each_other(renderer: RobotRenderer) -> None:
    q = standing_configuration(renderer.robot)
    alone = renderer.image(q)
    tocabi = load_robot("tocabi")
    with RobotRenderer(tocabi, 64, 48, smooth=False) as other:
        assert other.image(standing_configuration(tocabi)).shape == (48, 64, 3)
        np.testing.assert_array_equal(renderer.image(q), alone)
    np.testing.assert_array_equal(renderer.image(q), alone)


@pytest.mark.rendering
def test_wrong_shapes_are_named(renderer: RobotRenderer) -> None:
    q = standing_configuration(renderer.robot)
    with pytest.raises(ConfigError, match=r"q = \(3,\)"):
        renderer.image(q[:3])
    with pytest.raises(ConfigError, match="colours"):
        renderer.image(q, np.zeros((1, 3)))


@pytest.mark.rendering
def test_a_closed_renderer_says_so(robot: RobotDescription) -> None:
    with RobotRenderer(robot, 32, 32) as made:
        pass
    made.close()
    with pytest.raises(RenderingError, match="closed"):
        made.image(standing_configuration(robot))


@pytest.mark.rendering
def test_rendering_works_whoever_imported_mujoco_first() -> None:
    code = (
        "import mujoco, numpy\n"
        "from robots.loader import load_robot\n"
        "from robots.pinocchio_model import standing_configuration\n"
        "from sims.rendering import RobotRenderer\n"
        "robot = load_robot('g1')\n"
        "with RobotRenderer(robot, 32, 32) as renderer:\n"
        "    assert numpy.ptp(renderer.image(standing_configuration(robot))) > 50\n"
    )
    hidden = {"DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL", "PYOPENGL_PLATFORM"}
    environment = {k: v for k, v in os.environ.items() if k not in hidden}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.usefixtures("fresh_check")
def test_missing_opengl_is_told_with_the_packages_to_install(
    robot: RobotDescription, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(name: str) -> None:
        raise AttributeError("'NoneType' object has no attribute 'eglQueryString'")

    monkeypatch.setattr(rendering, "import_module", missing)
    problem = rendering_problem()
    assert problem is not None
    assert "eglQueryString" in problem
    assert "apt install libegl1 libgl1-mesa-dri libopengl0" in problem
    assert video_problem() == problem
    with pytest.raises(RenderingError, match="libegl1"):
        RobotRenderer(robot)


@pytest.mark.usefixtures("fresh_check")
def test_rendering_switched_off_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "disable")
    problem = rendering_problem()
    assert problem is not None
    assert "MUJOCO_GL=disable" in problem
    assert "apt" not in problem


def test_a_film_has_every_frame_and_even_sides(tmp_path: Path) -> None:
    path = tmp_path / "film.mp4"
    shades = (40, 120, 200)
    write_video(path, (np.full((49, 65, 3), shade, dtype=np.uint8) for shade in shades), fps=10)
    reader = imageio_ffmpeg.read_frames(str(path))
    meta = next(reader)
    assert meta["source_size"] == (64, 48)
    assert meta["fps"] == 10
    assert meta["codec"] == "h264"
    assert meta["pix_fmt"].startswith("yuv420p")
    means = [np.frombuffer(frame, dtype=np.uint8).mean() for frame in reader]
    np.testing.assert_allclose(means, shades, atol=3)  # video colours are 219 steps wide


def test_a_film_needs_a_frame(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="frames"):
        write_video(tmp_path / "film.mp4", [], fps=10)
