"""Hands as pose tasks: a commanded orientation is reached while the robot stands."""

import numpy as np
import pinocchio as pin
import pytest

from controllers.reference import WholeBodyReference, reference_here
from controllers.whole_body.controller import WholeBodyController
from controllers.whole_body.robot_config import controller_config
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array, RobotState
from robots.pinocchio_model import standing_configuration
from sims.plant import MujocoPlant


def ready(name: str, hand_task: str = "pose") -> tuple[WholeBodyController, WholeBodyReference, MujocoPlant]:
    robot = load_robot(name)
    plant = MujocoPlant(robot)
    plant.reset(standing_configuration(robot, "hands_front"))
    controller = WholeBodyController(robot, controller_config(robot, hand_task=hand_task), with_hands=True)
    controller.reset(plant.state())
    return controller, reference_here(controller.kin, with_hands=True), plant


def hand_of(kin: Kinematics, side: str) -> tuple[Array, Array]:
    return kin.frame_placement(kin.frame_id(kin.robot.roles[f"{side}_hand"]))


def test_a_hand_reaches_a_commanded_orientation_while_standing(robot_name: str) -> None:
    """Turned by 25 degrees about an axis that is none of its own, held where it is; the other hand stays."""
    controller, reference, plant = ready(robot_name)
    kin, turn = controller.kin, pin.exp3(np.radians(25.0) * np.array([0.6, 0.0, 0.8]))
    rotations, hands = reference.hand_rotations, reference.hands
    assert rotations is not None and hands is not None
    other, dt = rotations[1].copy(), controller.config.dt
    reference.hand_rotations = (turn @ rotations[0], rotations[1])
    for _ in range(round(2.5 / dt)):
        plant.send(controller.tick(plant.state(), reference).command)
        plant.advance(dt)
    rotation, position = hand_of(kin, "left")
    assert np.degrees(np.linalg.norm(pin.log3(reference.hand_rotations[0] @ rotation.T))) < 3.0
    assert np.linalg.norm(position - hands[0].position) < 0.02
    assert np.degrees(np.linalg.norm(pin.log3(other @ hand_of(kin, "right")[0].T))) < 3.0
    feet = [kin.frame_placement(kin.frame_id(kin.robot.roles[f"{s}_sole"]))[1][2] for s in ("left", "right")]
    np.testing.assert_allclose(feet, 0.0, rtol=0, atol=3e-3)


def test_angular_velocity_is_fed_forward_beside_the_correction(robot_name: str) -> None:
    controller, reference, _ = ready(robot_name)
    kin = controller.kin
    reference.com.position[:] = kin.com
    frame = kin.frame_id(kin.robot.roles["left_hand"])
    reference.hand_turns[0] = [0.0, 0.05, 0.1]
    v = controller.desired_velocity(reference)
    asked = kin.frame_jacobian(frame) @ v
    np.testing.assert_allclose(asked, [0.0, 0.0, 0.0, 0.0, 0.05, 0.1], rtol=0, atol=2e-2)


def test_position_tasks_do_not_heed_rotations(robot_name: str) -> None:
    answers = []
    for rotation in (np.eye(3), pin.exp3(np.array([0.3, 0.2, 0.1]))):
        controller, reference, _ = ready(robot_name, "position")
        reference.hand_rotations = (rotation, rotation)
        answers.append(controller.desired_velocity(reference))
    np.testing.assert_array_equal(*answers)


def test_what_is_missing_is_said() -> None:
    controller, reference, plant = ready("g1")
    reference.hand_rotations = None
    with pytest.raises(ValueError, match="rotations"):
        controller.tick(plant.state(), reference)
    with pytest.raises(ConfigError, match="hand_task"):
        controller_config(load_robot("g1"), hand_task="fist")
    q = standing_configuration(load_robot("g1"))
    state = RobotState(q, np.zeros(q.size - 1), np.zeros(q.size - 7), 0.0)
    reference.hands = None
    with pytest.raises(ValueError, match="hands"):
        controller.tick(state, reference)
