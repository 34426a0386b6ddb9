"""One tick of the stack: finite, bounded, determined by its input, in balance at rest, the same on either side."""

from dataclasses import replace

import numpy as np
import pytest

from controllers.reference import PointReference, WholeBodyReference, reference_here
from controllers.whole_body.config import ControllerConfig
from controllers.whole_body.controller import STAGES, WholeBodyController
from controllers.whole_body.robot_config import controller_config
from robots.description import Body, RobotDescription
from robots.errors import ConfigError
from robots.loader import load_robot
from robots.messages import Array, RobotState
from safety.filters.safety_filter import FILTERS, FilterStatus
from tests.support.states import at_rest

MIRROR = np.diag([1.0, -1.0, 1.0])
POSTURES = ("standing", "hands_front")


def random_state(robot: RobotDescription, rng: np.random.Generator) -> RobotState:
    """Somewhere near the posture with the hands in front, moving."""
    state = at_rest(robot, "hands_front")
    lower, upper = robot.position_limits
    state.q[:3] += rng.uniform(-0.02, 0.02, 3)
    turn = np.append(rng.uniform(-0.05, 0.05, 3), 1.0)
    state.q[3:7] = turn / np.linalg.norm(turn)
    state.q[7:] = np.clip(state.q[7:] + rng.uniform(-0.2, 0.2, len(robot.joints)), lower, upper)
    state.v[:] = rng.uniform(-0.3, 0.3, state.v.size)
    return state


def ready(robot: RobotDescription, config: ControllerConfig) -> tuple[WholeBodyController, WholeBodyReference]:
    """A controller and the reference to stay where the hands are in front."""
    controller = WholeBodyController(robot, config, with_hands=True)
    controller.reset(at_rest(robot, "hands_front"))
    return controller, reference_here(controller.kin, with_hands=True)


@pytest.mark.parametrize("name", FILTERS)
def test_commands_are_finite_and_within_effort(robot: RobotDescription, name: str) -> None:
    controller, reference = ready(robot, controller_config(robot, filter=name))
    rng = np.random.default_rng(0)
    effort = robot.joint_array("effort")
    for _ in range(10):
        state = random_state(robot, rng)
        command = controller.tick(state, reference).command
        for values in (command.q, command.v, command.tau, command.kp, command.kd):
            assert values.shape == effort.shape
            assert np.isfinite(values).all()
        assert (np.abs(command.tau) <= effort + 1e-6).all()


@pytest.mark.parametrize("dt", [0.0005, 0.002, 0.01])
def test_set_points_are_one_period_of_safe_velocity_ahead(robot: RobotDescription, dt: float) -> None:
    """q_safe = q + v_safe dt, and the motors are told v_safe; gains are the description's, scaled."""
    controller, reference = ready(robot, controller_config(robot, dt=dt, gain_scale=0.7))
    state = replace(random_state(robot, np.random.default_rng(1)), stamp=12.5)
    result = controller.tick(state, reference)
    np.testing.assert_allclose(result.command.q, state.q[7:] + dt * result.safety.v[6:], rtol=0, atol=1e-14)
    np.testing.assert_array_equal(result.command.v, result.safety.v[6:])
    np.testing.assert_array_equal(result.command.tau, result.dynwbc.torque)
    np.testing.assert_allclose(result.command.kp, 0.7 * robot.joint_array("kp"), rtol=1e-12)
    np.testing.assert_allclose(result.command.kd, 0.7 * robot.joint_array("kd"), rtol=1e-12)
    assert result.command.stamp == 12.5


def test_without_a_filter_the_desired_velocity_is_used(robot: RobotDescription) -> None:
    controller, reference = ready(robot, controller_config(robot, filter="none"))
    result = controller.tick(random_state(robot, np.random.default_rng(2)), reference)
    np.testing.assert_array_equal(result.safety.v, result.v_des)


@pytest.mark.parametrize("posture", POSTURES)
def test_at_rest_torques_and_ground_forces_balance_gravity(robot: RobotDescription, posture: str) -> None:
    """Asked to stay where it is, the robot does: the tick's fixed point is static equilibrium, M q_dd = 0."""
    config = controller_config(robot, filter="none")
    controller = WholeBodyController(robot, config, with_hands=False)
    state = at_rest(robot, posture)
    controller.reset(state)
    reference = reference_here(controller.kin, with_hands=False)
    reference.com = PointReference(controller.kin.com.copy())
    for _ in range(300):
        result = controller.tick(state, reference)
    kin = controller.kin
    np.testing.assert_allclose(result.v_des, 0, atol=1e-9)
    jacobian = np.vstack(
        [
            np.kron(np.eye(2), kin.frame_placement(kin.frame_id(sole.frame))[0].T)
            @ kin.frame_jacobian(kin.frame_id(sole.frame))
            for sole in robot.soles
        ]
    )
    weight = 9.81 * robot.total_mass
    generalised = jacobian.T @ result.dynwbc.wrench
    generalised[6:] += result.dynwbc.torque
    np.testing.assert_allclose(generalised, kin.bias, atol=1e-6 * weight)
    assert result.dynwbc.wrench[2] + result.dynwbc.wrench[8] == pytest.approx(weight, rel=1e-6)


def test_the_same_states_give_the_same_commands(robot: RobotDescription) -> None:
    """Bit for bit, with another controller of the same settings, and whatever time the clock tells."""
    ticking = iter(range(10**6))
    config = controller_config(robot)
    clocked = WholeBodyController(robot, config, True, clock=lambda: float(next(ticking)))
    plain, reference = ready(robot, config)
    clocked.reset(at_rest(robot, "hands_front"))
    states = [random_state(robot, np.random.default_rng(k)) for k in range(8)]
    for state in states:
        a, b = (c.tick(state, reference) for c in (plain, clocked))
        for x, y in zip(
            (a.command.q, a.command.v, a.command.tau), (b.command.q, b.command.v, b.command.tau), strict=True
        ):
            np.testing.assert_array_equal(x, y)
        np.testing.assert_array_equal(b.stage_seconds, np.ones(len(STAGES)))


def test_a_tick_leaves_its_input_alone_and_gives_arrays_of_its_own(robot: RobotDescription) -> None:
    controller, reference = ready(robot, controller_config(robot))
    state = random_state(robot, np.random.default_rng(3))
    q, v, tau = state.q.copy(), state.v.copy(), state.tau.copy()
    com, joints = reference.com.position.copy(), reference.joints.copy()
    first = controller.tick(state, reference)
    kept = [x.copy() for x in (first.command.q, first.command.v, first.command.tau, first.v_des, first.safety.v)]
    controller.tick(random_state(robot, np.random.default_rng(4)), reference)
    for x, y in zip(
        (first.command.q, first.command.v, first.command.tau, first.v_des, first.safety.v), kept, strict=True
    ):
        np.testing.assert_array_equal(x, y)
    for x, y in (
        (state.q, q),
        (state.v, v),
        (state.tau, tau),
        (reference.com.position, com),
        (reference.joints, joints),
    ):
        np.testing.assert_array_equal(x, y)


@pytest.mark.parametrize("part", ["q", "v"])
def test_a_state_that_is_not_finite_is_refused(robot: RobotDescription, part: str) -> None:
    controller, reference = ready(robot, controller_config(robot))
    state = at_rest(robot)
    getattr(state, part)[7] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        controller.tick(state, reference)


def test_bad_settings_are_refused_when_the_controller_is_made() -> None:
    robot = load_robot("g1")
    with pytest.raises(ConfigError, match="solver"):
        WholeBodyController(robot, controller_config(robot, dynwbc_solver="abacus"), with_hands=False)


# --- left and right


def other_side(name: str) -> str:
    if name.startswith("left_"):
        return "right_" + name[5:]
    return "left_" + name[6:] if name.startswith("right_") else name


def mirrored_body(body: Body) -> Body:
    """The body as seen in a mirror at the plane y = 0; joints keep the G1's sense of rotation."""
    joint = body.joint
    if joint is not None:
        axis = -MIRROR @ joint.axis
        sign = 1.0 if axis @ joint.axis > 0 else -1.0
        lower, upper = joint.position
        joint = replace(
            joint,
            name=other_side(joint.name),
            xyz=MIRROR @ joint.xyz,
            rpy=-MIRROR @ joint.rpy,
            axis=sign * axis,
            position=(lower, upper) if sign > 0 else (-upper, -lower),
        )
    return replace(
        body,
        name=other_side(body.name),
        com=MIRROR @ body.com,
        inertia=MIRROR @ body.inertia @ MIRROR,
        parent=None if body.parent is None else other_side(body.parent),
        joint=joint,
    )


def symmetric_g1() -> RobotDescription:
    """The G1 with its right half replaced by the mirrored left one, and what is in the middle averaged."""
    robot = load_robot("g1")
    image = {other_side(b.name): mirrored_body(b) for b in robot.bodies}
    bodies = []
    for body in robot.bodies:
        mirror = image[body.name]
        if body.name.startswith("right_"):
            bodies.append(mirror)
        elif body.name.startswith("left_"):
            bodies.append(body)
        else:
            mean = replace(body, com=0.5 * (body.com + mirror.com), inertia=0.5 * (body.inertia + mirror.inertia))
            bodies.append(mean)
    return replace(robot, bodies=tuple(bodies))


def mirrored_joints(robot: RobotDescription, values: Array) -> Array:
    """Joint values (nj,) of the mirrored robot: sides swapped, turned round for roll and yaw."""
    index = {name: i for i, name in enumerate(robot.joint_names)}
    source = [index[other_side(name)] for name in robot.joint_names]
    sign = np.array([1.0 if joint.axis[1] else -1.0 for joint in robot.joints])
    return sign * values[source]


def mirrored_state(robot: RobotDescription, state: RobotState) -> RobotState:
    q, v = state.q.copy(), state.v.copy()
    q[:3], v[:3] = MIRROR @ q[:3], MIRROR @ v[:3]
    q[3:6], v[3:6] = -MIRROR @ q[3:6], -MIRROR @ v[3:6]
    q[7:], v[6:] = mirrored_joints(robot, q[7:]), mirrored_joints(robot, v[6:])
    return RobotState(q, v, mirrored_joints(robot, state.tau), state.stamp)


def mirrored_point(point: PointReference) -> PointReference:
    return PointReference(MIRROR @ point.position, MIRROR @ point.velocity, MIRROR @ point.acceleration)


def mirrored_reference(robot: RobotDescription, reference: WholeBodyReference) -> WholeBodyReference:
    assert reference.hands is not None
    return WholeBodyReference(
        com=mirrored_point(reference.com),
        soles=(mirrored_point(reference.soles[1]), mirrored_point(reference.soles[0])),
        sole_rotations=(MIRROR @ reference.sole_rotations[1] @ MIRROR, MIRROR @ reference.sole_rotations[0] @ MIRROR),
        base_rotation=MIRROR @ reference.base_rotation @ MIRROR,
        torso_rotation=MIRROR @ reference.torso_rotation @ MIRROR,
        hands=(mirrored_point(reference.hands[1]), mirrored_point(reference.hands[0])),
        joints=mirrored_joints(robot, reference.joints),
        in_contact=reference.in_contact[::-1].copy(),
    )


@pytest.mark.parametrize("name", FILTERS)
def test_a_mirrored_state_gets_the_mirrored_command(name: str) -> None:
    """Both feet on the ground, then one; the hands pulled towards each other, so that the filter has work."""
    robot = symmetric_g1()
    config = controller_config(robot, filter=name)
    rng = np.random.default_rng(5)
    filtered = False
    for in_contact in ([True, True], [True, False]):
        controller, reference = ready(robot, config)
        mirror, _ = ready(robot, config)
        assert reference.hands is not None
        for hand in reference.hands:
            hand.position += rng.uniform(-0.1, 0.1, 3) - [0.2, 0, 0]
        reference.in_contact = np.array(in_contact)
        for _ in range(4):
            state = random_state(robot, rng)
            here = controller.tick(state, reference)
            there = mirror.tick(mirrored_state(robot, state), mirrored_reference(robot, reference))
            assert there.safety.status == here.safety.status
            filtered |= here.safety.status != FilterStatus.UNCHANGED
            for a, b, tolerance in (
                (here.command.v, there.command.v, 1e-7),
                (here.command.q, there.command.q, 1e-9),
                (here.command.tau, there.command.tau, 1e-5),
            ):
                np.testing.assert_allclose(b, mirrored_joints(robot, a), rtol=0, atol=tolerance)
    assert filtered == (name != "none")


@pytest.mark.parametrize("adaptive", [False, True])
def test_after_a_reset_nothing_of_the_ticks_before_is_left(robot: RobotDescription, adaptive: bool) -> None:
    """Hands sent into each other inside the torso, disturbed: command to go on from, correction, estimate, torques."""
    config = controller_config(robot, filter="issf", adaptive=adaptive)
    rng, (used, reference), (fresh, _) = np.random.default_rng(6), ready(robot, config), ready(robot, config)
    assert reference.hands is not None
    state = at_rest(robot, "hands_front")
    # one joint just within its limit, so that epsilon counts; or all beyond theirs, so that the filter has to recover
    moved = slice(-1, None) if adaptive else slice(7, None)
    state.q[moved] = robot.position_limits[1][-1:] - 0.01 if adaptive else robot.position_limits[1] + 0.05
    reference.joints = state.q[7:] + 0.5
    for hand in reference.hands:
        hand.position += [0.0, 0.0, 0.0 if adaptive else 0.5]
    for _ in range(30):
        # steadily towards the limits: noise would not be taken for a disturbance
        used.tick(replace(state, v=rng.uniform(0.2, 0.4, state.v.size)), reference)
    for controller in (used, fresh):
        controller.reset(state)
    here, there = used.tick(state, reference), fresh.tick(state, reference)
    assert there.safety.status != FilterStatus.UNCHANGED
    np.testing.assert_allclose(here.safety.v, there.safety.v, rtol=0, atol=1e-7)
    np.testing.assert_allclose(here.command.tau, there.command.tau, rtol=0, atol=1e-5)
