"""Every setting and every reference reaches the part of the controller that it is for, and nothing else."""

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from controllers.reference import PointReference, reference_here
from controllers.supervisor import Supervisor
from controllers.whole_body.config import BalanceTuning, ContactTuning, FilterTuning, TaskTuning
from controllers.whole_body.controller import TickResult, WholeBodyController
from controllers.whole_body.robot_config import controller_config
from robots.description import RobotDescription
from robots.kinematics import Kinematics
from robots.messages import Array, RobotState
from robots.pinocchio_model import standing_configuration
from safety.barriers.rows import FAMILIES
from safety.filters.conditions import FamilyParameters
from safety.filters.safety_filter import MetricWeights, SafetyFilter
from tests.support.velocities import frame_velocity
from wbc.dynwbc import DynWbcWeights
from wbc.qp import ProxqpSolver

TASKS = TaskTuning(
    foot=3.0,
    com=4.0,
    base=5.0,
    torso=6.0,
    hand=7.0,
    posture=8.0,
    max_linear=0.11,
    max_angular=0.23,
    hand_acceleration=1e3,
    sigma_min=1e-6,
)
ROWS = {
    "left_sole": slice(0, 6),
    "right_sole": slice(6, 12),
    "com": slice(12, 15),
    "base": slice(15, 18),
    "torso": slice(18, 21),
    "left_hand": slice(21, 24),
    "right_hand": slice(24, 27),
}
POINTS = ("left_sole", "right_sole", "com", "left_hand", "right_hand")
GAINS = {"left_sole": "foot", "right_sole": "foot", "left_hand": "hand", "right_hand": "hand"}
DIRECTION = np.array([2.0, -1.0, 2.0]) / 3.0


def state_of(robot: RobotDescription, speed: float = 0.0) -> RobotState:
    """Near the posture with the hands in front, nothing symmetric, moving at up to ``speed`` [m/s, rad/s]."""
    rng = np.random.default_rng(0)
    nj = len(robot.joints)
    q = standing_configuration(robot, "hands_front")
    turn = np.append(rng.uniform(-0.03, 0.03, 3), 1.0)
    q[3:7] = turn / np.linalg.norm(turn)
    lower, upper = robot.position_limits
    q[7:] = np.clip(q[7:] + rng.uniform(-0.05, 0.05, nj), lower, upper)
    return RobotState(q, speed * rng.uniform(-1.0, 1.0, 6 + nj), np.zeros(nj), 0.0)


class Case:
    """A controller at a state, and the reference that asks for no motion at all there."""

    def __init__(self, robot: RobotDescription, speed: float = 0.0, with_hands: bool = True, **changes: Any) -> None:
        self.robot = robot
        self.config = controller_config(robot, **changes)
        self.controller = WholeBodyController(robot, self.config, with_hands)
        self.state = state_of(robot, speed)
        self.controller.reset(self.state)
        # kinematics of the test's own
        self.kin = Kinematics(robot)
        self.kin.update(self.state.q, self.state.v)
        self.reference = reference_here(self.kin, with_hands)
        self.reference.com = PointReference(self.kin.com.copy())

    def frame(self, role: str) -> int:
        return self.kin.frame_id(self.robot.roles[role])

    def point(self, name: str) -> PointReference:
        r = self.reference
        hands = r.hands or ()
        return dict(zip(POINTS, (*r.soles, r.com, *hands), strict=False))[name]

    def task_jacobian(self) -> Array:
        """All tasks above the posture (27, nv), in the order of ``ROWS``."""
        kin = self.kin
        parts = [kin.frame_jacobian(self.frame(r)) for r in ("left_sole", "right_sole")]
        parts.append(kin.com_jacobian)
        parts += [kin.frame_jacobian(self.frame(r))[3:] for r in ("base", "torso")]
        parts += [kin.frame_jacobian(self.frame(r))[:3] for r in ("left_hand", "right_hand")]
        return np.concatenate(parts)

    def desired(self) -> Array:
        return self.controller.desired_velocity(self.reference)

    def tick(self) -> TickResult:
        return self.controller.tick(self.state, self.reference)

    def assert_tasks_move(self, **expected: Array) -> None:
        """The desired velocity moves the named tasks at these velocities, and the other ones not at all."""
        velocity = np.zeros(27)
        for name, value in expected.items():
            velocity[ROWS[name]][: value.size] = value
        np.testing.assert_allclose(self.task_jacobian() @ self.desired(), velocity, rtol=0, atol=1e-9)


class Spy:
    """Stands in for a method: keeps its arguments by name, and calls it."""

    def __init__(self, names: tuple[str, ...], method: Callable[..., Any]) -> None:
        self._names = names
        self._method = method
        self.seen: dict[str, Any] = {}

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        given = dict(zip(self._names, args, strict=False)) | kwargs
        self.seen = {k: np.array(v) if isinstance(v, np.ndarray) else v for k, v in given.items()}
        return self._method(*args, **kwargs)


def spy_on_filter(case: Case, monkeypatch: pytest.MonkeyPatch) -> Spy:
    safety_filter = filter_of(case)
    spy = Spy(("rows", "v_des", "feet", "balance"), safety_filter.apply)
    monkeypatch.setattr(SafetyFilter, "apply", lambda self, *args, **kwargs: spy(*args, **kwargs))
    return spy


def filter_of(case: Case) -> SafetyFilter:
    """The filter of velocities that is at work."""
    assert case.controller.filter is not None
    return case.controller.filter


def spy_on_dynwbc(case: Case, monkeypatch: pytest.MonkeyPatch) -> Spy:
    names = ("kin", "acceleration", "wrench", "in_contact", "contact_bias", "conditions", "joint_bounds", "load_scale")
    spy = Spy((*names, "load_limits"), case.controller.dynwbc.build)
    monkeypatch.setattr(case.controller.dynwbc, "build", spy)
    return spy


# --- KinWBC: gains, bounds, feed-forward


def test_nothing_moves_where_nothing_is_asked(robot: RobotDescription) -> None:
    case = Case(robot, tasks=TASKS)
    np.testing.assert_allclose(case.desired(), 0, atol=1e-12)


@pytest.mark.parametrize("name", POINTS)
def test_a_point_moves_at_its_own_gain_and_within_the_linear_bound(robot: RobotDescription, name: str) -> None:
    case = Case(robot, tasks=TASKS)
    start = case.point(name).position.copy()
    case.point(name).position = start + 1e-3 * DIRECTION
    case.assert_tasks_move(**{name: 1e-3 * getattr(TASKS, GAINS.get(name, name)) * DIRECTION})
    case.point(name).position = start + DIRECTION
    case.assert_tasks_move(**{name: TASKS.max_linear * DIRECTION})


@pytest.mark.parametrize("name", ["base", "torso"])
def test_an_axis_turns_at_its_own_gain_and_within_the_angular_bound(robot: RobotDescription, name: str) -> None:
    case = Case(robot, tasks=TASKS)
    start = getattr(case.reference, f"{name}_rotation")
    for angle, speed in ((1e-3, 1e-3 * getattr(TASKS, name)), (1.0, TASKS.max_angular)):
        setattr(case.reference, f"{name}_rotation", pin.exp3(angle * DIRECTION) @ start)
        case.assert_tasks_move(**{name: speed * DIRECTION})


@pytest.mark.parametrize("side", [0, 1])
def test_a_sole_turns_at_the_gain_of_the_feet_and_within_the_angular_bound(robot: RobotDescription, side: int) -> None:
    case = Case(robot, tasks=TASKS)
    start = case.reference.sole_rotations
    for angle, speed in ((1e-3, 1e-3 * TASKS.foot), (1.0, TASKS.max_angular)):
        rotations = list(start)
        rotations[side] = pin.exp3(angle * DIRECTION) @ start[side]
        case.reference.sole_rotations = (rotations[0], rotations[1])
        case.assert_tasks_move(**{POINTS[side]: np.concatenate([np.zeros(3), speed * DIRECTION])})


def test_the_posture_has_its_own_gain_and_the_angular_bound(robot: RobotDescription) -> None:
    """An error along a motion that disturbs no other task is corrected as if there were none."""
    case = Case(robot, tasks=TASKS)
    jacobian = case.task_jacobian()
    motion = np.random.default_rng(1).standard_normal(case.kin.nv)
    motion -= np.linalg.pinv(jacobian) @ (jacobian @ motion)
    motion /= np.linalg.norm(motion[6:])
    for size, speed in ((1e-3, 1e-3 * TASKS.posture), (1.0, TASKS.max_angular)):
        case.reference.joints = case.state.q[7:] + size * motion[6:]
        np.testing.assert_allclose(case.desired(), speed * motion, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", POINTS)
def test_velocity_and_acceleration_are_fed_forward(robot: RobotDescription, name: str) -> None:
    """An acceleration is divided by what eq. (15) of Lee et al. multiplies a velocity command with: kd + kp dt."""
    case = Case(robot, tasks=TASKS, dt=0.004, dynwbc=DynWbcWeights(kp=300.0, kd=25.0))
    velocity, acceleration = np.array([0.3, -0.2, 0.1]), np.array([-1.0, 2.0, 1.5])
    case.point(name).velocity = velocity
    case.assert_tasks_move(**{name: velocity})
    case.point(name).acceleration = acceleration
    case.assert_tasks_move(**{name: velocity + acceleration / (25.0 + 300.0 * 0.004)})


def test_every_task_has_the_acceleration_gain_of_the_dynamic_level(robot: RobotDescription) -> None:
    case = Case(robot, dt=0.004, dynwbc=DynWbcWeights(kp=300.0, kd=25.0))
    gains = [task.gains.acceleration_gain for level in case.controller.kinwbc.levels for task in level]
    assert len(gains) == 8
    np.testing.assert_allclose(gains, 26.2, rtol=1e-12)


@pytest.mark.parametrize("name", ["com", "left_hand"])
def test_acceleration_asked_for_is_acceleration_commanded(
    robot: RobotDescription, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From rest, what a point is asked to accelerate at is what DynWBC is told, through both levels."""
    case = Case(robot, filter="none", tasks=TASKS, dt=0.004, dynwbc=DynWbcWeights(kp=300.0, kd=25.0))
    case.point(name).acceleration = np.array([0.5, -0.4, 0.3])
    spy = spy_on_dynwbc(case, monkeypatch)
    case.tick()
    expected = np.zeros(27)
    expected[ROWS[name]] = [0.5, -0.4, 0.3]
    np.testing.assert_allclose(case.task_jacobian() @ spy.seen["acceleration"], expected, rtol=0, atol=1e-9)


def test_the_cut_off_of_singular_values_is_the_configured_one(robot: RobotDescription) -> None:
    """Far above every singular value, no task is followed."""
    cut = replace(TASKS, singular="cut")
    case = Case(robot, tasks=replace(cut, sigma_min=1e3))
    case.point("com").position += 0.1 * DIRECTION
    case.reference.joints = case.reference.joints + 0.1
    np.testing.assert_array_equal(case.desired(), 0)
    case = Case(robot, tasks=cut)
    case.point("com").position += 0.1 * DIRECTION
    assert np.linalg.norm(case.desired()) > 0.1


@pytest.mark.parametrize(
    ("name", "setting"),
    [("left_sole", "damped_foot"), ("com", "damped_com"), ("torso", "damped_turn"), ("left_hand", "damped_hand")],
)
def test_singular_values_of_each_level_are_damped_below_its_own_threshold(
    robot: RobotDescription, name: str, setting: str
) -> None:
    """Far above every singular value, what the level asks for makes no difference; with another's threshold it does."""
    steps = []
    for changed in (setting, "damped_com" if setting == "damped_hand" else "damped_hand"):
        case = Case(robot, tasks=replace(TASKS, **{changed: 1e3}))
        before = case.desired()
        if name == "torso":
            case.reference.torso_rotation = pin.exp3(0.1 * DIRECTION) @ case.reference.torso_rotation
        else:
            case.point(name).position += 0.1 * DIRECTION
        steps.append(np.linalg.norm(case.desired() - before))
    assert steps[0] < 1e-4
    assert steps[1] > 1e-2


def test_a_hand_whose_target_jumps_speeds_up_at_the_configured_rate(robot: RobotDescription) -> None:
    """The correction, not the feed-forward velocity: 2 m/s^2 for 4 ms ticks, up to the linear bound."""
    case = Case(robot, tasks=replace(TASKS, hand_acceleration=2.0), dt=0.004)
    case.point("left_hand").position += 5.0 * DIRECTION
    for speed in (0.008, 0.016, 0.024):
        case.assert_tasks_move(left_hand=speed * DIRECTION)
    case.controller.reset(case.state)
    case.assert_tasks_move(left_hand=0.008 * DIRECTION)
    case.point("left_hand").position[:] = np.nan
    assert np.isnan(case.desired()).any()
    case.reference.hands = reference_here(case.kin, True).hands
    case.assert_tasks_move(left_hand=np.zeros(3))


# --- safety filter: rows, weights, parameters, bounds


@pytest.mark.parametrize("in_contact", [(True, True), (True, False), (False, True)])
@pytest.mark.parametrize("swing_weight", [0.0, 250.0])
def test_the_filter_is_told_of_feet_on_the_ground_and_how_one_in_the_air_is_turned(
    robot: RobotDescription, in_contact: tuple[bool, bool], swing_weight: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its position counts by the fraction that ``swing_weight`` is of ``foot_weight``."""
    case = Case(robot, safety=FilterTuning(foot_weight=1000.0, swing_weight=swing_weight))
    case.reference.in_contact = np.array(in_contact)
    spy = spy_on_filter(case, monkeypatch)
    case.tick()
    metric = np.zeros((case.kin.nv, case.kin.nv))
    for role, touching in zip(("left_sole", "right_sole"), in_contact, strict=True):
        linear, angular = np.split(case.kin.frame_jacobian(case.frame(role)), 2)
        metric += angular.T @ angular + (1.0 if touching else swing_weight / 1000.0) * linear.T @ linear
    # whatever the axes and the order of the rows
    np.testing.assert_allclose(spy.seen["feet"].T @ spy.seen["feet"], metric, rtol=0, atol=1e-12)


@pytest.mark.parametrize("with_hands", [True, False])
def test_balance_is_the_com_and_the_orientation_of_base_and_torso(
    robot: RobotDescription, with_hands: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = Case(robot, with_hands=with_hands)
    spy = spy_on_filter(case, monkeypatch)
    case.tick()
    balance = case.task_jacobian()[12:21]
    assert spy.seen["balance"].shape == balance.shape == (9, case.kin.nv)
    np.testing.assert_allclose(spy.seen["balance"].T @ spy.seen["balance"], balance.T @ balance, rtol=0, atol=1e-12)


def test_the_weights_reach_the_filter(robot: RobotDescription) -> None:
    case = Case(robot, safety=FilterTuning(foot_weight=12.0, balance_weight=34.0, hand_weight=56.0))
    assert filter_of(case).weights == MetricWeights(12.0, 34.0, 56.0)


@pytest.mark.parametrize("weight", ["foot_weight", "balance_weight", "hand_weight"])
def test_a_heavier_weight_keeps_its_own_tasks_as_desired(robot: RobotDescription, weight: str) -> None:
    """All tasks are to move, the base may not: something has to give way, but not what weighs 1e6."""
    changed = {}
    for value in (0.0, 1e6):
        weights = {"foot_weight": 0.0, "balance_weight": 0.0, "hand_weight": 0.0} | {weight: value}
        case = Case(robot, tasks=TASKS, safety=FilterTuning(base_linear=0.03, **weights))
        for name in POINTS:
            case.point(name).position = case.point(name).position + DIRECTION
        result = case.tick()
        rows = {"foot_weight": slice(0, 12), "balance_weight": slice(12, 21), "hand_weight": slice(21, 27)}[weight]
        changed[value] = np.linalg.norm((case.task_jacobian() @ (result.safety.v - result.v_des))[rows])
    assert changed[0.0] > 0.01
    assert changed[1e6] < 1e-2 * changed[0.0]


@pytest.mark.parametrize("family", FAMILIES)
def test_the_parameters_of_every_family_reach_the_conditions(robot: RobotDescription, family: str) -> None:
    values = {f: FamilyParameters(alpha=1.0 + 2 * i, epsilon=2.0 + 2 * i) for i, f in enumerate(FAMILIES)}
    case = Case(robot, safety=FilterTuning(**values))
    parameters, i = filter_of(case).parameters, FAMILIES.index(family)
    assert getattr(parameters, family).alpha == parameters.values("alpha")[i] == 1.0 + 2 * i
    assert getattr(parameters, family).epsilon == parameters.values("epsilon")[i] == 2.0 + 2 * i


def assert_bound_is_reached(values: Array, bounds: Array | float) -> None:
    assert float(np.abs(values / bounds).max()) == pytest.approx(1.0, abs=1e-9)


def test_the_base_keeps_to_its_linear_bound(robot: RobotDescription) -> None:
    case = Case(robot, safety=FilterTuning(base_linear=0.03))
    for name in POINTS:
        case.point(name).position = case.point(name).position + DIRECTION
    result = case.tick()
    assert np.abs(result.v_des[:3]).max() > 0.1
    assert_bound_is_reached(result.safety.v[:3], 0.03)


def test_the_base_keeps_to_its_angular_bound(robot: RobotDescription) -> None:
    case = Case(robot, safety=FilterTuning(base_angular=0.07))
    case.reference.base_rotation = pin.exp3(DIRECTION) @ case.reference.base_rotation
    result = case.tick()
    assert np.abs(result.v_des[3:6]).max() > 0.5
    assert_bound_is_reached(result.safety.v[3:6], 0.07)


@pytest.mark.parametrize("scale", [0.01, 0.03])
def test_the_joints_keep_to_their_share_of_the_velocity_limits(robot: RobotDescription, scale: float) -> None:
    tasks = TaskTuning(posture=10.0, max_angular=20.0)
    case = Case(robot, with_hands=False, tasks=tasks, safety=FilterTuning(velocity_scale=scale))
    case.reference.joints = case.reference.joints + 1.0
    limits = robot.joint_array("velocity")
    result = case.tick()
    assert (np.abs(result.v_des[6:]) > scale * limits).any()
    assert_bound_is_reached(result.safety.v[6:], scale * limits)


# --- contact wrenches


def pushed(robot: RobotDescription, contact: ContactTuning, weights: DynWbcWeights, acceleration: Array) -> Case:
    """On the left foot alone, nothing in the way of a CoM acceleration that no sole can give."""
    case = Case(robot, filter="none", contact=contact, tasks=TASKS, dynwbc=weights)
    case.reference.in_contact = np.array([True, False])
    case.point("com").acceleration = acceleration
    return case


@pytest.mark.parametrize("friction", [0.25, 0.5])
@pytest.mark.parametrize("axis", [0, 1])
def test_friction_bounds_the_ground_force(robot: RobotDescription, friction: float, axis: int) -> None:
    """Where the wrench reference is all that counts, and it is far outside the cone."""
    weights = DynWbcWeights(force=1e3, moment=1e3)
    case = pushed(robot, ContactTuning(friction=friction), weights, 15.0 * np.eye(3)[axis])
    force = case.tick().dynwbc.wrench[:3]
    assert abs(force[axis]) == pytest.approx(friction * force[2], rel=1e-6)


@pytest.mark.parametrize("fraction", [0.3, 0.7])
@pytest.mark.parametrize(
    ("name", "row", "push"), [("length_fraction", 4, [-4.0, -4.0, 0.0]), ("width_fraction", 3, [0.0, -3.0, 0.0])]
)
def test_the_centre_of_pressure_keeps_to_its_share_of_the_sole(
    robot: RobotDescription, name: str, row: int, push: list[float], fraction: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both in the wrench that DynWBC is given and in the one that it finds where acceleration is all that counts."""
    weights = DynWbcWeights(acceleration=10.0, force=1e-6, moment=1e-6, torque_rate=0.0, energy=0.0)
    contact = replace(ContactTuning(friction=2.0), **{name: fraction})
    case = pushed(robot, contact, weights, np.array(push))
    spy = spy_on_dynwbc(case, monkeypatch)
    result = case.tick()
    sole = robot.soles[0]
    bound = fraction * (sole.half_length if name == "length_fraction" else sole.half_width)
    for wrench in (spy.seen["wrench"], result.dynwbc.wrench):
        assert wrench[2] > 1.0
        assert abs(wrench[row]) / wrench[2] == pytest.approx(bound, rel=1e-6)


def force_of(case: Case, wrench: Array) -> Array:
    """Net force (3,), world axes, of wrenches (12,) in sole axes."""
    rotations = [case.kin.frame_placement(case.frame(r))[0] for r in ("left_sole", "right_sole")]
    return rotations[0] @ wrench[:3] + rotations[1] @ wrench[6:9]


def test_the_wrench_is_for_what_the_filter_lets_through(
    robot: RobotDescription, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Net force m (c_dd + g), with the CoM acceleration of the filtered velocity, not of the desired one."""
    case = Case(robot, speed=0.01, safety=FilterTuning(base_linear=0.01))
    case.point("com").position = case.point("com").position + 0.01 * DIRECTION
    spy = spy_on_dynwbc(case, monkeypatch)
    result = case.tick()
    weights, jacobian = case.config.dynwbc, case.kin.com_jacobian
    assert np.linalg.norm(jacobian @ (result.safety.v - result.v_des)) > 0.01
    command = weights.kp * case.config.dt * result.safety.v + weights.kd * (result.safety.v - case.state.v)
    np.testing.assert_allclose(spy.seen["acceleration"], command, rtol=0, atol=1e-9)
    expected = robot.total_mass * (jacobian @ command + [0.0, 0.0, 9.81])
    np.testing.assert_allclose(force_of(case, spy.seen["wrench"]), expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize("sideways", [-0.4, 0.0, 0.4])
def test_the_feet_are_loaded_by_the_lever_of_the_zmp(
    robot: RobotDescription, sideways: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A force through the CoM meets the ground at the ZMP; its distances from the soles decide their fractions."""
    case = Case(robot, filter="none", tasks=TASKS)
    case.point("com").acceleration = np.array([0.0, sideways, 0.0])
    spy = spy_on_dynwbc(case, monkeypatch)
    case.tick()
    wrench = spy.seen["wrench"]
    (left_rotation, left), (right_rotation, right) = (
        case.kin.frame_placement(case.frame(r)) for r in ("left_sole", "right_sole")
    )
    zmp = case.kin.com - np.array([0.0, sideways, 9.81]) / 9.81 * (case.kin.com[2] - 0.5 * (left[2] + right[2]))
    line = (left - right)[:2]
    fraction = (zmp - right)[:2] @ line / (line @ line)
    assert 0.0 < fraction < 1.0
    loads = [(left_rotation @ wrench[:3])[2], (right_rotation @ wrench[6:9])[2]]
    np.testing.assert_allclose(loads, robot.total_mass * 9.81 * np.array([fraction, 1 - fraction]), rtol=1e-9)
    if sideways:
        # the force leans towards where the CoM is to go, so the other foot carries more than without
        resting = (case.kin.com - right)[:2] @ line / (line @ line)
        assert (fraction - resting) * sideways < -0.01 * abs(sideways)


# --- DynWBC and the motors


def test_the_soft_contact_term_stops_the_soles(robot: RobotDescription) -> None:
    """With a large weight no sole in contact accelerates, velocities and all: J q_dd + J_dot v = 0."""
    case = Case(robot, speed=0.3, dynwbc=DynWbcWeights(contact=1e7), contact=ContactTuning(friction=3.0))
    q, v, a = case.state.q, case.state.v, case.tick().dynwbc.acceleration
    step, kin = 1e-5, Kinematics(robot)

    def sole_velocities(t: float, acceleration: Array) -> Array:
        kin.update(kin.integrate(q, v + 0.5 * t * acceleration, t), v + t * acceleration)
        return np.concatenate([frame_velocity(kin, case.frame(r)) for r in ("left_sole", "right_sole")])

    def sole_accelerations(acceleration: Array) -> Array:
        return (sole_velocities(step, acceleration) - sole_velocities(-step, acceleration)) / (2 * step)

    bias = sole_accelerations(np.zeros_like(a))
    assert np.linalg.norm(bias) > 0.05
    assert np.linalg.norm(sole_accelerations(a)) < 1e-3 * np.linalg.norm(bias)


def test_the_first_torques_start_from_the_measured_ones(robot: RobotDescription) -> None:
    """With an overwhelming weight on their change, torques stay what they were measured to be at the reset."""
    case = Case(robot, dynwbc=DynWbcWeights(torque_rate=1e8))
    rng = np.random.default_rng(2)
    state = replace(case.state, tau=0.3 * robot.joint_array("effort") * rng.uniform(-1.0, 1.0, len(robot.joints)))
    case.controller.reset(state)
    np.testing.assert_allclose(case.tick().command.tau, state.tau, rtol=0, atol=0.01)


def test_the_load_follows_the_forces_under_the_feet_and_stays_where_they_are_not_measured(
    robot: RobotDescription, monkeypatch: pytest.MonkeyPatch
) -> None:
    """1.2 times the weight, then no measurement: model and wrench reference are scaled by what was found last."""
    weight = robot.total_mass * 9.81
    case = Case(robot, filter="none", balance=BalanceTuning(mass_time_constant=0.5))
    spy = spy_on_dynwbc(case, monkeypatch)
    case.tick()
    light = force_of(case, spy.seen["wrench"])
    assert spy.seen["load_scale"] == 1.0
    measured = replace(case.state, foot_forces=np.array([0.5, 0.7]) * weight)
    ticks = round(0.5 / case.config.dt)
    for _ in range(ticks):
        case.controller.tick(measured, case.reference)
    expected = 1.0 + 0.2 * (1.0 - (1.0 - case.config.dt / 0.5) ** ticks)
    case.tick()
    assert spy.seen["load_scale"] == pytest.approx(expected, rel=1e-12)
    np.testing.assert_allclose(force_of(case, spy.seen["wrench"]), expected * light, rtol=1e-9, atol=1e-9 * weight)


CHANGED = DynWbcWeights(
    acceleration=2.0, force=0.05, moment=3.0, torque_rate=0.02, energy=0.01, contact=1.0, kp=200.0, kd=30.0
)


@pytest.mark.parametrize("name", [f.name for f in fields(DynWbcWeights)])
def test_every_weight_reaches_the_torques(robot: RobotDescription, name: str) -> None:
    torques = []
    for weights in (DynWbcWeights(), replace(DynWbcWeights(), **{name: getattr(CHANGED, name)})):
        case = Case(robot, speed=0.1, dynwbc=weights)
        case.point("com").position = case.point("com").position + 0.01 * DIRECTION
        assert case.controller.dynwbc.weights == weights
        torques.append(case.tick().command.tau)
    assert np.abs(torques[1] - torques[0]).max() > 1e-4


def test_either_solver_gives_the_same_torques(robot: RobotDescription, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []
    solve = ProxqpSolver.solve

    def counted(self: ProxqpSolver, *args: Any) -> Any:
        calls.append(self)
        return solve(self, *args)

    monkeypatch.setattr(ProxqpSolver, "solve", counted)
    torques, used = {}, {}
    for name in ("daqp", "proxqp"):
        calls.clear()
        result = Case(robot, speed=0.1, dynwbc_solver=name).tick()
        assert result.dynwbc.status == "optimal"
        torques[name], used[name] = result.command.tau, len(calls)
    assert used == {"daqp": 0, "proxqp": 1}
    np.testing.assert_allclose(torques["proxqp"], torques["daqp"], rtol=0, atol=1e-5)


def test_the_scale_of_the_gains_reaches_motors_and_brake(robot: RobotDescription) -> None:
    kp, kd = robot.joint_array("kp"), robot.joint_array("kd")
    for scale in (0.5, 1.5):
        case = Case(robot, gain_scale=scale)
        command = case.tick().command
        np.testing.assert_allclose(command.kp, scale * kp, rtol=1e-12)
        np.testing.assert_allclose(command.kd, scale * kd, rtol=1e-12)
        case.state.q[7] = np.nan
        brake, _ = Supervisor(case.controller).tick(case.state, case.reference)
        np.testing.assert_allclose(brake.kd, scale * kd, rtol=1e-12)
