"""Each task against differences of its own quantity along ``integrate``, and what its command does to its error."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.messages import Array
from tests.support.states import random_state
from wbc.contact import SoleContact
from wbc.dynwbc import DynWbc, DynWbcWeights
from wbc.kinwbc import prioritised_velocity
from wbc.tasks import (
    CenterOfMassTask,
    FrameOrientationTask,
    FramePoseTask,
    FramePositionTask,
    PostureTask,
    Task,
    TaskGains,
)

STEP = 1e-6
GAINS = TaskGains(k=8.0, max_correction=1e6, acceleration_gain=40.8)
ROLES = ("base", "torso", "left_sole", "right_sole", "left_hand", "right_hand", "imu")


def random_rotation(rng: np.random.Generator) -> Array:
    return pin.exp3(rng.uniform(-1.5, 1.5, 3))


def tasks(kin: Kinematics, gains: TaskGains = GAINS, compensate_bias: bool = False) -> dict[str, Task]:
    """Every task on every frame that plays a role."""
    com = CenterOfMassTask(gains, compensate_bias=compensate_bias)
    out: dict[str, Task] = {"com": com, "posture": PostureTask(kin.nv - 6, gains)}
    for role in ROLES:
        frame = kin.frame_id(kin.robot.roles[role])
        out[f"position of {role}"] = FramePositionTask(frame, gains)
        out[f"orientation of {role}"] = FrameOrientationTask(frame, gains)
        out[f"pose of {role}"] = FramePoseTask(frame, gains, compensate_bias=compensate_bias)
    return out


def placement(task: Task, kin: Kinematics, q: Array) -> tuple[Array, Array]:
    """What a task controls, at ``q``, from pinocchio directly: a vector, and a rotation (identity where none)."""
    data = kin.model.createData()
    if isinstance(task, CenterOfMassTask):
        return pin.centerOfMass(kin.model, data, q).copy(), np.eye(3)
    if isinstance(task, PostureTask):
        return q[7:].copy(), np.eye(3)
    assert isinstance(task, FramePositionTask | FrameOrientationTask | FramePoseTask)
    pin.framesForwardKinematics(kin.model, data, q)
    pose = data.oMf[task.frame_id]
    vector = np.zeros(0) if isinstance(task, FrameOrientationTask) else pose.translation.copy()
    return vector, np.eye(3) if isinstance(task, FramePositionTask) else pose.rotation.copy()


def between(task: Task, start: tuple[Array, Array], end: tuple[Array, Array]) -> Array:
    """How far ``end`` is from ``start`` in the task's coordinates, world axes; rotation by pinocchio's logarithm."""
    turn = pin.log3(end[1] @ start[1].T)
    has_rotation = isinstance(task, FrameOrientationTask | FramePoseTask)
    return np.concatenate([end[0] - start[0], turn]) if has_rotation else end[0] - start[0]


def aim(task: Task, target: tuple[Array, Array]) -> None:
    if isinstance(task, PostureTask):
        task.joints = target[0]
        return
    if isinstance(task, CenterOfMassTask | FramePositionTask | FramePoseTask):
        task.position = target[0]
    if isinstance(task, FrameOrientationTask | FramePoseTask):
        task.rotation = target[1]


def test_jacobians_are_the_rates_of_the_quantities(kin: Kinematics) -> None:
    rng = np.random.default_rng(0)
    for _ in range(5):
        q, v = random_state(kin, rng)
        kin.update(q, v)
        for name, task in tasks(kin).items():
            aim(task, placement(task, kin, q))
            jacobian, command = task.evaluate(kin)
            assert jacobian.shape == (task.rows, kin.nv), name
            assert command.shape == (task.rows,), name
            ends = [placement(task, kin, kin.integrate(q, v, s * STEP)) for s in (-1, 1)]
            rate = between(task, ends[0], ends[1]) / (2 * STEP)
            np.testing.assert_allclose(jacobian @ v, rate, rtol=0, atol=1e-8 * np.linalg.norm(v), err_msg=name)


def test_commands_are_gain_times_the_way_to_the_target(kin: Kinematics) -> None:
    rng = np.random.default_rng(1)
    for _ in range(5):
        q, v = random_state(kin, rng)
        kin.update(q, v)
        for name, task in tasks(kin).items():
            here = placement(task, kin, q)
            target = (here[0] + rng.normal(size=here[0].size), random_rotation(rng) @ here[1])
            aim(task, target)
            expected = GAINS.k * between(task, here, target)
            np.testing.assert_allclose(task.evaluate(kin)[1], expected, rtol=0, atol=1e-9, err_msg=name)


def test_commands_vanish_at_the_target(kin: Kinematics) -> None:
    q, v = random_state(kin, np.random.default_rng(2))
    kin.update(q, v)
    for name, task in tasks(kin).items():
        aim(task, placement(task, kin, q))
        np.testing.assert_allclose(task.evaluate(kin)[1], 0.0, rtol=0, atol=1e-12, err_msg=name)


def test_following_the_command_shrinks_the_error_at_the_rate_of_the_gain(kin: Kinematics) -> None:
    """Over a step dt the error becomes (1 - k dt) of itself, up to second order in dt."""
    rng = np.random.default_rng(3)
    dt = 1e-5
    for _ in range(3):
        q, _ = random_state(kin, rng)
        for name, task in tasks(kin).items():
            here = placement(task, kin, q)
            target = (here[0] + 0.05 * rng.normal(size=here[0].size), pin.exp3(0.3 * rng.normal(size=3)) @ here[1])
            aim(task, target)
            kin.update(q, np.zeros(kin.nv))
            velocity = prioritised_velocity([task.evaluate(kin)], kin.nv, 1e-4)
            after = placement(task, kin, kin.integrate(q, velocity, dt))
            before, left = between(task, here, target), between(task, after, target)
            np.testing.assert_allclose(left, (1 - GAINS.k * dt) * before, rtol=0, atol=1e-6, err_msg=name)
            assert np.linalg.norm(left) < np.linalg.norm(before), name


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 1.0, 1.6, 3.0, *(np.pi - 10.0**-k for k in range(2, 13))])
def test_orientation_errors_are_exact_from_no_turn_to_half_a_turn(kin: Kinematics, angle: float) -> None:
    rng = np.random.default_rng(4)
    q, v = random_state(kin, rng)
    kin.update(q, v)
    task = FrameOrientationTask(kin.frame_id(kin.robot.roles["torso"]), GAINS)
    rotation = placement(task, kin, q)[1]
    for axis in (*np.eye(3), *rng.normal(size=(5, 3))):
        vector = angle * axis / np.linalg.norm(axis)
        task.rotation = pin.exp3(vector) @ rotation
        np.testing.assert_allclose(task.evaluate(kin)[1] / GAINS.k, vector, rtol=0, atol=1e-14)


def test_posture_leaves_the_base_alone(kin: Kinematics) -> None:
    q, v = random_state(kin, np.random.default_rng(5))
    kin.update(q, v)
    task = PostureTask(kin.nv - 6, GAINS)
    task.set_target(q[7:])
    jacobian, _ = task.evaluate(kin)
    np.testing.assert_array_equal(jacobian @ v, v[6:])


Feed = Callable[[Task, Array], None]


def feed_velocity(task: Task, value: Array) -> None:
    if isinstance(task, FrameOrientationTask):
        task.angular_velocity = value
    elif isinstance(task, CenterOfMassTask | FramePositionTask | FramePoseTask):
        task.velocity = value


def feed_acceleration(task: Task, value: Array) -> None:
    if isinstance(task, CenterOfMassTask | FramePositionTask | FramePoseTask):
        task.acceleration = value


@pytest.mark.parametrize(("feed", "factor"), [(feed_velocity, 1.0), (feed_acceleration, 1.0 / 40.8)])
def test_feed_forward_is_added_to_the_correction(kin: Kinematics, feed: Feed, factor: float) -> None:
    """Velocity as it is, acceleration over K_d + K_p dt; neither is clipped with the correction."""
    rng = np.random.default_rng(6)
    q, v = random_state(kin, rng)
    kin.update(q, v)
    gains = replace(GAINS, max_correction=0.1)
    for name, task in tasks(kin, gains).items():
        if isinstance(task, PostureTask) or (feed is feed_acceleration and isinstance(task, FrameOrientationTask)):
            continue
        here = placement(task, kin, q)
        aim(task, (here[0] + 1.0, random_rotation(rng) @ here[1]))
        before = task.evaluate(kin)[1].copy()
        value = 10.0 * rng.normal(size=task.rows)
        feed(task, value)
        kept = value.copy()
        for _ in range(2):  # twice: the reference must not be changed by reading it
            np.testing.assert_allclose(task.evaluate(kin)[1], before + factor * value, rtol=0, atol=1e-12, err_msg=name)
        assert np.array_equal(value, kept), name


def test_feed_forward_acceleration_comes_out_of_the_velocity_law(kin: Kinematics) -> None:
    """At rest on the reference, eq. (15) makes of the task's command the reference's acceleration."""
    kin.update(random_state(kin, np.random.default_rng(10))[0], np.zeros(kin.nv))
    soles = [SoleContact(sole.frame, sole.half_length, sole.half_width, 0.6) for sole in kin.robot.soles]
    weights, dt = DynWbcWeights(kp=300.0, kd=30.0), 0.004
    dynwbc = DynWbc(kin, soles, weights)
    task = CenterOfMassTask(TaskGains(8.0, acceleration_gain=weights.kd + weights.kp * dt))
    task.position, task.acceleration = kin.com.copy(), np.array([1.0, -2.0, 3.0])
    jacobian, command = task.evaluate(kin)
    velocity = prioritised_velocity([(jacobian, command)], kin.nv, 1e-4)
    acceleration = dynwbc.acceleration_reference(velocity, kin.v, dt)
    np.testing.assert_allclose(jacobian @ acceleration, task.acceleration, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ["com", "posture", "position of left_hand", "orientation of torso"])
def test_corrections_are_clipped_in_norm_and_keep_their_direction(kin: Kinematics, name: str) -> None:
    rng = np.random.default_rng(7)
    q, v = random_state(kin, rng)
    kin.update(q, v)
    task = tasks(kin, replace(GAINS, max_correction=0.25))[name]
    here = placement(task, kin, q)
    far = (here[0] + 5.0 * rng.normal(size=here[0].size), pin.exp3(np.array([1.0, 0.5, -0.7])) @ here[1])
    aim(task, far)
    command, way = task.evaluate(kin)[1], between(task, here, far)
    np.testing.assert_allclose(command, 0.25 * way / np.linalg.norm(way), rtol=0, atol=1e-12)


def test_a_pose_clips_position_and_orientation_separately(kin: Kinematics) -> None:
    q, v = random_state(kin, np.random.default_rng(8))
    kin.update(q, v)
    task = tasks(kin, replace(GAINS, max_correction=0.25))["pose of left_sole"]
    here = placement(task, kin, q)
    near = (here[0] + np.array([0.01, 0.0, 0.0]), pin.exp3(np.array([0.0, 1.0, 0.0])) @ here[1])
    aim(task, near)
    np.testing.assert_allclose(task.evaluate(kin)[1], [0.08, 0, 0, 0, 0.25, 0], rtol=0, atol=1e-12)


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=6), st.floats(0.1, 50.0), st.floats(1e-3, 10.0))
def test_a_correction_is_the_nearest_allowed_one(error: list[float], k: float, limit: float) -> None:
    e = np.array(error)
    correction = TaskGains(k, limit).correction(e)
    norm = np.linalg.norm(k * e)
    expected = k * e * (1.0 if norm <= limit else limit / norm)
    assert np.linalg.norm(correction) <= limit * (1 + 1e-12)
    np.testing.assert_allclose(correction, expected, rtol=1e-12, atol=1e-300)


@pytest.mark.parametrize("name", ["k", "max_correction", "acceleration_gain"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_bad_gains_are_refused(name: str, value: float) -> None:
    with pytest.raises(ConfigError, match=name):
        TaskGains(**({"k": 5.0} | {name: value}))


def test_reading_a_task_twice_gives_the_same(kin: Kinematics) -> None:
    q, v = random_state(kin, np.random.default_rng(9))
    kin.update(q, v)
    for name, task in tasks(kin).items():
        aim(task, (np.ones(task.rows if isinstance(task, PostureTask) else 3), np.eye(3)))
        first = [x.copy() for x in task.evaluate(kin)]
        for a, b in zip(first, task.evaluate(kin), strict=True):
            assert np.array_equal(a, b), name


@pytest.mark.parametrize("name", ["com", "pose of left_sole", "pose of right_sole"])
def test_with_the_bias_compensated_a_moving_robot_gets_the_acceleration_asked_for(kin: Kinematics, name: str) -> None:
    """Eq. (15), from the measured velocity on: J q_dd + J_dot v is the reference's acceleration, and not without."""
    q, v = random_state(kin, np.random.default_rng(12))
    dt, weights = 0.004, DynWbcWeights(kp=300.0, kd=30.0)
    gain = weights.kd + weights.kp * dt
    soles = [SoleContact(sole.frame, sole.half_length, sole.half_width, 0.6) for sole in kin.robot.soles]
    task, plain = (tasks(kin, TaskGains(8.0, acceleration_gain=gain), biased)[name] for biased in (True, False))
    aim(task, placement(task, kin, q))
    rates = []
    for side in (-1, 1):
        kin.update(kin.integrate(q, v, side * STEP), v)
        rates.append(task.evaluate(kin)[0] @ v)
    dh_dt = (rates[1] - rates[0]) / (2 * STEP)
    kin.update(q, v)
    kin.update_bias_acceleration()
    aim(task, placement(task, kin, q))
    jacobian = task.evaluate(kin)[0]
    wanted = np.arange(1.0, 1.0 + task.rows)
    for either in (task, plain):
        aim(either, placement(task, kin, q))
        feed_velocity(either, weights.kd / gain * (jacobian @ v))
        feed_acceleration(either, wanted.copy())
    for without in (True, False):
        command = (task if without else plain).evaluate(kin)[1]
        velocity = prioritised_velocity([(jacobian, command)], kin.nv, 1e-6)
        acceleration = DynWbc(kin, soles, weights).acceleration_reference(velocity, v, dt)
        actual = jacobian @ acceleration + dh_dt
        expected = wanted if without else wanted + dh_dt
        np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-5)
    assert np.linalg.norm(dh_dt) > 0.1
    assert isinstance(task, CenterOfMassTask | FramePoseTask)
    np.testing.assert_array_equal(task.acceleration, wanted)
