"""The exponential CBF inside the whole-body controller: what its accelerations do to the barriers."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from controllers.reference import WholeBodyReference, reference_here
from controllers.whole_body.config import FilterTuning
from controllers.whole_body.controller import TickResult, WholeBodyController
from controllers.whole_body.robot_config import controller_config
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array, RobotState
from robots.pinocchio_model import standing_configuration
from safety.barriers.barrier_set import standard_barriers
from safety.filters.conditions import FamilyParameters
from safety.filters.safety_filter import FilterStatus
from safety.filters.second_order import ecbf
from wbc.contact import SoleContact
from wbc.dynwbc import DynWbcResult
from wbc.torque_qp import DynWbcProblem, TorqueQp

POSTURE = "hands_front"


def ready(name: str, filter_name: str, **tuning: Any) -> tuple[WholeBodyController, WholeBodyReference]:
    robot = load_robot(name)
    config = controller_config(robot, filter=filter_name, safety=FilterTuning(**tuning))
    controller = WholeBodyController(robot, config, with_hands=True)
    kin = controller.kin
    kin.update(standing_configuration(robot, POSTURE), np.zeros(kin.nv))
    return controller, reference_here(kin, with_hands=True)


def moving_state(controller: WholeBodyController, rng: np.random.Generator, speed: float) -> RobotState:
    """The hands-front posture, its arms on the move; the legs are at rest."""
    kin = controller.kin
    v = np.zeros(kin.nv)
    arms = [i for i, n in enumerate(kin.joint_names) if any(w in n.lower() for w in ("shoulder", "elbow", "wrist"))]
    v[6 + np.array(arms)] = speed * rng.normal(size=len(arms))
    return RobotState(standing_configuration(controller.robot, POSTURE), v, np.zeros(kin.nv - 6), 0.0)


def hands_into_torso(reference: WholeBodyReference) -> None:
    assert reference.hands is not None
    for hand in reference.hands:
        hand.position = np.array([0.0, 0.0, hand.position[2]])


@pytest.fixture(params=["g1", "tocabi"])
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def exponential_barrier(kin: Kinematics, q: Array, v: Array, alpha: Array) -> Array:
    """h_e = h_dot + alpha h of every row, eq. (54) of Lee et al., from first-order quantities only."""
    kin.update_geometry(q)
    rows = standard_barriers(kin).evaluate(kin)
    return rows.jac @ v + rows.dh_dt + alpha * rows.h


@pytest.mark.parametrize("seed", range(3))
def test_the_acceleration_satisfies_equation_55_along_the_motion_it_starts(name: str, seed: int) -> None:
    controller, reference = ready(name, "ecbf")
    hands_into_torso(reference)
    state = moving_state(controller, np.random.default_rng(seed), 0.8)
    controller.reset(state)
    result = controller.tick(state, reference)
    assert result.safety.status == FilterStatus.FILTERED
    assert result.safety.slack < 1e-7
    kin = Kinematics(controller.robot)
    family = controller.barriers.evaluate(controller.kin).family
    alpha = controller.config.safety.parameters().of_rows(family).alpha
    a, step = result.dynwbc.acceleration, 1e-6
    after = exponential_barrier(kin, kin.integrate(state.q, state.v, step), state.v + step * a, alpha)
    before = exponential_barrier(kin, kin.integrate(state.q, state.v, -step), state.v - step * a, alpha)
    here = exponential_barrier(kin, state.q, state.v, alpha)
    gap = (after - before) / (2 * step) + alpha * here
    assert gap.min() > -1e-4
    assert np.count_nonzero(gap < 1e-4) == result.safety.active > 0


def test_far_from_danger_torques_are_those_without_a_filter(name: str) -> None:
    results: list[TickResult] = []
    eager = FamilyParameters(alpha=100.0)
    for filter_name in ("none", "ecbf"):
        controller, reference = ready(name, filter_name, self_collision=eager, leg_collision=eager)
        state = moving_state(controller, np.random.default_rng(1), 0.0)
        controller.reset(state)
        results.append(controller.tick(state, reference))
    without, with_filter = results
    assert with_filter.safety.status == FilterStatus.UNCHANGED
    np.testing.assert_allclose(with_filter.dynwbc.torque, without.dynwbc.torque, rtol=0, atol=1e-7)
    assert with_filter.safety.relaxed.size == 0


def test_the_motors_are_told_the_velocity_that_gives_this_acceleration(name: str) -> None:
    """Otherwise their damping would pull the arms back into what DynWBC has just kept them out of."""
    controller, reference = ready(name, "ecbf")
    hands_into_torso(reference)
    state = moving_state(controller, np.random.default_rng(2), 0.3)
    controller.reset(state)
    result = controller.tick(state, reference)
    told = np.concatenate([np.zeros(6), result.command.v])
    asked = controller.dynwbc.acceleration_reference(told, state.v, controller.config.dt)
    np.testing.assert_allclose(asked[6:], result.dynwbc.acceleration[6:], rtol=0, atol=1e-8)


@pytest.mark.parametrize(("scale", "speed"), [(0.003, 0.02), (0.02, 3.0)])
def test_velocity_bounds_hold_and_the_report_is_that_of_the_bounded_command(
    name: str, scale: float, speed: float
) -> None:
    """At 0.02 rad/s the motors can keep to the bounds; at 3 rad/s nothing can, and the command is cut."""
    controller, reference = ready(name, "ecbf", velocity_scale=scale)
    hands_into_torso(reference)
    state = moving_state(controller, np.random.default_rng(3), speed)
    controller.reset(state)
    result = controller.tick(state, reference)
    bounds = scale * controller.robot.joint_array("velocity")
    assert (np.abs(result.command.v) <= bounds).all()
    assert (np.abs(result.command.v) > bounds - 1e-9).any()
    rows = controller.barriers.evaluate(controller.kin, second_order=True)
    spaces = ecbf(rows, state.v, controller.config.safety.parameters().of_rows(rows.family))
    asked = controller.dynwbc.acceleration_reference(result.safety.v, state.v, controller.config.dt)
    assert result.safety.slack == pytest.approx(max(0.0, float((spaces.b - spaces.A @ asked).max())), abs=1e-6)
    if speed == 0.02:
        joints = result.dynwbc.acceleration[6:]
        told = controller.dynwbc.velocity_command(result.dynwbc.acceleration, state.v, controller.config.dt)[6:]
        assert (np.abs(told) <= bounds + 1e-9).all()
        assert np.abs(joints).max() > 0.1


def racing_state(controller: WholeBodyController) -> RobotState:
    """The closest two bodies race into each other."""
    kin = controller.kin
    kin.update(standing_configuration(controller.robot, POSTURE), np.zeros(kin.nv))
    rows = controller.barriers.evaluate(kin)
    pairs = controller.barriers.slices["self_collision"]
    closest = pairs.start + int(np.argmin(rows.h[pairs]))
    v = np.zeros(kin.nv)
    v[6:] = -200.0 * rows.jac[closest, 6:]
    return RobotState(kin.q.copy(), v, np.zeros(kin.nv - 6), 0.0)


def test_conditions_that_no_torque_can_meet_are_relaxed_and_reported(name: str) -> None:
    """Arms that race into the torso cannot be stopped by their motors."""
    controller, reference = ready(name, "ecbf")
    robot, state = controller.robot, racing_state(controller)
    controller.reset(state)
    result = controller.tick(state, reference)
    assert result.dynwbc.status == "optimal" and result.dynwbc.relaxed
    assert result.safety.status == FilterStatus.RELAXED
    assert result.safety.slack == pytest.approx(result.safety.violation.max(), rel=1e-12)
    assert (np.abs(result.dynwbc.torque) <= robot.joint_array("effort") + 1e-7).all()


def test_no_perturbation_leaves_dynwbc_without_an_answer(name: str) -> None:
    """The same conflict with every number of the problem off by rounding, seen by new solvers and by used ones."""
    controller, reference = ready(name, "ecbf")
    state = racing_state(controller)
    problems: list[DynWbcProblem] = []
    solve = controller.dynwbc.solve

    def kept(problem: DynWbcProblem) -> DynWbcResult:
        problems.append(problem)
        return solve(problem)

    controller.dynwbc.solve = kept
    controller.reset(state)
    controller.tick(state, reference)
    problem, rng = problems[0], np.random.default_rng(0)
    contacts = [SoleContact(s.frame, s.half_length, s.half_width, 0.6) for s in controller.robot.soles]
    effort, count = controller.robot.joint_array("effort"), controller.barriers.size
    used, slack, slack_seen = TorqueQp((0, 1), contacts, effort, "daqp", count), [], []
    for i in range(60):
        parts = {part: getattr(problem, part) for part in ("hessian", "gradient", "rows", "lower", "upper")}
        noisy = {part: a * (1.0 + 1e-15 * rng.normal(size=a.shape)) for part, a in parts.items()}
        noisy["hessian"] = 0.5 * (noisy["hessian"] + noisy["hessian"].T)
        qp = used if i % 2 else TorqueQp((0, 1), contacts, effort, "daqp", count)
        solution, relaxed = qp.solve(replace(problem, **noisy))
        assert solution.status == "optimal" and relaxed
        # cones and torques hold, and the conditions are as short as they were
        value = problem.rows @ solution.x
        limits = slice(0, len(value) - count)
        assert (value[limits] <= problem.upper[problem.gradient.size :][limits] + 1e-6).all()
        assert (value[limits] >= problem.lower[problem.gradient.size :][limits] - 1e-6).all()
        short = np.maximum(0.0, problem.lower[-count:] - value[-count:])
        slack.append(float(np.linalg.norm(short)))
        if not solution.spent:
            slack_seen.append(slack[-1])
    assert len(slack_seen) > 50
    assert np.ptp(slack_seen) <= 1e-5 * max(slack_seen)
    # where the budget was spent, it was close
    assert max(slack) <= 1.01 * min(slack_seen)
