"""Limits of tilt, height and rate: passed twice in a row, the motors brake and nothing else."""

from dataclasses import replace

import numpy as np
import pytest

from controllers.agent import Agent
from controllers.motion_limits import IN_A_ROW, MotionLimits, MotionWatch
from controllers.supervisor import Supervisor
from controllers.whole_body.config import ControllerConfig
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import RobotState
from robots.pinocchio_model import standing_configuration

G1 = load_robot("g1")


def standing(robot: RobotDescription = G1) -> RobotState:
    nj = len(robot.joints)
    return RobotState(standing_configuration(robot), np.zeros(6 + nj), np.zeros(nj), 0.0)


def tilted(state: RobotState, angle: float, axis: int = 0) -> RobotState:
    q = state.q.copy()
    q[3:7] = 0.0
    q[3 + axis], q[6] = np.sin(0.5 * angle), np.cos(0.5 * angle)
    return replace(state, q=q)


def with_rate(state: RobotState, place: int, rate: float) -> RobotState:
    v = state.v.copy()
    v[place] = rate
    return replace(state, v=v)


def bent(robot: RobotDescription, deep: float) -> RobotState:
    """On both soles, with bent knees."""
    state, kin = standing(robot), Kinematics(robot)
    q = state.q.copy()
    for i, name in enumerate(robot.joint_names):
        share = {"hip_pitch": -0.5, "knee": 1.0, "ankle_pitch": -0.5}
        for part, factor in share.items():
            if part in name.lower() or part.replace("_pitch", "p") in name.lower():
                q[7 + i] = factor * deep
    kin.update_geometry(q)
    q[2] -= min(kin.frame_placement(kin.frame_id(sole.frame))[1][2] for sole in robot.soles)
    return replace(state, q=q)


def watch() -> MotionWatch:
    return MotionWatch(MotionLimits(), G1.posture("standing").base_height)


BEYOND = {
    "tilted": tilted(standing(), 1.05),
    "tilted by": tilted(standing(), -2.5, axis=1),
    "turns at": with_rate(standing(), 4, -6.1),
    "over the soles": bent(G1, 2.5),
}
WITHIN = {
    "tilt": tilted(standing(), 0.95),
    "yaw": tilted(standing(), 3.0, axis=2),
    "rate": with_rate(standing(), 4, 5.9),
    "height": bent(G1, 1.6),
    "a joint": with_rate(standing(), 6 + G1.joint_names.index("left_knee_joint"), 29.0),
}


@pytest.mark.parametrize("words", BEYOND)
def test_beyond_a_limit_is_named_the_second_time(words: str) -> None:
    seen, state = watch(), BEYOND[words]
    found = [seen.inspect(state, float(state.q[2])) for _ in range(IN_A_ROW)]
    assert found[:-1] == [None] * (IN_A_ROW - 1)
    assert found[-1] is not None and words in found[-1]


@pytest.mark.parametrize("name", WITHIN)
def test_within_the_limits_nothing_is_said(name: str) -> None:
    seen, state = watch(), WITHIN[name]
    assert [seen.inspect(state, float(state.q[2])) for _ in range(5)] == [None] * 5


def test_one_broken_measurement_is_none() -> None:
    seen = watch()
    for _ in range(5):
        assert seen.inspect(BEYOND["tilted"], 0.7) is None
        assert seen.inspect(standing(), 0.7) is None


def test_an_unknown_height_is_not_low() -> None:
    seen = watch()
    assert [seen.inspect(standing(), float("nan")) for _ in range(3)] == [None] * 3


@pytest.mark.parametrize("words", BEYOND)
@pytest.mark.parametrize("name", ["g1", "tocabi"])
def test_a_robot_that_falls_is_braked_at_once_and_for_good(name: str, words: str) -> None:
    robot = load_robot(name)
    agent, state = Agent(robot), standing(robot)
    agent.reset(state)
    bad = BEYOND[words]
    if name == "tocabi":
        bad = {
            "tilted": tilted(state, 1.05),
            "tilted by": tilted(state, -2.5, axis=1),
            "turns at": with_rate(state, 4, -6.1),
            "over the soles": bent(robot, 2.5),
        }[words]
    agent.tick(state)
    for i in range(1, IN_A_ROW + 1):
        output = agent.tick(replace(bad, stamp=0.002 * i))
    for i in range(5):
        command = output.command
        assert not command.kp.any() and not command.tau.any() and not command.v.any()
        np.testing.assert_array_equal(command.kd, robot.joint_array("kd"))
        output = agent.tick(replace(state, stamp=0.1 + 0.002 * i))
    assert agent.supervisor.damping and agent.stop_cause is not None


def test_a_robot_that_falls_while_its_motors_fade_out_is_braked_at_once() -> None:
    agent, state = Agent(G1), standing()
    agent.reset(state)
    agent.tick(state)
    agent.supervisor.fade("the controller is late", 0.002)
    fallen = BEYOND["tilted"]
    for i in range(1, IN_A_ROW + 1):
        assert agent.tick(replace(state, stamp=0.002 * i)).command.kp.any()
    for i in range(IN_A_ROW):
        command = agent.tick(replace(fallen, stamp=0.1 + 0.002 * i)).command
    assert not command.kp.any() and agent.stop_cause == "the controller is late"
    assert "tilted" in str(agent.supervisor.last_cause)


def test_the_same_fallen_state_twice_is_one_measurement() -> None:
    agent, state = Agent(G1), standing()
    agent.reset(state)
    agent.tick(state)
    fallen = replace(BEYOND["tilted"], stamp=0.002)
    assert agent.tick(fallen).command.kp.any() and agent.tick(fallen).command.kp.any()


def test_whoever_asks_for_damping_gets_it_with_the_first_cause() -> None:
    agent, state = Agent(G1), standing()
    agent.reset(state)
    agent.tick(state)
    agent.hold("first")
    agent.supervisor.damp("second", 0.002)
    command = agent.tick(replace(state, stamp=0.002)).command
    assert not command.kp.any() and agent.stop_cause == "first"


def test_a_joint_that_is_lost_is_only_braked_while_the_others_hold() -> None:
    agent, state = Agent(G1), standing()
    agent.reset(state)
    agent.tick(state)
    lost = np.zeros(29, dtype=bool)
    lost[3] = True
    agent.supervisor.fade("encoder", 0.002, lost)
    command = agent.tick(replace(state, stamp=0.002)).command
    assert command.kp[3] == 0.0 and command.tau[3] == 0.0 and command.kd[3] > 0.0
    assert (command.kp[~lost] > 0.0).all()


@pytest.mark.parametrize(("field", "value"), [("tilt", 0.0), ("tilt", 4.0), ("rate", -1.0), ("height", 1.5)])
def test_limits_that_are_none_are_refused(field: str, value: float) -> None:
    with pytest.raises(ConfigError, match=field):
        MotionLimits(**{field: value})


def test_limits_are_the_configurations() -> None:
    config = ControllerConfig(limits=MotionLimits(tilt=0.3))
    supervisor = Supervisor(Agent(G1, config).controller)
    states = [replace(tilted(standing(), 0.35), stamp=0.002 * i) for i in range(3)]
    assert [supervisor.inspect(state) for state in states] == [True, False, False]
    assert "0.35 rad, over 0.3" in str(supervisor.cause)
