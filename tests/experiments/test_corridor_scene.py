"""The scene of the corridor: boards, sphere and goals."""

import numpy as np
import pytest

from experiments.running.corridor_loop import CorridorLoop
from experiments.scenarios.corridor import (
    CLOSING,
    D_MIN,
    GOALS,
    HAND_RADIUS,
    WIDE_GAP,
    Corridor,
    ramp,
)
from robots.description import RobotDescription


@pytest.mark.parametrize("t", [0.7, 2.4, 2.75, 3.4, 5.2, 5.9, 7.0, 8.8, 9.3, 10.3, 10.9, 13.0])
def test_obstacles_move_as_fast_as_they_say(t: float) -> None:
    scene = Corridor(0.13)
    after, before, now = (scene.obstacles(t + step) for step in (1e-6, -1e-6, 0.0))
    for a, b, o in zip(after, before, now, strict=True):
        np.testing.assert_allclose(o.velocity, (a.position - b.position) / 2e-6, rtol=0, atol=1e-8)


def test_the_scene_s_kinds_are_those_of_its_obstacles() -> None:
    scene = Corridor()
    assert tuple(o.kind for o in scene.obstacles(0.0)) == scene.kinds


def test_a_ramp_is_at_rest_at_both_ends() -> None:
    assert ramp(0.0, 1.0, 3.0) == (0.0, 0.0)
    assert ramp(2.0, 1.0, 3.0)[0] == pytest.approx(0.5)
    assert ramp(4.0, 1.0, 3.0) == (1.0, 0.0)


@pytest.mark.parametrize("gap", [0.11, 0.14, 0.19])
def test_closed_boards_are_both_too_near_and_neither_touches_the_hand_in_the_middle(
    corridor_g1: RobotDescription, gap: float
) -> None:
    """The conflict of figure 2(b): both phi >= 0, both distances above 0."""
    loop = CorridorLoop(corridor_g1, Corridor(gap), "none")
    assert loop.obstacle_barrier.bodies is not None
    hand = corridor_g1.collisions[loop.obstacle_barrier.bodies.names.index("left_hand")]
    assert hand.radius == HAND_RADIUS
    boards = loop.scene.obstacles(CLOSING[1])[:2]
    for board, side in zip(boards, (-1, 1), strict=True):
        face = board.position[2] - side * board.half_sizes[2]
        distance = side * (face - GOALS[0, 2]) - HAND_RADIUS
        assert distance == pytest.approx(gap / 2 - HAND_RADIUS, abs=1e-12)
        assert 0 < distance < D_MIN["obstacle"]


def test_open_boards_leave_the_hand_its_margin() -> None:
    assert WIDE_GAP / 2 - HAND_RADIUS > D_MIN["obstacle"]


def test_nothing_is_random_without_a_seed_and_everything_repeats_with_one() -> None:
    np.testing.assert_array_equal(Corridor().goals, GOALS)
    np.testing.assert_array_equal(Corridor().goals, Corridor().goals)
    a, again, b = Corridor(seed=1), Corridor(seed=1), Corridor(seed=2)
    np.testing.assert_array_equal(a.goals, again.goals)
    np.testing.assert_array_equal(a.sphere_nearest, again.sphere_nearest)
    assert not np.allclose(a.goals, b.goals)
    assert not np.allclose(a.goals, GOALS)
