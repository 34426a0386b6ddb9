"""Walking in closed loop: a fifth heavier than the model; a push."""

import dataclasses
import functools

import numpy as np
import pytest

from controllers.gaits.commands import VelocityCommand
from experiments.recording.recording import Recording
from experiments.running.run import run
from experiments.scenarios.options import PlantOptions
from experiments.scenarios.pushed import Pushed
from experiments.scenarios.pushes import DIRECTIONS, Push
from experiments.scenarios.scenario import Setup
from experiments.scenarios.walk import Walk
from experiments.scenarios.walk_plan import meeting, walk_setup
from robots.description import RobotDescription
from robots.loader import load_robot

SPEED = 0.2
PUSHED_AT = 1.8


@functools.cache
def heavy_walk(robot: str) -> Recording:
    return run(Walk(robot=robot, duration=8.0, vx=SPEED, plant=PlantOptions(mass_scale=1.2)))


def test_a_heavier_robot_walks_and_stops(robot_name: str) -> None:
    summary = heavy_walk(robot_name).summary
    assert not summary["fell"]
    assert summary["stop_cause"] is None
    assert summary["qp_failures"] == 0
    assert summary["steps"] >= 6
    assert summary["step_height_min_m"] > 0.04
    assert summary["min_h_self_collision_m"] > 0.0


def test_the_zmp_stays_in_the_standing_sole(robot_name: str) -> None:
    summary = heavy_walk(robot_name).summary
    assert summary["zmp_inside_single_fraction"] >= 0.99
    assert summary["zmp_inside_fraction"] >= 0.99


def test_standing_feet_do_not_slide(robot_name: str) -> None:
    summary = heavy_walk(robot_name).summary
    assert summary["foot_slide_max_m"] < 0.005


def test_it_walks_as_fast_as_it_is_told(robot_name: str) -> None:
    """Way of the soles' middle between touchdowns at full speed, two or more steps in, before the stop."""
    series = heavy_walk(robot_name).series
    down = np.flatnonzero((np.diff(series["in_contact"], axis=0) > 0).any(axis=1)) + 1
    down = [i for i in down if (series["command"][i - 1] != 0.0).any()][1:]
    middle = series["soles"][:, :, 0].mean(axis=1)
    speed = (middle[down[-1]] - middle[down[0]]) / (series["time"][down[-1]] - series["time"][down[0]])
    assert speed == pytest.approx(SPEED, abs=0.03)
    # straight on, upright, and feet side by side in the end
    assert np.abs(series["com"][-1, 1] - series["com"][0, 1]) < 0.03
    left, right = series["soles"][-1, :, 0]
    assert abs(left - right) < 0.03


def test_the_estimated_load_is_the_robots(robot_name: str) -> None:
    scale = heavy_walk(robot_name).series["load_scale"]
    assert scale[0] == pytest.approx(1.0, abs=0.01)
    assert np.median(scale[len(scale) // 2 :]) == pytest.approx(1.2, abs=0.03)


def test_the_heavier_g1_walks_fast_and_is_where_the_meeting_with_an_obstacle_is_planned() -> None:
    """At 0.4 m/s, where steps take longer than slow ones; in the middle of the left foot's third support."""
    options = Walk(duration=8.6, vx=0.4, plant=PlantOptions(mass_scale=1.2))
    place = meeting(dataclasses.replace(options, obstacle="moving", duration=20.0), load_robot("g1"))
    result = run(options)
    assert not result.summary["fell"]
    assert result.summary["qp_failures"] == 0
    assert result.summary["foot_slide_max_m"] < 0.005
    series = result.series
    left = (series["in_contact"] == [1.0, 0.0]).all(axis=1)
    ends = np.flatnonzero(np.diff(left.astype(int)))
    middle = (ends[4] + ends[5]) // 2
    assert series["time"][middle] == pytest.approx(place.time, abs=0.05)
    assert series["q"][middle, 0] - series["q"][0, 0] == pytest.approx(place.ahead, abs=0.03)


def walk_until(t: float) -> VelocityCommand:
    return VelocityCommand(vx=SPEED) if t >= 0.5 else VelocityCommand()


class WalkUntil(Pushed):
    """Walks from half a second on."""

    def setup(self, robot: RobotDescription) -> Setup:
        return walk_setup(robot, walk_until)


def test_a_push_to_the_side_moves_a_foothold_and_the_robot_walks_on() -> None:
    """0.15 N s per kg: the foot after the push comes down elsewhere, later ones are a width apart again."""
    robot = load_robot("g1")
    push = Push(1.5 * robot.total_mass, DIRECTIONS["left"], PUSHED_AT)
    result = run(WalkUntil(duration=4.2, pushes=(push,)))
    summary, series = result.summary, result.series
    assert not summary["fell"]
    assert summary["qp_failures"] == 0
    apart = series["soles"][:, 0, 1] - series["soles"][:, 1, 1]
    both, time = series["in_contact"].all(axis=1), series["time"]
    start, after, later = apart[0], both & (time > PUSHED_AT) & (time < PUSHED_AT + 1.2), both & (time > 3.85)
    assert np.abs(apart[after] - start).max() > 0.03
    assert np.abs(apart[later] - start).max() < 0.04
    # the push was what it says: momentum over mass
    velocity = np.gradient(series["com"][:, 1], time)
    gained = velocity[np.searchsorted(time, PUSHED_AT + 0.1)] - velocity[np.searchsorted(time, PUSHED_AT)]
    assert 0.02 < gained < 0.3
