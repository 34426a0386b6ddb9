"""Pictures of the corridor show what was there."""

from collections.abc import Sequence

import numpy as np
import pytest

from experiments.reports.corridor import corridor_frames
from experiments.reports.media import obstacle_shapes, rotation_to
from experiments.running.corridor_loop import CorridorLoop, CorridorRun
from experiments.scenarios.corridor import (
    INSTANTS,
    Corridor,
)
from experiments.studies.corridor import report_scene
from robots.description import RobotDescription
from robots.errors import ConfigError
from safety.geometry.shapes import Obstacle
from sims.rendering import RobotRenderer
from sims.shapes import Shape
from tests.support.corridor import DURATION


def test_obstacles_become_shapes() -> None:
    turn = rotation_to(np.array([0.6, 0.0, 0.8]))
    obstacles = [
        Obstacle.sphere(np.ones(3), 0.1),
        Obstacle.capsule(np.zeros(3), np.array([0.0, 0.3, 0.4]), 0.05),
        Obstacle.capsule(np.ones(3), np.ones(3), 0.05),
        Obstacle.box(np.zeros(3), turn, np.array([0.1, 0.2, 0.3])),
        Obstacle.half_space(np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, 2.0])),
    ]
    ball, capsule, point, box, plate = obstacle_shapes(obstacles)
    assert [s.kind for s in (ball, capsule, point, box, plate)] == ["sphere", "capsule", "sphere", "box", "box"]
    assert capsule.size == pytest.approx((0.05, 0.25))
    np.testing.assert_allclose(capsule.center, [0.0, 0.15, 0.2])
    np.testing.assert_allclose(capsule.rotation[:, 2], [0.0, 0.6, 0.8], atol=1e-15)
    np.testing.assert_array_equal(box.rotation, turn)
    # its upper face is the plane
    assert plate.center[2] + plate.size[2] == pytest.approx(1.0)


@pytest.mark.parametrize("z", [(1, 0, 0), (0, -1, 0), (0, 0, -1), (0.6, 0.0, -0.8)])
def test_a_rotation_to_an_axis_is_one(z: Sequence[float]) -> None:
    turn = rotation_to(np.array(z, dtype=float))
    np.testing.assert_allclose(turn[:, 2], z, atol=1e-15)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(turn) == pytest.approx(1.0)


def test_bad_shapes_are_refused() -> None:
    for kind, size in (("cone", (1.0,)), ("box", (1.0, 1.0)), ("sphere", (0.0,)), ("capsule", (0.1, np.nan))):
        with pytest.raises(ConfigError, match=r"shape|size"):
            Shape(kind, size, np.zeros(3))
    with pytest.raises(ConfigError, match="center"):
        Shape("sphere", (0.1,), np.array([0.0, np.inf, 0.0]))


@pytest.mark.rendering
def test_every_kind_of_shape_is_drawn_where_it_is(corridor_g1: RobotDescription) -> None:
    """A shape in front of the robot changes the picture, one behind the camera does not."""
    kin = CorridorLoop(corridor_g1, Corridor(), "none").kin
    q = kin.full_configuration(kin.posture())
    turn = rotation_to(np.array([0.0, 0.6, 0.8]))
    with RobotRenderer(corridor_g1, 96, 96) as renderer:
        bare = renderer.image(q)
        for kind, size in (("sphere", (0.1,)), ("capsule", (0.05, 0.1)), ("box", (0.1, 0.05, 0.02))):
            seen = renderer.image(q, shapes=[Shape(kind, size, np.array([0.5, 0.3, 0.8]), turn)])
            hidden = renderer.image(q, shapes=[Shape(kind, size, np.array([50.0, 33.0, 0.8]), turn)])
            assert (seen != bare).any()
            np.testing.assert_array_equal(hidden, bare)


@pytest.mark.rendering
def test_pictures_are_taken_at_the_three_instants(
    corridor_g1: RobotDescription, corridor_runs: dict[str, CorridorRun]
) -> None:
    (frames,) = corridor_frames(report_scene(Corridor(), corridor_g1), corridor_g1, [corridor_runs["pssa"]])
    assert [t for t, _ in frames] == pytest.approx([t for t in INSTANTS if t < DURATION])
    assert all(png.startswith(b"\x89PNG") for _, png in frames)
