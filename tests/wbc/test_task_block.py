"""Tasks in one block of rows: the same as each task alone, wherever its references are kept."""

import math

import numpy as np
import pinocchio as pin
import pytest

from robots.description import RobotDescription
from robots.errors import ConfigError, TargetNotSetError
from robots.kinematics import Kinematics
from robots.messages import Array
from robots.pinocchio_model import standing_configuration
from wbc.task_block import TaskBlock
from wbc.tasks import (
    CenterOfMassTask,
    FrameOrientationTask,
    FramePoseTask,
    FramePositionTask,
    PostureTask,
    Task,
    TaskGains,
)

GAINS = TaskGains(8.0, 0.7, 33.0)


def moving(robot: RobotDescription) -> Kinematics:
    kin, rng = Kinematics(robot), np.random.default_rng(0)
    q = standing_configuration(robot)
    q[7:] = rng.uniform(*robot.position_limits)
    kin.update(q, rng.normal(size=kin.nv))
    kin.update_bias_acceleration()
    return kin


def all_kinds(kin: Kinematics, rng: np.random.Generator) -> list[list[Task]]:
    """Levels with every kind of task, their references drawn."""
    frame = {role: kin.frame_id(name) for role, name in kin.robot.roles.items()}
    pose = FramePoseTask(frame["left_sole"], GAINS, TaskGains(4.0, 0.3, 33.0), compensate_bias=True)
    com = CenterOfMassTask(GAINS, compensate_bias=True)
    turn, point = FrameOrientationTask(frame["torso"], GAINS), FramePositionTask(frame["right_hand"], GAINS)
    posture = PostureTask(kin.nv - 6, GAINS)
    pose.position, pose.rotation = rng.normal(size=3), pin.rpy.rpyToMatrix(rng.normal(size=3))
    pose.velocity, pose.acceleration = rng.normal(size=6), rng.normal(size=6)
    com.position, com.velocity, com.acceleration = rng.normal(size=(3, 3))
    turn.rotation, turn.angular_velocity = pin.rpy.rpyToMatrix(rng.normal(size=3)), rng.normal(size=3)
    point.position, point.velocity, point.acceleration = rng.normal(size=(3, 3))
    posture.joints = rng.normal(size=kin.nv - 6)
    return [[pose, com], [turn], [point], [posture]]


def plain_rows(kin: Kinematics, task: Task) -> tuple[Array, Array]:
    """Jacobian from pinocchio, command from the formula of :class:`wbc.tasks.TaskGains`."""
    assert isinstance(task, FramePoseTask)
    rotation, position = kin.frame_placement(task.frame_id)
    turn = task.rotation @ rotation.T
    angle = math.acos(np.clip(0.5 * (np.trace(turn) - 1.0), -1.0, 1.0))
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / (2 * math.sin(angle))
    command = (
        task.velocity + (task.acceleration - kin.frame_bias_acceleration(task.frame_id)) / task.gains.acceleration_gain
    )
    command[:3] += task.gains.correction(task.position - position)
    command[3:] += task.angular_gains.correction(angle * axis)
    return kin.frame_jacobian(task.frame_id), command


def test_a_block_has_the_rows_of_each_task_in_order(robot: RobotDescription) -> None:
    kin, rng = moving(robot), np.random.default_rng(1)
    levels = all_kinds(kin, rng)
    alone = [[task.evaluate(kin) for task in level] for level in levels]
    block = TaskBlock(kin.nv, levels)
    for _ in range(2):
        for (jacobian, command), parts in zip(block.evaluate(kin), alone, strict=True):
            np.testing.assert_array_equal(jacobian, np.concatenate([j for j, _ in parts]))
            np.testing.assert_array_equal(command, np.concatenate([c for _, c in parts]))
    np.testing.assert_array_equal(block.jacobian, np.concatenate([j for j, _ in block.levels]))
    assert block.sizes.tolist() == [9, 3, 3, kin.nv - 6]


def test_rows_of_a_pose_are_those_of_the_plain_formulas(robot: RobotDescription) -> None:
    kin = moving(robot)
    pose = all_kinds(kin, np.random.default_rng(2))[0][0]
    for result, expected in zip(pose.evaluate(kin), plain_rows(kin, pose), strict=True):
        np.testing.assert_allclose(result, expected, rtol=0, atol=1e-12)


def test_references_set_after_the_layout_count(robot: RobotDescription) -> None:
    """By assignment and in place; what was assigned is copied."""
    kin = moving(robot)
    hand = FramePositionTask(kin.frame_id(robot.roles["left_hand"]), GAINS)
    block = TaskBlock(kin.nv, [[hand]])
    target = kin.frame_placement(hand.frame_id)[1] + np.array([0.01, 0.0, 0.0])
    hand.position = target
    target[:] = np.nan
    np.testing.assert_allclose(block.evaluate(kin)[0][1], [0.08, 0.0, 0.0], rtol=0, atol=1e-12)
    hand.position[1] += 0.02
    np.testing.assert_allclose(block.evaluate(kin)[0][1], [0.08, 0.16, 0.0], rtol=0, atol=1e-12)


def test_a_correction_changes_by_no_more_than_it_may(robot: RobotDescription) -> None:
    """On the straight way to the new one, and at its own bound from there on; after a reset from zero again."""
    kin = moving(robot)
    hand = FramePositionTask(kin.frame_id(robot.roles["left_hand"]), TaskGains(8.0, 0.5, max_change=0.2))
    block = TaskBlock(kin.nv, [[hand]])
    hand.velocity = np.array([0.0, 0.0, 3.0])
    for way in (np.array([0.6, -0.8, 0.0]), np.array([-0.6, 0.8, 0.0])):
        hand.position = kin.frame_placement(hand.frame_id)[1] + 5.0 * way
        commands = [block.evaluate(kin)[0][1] - hand.velocity for _ in range(7)]
        steps = np.linalg.norm(np.diff([c.copy() for c in commands], axis=0), axis=1)
        assert (steps <= 0.2 + 1e-12).all()
        np.testing.assert_allclose(commands[-1], 0.5 * way, rtol=0, atol=1e-12)
    block.reset()
    np.testing.assert_allclose(block.evaluate(kin)[0][1] - hand.velocity, 0.2 * way, rtol=0, atol=1e-12)


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan")])
def test_a_bad_bound_of_the_change_is_refused(value: float) -> None:
    with pytest.raises(ConfigError, match="max_change"):
        TaskGains(8.0, max_change=value)


def test_a_task_of_another_stack_is_refused(robot: RobotDescription) -> None:
    """It would follow references that nobody sets any more."""
    kin = moving(robot)
    hand = FramePositionTask(kin.frame_id(robot.roles["left_hand"]), GAINS)
    TaskBlock(kin.nv, [[hand]])
    with pytest.raises(ConfigError, match="FramePositionTask"):
        TaskBlock(kin.nv, [[hand]])


def unset_tasks(kin: Kinematics) -> list[Task]:
    frame = kin.frame_id(kin.robot.roles["left_hand"])
    kinds = FramePositionTask, FrameOrientationTask, FramePoseTask
    framed = [kind(frame, GAINS, name=f"hand {i}") for i, kind in enumerate(kinds)]
    return [CenterOfMassTask(GAINS, name="the CoM"), *framed, PostureTask(kin.nv - 6, GAINS, name="rest")]


def aim(task: Task) -> None:
    place, turn = np.array([0.1, 0.2, 0.3]), np.eye(3)
    if isinstance(task, FramePoseTask):
        task.set_target(place, turn)
    elif isinstance(task, FrameOrientationTask):
        task.set_target(turn)
    else:
        task.set_target(place if task.rows == 3 else np.zeros(task.rows))


@pytest.mark.parametrize("k", range(5))
def test_a_target_that_was_never_set_is_an_error_that_names_the_task(robot: RobotDescription, k: int) -> None:
    """Alone and in a stack, where its references are kept by the block; once it is set, nothing is in the way."""
    kin = moving(robot)
    alone, tasks = unset_tasks(kin)[k], unset_tasks(kin)
    block = TaskBlock(kin.nv, [tasks])
    for task in tasks:
        if task is not tasks[k]:
            aim(task)
    assert not alone.is_set
    for evaluate in (lambda: alone.evaluate(kin), lambda: block.evaluate(kin)):
        with pytest.raises(TargetNotSetError, match=f"'{alone.name}'"):
            evaluate()
    aim(tasks[k])
    aim(alone)
    assert tasks[k].is_set and np.isfinite(block.evaluate(kin)[0][1]).all()
    np.testing.assert_array_equal(alone.evaluate(kin)[1], tasks[k].evaluate(kin)[1])


def test_half_a_target_of_a_pose_is_none(robot: RobotDescription) -> None:
    kin = moving(robot)
    pose = FramePoseTask(kin.frame_id(robot.roles["left_hand"]), GAINS)
    pose.position = np.zeros(3)
    with pytest.raises(TargetNotSetError, match="FramePoseTask"):
        pose.evaluate(kin)


def test_targets_of_another_shape_are_refused_by_name(robot: RobotDescription) -> None:
    """Numpy would stretch one number over all of them."""
    kin = moving(robot)
    com, point, turn, pose, rest = unset_tasks(kin)
    for task, target, part in (
        (com, (1.0,), "position of task the CoM"),
        (com, (np.zeros(3), np.zeros(2)), "velocity of task the CoM"),
        (point, (np.zeros(6),), "position of task hand 0"),
        (turn, (np.zeros(3),), "rotation of task hand 1"),
        (pose, (np.zeros(3), np.eye(3), np.zeros(3)), "velocity of task hand 2"),
        (rest, (np.zeros(3),), "joints of task rest"),
    ):
        with pytest.raises(ConfigError, match=part):
            task.set_target(*target)


def test_a_list_is_a_target_and_feed_forward_that_is_left_out_is_zero(robot: RobotDescription) -> None:
    kin = moving(robot)
    for task in unset_tasks(kin)[:2]:
        assert isinstance(task, CenterOfMassTask | FramePositionTask)
        task.set_target([1, 2, 3], np.ones(3), np.ones(3))
        np.testing.assert_array_equal(task.velocity, np.ones(3))
        task.set_target(np.ones(3))
        np.testing.assert_array_equal(task.velocity, np.zeros(3))
        np.testing.assert_array_equal(task.acceleration, np.zeros(3))


def test_gains_set_after_the_layout_count(robot: RobotDescription) -> None:
    kin = moving(robot)
    tasks = unset_tasks(kin)
    block = TaskBlock(kin.nv, [tasks])
    for task in tasks:
        aim(task)
    before, other = block.evaluate(kin)[0][1].copy(), TaskGains(2.0, 1e6, 33.0)
    for task in tasks:
        task.set_gains(other)
    after = block.evaluate(kin)[0][1]
    alone = np.concatenate([task.evaluate(kin)[1] for task in tasks])
    np.testing.assert_array_equal(after, alone)
    assert (np.abs(after - before)[:12] > 1e-6).all()
    np.testing.assert_allclose(after[:3], 2.0 * (np.array([0.1, 0.2, 0.3]) - kin.com), rtol=0, atol=1e-12)
