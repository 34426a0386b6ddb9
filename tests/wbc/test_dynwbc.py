"""DynWBC's parts and limits: eq. (15), contact terms, torque rate, standing still, and what happens on failure."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from robots.description import RobotDescription
from robots.errors import ConfigError, UnknownNameError
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array
from robots.pinocchio_model import standing_configuration
from tests.support.velocities import frame_velocity
from wbc.contact import SoleContact
from wbc.dynwbc import DynWbc, DynWbcResult, DynWbcWeights, contact_bias_acceleration
from wbc.torque_qp import DynWbcProblem
from wbc.wrench import GRAVITY

STEP = 1e-6
KINEMATICS = {name: Kinematics(load_robot(name)) for name in ("g1", "tocabi")}
BOTH = np.array([True, True])
SOLVERS = ("daqp", "proxqp")


@pytest.fixture
def kin(robot_name: str) -> Kinematics:
    """At a random state near the standing posture, in any orientation, moving."""
    kinematics = KINEMATICS[robot_name]
    disturb(kinematics, np.random.default_rng(0))
    return kinematics


def disturb(kin: Kinematics, rng: np.random.Generator) -> None:
    q = standing_configuration(kin.robot)
    low, high = kin.robot.position_limits
    q[7:] = np.clip(q[7:] + 0.3 * rng.normal(size=low.size), low, high)
    q = kin.integrate(q, np.concatenate([rng.normal(size=6), np.zeros(low.size)]), 1.0)
    kin.update(q, rng.normal(size=kin.nv))


def soles(robot: RobotDescription) -> list[SoleContact]:
    return [SoleContact(s.frame, s.half_length, s.half_width, 0.6) for s in robot.soles]


def controller(kin: Kinematics, weights: DynWbcWeights | None = None, solver: str = "daqp") -> DynWbc:
    return DynWbc(kin, soles(kin.robot), weights or DynWbcWeights(), solver)


def weight_on_both(kin: Kinematics) -> Array:
    """Half the weight on each foot, in sole axes of level feet."""
    return np.tile([0.0, 0.0, 0.5 * kin.robot.total_mass * GRAVITY, 0.0, 0.0, 0.0], 2)


def posed(dynwbc: DynWbc, kin: Kinematics, rng: np.random.Generator) -> DynWbcProblem:
    return dynwbc.build(kin, rng.normal(size=kin.nv), weight_on_both(kin), BOTH)


# --- eq. (15) and the contact quantities


def test_the_acceleration_reference_is_eq_15(kin: Kinematics) -> None:
    """K_p (q_safe - q) + K_d (v_safe - v), with q_safe the integral of v_safe over one step, base included."""
    rng = np.random.default_rng(1)
    weights = DynWbcWeights(kp=350.0, kd=45.0)
    dynwbc = controller(kin, weights)
    for dt in (5e-4, 2e-3, 1e-2):
        v_safe = rng.normal(size=kin.nv)
        q_safe = kin.integrate(kin.q, v_safe, dt)
        way = pin.difference(kin.model, kin.q, q_safe)
        expected = weights.kp * way + weights.kd * (v_safe - kin.v)
        np.testing.assert_allclose(dynwbc.acceleration_reference(v_safe, kin.v, dt), expected, rtol=0, atol=1e-9)


def test_contact_jacobians_are_rates_in_sole_axes(kin: Kinematics) -> None:
    dynwbc = controller(kin)
    q, v = kin.q.copy(), kin.v.copy()
    velocity = dynwbc.contact_jacobian(kin, BOTH) @ v
    for i, sole in enumerate(kin.robot.soles):
        frame = kin.frame_id(sole.frame)
        ends = []
        for sign in (-1, 1):
            kin.update(kin.integrate(q, v, sign * STEP), v)
            rotation, position = kin.frame_placement(frame)
            ends.append((rotation.copy(), position.copy()))
        kin.update(q, v)
        rotation, _ = kin.frame_placement(frame)
        linear = rotation.T @ (ends[1][1] - ends[0][1]) / (2 * STEP)
        angular = rotation.T @ pin.log3(ends[1][0] @ ends[0][0].T) / (2 * STEP)
        np.testing.assert_allclose(velocity[6 * i : 6 * i + 6], np.append(linear, angular), rtol=0, atol=1e-7)


@pytest.mark.parametrize("touching", [(True, False), (False, True), (False, False)])
def test_feet_in_the_air_have_no_contact_rows(kin: Kinematics, touching: tuple[bool, bool]) -> None:
    dynwbc = controller(kin)
    full, part = (dynwbc.contact_jacobian(kin, np.array(mask)) for mask in ((True, True), touching))
    np.testing.assert_array_equal(part, full[np.repeat(touching, 6)])


def test_contact_bias_is_the_rate_of_the_contact_velocity_at_constant_joint_rates(kin: Kinematics) -> None:
    """Differences of the sole's world velocity along the motion, turned into sole axes."""
    frames = [kin.frame_id(s.frame) for s in kin.robot.soles]
    q, v = kin.q.copy(), kin.v.copy()
    ends = []
    for sign in (-1, 1):
        kin.update(kin.integrate(q, v, sign * STEP), v)
        ends.append([frame_velocity(kin, i) for i in frames])
    kin.update(q, v)
    bias = contact_bias_acceleration(kin, frames)
    for k, frame in enumerate(frames):
        rotation, _ = kin.frame_placement(frame)
        rate = ((ends[1][k] - ends[0][k]) / (2 * STEP)).reshape(2, 3) @ rotation
        np.testing.assert_allclose(bias[6 * k : 6 * k + 6], rate.ravel(), rtol=0, atol=1e-7)


def test_reading_the_contact_bias_leaves_the_kinematics_as_they_were(kin: Kinematics) -> None:
    names = ("mass_matrix", "bias", "world_jacobian", "joint_transforms", "com", "com_velocity", "com_jacobian")
    before = [getattr(kin, name).copy() for name in names]
    contact_bias_acceleration(kin, [kin.frame_id(s.frame) for s in kin.robot.soles])
    for name, old in zip(names, before, strict=True):
        np.testing.assert_allclose(getattr(kin, name), old, rtol=0, atol=1e-12, err_msg=name)


# --- what the weights do in their limits


def test_feet_stop_accelerating_as_the_contact_weight_grows(kin: Kinematics) -> None:
    """Far from any limit the residual of a soft constraint goes as one over its weight."""
    rng = np.random.default_rng(2)
    command = 0.2 * rng.normal(size=kin.nv)
    bias = contact_bias_acceleration(kin, [kin.frame_id(s.frame) for s in kin.robot.soles])
    left = []
    for weight in (1e2, 1e4, 1e6):
        # friction and effort out of the way: the claim is about the term alone
        free = DynWbcWeights(contact=weight, force=1e-6, moment=1e-6, torque_rate=0.0)
        dynwbc = controller(kin, free)
        problem = dynwbc.build(kin, command, weight_on_both(kin), BOTH, bias)
        loose = replace(problem, lower=np.full_like(problem.lower, -1e30), upper=np.full_like(problem.upper, 1e30))
        result = dynwbc.solve(loose)
        assert result.status == "optimal"
        jacobian = dynwbc.contact_jacobian(kin, BOTH)
        left.append(np.linalg.norm(jacobian @ result.acceleration + bias))
    assert left[0] > 0
    assert left[1] < 0.02 * left[0]
    assert left[2] < 0.02 * left[1]


def test_without_the_soft_term_the_contact_bias_is_not_used(kin: Kinematics) -> None:
    dynwbc = controller(kin)
    rng = np.random.default_rng(3)
    command = rng.normal(size=kin.nv)
    with_bias = dynwbc.build(kin, command, weight_on_both(kin), BOTH, 100.0 * rng.normal(size=12))
    without = dynwbc.build(kin, command, weight_on_both(kin), BOTH)
    np.testing.assert_array_equal(with_bias.hessian, without.hessian)
    np.testing.assert_array_equal(with_bias.gradient, without.gradient)


def test_torques_stay_at_the_previous_ones_as_their_weight_grows(kin: Kinematics) -> None:
    rng = np.random.default_rng(4)
    effort = kin.robot.joint_array("effort")
    previous = 0.5 * effort * rng.uniform(-1.0, 1.0, effort.size)
    command = rng.normal(size=kin.nv)
    away = []
    for weight in (1e6, 1e8):  # beside 1 / inertia^2 of the smallest joint, where accelerations weigh 1
        dynwbc = controller(kin, DynWbcWeights(torque_rate=weight))
        dynwbc.reset(previous)
        result = dynwbc.solve(dynwbc.build(kin, command, weight_on_both(kin), BOTH))
        assert result.status == "optimal"
        away.append(np.linalg.norm(result.torque - previous))
    assert away[1] < 0.02 * away[0]
    assert away[1] < 1e-4 * np.linalg.norm(previous)


def test_a_command_within_reach_is_followed_exactly(kin: Kinematics) -> None:
    """Accelerations that some torques and inner wrenches produce, asked for together with those wrenches."""
    rng = np.random.default_rng(5)
    still = kin.q.copy()
    kin.update(still, np.zeros(kin.nv))
    dynwbc = controller(kin, DynWbcWeights(torque_rate=0.0, energy=0.0))
    wrench = weight_on_both(kin) * (1.0 + 0.1 * rng.normal(size=12))
    torque = 0.1 * kin.robot.joint_array("effort") * rng.uniform(-1.0, 1.0, kin.nv - 6)
    forces = np.concatenate([np.zeros(6), torque]) + dynwbc.contact_jacobian(kin, BOTH).T @ wrench - kin.bias
    command = np.linalg.solve(kin.mass_matrix, forces)
    result = dynwbc.solve(dynwbc.build(kin, command, wrench, BOTH))
    np.testing.assert_allclose(result.acceleration, command, rtol=0, atol=1e-8 * abs(command).max())
    np.testing.assert_allclose(result.wrench, wrench, rtol=0, atol=1e-8 * abs(wrench).max())
    np.testing.assert_allclose(result.torque, torque, rtol=0, atol=1e-8 * abs(torque).max())


def standing_still(kin: Kinematics, weights: DynWbcWeights) -> tuple[DynWbc, DynWbcResult]:
    kin.update(standing_configuration(kin.robot), np.zeros(kin.nv))
    dynwbc = controller(kin, weights)
    return dynwbc, dynwbc.solve(dynwbc.build(kin, np.zeros(kin.nv), weight_on_both(kin), BOTH))


def test_standing_still_the_feet_carry_the_weight_and_nothing_accelerates(kin: Kinematics) -> None:
    """Weights that make the acceleration nearly binding: the wrenches balance gravity about the centre of mass."""
    dynwbc, result = standing_still(kin, DynWbcWeights(1e4, 1e-6, 1e-6, 0.0, 0.0))
    force, moment = np.zeros(3), np.zeros(3)
    for frame, wrench in zip(dynwbc.frame_ids, result.wrench.reshape(-1, 6), strict=True):
        rotation, place = kin.frame_placement(frame)
        force += rotation @ wrench[:3]
        moment += rotation @ wrench[3:] + np.cross(place - kin.com, rotation @ wrench[:3])
    total = np.concatenate([force, moment])
    weight = kin.robot.total_mass * GRAVITY
    assert abs(result.acceleration).max() < 1e-5
    np.testing.assert_allclose(total, [0, 0, weight, 0, 0, 0], rtol=0, atol=1e-5 * weight)


def test_the_last_torques_of_one_tick_are_the_previous_ones_of_the_next(kin: Kinematics) -> None:
    rng = np.random.default_rng(6)
    dynwbc, other = controller(kin), controller(kin)
    first = dynwbc.solve(posed(dynwbc, kin, rng))
    other.reset(first.torque)
    command = rng.normal(size=kin.nv)
    mine, theirs = (d.build(kin, command, weight_on_both(kin), BOTH) for d in (dynwbc, other))
    np.testing.assert_array_equal(mine.gradient, theirs.gradient)


# --- failure


def contradictory(problem: DynWbcProblem, nj: int) -> DynWbcProblem:
    """A left foot that has to pull at 1 N, which its cone forbids."""
    upper = problem.upper.copy()
    upper[nj + 2] = -1.0
    return replace(problem, upper=upper)


def crossed(problem: DynWbcProblem, nj: int) -> DynWbcProblem:
    upper, lower = problem.upper.copy(), problem.lower.copy()
    upper[-nj:], lower[-nj:] = lower[-nj:].copy(), upper[-nj:].copy()
    return replace(problem, upper=upper, lower=lower)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("spoil", [contradictory, crossed])
def test_an_infeasible_tick_keeps_the_last_torques_and_says_so(kin: Kinematics, solver: str, spoil: object) -> None:
    assert callable(spoil)
    rng = np.random.default_rng(7)
    dynwbc = controller(kin, solver=solver)
    good = dynwbc.solve(posed(dynwbc, kin, rng))
    assert good.status == "optimal"
    for _ in range(2):
        bad = dynwbc.solve(spoil(posed(dynwbc, kin, rng), kin.nv - 6))
        assert bad.status == "infeasible" if solver == "daqp" or spoil is crossed else bad.status != "optimal"
        np.testing.assert_array_equal(bad.torque, good.torque)
        np.testing.assert_array_equal(bad.acceleration, good.acceleration)
        np.testing.assert_array_equal(bad.wrench, good.wrench)
    again = dynwbc.solve(posed(dynwbc, kin, rng))
    assert again.status == "optimal"
    assert not np.array_equal(again.torque, good.torque)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("where", ["acceleration", "wrench"])
def test_a_nan_reference_fails_keeps_the_last_torques_and_passes(kin: Kinematics, solver: str, where: str) -> None:
    rng = np.random.default_rng(8)
    dynwbc = controller(kin, solver=solver)
    good = dynwbc.solve(posed(dynwbc, kin, rng))
    command, wrench = rng.normal(size=kin.nv), weight_on_both(kin)
    (command if where == "acceleration" else wrench)[3] = np.nan
    bad = dynwbc.solve(dynwbc.build(kin, command, wrench, BOTH))
    assert bad.status == "failed"
    np.testing.assert_array_equal(bad.torque, good.torque)
    assert dynwbc.solve(posed(dynwbc, kin, rng)).status == "optimal"


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_nan_state_fails_and_passes(kin: Kinematics, solver: str) -> None:
    """NaN joint velocity: the bias forces, and with them rows and bounds, are NaN."""
    rng = np.random.default_rng(9)
    dynwbc = controller(kin, solver=solver)
    good = dynwbc.solve(posed(dynwbc, kin, rng))
    q, v = kin.q.copy(), kin.v.copy()
    broken = v.copy()
    broken[8] = np.nan
    kin.update(q, broken)
    bad = dynwbc.solve(posed(dynwbc, kin, rng))
    kin.update(q, v)
    assert bad.status == "failed"
    np.testing.assert_array_equal(bad.torque, good.torque)
    assert dynwbc.solve(posed(dynwbc, kin, rng)).status == "optimal"


def test_before_the_first_optimum_the_torques_are_those_of_the_reset(kin: Kinematics) -> None:
    rng = np.random.default_rng(10)
    dynwbc = controller(kin)
    torque = rng.normal(size=kin.nv - 6)
    dynwbc.reset(torque)
    kept = torque.copy()
    torque[:] = np.nan  # the caller's array is not held on to
    bad = dynwbc.solve(crossed(posed(dynwbc, kin, rng), kin.nv - 6))
    assert bad.status == "infeasible"
    np.testing.assert_array_equal(bad.torque, kept)


def test_results_are_not_overwritten_by_the_next_tick(kin: Kinematics) -> None:
    rng = np.random.default_rng(11)
    dynwbc = controller(kin)
    first = dynwbc.solve(posed(dynwbc, kin, rng))
    copies = first.torque.copy(), first.acceleration.copy(), first.wrench.copy()
    for _ in range(3):
        dynwbc.solve(posed(dynwbc, kin, rng))
    for array, copy in zip((first.torque, first.acceleration, first.wrench), copies, strict=True):
        assert np.array_equal(array, copy)


def test_building_writes_to_none_of_its_inputs(kin: Kinematics) -> None:
    rng = np.random.default_rng(12)
    dynwbc = controller(kin, DynWbcWeights(contact=1.0))
    inputs = [rng.normal(size=kin.nv), weight_on_both(kin), BOTH.copy(), rng.normal(size=12)]
    views = [kin.mass_matrix, kin.bias, kin.q, kin.v]
    before = [x.copy() for x in inputs + views]
    dynwbc.solve(dynwbc.build(kin, inputs[0], inputs[1], inputs[2], inputs[3]))
    for array, copy in zip(inputs + views, before, strict=True):
        assert np.array_equal(array, copy)


# --- what is refused


@pytest.mark.parametrize("name", ["acceleration", "force", "moment", "kd"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_weights_that_have_to_be_positive(name: str, value: float) -> None:
    with pytest.raises(ConfigError, match=name):
        DynWbcWeights(**{name: value})


@pytest.mark.parametrize("name", ["torque_rate", "energy", "contact", "kp"])
def test_weights_that_may_be_zero(name: str) -> None:
    assert getattr(DynWbcWeights(**{name: 0.0}), name) == 0.0
    for value in (-1.0, float("nan"), float("inf")):
        with pytest.raises(ConfigError, match=name):
            DynWbcWeights(**{name: value})


def test_unknown_soles_and_solvers_are_refused() -> None:
    kin = KINEMATICS["g1"]
    with pytest.raises(UnknownNameError, match="no_such_sole"):
        DynWbc(kin, [SoleContact("no_such_sole", 0.1, 0.05, 0.6)], DynWbcWeights())
    with pytest.raises(ConfigError, match="daqp, proxqp"):
        controller(kin, solver="quadprog")


# --- the load: how heavy the robot is, and what each foot may carry


@pytest.mark.parametrize("scale", [0.8, 1.25])
def test_a_load_scale_is_a_model_with_all_masses_scaled(kin: Kinematics, scale: float) -> None:
    """Base and torques of the maps solve scale (M q_dd + h) = S^T tau + J^T F, for any joint acceleration and force."""
    rng = np.random.default_rng(11)
    dynwbc = controller(kin)
    problem = dynwbc.build(kin, rng.normal(size=kin.nv), weight_on_both(kin), BOTH, load_scale=scale)
    x = rng.normal(size=problem.gradient.size)
    base = problem.base @ np.append(x, 1.0)
    torque = problem.torque @ np.append(x, 1.0)
    acceleration = np.concatenate([base, x[: dynwbc.nj]])
    forces = dynwbc.contact_jacobian(kin, BOTH).T @ x[dynwbc.nj :]
    left = scale * (kin.mass_matrix @ acceleration + kin.bias) - forces
    np.testing.assert_allclose(left, np.concatenate([np.zeros(6), torque]), rtol=0, atol=1e-7)


def test_a_scaled_load_is_carried(kin: Kinematics) -> None:
    """At rest: forces sum to the scaled weight when the reference says so; the model's own matrices are left alone."""
    kin.update(standing_configuration(kin.robot), np.zeros(kin.nv))
    before = kin.mass_matrix.copy(), kin.bias.copy()
    dynwbc = controller(kin)
    result = dynwbc.solve(dynwbc.build(kin, np.zeros(kin.nv), 1.2 * weight_on_both(kin), BOTH, load_scale=1.2))
    assert result.status == "optimal"
    np.testing.assert_array_equal(kin.mass_matrix, before[0])
    np.testing.assert_array_equal(kin.bias, before[1])
    weight = kin.robot.total_mass * GRAVITY
    assert result.wrench[[2, 8]].sum() == pytest.approx(1.2 * weight, rel=1e-3)


@pytest.mark.parametrize("scale", [1.0, 1.2])
@pytest.mark.parametrize("limits", [(0.0, 1.0), (1.0, 0.2), (0.3, 1.5), (1.0, 1.0)])
def test_a_foot_carries_no_more_than_its_limit(kin: Kinematics, limits: tuple[float, float], scale: float) -> None:
    """Of the scaled weight; with half of it asked of each foot, the limit is met where it is below that."""
    kin.update(standing_configuration(kin.robot), np.zeros(kin.nv))
    dynwbc, other = controller(kin), controller(kin)
    wrench = scale * weight_on_both(kin)
    args = (kin, np.zeros(kin.nv), wrench, BOTH)
    free = other.solve(other.build(*args, load_scale=scale))
    result = dynwbc.solve(dynwbc.build(*args, load_scale=scale, load_limits=np.array(limits)))
    assert result.status == "optimal"
    weight = scale * kin.robot.total_mass * GRAVITY
    for foot, limit in enumerate(limits):
        normal = result.wrench[6 * foot + 2]
        if limit < 1.0:
            assert normal == pytest.approx(min(limit * weight, free.wrench[6 * foot + 2]), abs=1e-4 * weight)
            assert normal <= limit * weight + 1e-6 * weight
    if min(limits) >= 1.0:
        np.testing.assert_allclose(result.wrench, free.wrench, rtol=0, atol=1e-6 * weight)


@pytest.mark.parametrize("foot", [0, 1])
def test_on_one_foot_its_own_limit_counts(kin: Kinematics, foot: int) -> None:
    kin.update(standing_configuration(kin.robot), np.zeros(kin.nv))
    dynwbc = controller(kin)
    standing = np.arange(2) == foot
    weight, normal = kin.robot.total_mass * GRAVITY, 6 * foot + 2
    carried = []
    for limits in ((1.0, 0.4), (0.4, 1.0)):
        wrench = 2.0 * weight_on_both(kin)
        result = dynwbc.solve(dynwbc.build(kin, np.zeros(kin.nv), wrench, standing, load_limits=np.array(limits)))
        assert result.status == "optimal"
        carried.append(result.wrench[normal] / weight)
    assert carried[1 - foot] == pytest.approx(0.4, abs=1e-6)
    assert carried[foot] > 0.9


def test_a_limit_does_not_load_a_foot_in_the_air(kin: Kinematics) -> None:
    kin.update(standing_configuration(kin.robot), np.zeros(kin.nv))
    dynwbc = controller(kin)
    left = np.array([True, False])
    problem = dynwbc.build(kin, np.zeros(kin.nv), weight_on_both(kin), left, load_limits=np.array([1.0, 0.7]))
    result = dynwbc.solve(problem)
    assert result.status == "optimal"
    assert problem.feet == (0,)
    np.testing.assert_array_equal(result.wrench[6:], np.zeros(6))
