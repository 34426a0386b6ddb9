"""DynWBC's reduced problem against the full one of eqs. (16)-(18) over (q_dd, F, tau), solved by other means."""

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import nnls

from robots.kinematics import Kinematics
from robots.messages import Array, Mask
from robots.pinocchio_model import standing_configuration
from wbc.contact import SoleContact, wrench_cone
from wbc.dynwbc import DynWbc, DynWbcResult, DynWbcWeights, contact_bias_acceleration
from wbc.qp import kkt_residual, make_solver
from wbc.torque_qp import DynWbcProblem

SUPPORTS = {"both": (True, True), "left": (True, False), "right": (False, True), "none": (False, False)}
WEIGHTS = {
    "default": DynWbcWeights(),
    "paper": DynWbcWeights(acceleration=1.0, force=1.0, moment=1.0, torque_rate=1e-2, energy=1e-2),
    "no rate, no energy": DynWbcWeights(torque_rate=0.0, energy=0.0),
    "loose wrench": DynWbcWeights(force=1e-4, moment=1e-2, torque_rate=1e-2),
    "much energy": DynWbcWeights(energy=0.3, acceleration=0.2),
    "soft contact": DynWbcWeights(contact=10.0),
}
AGREEMENT = {"daqp": 1e-9, "proxqp": 1e-7}
"""Of q_dd, F and tau, relative to the largest entry of each: an active-set method is exact, ProxQP iterates."""


@dataclass
class Case:
    """One state and its references."""

    kin: Kinematics
    contacts: list[SoleContact]
    weights: DynWbcWeights
    acceleration: Array
    wrench: Array
    in_contact: Mask
    previous: Array

    def jacobian(self) -> Array:
        """Of both soles in sole axes, zero for a swing foot; by a work space of its own."""
        model, data = self.kin.model, self.kin.model.createData()
        rows = []
        for contact, touching in zip(self.contacts, self.in_contact, strict=True):
            frame = model.getFrameId(contact.frame)
            rows.append(touching * pin.computeFrameJacobian(model, data, self.kin.q, frame, pin.ReferenceFrame.LOCAL))
        return np.vstack(rows)

    def bias(self) -> Array:
        """J_c_dot q_dot, in sole axes; zero for a swing foot."""
        raw = contact_bias_acceleration(self.kin, [self.kin.frame_id(c.frame) for c in self.contacts])
        return raw * np.repeat(self.in_contact, 6)

    def dynamics(self) -> tuple[Array, Array]:
        """Mass matrix and bias forces, by a work space of their own."""
        model, data = self.kin.model, self.kin.model.createData()
        mass = pin.crba(model, data, self.kin.q)
        return np.triu(mass) + np.triu(mass, 1).T, pin.rnea(model, data, self.kin.q, self.kin.v, np.zeros(model.nv))


def random_case(kin: Kinematics, rng: np.random.Generator, support: str, weights: DynWbcWeights, push: float) -> Case:
    """Around the standing posture, in any orientation, moving; ``push`` scales what the references ask for."""
    q = standing_configuration(kin.robot)
    low, high = kin.robot.position_limits
    q[7:] = np.clip(q[7:] + 0.4 * rng.normal(size=low.size), low, high)
    q = kin.integrate(q, np.concatenate([rng.normal(size=6), np.zeros(low.size)]), 1.0)
    kin.update(q, rng.normal(size=kin.nv))
    # no foot like the other: which is which has to matter
    parts = zip(kin.robot.soles, (0.9, 0.7), (0.6, 0.5), strict=True)
    contacts = [
        SoleContact(s.frame, fraction * s.half_length, fraction * s.half_width, mu) for s, fraction, mu in parts
    ]
    weight = kin.robot.total_mass * 9.81
    scale = push * weight * np.array([0.3, 0.3, 0.5, 0.03, 0.05, 0.03])
    wrench = np.tile([0.0, 0.0, 0.5 * weight, 0.0, 0.0, 0.0], 2) + np.tile(scale, 2) * rng.normal(size=12)
    effort = kin.robot.joint_array("effort")
    previous = 0.3 * effort * rng.uniform(-1.0, 1.0, effort.size)
    return Case(
        kin, contacts, weights, 5.0 * push * rng.normal(size=kin.nv), wrench, np.array(SUPPORTS[support]), previous
    )


def controller(case: Case, solver: str = "daqp") -> DynWbc:
    dynwbc = DynWbc(case.kin, case.contacts, case.weights, solver)
    dynwbc.reset(case.previous)
    return dynwbc


def build(case: Case, dynwbc: DynWbc) -> DynWbcProblem:
    return dynwbc.build(case.kin, case.acceleration, case.wrench, case.in_contact, case.bias())


def wrenches(case: Case, x: Array) -> Array:
    """Both feet's wrenches (12,) in a reduced x: none on a foot in the air."""
    out = np.zeros(12)
    out[np.repeat(case.in_contact, 6)] = x[case.kin.nv - 6 :]
    return out


def full_cost(case: Case) -> tuple[Array, Array, float]:
    """Half the cost of eq. (16) as x^T H x / 2 + g^T x + c over x = (q_dd, F, tau)."""
    w, nv = case.weights, case.kin.nv
    mass, _ = case.dynamics()
    jacobian, bias = case.jacobian(), case.bias()
    by_wrench = np.tile([w.force] * 3 + [w.moment] * 3, 2)
    size = nv + 12 + nv - 6
    hessian = np.zeros((size, size))
    hessian[:nv, :nv] = w.acceleration * np.eye(nv) + w.energy * mass + w.contact * jacobian.T @ jacobian
    hessian[nv : nv + 12, nv : nv + 12] = np.diag(by_wrench)
    hessian[nv + 12 :, nv + 12 :] = w.torque_rate * np.eye(nv - 6)
    parts = [
        -w.acceleration * case.acceleration + w.contact * jacobian.T @ bias,
        -by_wrench * case.wrench,
        -w.torque_rate * case.previous,
    ]
    constant = w.acceleration * case.acceleration @ case.acceleration + by_wrench @ case.wrench**2
    constant += w.torque_rate * case.previous @ case.previous + w.contact * bias @ bias
    return hessian, np.concatenate(parts), 0.5 * float(constant)


def full_rows(case: Case) -> tuple[Array, Array, Array, Array]:
    """Equalities E x = e (eq. (18) and swing feet) and inequalities G x <= d (eq. (17) and torque limits)."""
    nv = case.kin.nv
    mass, forces = case.dynamics()
    select = np.hstack([np.zeros((nv - 6, 6)), np.eye(nv - 6)])
    motion = np.hstack([mass, -case.jacobian().T, -select.T])
    swing = np.repeat(~case.in_contact, 6)
    held = np.hstack([np.zeros((12, nv)), np.eye(12), np.zeros((12, nv - 6))])[swing]
    equal = np.vstack([motion, held])
    right = np.concatenate([-forces, np.zeros(len(held))])
    cones = []
    for i, contact in enumerate(case.contacts):
        if case.in_contact[i]:
            rows = np.zeros((16, equal.shape[1]))
            rows[:, nv + 6 * i : nv + 6 * i + 6] = wrench_cone(contact)
            cones.append(rows)
    torque = np.hstack([np.zeros((nv - 6, nv + 12)), np.eye(nv - 6)])
    effort = case.kin.robot.joint_array("effort")
    sides = np.vstack([*cones, torque, -torque])
    return equal, right, sides, np.concatenate([np.zeros(16 * len(cones)), effort, effort])


def full_solution(case: Case) -> tuple[Array, int, int]:
    """Minimiser of the full form and how many cone and torque sides it presses on; certified by its KKT conditions.

    The active set comes from non-negative least squares (see ``test_qp``) on an orthonormal basis of the null space
    of the equalities, the numbers from one linear solve of the full optimality system on it.
    """
    hessian, gradient, _ = full_cost(case)
    equal, right, sides, limits = full_rows(case)
    active = active_sides(hessian, gradient, equal, right, sides, limits)
    rows = np.vstack([equal, sides[active]])
    n = gradient.size
    system = np.block([[hessian, rows.T], [rows, np.zeros((len(rows), len(rows)))]])
    scale = 1.0 / np.sqrt(abs(system).max(axis=1))
    answer = np.linalg.lstsq(
        system * scale[:, None] * scale, scale * np.concatenate([-gradient, right, limits[active]]), rcond=None
    )[0]
    answer *= scale
    x, multipliers = answer[:n], answer[n + len(equal) :]
    assert (sides @ x - limits).max() < 1e-8
    assert multipliers.min(initial=0.0) > -1e-8
    assert abs(hessian @ x + gradient + rows.T @ answer[n:]).max() < 1e-8 * max(1.0, abs(gradient).max())
    assert abs(equal @ x - right).max() < 1e-8 * abs(right).max()
    cones = 16 * int(case.in_contact.sum())
    return x, int(active[:cones].sum()), int(active[cones:].sum())


def active_sides(hessian: Array, gradient: Array, equal: Array, right: Array, sides: Array, limits: Array) -> Mask:
    start = np.linalg.lstsq(equal, right, rcond=None)[0]
    _, sigma, vt = np.linalg.svd(equal)
    free = vt[int((sigma > 1e-10 * sigma[0]).sum()) :].T
    factor = np.linalg.cholesky(free.T @ hessian @ free)
    shift = np.linalg.solve(factor, free.T @ (hessian @ start + gradient))
    reduced = np.linalg.solve(factor, (sides @ free).T).T
    room = limits - sides @ start + reduced @ shift
    # y measured in units of its unconstrained size, so that the last residual does not vanish beside it
    unit = max(1.0, float(np.linalg.norm(shift)))
    norms = np.linalg.norm(reduced, axis=1)
    matrix = -np.vstack([(reduced / norms[:, None]).T, room / norms / unit])
    weights, _ = nnls(matrix, np.append(np.zeros(free.shape[1]), 1.0), maxiter=10_000)
    return weights > 0


def assert_agrees(case: Case, result: DynWbcResult, solver: str = "daqp") -> tuple[int, int]:
    expected, cones, limits = full_solution(case)
    nv = case.kin.nv
    assert result.status == "optimal"
    for mine, theirs in (
        (result.acceleration, expected[:nv]),
        (result.wrench, expected[nv : nv + 12]),
        (result.torque, expected[nv + 12 :]),
    ):
        np.testing.assert_allclose(mine, theirs, rtol=0, atol=AGREEMENT[solver] * max(1.0, abs(theirs).max()))
    return cones, limits


def assert_constraints_hold(case: Case, result: DynWbcResult) -> None:
    kin, effort = case.kin, case.kin.robot.joint_array("effort")
    data = kin.model.createData()
    needed = pin.rnea(kin.model, data, kin.q, kin.v, result.acceleration)
    given = case.jacobian().T @ result.wrench
    given[6:] += result.torque
    np.testing.assert_allclose(given, needed, rtol=0, atol=1e-9 * max(abs(needed).max(), abs(result.wrench).max()))
    assert (abs(result.torque) <= effort + 1e-7).all()
    for i, contact in enumerate(case.contacts):
        part = result.wrench[6 * i : 6 * i + 6]
        if case.in_contact[i]:
            assert (wrench_cone(contact) @ part).max() < 1e-7
        else:
            assert not part.any()


@pytest.mark.parametrize("support", SUPPORTS)
@pytest.mark.parametrize("weights", WEIGHTS)
def test_the_reduced_form_has_the_optimum_of_the_full_form(kin: Kinematics, support: str, weights: str) -> None:
    rng = np.random.default_rng(list(WEIGHTS).index(weights))
    for push in (0.3, 2.0):
        case = random_case(kin, rng, support, WEIGHTS[weights], push)
        dynwbc = controller(case)
        result = dynwbc.solve(build(case, dynwbc))
        assert_agrees(case, result)
        assert_constraints_hold(case, result)


def test_pressed_cones_and_torque_limits_agree_too(kin: Kinematics) -> None:
    """References that ask for the impossible: many sides active at once, in both families."""
    rng = np.random.default_rng(10)
    cones = limits = 0
    for support in ("both", "left", "right", "none"):
        for push in (4.0, 20.0):
            case = random_case(kin, rng, support, WEIGHTS["default"], push)
            dynwbc = controller(case)
            result = dynwbc.solve(build(case, dynwbc))
            pressed = assert_agrees(case, result)
            assert_constraints_hold(case, result)
            cones, limits = cones + pressed[0], limits + pressed[1]
    assert cones > 10
    assert limits > 10


@pytest.mark.parametrize("solver", ["daqp", "proxqp"])
def test_both_solvers_reach_the_optimum_and_meet_its_conditions(kin: Kinematics, solver: str) -> None:
    rng = np.random.default_rng(11)
    for support in SUPPORTS:
        for push in (0.3, 2.0):
            case = random_case(kin, rng, support, WEIGHTS["default"], push)
            dynwbc = controller(case, solver)
            problem = build(case, dynwbc)
            parts = problem.hessian, problem.gradient, problem.rows, problem.lower, problem.upper
            fresh = make_solver(solver, problem.gradient.size, len(problem.rows))
            solution = fresh.solve(*parts)
            assert solution.status == "optimal"
            assert kkt_residual(*parts, solution) < 1e-8 * max(1.0, abs(solution.multipliers).max())
            assert_agrees(case, dynwbc.solve(problem), solver)


def test_a_sequence_agrees_step_by_step_and_each_step_starts_from_the_torques_before(kin: Kinematics) -> None:
    """One warm-started controller through changes of support, tau_prev handed on inside."""
    rng = np.random.default_rng(12)
    first = random_case(kin, rng, "both", WEIGHTS["paper"], 0.5)
    dynwbc, previous = controller(first), first.previous
    for support in ("both", "both", "left", "left", "none", "right", "right", "both"):
        case = replace(random_case(kin, rng, support, WEIGHTS["paper"], 0.5), previous=previous)
        result = dynwbc.solve(build(case, dynwbc))
        assert_agrees(case, result)
        previous = result.torque


@pytest.mark.parametrize("support", SUPPORTS)
@pytest.mark.parametrize("only", ["acceleration", "force", "moment", "torque_rate", "energy", "contact"])
def test_each_term_of_the_reduced_cost_is_that_of_the_paper(kin: Kinematics, support: str, only: str) -> None:
    """One weight large, the others negligible: the reduced cost is half of eq. (16), up to a constant."""
    rng = np.random.default_rng(13)
    tiny = {"acceleration": 1e-9, "force": 1e-9, "moment": 1e-9, "torque_rate": 0.0, "energy": 0.0, "contact": 0.0}
    case = random_case(kin, rng, support, DynWbcWeights(**(tiny | {only: 1.0})), 1.0)
    dynwbc = controller(case)
    problem = build(case, dynwbc)
    hessian, gradient, constant = full_cost(case)
    gaps, sizes = [], []
    for x in rng.normal(size=(6, problem.gradient.size)) * 10.0:
        base = problem.base @ np.append(x, 1.0)
        torque = problem.torque @ np.append(x, 1.0)
        full = np.concatenate([base, x[: kin.nv - 6], wrenches(case, x), torque])
        expected = 0.5 * full @ hessian @ full + gradient @ full + constant
        gaps.append(expected - (0.5 * x @ problem.hessian @ x + problem.gradient @ x))
        sizes.append(abs(expected))
    np.testing.assert_allclose(gaps, gaps[0], rtol=0, atol=1e-11 * max(sizes))


def test_the_gradient_of_the_reduced_cost_is_that_of_the_energy_by_differences(kin: Kinematics) -> None:
    """The energy q_dd^T M q_dd is quadratic: central differences of it are exact to rounding."""
    rng = np.random.default_rng(14)
    case = random_case(kin, rng, "both", DynWbcWeights(1e-12, 1e-12, 1e-12, 0.0, 1.0), 0.0)
    problem = build(case, controller(case))
    mass, _ = case.dynamics()

    def energy(x: Array) -> float:
        acceleration = np.concatenate([problem.base @ np.append(x, 1.0), x[: kin.nv - 6]])
        return float(0.5 * acceleration @ mass @ acceleration)

    x = rng.normal(size=problem.gradient.size)
    numeric = [0.5 * (energy(x + e) - energy(x - e)) for e in np.eye(x.size)]
    np.testing.assert_allclose(problem.hessian @ x + problem.gradient, numeric, rtol=0, atol=1e-8)


@pytest.mark.parametrize("support", SUPPORTS)
def test_the_maps_of_a_problem_are_the_equations_of_motion(kin: Kinematics, support: str) -> None:
    """Any x, optimal or not: base and torque maps give what inverse dynamics gives."""
    rng = np.random.default_rng(15)
    case = random_case(kin, rng, support, WEIGHTS["default"], 1.0)
    problem = build(case, controller(case))
    for x in rng.normal(size=(5, problem.gradient.size)) * 20.0:
        joints = x[: kin.nv - 6]
        acceleration = np.concatenate([problem.base @ np.append(x, 1.0), joints])
        needed = pin.rnea(kin.model, kin.model.createData(), kin.q, kin.v, acceleration)
        needed -= case.jacobian().T @ wrenches(case, x)
        size = abs(needed).max()
        np.testing.assert_allclose(needed[:6], 0.0, rtol=0, atol=1e-10 * size)
        np.testing.assert_allclose(problem.torque @ np.append(x, 1.0), needed[6:], rtol=0, atol=1e-10 * size)
        np.testing.assert_array_equal(problem.rows[-(kin.nv - 6) :], problem.torque[:, :-1])


@pytest.mark.parametrize("support", SUPPORTS)
def test_the_limits_and_the_answer_of_a_problem_are_what_its_maps_say(kin: Kinematics, support: str) -> None:
    case = random_case(kin, np.random.default_rng(16), support, WEIGHTS["default"], 1.0)
    dynwbc = controller(case)
    problem = build(case, dynwbc)
    effort, offset = kin.robot.joint_array("effort"), problem.torque[:, -1]
    np.testing.assert_array_equal(problem.lower[-(kin.nv - 6) :], -effort - offset)
    np.testing.assert_array_equal(problem.upper[-(kin.nv - 6) :], effort - offset)
    result = dynwbc.solve(problem)
    assert result.status == "optimal"
    joints = result.acceleration[6:]
    x = np.append(joints, np.concatenate([result.wrench[6 * foot : 6 * foot + 6] for foot in problem.feet] or [[]]))
    for found, expected in (
        (result.acceleration[:6], problem.base[:, :-1] @ x + problem.base[:, -1]),
        (result.torque, problem.torque[:, :-1] @ x + offset),
    ):
        np.testing.assert_allclose(
            found, expected, rtol=0, atol=1e-12 * (1.0 + abs(problem.torque).max() * abs(x).max())
        )
