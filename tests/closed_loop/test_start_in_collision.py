"""A start with the arms deep inside the torso: left at a bounded speed and acceleration, in a stated time."""

from functools import cache

import numpy as np
import pytest

from controllers.whole_body.robot_config import controller_config
from experiments.benchmarks.recovery import STARTS, leave_collision, recovery_figures
from robots.loader import load_robot
from robots.messages import Array

LATE = {"g1": 1.0, "tocabi": 2.0}
"""How many times the guaranteed time the way out may take: TOCABI's dry friction eats half of the speed."""

CASES = [(robot, name) for robot in STARTS for name in ("cbf", "issf", "ssa", "rssa")]


@cache
def course(robot_name: str, name: str) -> dict[str, Array]:
    robot = load_robot(robot_name)
    return leave_collision(robot, controller_config(robot, filter=name))


@pytest.mark.parametrize(("robot_name", "name"), CASES)
def test_it_is_left_gently(robot_name: str, name: str) -> None:
    series = course(robot_name, name)
    assert series["h"][0] < -0.1
    assert not series["failed"].any()
    assert np.abs(np.diff(series["v"], axis=0)).max() <= 0.3
    assert np.abs(np.diff(series["torque"], axis=0)).max() <= 0.2
    assert np.abs(series["torque"]).max() < 0.7


@pytest.mark.parametrize(("robot_name", "name"), CASES)
def test_it_is_left_in_the_time_that_is_guaranteed(robot_name: str, name: str) -> None:
    series, config = course(robot_name, name), controller_config(load_robot(robot_name), filter=name)
    family = config.safety.self_collision
    guaranteed = -series["h"][0] / family.recovery_speed + family.recovery_speed / family.recovery_acceleration
    late = round(LATE[robot_name] * guaranteed / config.dt)
    assert series["h"][late:].min() >= -family.recovery_depth
    assert recovery_figures(series, config)["out_s"] <= late * config.dt
    if name != "cbf":
        # a CBF comes to the boundary itself only in the limit
        assert series["h"][-100:].min() > 0
