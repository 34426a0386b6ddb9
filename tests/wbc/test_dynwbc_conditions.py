"""Conditions on the acceleration inside DynWBC, against the full problem over (q_dd, F, tau)."""

import numpy as np
import pytest

from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array
from robots.pinocchio_model import standing_configuration
from tests.support.budgets import limit
from wbc.contact import SoleContact, wrench_cone
from wbc.dynwbc import DynWbc, DynWbcResult, DynWbcWeights
from wbc.least_slack import LeastSlack
from wbc.qp import UNBOUNDED, make_solver

COUNT = 6
BOTH = (True, True)
SUPPORTS = pytest.mark.parametrize("support", [BOTH, (True, False), (False, True)], ids=["both", "left", "right"])
WEIGHTS = DynWbcWeights()


class Setting:
    """A moving robot, asked for a random acceleration."""

    def __init__(self, name: str, seed: int, support: tuple[bool, bool] = BOTH) -> None:
        self.in_contact = np.array(support)
        rng = np.random.default_rng(seed)
        robot = load_robot(name)
        self.rng, self.kin = rng, Kinematics(robot)
        kin = self.kin
        q = standing_configuration(robot)
        q[7:] += 0.05 * rng.normal(size=q.size - 7)
        kin.update(q, 0.3 * rng.normal(size=kin.nv))
        self.contacts = [SoleContact(s.frame, s.half_length, s.half_width, 0.6) for s in robot.soles]
        self.acceleration = 2.0 * rng.normal(size=kin.nv)
        self.wrench = np.tile([0.0, 0.0, 0.5 * robot.total_mass * 9.81, 0.0, 0.0, 0.0], 2)
        self.previous = 0.1 * robot.joint_array("effort") * rng.normal(size=len(robot.joints))

    def solve(self, conditions: tuple[Array, Array] | None) -> tuple[DynWbc, DynWbcResult]:
        count = 0 if conditions is None else len(conditions[1])
        dynwbc = DynWbc(self.kin, self.contacts, WEIGHTS, condition_count=count)
        dynwbc.reset(self.previous)
        problem = dynwbc.build(self.kin, self.acceleration, self.wrench, self.in_contact, conditions=conditions)
        return dynwbc, dynwbc.solve(problem)

    def full_problem(self, conditions: tuple[Array, Array]) -> tuple[Array, Array, Array, Array, Array]:
        """Eqs. (16)-(18) with the conditions as further rows."""
        kin, w, nv, nj, nf = self.kin, WEIGHTS, self.kin.nv, self.kin.nv - 6, 12
        jacobian = np.vstack([kin.frame_jacobian(kin.frame_id(c.frame), local=True) for c in self.contacts])
        jacobian[np.repeat(~self.in_contact, 6)] = 0.0
        wrench_weight = np.tile([w.force] * 3 + [w.moment] * 3, 2)
        hessian = np.zeros((nv + nf + nj,) * 2)
        mass = np.array(kin.mass_matrix)
        hessian[:nv, :nv] = w.acceleration * np.eye(nv) + w.energy * mass
        hessian[nv : nv + nf, nv : nv + nf] = np.diag(wrench_weight)
        hessian[nv + nf :, nv + nf :] = w.torque_rate * np.eye(nj)
        gradient = -np.concatenate(
            [w.acceleration * self.acceleration, wrench_weight * self.wrench, w.torque_rate * self.previous]
        )
        cone = np.zeros((32, nf))
        for i, contact in enumerate(self.contacts):
            cone[16 * i : 16 * i + 16, 6 * i : 6 * i + 6] = wrench_cone(contact)
        selection = np.hstack([np.zeros((nj, 6)), np.eye(nj)])
        dynamics = np.hstack([mass, -jacobian.T, -selection.T])
        none = np.zeros
        rows = np.vstack(
            [
                dynamics,
                np.hstack([none((32, nv)), cone, none((32, nj))]),
                np.hstack([conditions[0], none((len(conditions[1]), nf + nj))]),
            ]
        )
        effort, free = kin.robot.joint_array("effort"), np.full(nv + nf, UNBOUNDED)
        out_of_reach = np.full(len(conditions[1]), UNBOUNDED)
        free[nv:][np.repeat(~self.in_contact, 6)] = 0.0
        lower = np.concatenate([-free, -effort, -kin.bias, np.full(32, -UNBOUNDED), conditions[1]])
        upper = np.concatenate([free, effort, -kin.bias, np.zeros(32), out_of_reach])
        return hessian, gradient, rows, lower, upper


@pytest.fixture(params=["g1", "tocabi"])
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@SUPPORTS
@pytest.mark.parametrize("seed", range(5))
def test_the_optimum_is_that_of_the_full_problem(name: str, seed: int, support: tuple[bool, bool]) -> None:
    setting = Setting(name, seed, support)
    matrix, bound = setting.rng.normal(size=(COUNT, setting.kin.nv)), np.zeros(COUNT)
    _, free = setting.solve(None)
    bound = matrix @ free.acceleration + np.array([0.5, 0.3, 0.2, -0.5, -5.0, 0.1])
    _, result = setting.solve((matrix, bound))
    problem = setting.full_problem((matrix, bound))
    expected = make_solver("proxqp", problem[1].size, len(problem[2])).solve(*problem)
    assert expected.status == "optimal"
    assert result.status == "optimal" and not result.relaxed
    nv = setting.kin.nv
    np.testing.assert_allclose(result.acceleration, expected.x[:nv], rtol=0, atol=1e-6 * np.abs(expected.x[:nv]).max())
    np.testing.assert_allclose(result.torque, expected.x[nv + 12 :], rtol=0, atol=1e-5)
    gap = matrix @ result.acceleration - bound
    assert gap.min() > -1e-8
    assert (gap < 1e-7).any()


def test_conditions_that_hold_anyway_change_nothing(name: str) -> None:
    setting = Setting(name, 11)
    _, free = setting.solve(None)
    matrix = setting.rng.normal(size=(COUNT, setting.kin.nv))
    _, result = setting.solve((matrix, matrix @ free.acceleration - 1.0))
    np.testing.assert_allclose(result.torque, free.torque, rtol=0, atol=1e-9)
    assert not result.relaxed


@SUPPORTS
@pytest.mark.parametrize("seed", range(3))
def test_conditions_in_conflict_are_violated_by_the_least_squares(
    name: str, seed: int, support: tuple[bool, bool]
) -> None:
    setting = Setting(name, seed, support)
    _, free = setting.solve(None)
    matrix = setting.rng.normal(size=(COUNT, setting.kin.nv))
    matrix[1], matrix[3] = -matrix[0], -2.0 * matrix[2]
    bound = matrix @ free.acceleration - 0.1
    bound[0], bound[1] = 1.0, 1.0
    bound[2], bound[3] = 0.5, 0.5
    dynwbc, result = setting.solve((matrix, bound))
    assert result.status == "optimal" and result.relaxed
    short = np.maximum(0.0, bound - matrix @ result.acceleration)
    # two against each other: a + b = 2 shared evenly, and a + b / 2 = 0.75 shared as 1 : 1/2 of its multiplier
    np.testing.assert_allclose(short[:2], [1.0, 1.0], atol=1e-4)
    np.testing.assert_allclose(short[2:4], [0.6, 0.3], atol=1e-4)
    np.testing.assert_allclose(short[4:], 0.0, atol=1e-4)
    effort = setting.kin.robot.joint_array("effort")
    assert (np.abs(result.torque) <= effort + 1e-9).all()
    cone = np.concatenate([wrench_cone(c) @ result.wrench[6 * i : 6 * i + 6] for i, c in enumerate(setting.contacts)])
    assert cone.max() < 1e-8
    # the next problem, with nothing in conflict, is solved as if there had been none
    problem = dynwbc.build(
        setting.kin,
        setting.acceleration,
        setting.wrench,
        setting.in_contact,
        conditions=(matrix, matrix @ free.acceleration - 1.0),
    )
    assert not dynwbc.solve(problem).relaxed


def test_another_number_of_conditions_is_refused(name: str) -> None:
    setting = Setting(name, 0)
    dynwbc = DynWbc(setting.kin, setting.contacts, WEIGHTS, condition_count=2)
    for conditions in (None, (np.zeros((3, setting.kin.nv)), np.zeros(3))):
        with pytest.raises(ValueError, match="2 announced"):
            dynwbc.build(setting.kin, setting.acceleration, setting.wrench, setting.in_contact, conditions=conditions)


@pytest.mark.parametrize(("steps", "rounds"), [(0, 300), (1, 300)])
def test_a_spent_budget_costs_slack_and_never_the_limits(
    name: str, steps: int, rounds: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    setting = Setting(name, 0)
    _, free = setting.solve(None)
    matrix = setting.rng.normal(size=(COUNT, setting.kin.nv))
    matrix[1] = -matrix[0]
    bound = matrix @ free.acceleration - 0.1
    bound[0], bound[1] = 5.0, 5.0
    _, least = setting.solve((matrix, bound))
    limit(monkeypatch, LeastSlack, steps=steps, rounds=rounds)
    dynwbc = DynWbc(setting.kin, setting.contacts, WEIGHTS, condition_count=COUNT)
    dynwbc.reset(setting.previous)
    arguments = setting.kin, setting.acceleration, setting.wrench, setting.in_contact
    problem = dynwbc.build(*arguments, conditions=(matrix, bound))
    result = dynwbc.solve(problem)
    assert result.status == "optimal" and result.relaxed
    assert result.spent
    effort = setting.kin.robot.joint_array("effort")
    assert (np.abs(result.torque) <= effort + 1e-7).all()
    cone = np.concatenate([wrench_cone(c) @ result.wrench[6 * i : 6 * i + 6] for i, c in enumerate(setting.contacts)])
    assert cone.max() < 1e-7
    short, fewest, start = (
        np.linalg.norm(np.maximum(0.0, bound - matrix @ a))
        for a in (result.acceleration, least.acceleration, free.acceleration)
    )
    assert fewest - 1e-4 <= short <= start + 1e-4
