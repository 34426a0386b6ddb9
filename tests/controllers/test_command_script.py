"""Scripts of velocity commands, and hands that are carried along."""

import dataclasses
import math
import re
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import experiments
from controllers.gaits.commands import CommandScript, VelocityCommand, between, read_script
from controllers.gaits.footholds import LEFT, RIGHT, Foothold
from controllers.gaits.walking import (
    CommandedWalk,
    VelocityFootsteps,
    Walking,
    WalkTuning,
    walk_tuning,
    walking_changes,
)
from controllers.motions.hands import CarriedHands
from controllers.reference import PointReference, WholeBodyReference, reference_here
from controllers.whole_body.robot_config import controller_config
from robots.description import RobotDescription
from robots.errors import ConfigError, DescriptionError
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array, RobotState
from robots.pinocchio_model import standing_configuration

MIXED = Path(experiments.__file__).parent / "data" / "mixed.txt"
REACH = WalkTuning(forward=0.32, turn=0.4, widest=4 / 3, swing_acceleration=1e3)
"""Steps of 0.8 s at any speed: up to 0.4 m/s forward, and with feet 0.24 m apart 0.1 m/s sideways; 0.5 rad/s."""


def script_file(folder: Path, text: str) -> Path:
    path = folder / "walk.txt"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_command_holds_from_its_time_until_the_next(tmp_path: Path) -> None:
    script = read_script(script_file(tmp_path, "# a walk\n\n1 0.2 0 -0.1  # forward\n3.5, 0, 0.1, 0\n5 step\n6 stop\n"))
    assert script(0.999) == VelocityCommand()
    assert script(1.0) == script(3.499) == VelocityCommand(0.2, 0.0, -0.1)
    assert script(3.5) == VelocityCommand(0.0, 0.1, 0.0)
    assert script(5.0) == VelocityCommand(stepping=True)
    assert script(6.0) == script(1e6) == VelocityCommand()
    assert not script(6.0).walks and script(5.0).walks


def test_a_time_that_rounding_made_a_little_early_counts() -> None:
    forward = VelocityCommand(0.1)
    before = math.nextafter(5.0, 0.0)
    assert CommandScript([5.0], [forward])(before).walks
    assert between(lambda t: forward, 5.0, 6.0)(before).walks
    assert not between(lambda t: forward, 1.0, 5.0)(before).walks


def test_no_velocity_at_all_is_stepping_on_the_spot(tmp_path: Path) -> None:
    assert read_script(script_file(tmp_path, "0 0 0 0"))(0.0) == VelocityCommand(stepping=True)


@pytest.mark.parametrize(
    ("text", "line", "allowed"),
    [
        ("1 0.2 0 0\n2 0.2 0", 2, "time and stop"),
        ("1 walk", 1, "time and step"),
        ("# first\n1 0.2 zero 0", 2, "vx [m/s]"),
        ("2 stop\n2 step", 2, "after that of the command before it, 2 s"),
        ("2 stop\n1 step", 2, "after that of the command before it, 2 s"),
        ("-1 stop", 1, "0 or above"),
        ("nan stop", 1, "0 or above"),
        ("1 inf 0 0", 1, "finite"),
        ("1 0.2 0 0\n\n3 0.5 0 0", 3, "from -0.4 to 0.4"),
        ("1 0 -0.11 0", 1, "from -0.1 to 0.1"),
        ("1 0 0 0.6", 1, "from -0.5 to 0.5"),
    ],
)
def test_a_wrong_line_is_named_with_its_file_and_what_is_allowed(
    tmp_path: Path, text: str, line: int, allowed: str
) -> None:
    path = script_file(tmp_path, text)
    with pytest.raises(ConfigError) as caught:
        read_script(path, partial(REACH.require_reachable, width=0.24))
    message = str(caught.value)
    assert str(path) in message
    assert f"line {line}" in message
    assert text.splitlines()[line - 1] in message
    assert allowed in message


@pytest.mark.parametrize("text", ["", "# nothing\n\n"])
def test_a_script_without_commands_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(ConfigError, match="no commands"):
        read_script(script_file(tmp_path, text))


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    binary = tmp_path / "picture.png"
    binary.write_bytes(b"\x89PNG\xff\xfe")
    for path in (tmp_path / "absent.txt", tmp_path, binary):
        with pytest.raises(ConfigError) as caught:
            read_script(path)
        assert str(path) in str(caught.value)


def test_times_and_commands_belong_together() -> None:
    for times in ([], [1.0, 2.0]):
        with pytest.raises(ConfigError, match="at least one"):
            CommandScript(times, [VelocityCommand()])


@pytest.mark.parametrize("name", ["g1", "tocabi"])
def test_the_script_that_comes_along_is_within_reach_of_the_robots(name: str) -> None:
    robot = load_robot(name)
    kin = Kinematics(robot)
    kin.update_geometry(standing_configuration(robot))
    left, right = (kin.frame_placement(kin.frame_id(robot.roles[r]))[1] for r in ("left_sole", "right_sole"))
    script = read_script(MIXED, partial(walk_tuning(robot).require_reachable, width=abs(left[1] - right[1])))
    commands = script.commands
    assert any(c.vx > 0 for c in commands) and any(c.vx < 0 for c in commands)
    assert any(c.vy > 0 for c in commands) and any(c.vy < 0 for c in commands)
    assert any(c.wz > 0 for c in commands) and any(c.wz < 0 for c in commands)
    assert any(c == VelocityCommand(stepping=True) for c in commands)
    assert not script(0.0).walks and not commands[-1].walks and script.times[-1] <= 57.0


def test_the_robot_stands_before_and_after() -> None:
    forward = VelocityCommand(0.2)
    command = between(lambda t: forward, 1.0, 5.0)
    assert [command(t).walks for t in (0.0, 0.998, 1.0, 4.998, 5.0, 9.0)] == [False, False, True, True, False, False]


@pytest.mark.parametrize(
    "tuning",
    [
        WalkTuning(),
        WalkTuning(narrowest=0.9),
        WalkTuning(widest=1.1),
        WalkTuning(swing_acceleration=2.5),
        WalkTuning(swing_acceleration=1.0),
    ],
)
def test_the_fastest_command_is_the_last_that_the_footholds_follow(tuning: WalkTuning) -> None:
    width = 0.24
    fastest, limits = tuning.fastest(width), tuning.limits(width)
    planner = VelocityFootsteps(limits, tuning.timing)

    def two_steps(vy: float) -> float:
        start = Foothold(0.0, 0.0, 0.0)
        other = planner.next_foothold(start, LEFT, VelocityCommand(vy=vy))
        return planner.next_foothold(other, RIGHT, VelocityCommand(vy=vy)).y

    def way(speed: float) -> float:
        return speed * tuning.timing.period(speed)

    assert two_steps(fastest.vy) == pytest.approx(2 * way(fastest.vy), abs=1e-12)
    assert two_steps(1.05 * fastest.vy) < 1.999 * way(1.05 * fastest.vy)
    assert way(fastest.vx) == pytest.approx(limits.forward)
    assert fastest.wz * tuning.timing.period(0.5 * width * fastest.wz) == pytest.approx(limits.turn)
    for name in ("vx", "vy", "wz"):
        with pytest.raises(ConfigError, match=name):
            tuning.require_reachable(VelocityCommand(**{name: -1.01 * getattr(fastest, name)}), width)
        tuning.require_reachable(VelocityCommand(**{name: -getattr(fastest, name)}), width)


def test_velocities_that_together_ask_for_longer_steps_than_there_are_are_refused() -> None:
    """Each is allowed alone; what is allowed beside the others, the planner follows."""
    tuning, width = WalkTuning(single_support=0.45, double_support=0.15), 0.24
    fastest, limits = tuning.fastest(width), tuning.limits(width)
    command = VelocityCommand(0.95 * fastest.vx, 0.0, fastest.wz)
    with pytest.raises(ConfigError, match="beside the other") as caught:
        tuning.require_reachable(command, width)
    assert caught.value.name in ("vx", "wz")
    # what it says is within reach is, and no more
    fraction = int(re.findall(r"(\d+) %", str(caught.value))[0])
    tuning.require_reachable(command.scaled(0.01 * fraction), width)
    with pytest.raises(ConfigError):
        tuning.require_reachable(command.scaled(0.01 * (fraction + 1)), width)
    planner, kept = VelocityFootsteps(limits, tuning.timing), 0
    for vx, vy, wz in np.random.default_rng(0).uniform(-1.0, 1.0, (200, 3)):
        command = VelocityCommand(vx * fastest.vx, 0.5 * vy * fastest.vy, wz * fastest.wz)
        try:
            tuning.require_reachable(command, width)
        except ConfigError:
            continue
        kept += 1
        stance = Foothold(0.3, -0.2, 0.5)
        *_, turn = stance.relative(planner.next_foothold(stance, LEFT, command))
        assert turn == pytest.approx(command.wz * tuning.timing.period(command.foot_speed(width)), abs=1e-12)
    assert 50 < kept < 190


def standing(name: str = "g1") -> tuple[Walking, WholeBodyReference, RobotState, Kinematics]:
    robot = load_robot(name)
    kin = Kinematics(robot)
    q = standing_configuration(robot, "hands_front")
    kin.update(q, np.zeros(kin.nv))
    state = RobotState(q, np.zeros(kin.nv), np.zeros(kin.nv - 6), 0.0)
    return Walking(kin, walk_tuning(robot)), reference_here(kin, with_hands=True), state, kin


def test_a_commanded_walk_follows_its_commands_until_it_is_stopped() -> None:
    walking, reference, state, kin = standing()
    gait = CommandedWalk(walking, lambda t: VelocityCommand(0.1 * t))
    gait.apply(reference, 2.0, state, kin)
    assert walking.command == VelocityCommand(0.2)
    gait.stop()
    gait.apply(reference, 3.0, state, kin)
    assert walking.command == VelocityCommand()


def circling(reference: WholeBodyReference, start: Array, t: float) -> None:
    """CoM on an arc with a heading that turns at 0.7 rad/s, both with exact rates."""
    rate, angle = 0.7, 0.4 + 0.7 * t
    c, s = math.cos(angle), math.sin(angle)
    reference.com = PointReference(
        np.array([s, 1 - c, 0.9]), rate * np.array([c, s, 0.0]), rate**2 * np.array([-s, c, 0.0])
    )
    reference.base_rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ start
    reference.turn_rate = rate


def test_carried_hands_keep_their_places_and_move_as_their_rates_say() -> None:
    _, reference, *_ = standing()
    upright, h = reference.base_rotation.copy(), 1e-4
    circling(reference, upright, 0.0)
    hands = CarriedHands(reference)

    def at(t: float) -> tuple[PointReference, PointReference]:
        circling(reference, upright, t)
        hands.apply(reference, t)
        assert reference.hands is not None
        return reference.hands

    first, com = at(0.0), reference.com.position
    arms = [hand.position - com for hand in first]
    for t in (0.3, 2.0, 7.0):
        for k, (now, before, after) in enumerate(zip(at(t), at(t - h), at(t + h), strict=True)):
            np.testing.assert_allclose((after.position - before.position) / (2 * h), now.velocity, atol=1e-7)
            np.testing.assert_allclose((after.velocity - before.velocity) / (2 * h), now.acceleration, atol=1e-7)
            c, s = math.cos(0.7 * t), math.sin(0.7 * t)
            turned = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ arms[k]
            circling(reference, upright, t)
            np.testing.assert_allclose(now.position - reference.com.position, turned, atol=1e-12)


def test_carried_hands_begin_where_the_hands_are() -> None:
    _, reference, *_ = standing("tocabi")
    assert reference.hands is not None
    before = [hand.position.copy() for hand in reference.hands]
    CarriedHands(reference).apply(reference, 0.0)
    np.testing.assert_allclose([hand.position for hand in reference.hands], before, atol=1e-12)


def test_hands_that_are_no_task_cannot_be_carried() -> None:
    _, reference, *_ = standing()
    reference.hands = None
    with pytest.raises(ConfigError, match="hands"):
        CarriedHands(reference)


def test_the_description_tunes_how_a_robot_walks() -> None:
    robot = load_robot("g1")
    own = dict(robot.tuning) | {"walking": {"step_height": 0.08, "gain_scale": 0.75}}
    tuned = walk_tuning(_with_tuning(robot, own))
    assert (tuned.step_height, tuned.gain_scale) == (0.08, 0.75)
    with pytest.raises(DescriptionError, match="step_heigth"):
        walk_tuning(_with_tuning(robot, dict(robot.tuning) | {"walking": {"step_heigth": 0.08}}))
    with pytest.raises(ConfigError, match="gain_scale"):
        walk_tuning(_with_tuning(robot, dict(robot.tuning) | {"walking": {"gain_scale": -0.1}}))


def test_walking_changes_what_its_table_says_and_leaves_the_other_weights() -> None:
    robot = load_robot("g1")
    own = {"force_weight": 3e-4, "moment_weight": 2e-3, "load_estimate_time": 0.7, "gain_scale": 0.75}
    robot = _with_tuning(robot, dict(robot.tuning) | {"walking": own})
    base, config = controller_config(robot), controller_config(robot, **walking_changes(robot))
    assert config.dynwbc == dataclasses.replace(base.dynwbc, force=3e-4, moment=2e-3)
    assert config.balance == dataclasses.replace(base.balance, mass_time_constant=0.7)
    assert (config.gain_scale, config.compensate_bias) == (0.75, True)
    assert walking_changes(robot, load_estimate=False)["balance"].mass_time_constant == 0.0


def _with_tuning(robot: RobotDescription, tuning: dict[str, Any]) -> RobotDescription:
    return dataclasses.replace(robot, tuning=tuning)
