"""Filter, parameters and gains changed while the robot moves: in force from the next tick on, and rows stay safe."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from controllers.agent import Agent
from controllers.balance.dcm_plan import DcmReference
from controllers.reference import WholeBodyReference, reference_here
from controllers.whole_body.config import FilterTuning, TaskTuning
from controllers.whole_body.controller import TickResult, WholeBodyController
from controllers.whole_body.robot_config import controller_config
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.loader import load_robot
from robots.messages import Array, RobotState
from robots.pinocchio_model import standing_configuration
from safety.barriers.rows import FAMILIES
from safety.filters.safety_filter import FilterStatus
from sims.plant import MujocoPlant
from wbc.dynwbc import DynWbcWeights
from wbc.tasks import CenterOfMassTask


class Course:
    """Hands sent into the torso, in simulation."""

    def __init__(self, **changes: Any) -> None:
        robot = load_robot("g1")
        self.plant = MujocoPlant(robot)
        self.plant.reset(standing_configuration(robot, "hands_front"))
        self.controller = WholeBodyController(robot, controller_config(robot, **changes), with_hands=True)
        self.controller.reset(self.plant.state())
        self.reference: WholeBodyReference = reference_here(self.controller.kin, with_hands=True)
        for point in self.reference.hands or ():
            point.position[:2] = 0.0
        self.lowest: list[float] = []

    def tick(self) -> TickResult:
        result = self.controller.tick(self.plant.state(), self.reference)
        rows = self.controller.barriers.slices["self_collision"]
        self.lowest.append(float(self.controller.barriers.evaluate(self.controller.kin).h[rows].min()))
        self.plant.send(result.command)
        self.plant.advance(self.controller.config.dt)
        return result

    def ticks(self, duration: float) -> list[TickResult]:
        return [self.tick() for _ in range(round(duration / self.controller.config.dt))]


def with_pairs(safety: FilterTuning, **changes: float) -> FilterTuning:
    return replace(safety, self_collision=replace(safety.self_collision, **changes))


def change_filter(course: Course, name: str) -> None:
    course.controller.set_filter(name, controller_config(course.controller.robot, filter=name).safety)
    assert course.controller.config.filter == name


def test_another_filter_takes_over_in_mid_run_and_the_rows_stay_safe() -> None:
    course, seen = Course(filter="issf"), []
    for name in ("pssa", "cbf", "ssa", "issf"):
        seen += course.ticks(0.4)
        change_filter(course, name)
    seen += course.ticks(0.4)
    assert min(course.lowest) > 0.0
    statuses = {result.safety.status for result in seen}
    assert FilterStatus.FILTERED in statuses and FilterStatus.FAILED not in statuses


def test_conditions_move_into_dynwbc_and_back_in_mid_run() -> None:
    """eCBF, which lets the hands 8 mm into the torso wherever it starts from; ISSf-CBF brings them out again."""
    course = Course(filter="issf")
    course.ticks(0.5)
    change_filter(course, "ecbf")
    within = course.ticks(0.5)
    assert course.controller.filter is None
    assert FilterStatus.FAILED not in {result.safety.status for result in within}
    assert {result.dynwbc.status for result in within} == {"optimal"}
    assert within[-1].safety.active > 0
    change_filter(course, "issf")
    course.ticks(0.5)
    assert min(course.lowest) > -0.01
    assert course.lowest[-1] > 0.01


def test_a_filter_from_the_next_tick_on_is_as_if_it_had_been_there(robot_name: str) -> None:
    """At rest, where no filter has anything to go on from: the same answer, bit for bit, prepared or not."""
    robot = load_robot(robot_name)
    q = standing_configuration(robot, "hands_front")
    state = RobotState(q, np.zeros(q.size - 1), np.zeros(q.size - 7), 0.0)

    def answer(first: str, then: str | None, prepared: bool = False) -> Array:
        controller = WholeBodyController(robot, controller_config(robot, filter=first), with_hands=True)
        controller.reset(state)
        reference = reference_here(controller.kin, with_hands=True)
        for point in reference.hands or ():
            point.position[:2] = 0.0
        if then is not None:
            if prepared:
                controller.prepare_filter(then)
            controller.set_filter(then, controller_config(robot, filter=then).safety)
        return controller.tick(state, reference).command.tau

    for first, then in (("issf", "cbf"), ("issf", "ecbf"), ("ecbf", "rssa")):
        np.testing.assert_array_equal(answer(first, then), answer(then, None))
        np.testing.assert_array_equal(answer(first, then, True), answer(then, None))


def test_a_filter_that_is_not_allowed_is_refused_and_the_old_one_goes_on() -> None:
    course = Course(filter="issf")
    course.tick()
    config, safety = course.controller.config, course.controller.filter
    for name, adaptive in (("magic", False), ("cbf", True)):
        with pytest.raises(ConfigError, match="filter"):
            course.controller.set_filter(name, adaptive=adaptive)
    assert course.controller.config is config
    assert course.controller.filter is safety
    hard = Course(filter="issf", drives="hardware").controller
    with pytest.raises(ConfigError, match="hardware"):
        hard.set_filter("none")


def test_other_parameters_show_where_the_robot_comes_to_rest_and_it_stays_safe() -> None:
    """ISSf at rest keeps |J|^2 / (alpha epsilon): with a fifth of it the hands come closer, and go back again."""
    course = Course(filter="issf")
    safety = with_pairs(course.controller.config.safety, alpha=8.0, epsilon=1.0)
    course.controller.set_safety(safety)
    course.ticks(2.0)
    wide = course.lowest[-1]
    course.controller.set_safety(with_pairs(safety, epsilon=5.0))
    course.ticks(1.5)
    narrow = course.lowest[-1]
    course.controller.set_safety(safety)
    course.ticks(2.0)
    assert 0.0 < narrow < 0.5 * wide
    # dry friction holds the joints a little before or behind where they were
    assert course.lowest[-1] > 0.8 * wide
    assert min(course.lowest) > 0.0


@pytest.mark.parametrize("filter_name", ["issf", "ecbf"])
def test_other_parameters_count_in_the_next_tick(filter_name: str) -> None:
    """As in a controller that has them from the start: same state, same command but for warm starts."""
    robot, safety = load_robot("g1"), FilterTuning(base_linear=0.05, hand_weight=3.0, velocity_scale=0.2)
    answers = []
    for given in (None, safety):
        course = Course(filter=filter_name, safety=given or FilterTuning())
        course.controller.set_safety(safety)
        answers.append(course.tick())
        assert course.controller.config.safety == safety
    np.testing.assert_allclose(answers[0].safety.v, answers[1].safety.v, rtol=0, atol=1e-7)
    assert (np.abs(answers[0].command.v) <= 0.2 * robot.joint_array("velocity") + 1e-9).all()


def test_epsilon_that_is_adapted_stays_below_its_new_upper_end() -> None:
    course = Course(filter="issf", adaptive=True)
    course.ticks(0.2)
    held = course.tick().safety.v
    course.controller.set_safety(
        replace(
            course.controller.config.safety,
            **{f: replace(getattr(course.controller.config.safety, f), epsilon=1e-3) for f in FAMILIES},
        )
    )
    # a thousand times as cautious: the hands are driven out at once
    assert np.linalg.norm(course.tick().safety.v - held) > 0.1


def test_other_gains_of_a_task_count_in_the_next_tick() -> None:
    """The hands' command is gain times error, and bounded by the new bound."""
    tasks = TaskTuning(hand=2.0, hand_acceleration=1e6)
    course = Course(filter="none", tasks=tasks)
    kin = course.controller.kin
    for point in course.reference.hands or ():
        point.position[:] = kin.frame_placement(kin.frame_id("left_palm"))[1]
    course.reference.hands[0].position[2] += 0.01
    hand = kin.frame_id(kin.robot.roles["left_hand"])

    def asked() -> Array:
        return kin.frame_jacobian(hand)[:3] @ course.controller.desired_velocity(course.reference)

    np.testing.assert_allclose(asked(), [0.0, 0.0, 0.02], rtol=0, atol=1e-6)
    course.controller.set_gains(replace(tasks, hand=9.0))
    np.testing.assert_allclose(asked(), [0.0, 0.0, 0.09], rtol=0, atol=1e-6)
    course.controller.set_gains(replace(tasks, hand=9.0, max_linear=0.03))
    np.testing.assert_allclose(asked(), [0.0, 0.0, 0.03], rtol=0, atol=1e-6)
    assert course.controller.config.tasks.hand == 9.0
    assert course.controller.tasks["left_hand"].gains.k == 9.0


@pytest.mark.parametrize(
    "changed",
    [{"tasks": TaskTuning(com=2.0, posture=1.0, singular="cut")}, {"dynwbc": DynWbcWeights(kp=100.0, kd=25.0)}],
)
def test_gains_set_later_are_those_of_a_controller_made_with_them(changed: dict[str, Any]) -> None:
    answers = []
    for given in ({}, changed):
        course = Course(filter="none", **given)
        course.controller.set_gains(**changed)
        answers.append(course.tick())
    np.testing.assert_allclose(answers[0].v_des, answers[1].v_des, rtol=0, atol=1e-12)
    np.testing.assert_allclose(answers[0].command.tau, answers[1].command.tau, rtol=0, atol=1e-6)


def test_the_motors_gains_and_the_feedback_of_the_dcm_change_between_ticks() -> None:
    course = Course(filter="none")
    controller, robot = course.controller, course.controller.robot
    before = course.tick().command
    controller.set_gains(dcm_gain=7.5, gain_scale=0.25)
    command = course.tick().command
    np.testing.assert_allclose(command.kp, 0.25 * robot.joint_array("kp"), rtol=1e-15)
    np.testing.assert_allclose(command.kd, 0.25 * robot.joint_array("kd"), rtol=1e-15)
    np.testing.assert_allclose(before.kp, robot.joint_array("kp"), rtol=1e-15)
    assert not command.kp.flags.writeable
    assert (controller.config.balance.dcm_gain, controller.config.gain_scale) == (7.5, 0.25)
    for bad, name in (({"dcm_gain": -1.0}, "dcm_gain"), ({"gain_scale": np.nan}, "gain_scale")):
        with pytest.raises(ConfigError, match=name):
            controller.set_gains(**bad)
    assert (controller.config.balance.dcm_gain, controller.config.gain_scale) == (7.5, 0.25)


def test_the_feedback_of_the_dcm_acts_by_the_gain_that_was_set() -> None:
    """The acceleration asked of the CoM is linear in the gain, for the same error of the DCM."""
    course = Course(filter="none")
    kin = course.controller.kin
    omega = float(np.sqrt(9.81 / kin.com[2]))
    here = kin.com[:2] + kin.com_velocity[:2] / omega
    course.reference.dcm = DcmReference(here + np.array([0.004, -0.002]), np.zeros(2), omega)

    def asked(gain: float) -> Array:
        course.controller.set_gains(dcm_gain=gain)
        course.controller.desired_velocity(course.reference)
        task = course.controller.tasks["com"]
        assert isinstance(task, CenterOfMassTask)
        return task.acceleration[:2].copy()

    low, middle, high = asked(2.0), asked(4.0), asked(8.0)
    np.testing.assert_allclose(high - middle, 2.0 * (middle - low), rtol=0, atol=1e-9)
    assert np.linalg.norm(high - middle) > 1e-4


def test_gains_change_in_mid_run_and_the_robot_stands_and_stays_safe() -> None:
    course = Course(filter="issf")
    course.ticks(0.5)
    course.controller.set_gains(TaskTuning(hand=4.0, com=5.0), DynWbcWeights(kp=200.0, kd=30.0))
    course.ticks(1.0)
    assert min(course.lowest) > 0.0
    assert np.linalg.norm(course.controller.kin.com[:2]) < 0.1
    assert course.controller.dynwbc.weights.kd == 30.0


@pytest.mark.parametrize("name", ["config", "filter", "tasks", "dynwbc", "kinwbc", "kin", "barriers"])
def test_nothing_can_be_set_past_the_checks(name: str) -> None:
    controller = Course(filter="issf").controller
    with pytest.raises(AttributeError):
        setattr(controller, name, None)
    for part in ("parameters", "weights", "settings", "v_max", "name", "alpha"):
        with pytest.raises(AttributeError):
            setattr(controller.filter, part, None)
    for part in ("gains", "compensate_bias", "name"):
        with pytest.raises(AttributeError):
            setattr(controller.tasks["left_hand"], part, None)


def test_another_filter_comes_with_what_the_description_has_for_it(robot: RobotDescription) -> None:
    """What is tuned for ISSf-CBF is too bold for a CBF; what somebody has set himself is kept."""
    agent = Agent(robot)
    agent.controller.set_filter("cbf")
    assert agent.controller.config.safety == controller_config(robot, filter="cbf").safety
    agent.controller.set_filter("issf")
    assert agent.controller.config.safety == controller_config(robot, filter="issf").safety
    safety = agent.controller.config.safety
    own = replace(safety, self_collision=replace(safety.self_collision, alpha=3.0))
    agent.controller.set_safety(own)
    agent.controller.set_filter("cbf")
    assert agent.controller.config.safety == own
