"""A task of one's own in the controller: its place, its target, its weight in the filter; without a patch."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from controllers.agent import Agent
from controllers.reference import WholeBodyReference, reference_here
from controllers.whole_body.controller import WholeBodyController
from controllers.whole_body.robot_config import controller_config
from controllers.whole_body.task_stack import PlacedTask, Priority, TaskStack
from robots.errors import ConfigError, TargetNotSetError, UnknownNameError
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array, RobotState
from robots.pinocchio_model import standing_configuration
from sims.plant import MujocoPlant
from wbc.tasks import CenterOfMassTask, FramePositionTask, PostureTask, TaskGains

PAGE = (Path(__file__).parents[2] / "docs" / "controller.md").read_text(encoding="utf-8")
GAINS = TaskGains(5.0, 0.5, 40.8)


@pytest.fixture(scope="module")
def pointing() -> Any:
    """The worked example of docs/controller.md."""
    scope: dict[str, Any] = {}
    code = next(b for b in re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL) if "class PointingTask" in b)
    exec(compile(code, "docs/controller.md", "exec"), scope)
    return scope["pointing"]


def elbow(kin: Kinematics) -> list[PlacedTask]:
    """The left elbow above the posture."""
    task = FramePositionTask(kin.frame_id("left_elbow_link"), GAINS, name="elbow")
    return [PlacedTask(task, "other", Priority.HANDS + 5)]


def ready(extra: Any, with_hands: bool = False, **changes: Any) -> tuple[WholeBodyController, WholeBodyReference]:
    robot = load_robot("g1")
    config = controller_config(robot, **({"filter": "none"} | changes))
    controller = WholeBodyController(robot, config, with_hands, extra_tasks=extra)
    kin = controller.kin
    kin.update(standing_configuration(robot, "hands_front"), np.zeros(kin.nv))
    return controller, reference_here(kin, with_hands)


def followed(controller: WholeBodyController, reference: WholeBodyReference, duration: float) -> None:
    """Go where KinWBC leads, exactly."""
    kin, dt = controller.kin, 0.01
    for _ in range(round(duration / dt)):
        q = kin.integrate(kin.q, controller.desired_velocity(reference), dt)
        kin.update(q, np.zeros(kin.nv))


def test_the_worked_example_points_where_it_is_told_while_the_robot_stands(pointing: Any) -> None:
    """In simulation, through supervisor, filter and torques; the feet stay and the robot is up."""
    robot = load_robot("g1")
    body = MujocoPlant(robot)
    body.reset(standing_configuration(robot, "standing"))
    agent = Agent(robot, controller_config(robot), extra_tasks=pointing)
    agent.reset(body.state())
    agent.warm_up()
    place = np.array([2.0, 0.8, 1.0])
    agent.reference.extra["pointing"] = (place,)
    kin = agent.controller.kin
    for _ in range(round(2.0 / agent.dt)):
        body.send(agent.tick(body.state()).command)
        body.advance(agent.dt)
    assert agent.stop_cause is None
    rotation, origin = kin.frame_placement(kin.frame_id("torso"))
    way = (place - origin) / np.linalg.norm(place - origin)
    assert np.degrees(np.arccos(rotation[:, 0] @ way)) < 2.0
    feet = [kin.frame_placement(kin.frame_id(robot.roles[f"{side}_sole"]))[1][2] for side in ("left", "right")]
    np.testing.assert_allclose(feet, 0.0, rtol=0, atol=2e-3)


def test_a_task_is_reached_by_its_target_and_the_tasks_above_are_not_disturbed() -> None:
    controller, reference = ready(elbow)
    kin = controller.kin
    start, com = kin.q.copy(), kin.com.copy()
    # where the shoulder can bring it
    raised = start.copy()
    raised[7 + kin.joint_names.index("left_shoulder_roll_joint")] += 0.3
    kin.update(raised, np.zeros(kin.nv))
    target = kin.frame_placement(kin.frame_id("left_elbow_link"))[1].copy()
    kin.update(start, np.zeros(kin.nv))
    controller.tasks["elbow"].set_target(target)
    reference.com.position[:] = com
    followed(controller, reference, 3.0)
    np.testing.assert_allclose(kin.frame_placement(kin.frame_id("left_elbow_link"))[1], target, rtol=0, atol=1e-3)
    np.testing.assert_allclose(kin.com, com, rtol=0, atol=1e-4)


def test_priorities_decide_between_tasks_that_contradict_each_other() -> None:
    """A second task on the left hand, 20 cm aside: the one of the lower number is met."""

    def second(priority: float) -> Any:
        def make(kin: Kinematics) -> list[PlacedTask]:
            task = FramePositionTask(kin.frame_id(kin.robot.roles["left_hand"]), GAINS, name="second")
            return [PlacedTask(task, "other", priority)]

        return make

    for priority, first in ((Priority.HANDS - 5, False), (Priority.HANDS + 5, True)):
        controller, reference = ready(second(priority), with_hands=True)
        kin, hands = controller.kin, reference.hands
        assert hands is not None
        aside = hands[0].position + np.array([0.0, 0.1, 0.1])
        controller.tasks["second"].set_target(aside)
        followed(controller, reference, 3.0)
        place = kin.frame_placement(kin.frame_id(kin.robot.roles["left_hand"]))[1]
        np.testing.assert_allclose(place, hands[0].position if first else aside, rtol=0, atol=2e-3)


@pytest.mark.parametrize("role", ["feet", "balance", "hands"])
def test_the_filter_leaves_a_task_alone_by_the_weight_of_its_role(role: str) -> None:
    """An elbow whose way is cut by the base's bounds: what weighs more keeps more of what it asked for."""
    kept = {}
    for chosen in ("other", role):
        controller, reference = ready(lambda kin, r=chosen: [replace(elbow(kin)[0], role=r)], filter="cbf")
        kin = controller.kin
        controller.set_safety(replace(controller.config.safety, velocity_scale=0.01))
        frame = kin.frame_id("left_elbow_link")
        controller.tasks["elbow"].set_target(kin.frame_placement(frame)[1] + [0.1, 0.1, 0.1])
        state = RobotState(kin.q.copy(), np.zeros(kin.nv), np.zeros(kin.nv - 6), 0.0)
        result = controller.tick(state, reference)
        assert np.abs(result.safety.v - result.v_des).max() > 0.1
        kept[chosen] = np.linalg.norm(kin.frame_jacobian(frame)[:3] @ (result.safety.v - result.v_des))
    assert kept[role] < 0.9 * kept["other"]


def test_a_task_that_was_never_told_where_to_go_is_named() -> None:
    controller, reference = ready(elbow)
    controller.warm_up()
    with pytest.raises(TargetNotSetError, match="'elbow'"):
        controller.desired_velocity(reference)
    state = RobotState(controller.kin.q.copy(), np.zeros(controller.kin.nv), np.zeros(controller.kin.nv - 6), 0.0)
    with pytest.raises(ValueError, match="target of task 'elbow'"):
        controller.tick(state, reference)
    controller.tasks["elbow"].set_target(np.ones(3))
    controller.tick(state, reference)


def test_targets_in_the_reference_are_checked() -> None:
    controller, reference = ready(elbow)
    reference.extra["knee"] = (np.zeros(3),)
    with pytest.raises(ValueError, match="'knee'"):
        controller.desired_velocity(reference)
    del reference.extra["knee"]
    reference.extra["elbow"] = (np.zeros(2),)
    with pytest.raises(ConfigError, match="position of task elbow"):
        controller.desired_velocity(reference)


def test_a_frozen_reference_is_at_rest_and_keeps_targets_of_its_own() -> None:
    _, reference = ready(elbow, with_hands=True)
    reference.extra["elbow"] = (np.ones(3),)
    reference.com.velocity, reference.hand_turns[0] = np.ones(3), 1.0
    frozen = reference.at_rest()
    reference.extra["elbow"][0][:] = 5.0
    np.testing.assert_array_equal(frozen.extra["elbow"][0], np.ones(3))
    assert not frozen.com.velocity.any() and not frozen.hand_turns.any()
    np.testing.assert_array_equal(frozen.com.position, reference.com.position)


# --- the stack


def stack_of(kin: Kinematics, *places: tuple[str, str, float]) -> TaskStack:
    frame = kin.frame_id(kin.robot.roles["left_hand"])
    placed = [PlacedTask(FramePositionTask(frame, GAINS, name=n), role, priority) for n, role, priority in places]
    return TaskStack(kin.nv, placed, 0.03, True)


def test_tasks_are_given_back_by_name_and_their_rows_by_role(robot_name: str) -> None:
    """Roles whose tasks do not follow each other, in the order in which they were given."""
    kin = Kinematics(load_robot(robot_name))
    kin.update(standing_configuration(kin.robot), np.zeros(kin.nv))
    names = ("left_sole", "right_sole", "left_hand", "right_hand")
    roles, priorities = ("feet", "hands", "feet", "hands"), (3.0, 1.0, 2.0, 2.0)
    tasks = [FramePositionTask(kin.frame_id(kin.robot.roles[n]), GAINS, name=n) for n in names]
    for task in tasks:
        task.set_target(np.zeros(3))
    placed = [PlacedTask(t, r, p) for t, r, p in zip(tasks, roles, priorities, strict=True)]
    stack = TaskStack(kin.nv, placed, 0.03, True)
    assert [[t.name for t in level] for level in stack.kinwbc.levels] == [
        ["right_sole"],
        ["left_hand", "right_hand"],
        ["left_sole"],
    ]
    stack.kinwbc.evaluate(kin)

    def expected(*chosen: str) -> Array:
        return np.concatenate([kin.frame_jacobian(kin.frame_id(kin.robot.roles[n]))[:3] for n in chosen])

    for role, chosen in (("feet", ("left_sole", "left_hand")), ("hands", ("right_sole", "right_hand"))):
        np.testing.assert_allclose(stack.rows(role), expected(*chosen), rtol=0, atol=1e-14)
    assert stack.rows("balance") is None
    assert stack["left_hand"] is tasks[2] and stack.names == names and "head" not in stack
    with pytest.raises(UnknownNameError, match="'head'"):
        stack["head"]


def test_what_cannot_be_a_place_is_refused() -> None:
    kin = Kinematics(load_robot("g1"))
    with pytest.raises(ConfigError, match="names of tasks"):
        stack_of(kin, ("hand", "hands", 1.0), ("hand", "other", 2.0))
    with pytest.raises(ConfigError, match="role of task hand"):
        stack_of(kin, ("hand", "head", 1.0))
    with pytest.raises(ConfigError, match="priority of task hand"):
        stack_of(kin, ("hand", "hands", float("nan")))
    with pytest.raises(ConfigError, match="damped_below"):
        PlacedTask(CenterOfMassTask(GAINS), "other", 1.0, 0.0)
    with pytest.raises(ConfigError, match="placed task"):
        PlacedTask("com", "other", 1.0)
    with pytest.raises(ConfigError, match="names of tasks"):
        ready(lambda kin: [PlacedTask(PostureTask(29, GAINS, name="posture"), "other", 70)])
