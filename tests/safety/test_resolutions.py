"""The inputs that resolutions pick: against other solvers, by optimality conditions, and in closed form."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linprog, nnls

from robots.messages import Array
from safety.barriers.rows import FAMILIES, BarrierRows
from safety.filters.conditions import BarrierParameters, FamilyParameters
from safety.filters.conflict import Candidates, minimal_conflict
from safety.filters.safety_filter import FilterResult, FilterStatus, MetricWeights, SafetyFilter
from tests.support.rows import rows_demanding
from wbc.qp import UNBOUNDED, make_solver

OBSTACLE = FAMILIES.index("obstacle")
V_MAX = 2.0
ETA = 0.5
KINDS_OF_PROBLEM = ("plain", "duplicate", "zero", "opposite", "scaled")


def make(name: str, n: int, nv: int, foot_weight: float = 0.0, **parameters: float) -> SafetyFilter:
    family = FamilyParameters(eta=ETA, **parameters)
    return SafetyFilter(name, n, BarrierParameters(obstacle=family), np.full(nv, V_MAX), MetricWeights(foot_weight))


def degenerate(kind: str, A: Array, b: Array, v: Array) -> tuple[Array, Array]:
    """Rows that still hold at ``v``, in a shape that solvers do not like."""
    A, b = A.copy(), b.copy()
    if kind == "duplicate":
        A[1], b[1] = A[0], b[0]
        A[2], b[2] = 2 * A[0], 2 * b[0]
    elif kind == "zero":
        A[0], b[0] = 0.0, -0.3
        A[1], b[1] = 0.0, 0.0
    elif kind == "opposite":
        A[1], b[1] = -A[0], -A[0] @ v
        b[0] = A[0] @ v - 1e-3
    elif kind == "scaled":
        A[:3] *= 1e3
        b[:3] *= 1e3
    return A, b


def feasible(kind: str, rng: np.random.Generator, nv: int = 4, n: int = 9) -> tuple[Array, Array, Array]:
    """Rows with a common velocity between the bounds, and a nominal velocity."""
    A, v = rng.normal(size=(n, nv)), rng.uniform(-0.8 * V_MAX, 0.8 * V_MAX, nv)
    A, b = degenerate(kind, A, A @ v - rng.uniform(0.0, 1.0, n), v)
    return A, b, rng.normal(scale=2.0, size=nv)


def explicit(
    hessian: Array, v_des: Array, A: Array, b: Array, slack_cost: float | None, pull: float = 1.0
) -> tuple[Array, Array]:
    """The same problem for ProxQP, with slack variables where they cost something; velocity and slack."""
    nv, n = v_des.size, b.size
    if slack_cost is None:
        solver, H, g, rows = make_solver("proxqp", nv, n), hessian, -hessian @ v_des, A
        lower, upper = np.append(np.full(nv, -V_MAX), b), np.append(np.full(nv, V_MAX), np.full(n, UNBOUNDED))
        solution = solver.solve(H, g, rows, lower, upper)
    else:
        solver = make_solver("proxqp", nv + n, n)
        H = np.zeros((nv + n, nv + n))
        H[:nv, :nv], H[nv:, nv:] = pull * hessian, slack_cost * np.eye(n)
        g = np.append(-pull * hessian @ v_des, np.zeros(n))
        lower = np.concatenate([np.full(nv, -V_MAX), np.zeros(n), b])
        upper = np.concatenate([np.full(nv, V_MAX), np.full(2 * n, UNBOUNDED)])
        solution = solver.solve(H, g, np.hstack([A, np.eye(n)]), lower, upper)
    assert solution.status == "optimal"
    return solution.x[:nv], solution.x[nv:]


def kkt_residual(hessian: Array, v_des: Array, A: Array, b: Array, v: Array) -> float:
    """What is left of the cost's gradient that no non-negative multipliers of sides at their limit explain."""
    scale = np.maximum(1.0, np.abs(A).max(axis=1, initial=1.0))
    tight = (A @ v - b) / scale < 1e-7
    eye = np.eye(v.size)
    sides = [(A / scale[:, None])[tight], eye[v <= -V_MAX + 1e-9], -eye[v >= V_MAX - 1e-9]]
    normals = np.vstack(sides).T
    gradient = hessian @ (v - v_des)
    return float(nnls(normals, gradient)[1]) if normals.size else float(np.linalg.norm(gradient))


@pytest.mark.parametrize("name", ["ssa", "pssa"])
@pytest.mark.parametrize("kind", KINDS_OF_PROBLEM)
def test_the_nearest_velocity_is_a_second_solvers_and_optimal(kind: str, name: str) -> None:
    rng = np.random.default_rng(KINDS_OF_PROBLEM.index(kind))
    kept, filtered = make(name, 9, 4, foot_weight=5.0), 0
    for _ in range(250):
        A, b, v_des = feasible(kind, rng)
        feet = rng.normal(size=(2, 4))
        result = kept.apply(rows_demanding(A, b, ETA), v_des, feet)
        hessian = np.eye(4) + 5.0 * feet.T @ feet
        assert result.status in {FilterStatus.UNCHANGED, FilterStatus.FILTERED}
        np.testing.assert_allclose(result.v, explicit(hessian, v_des, A, b, None)[0], rtol=0, atol=1e-6)
        assert kkt_residual(hessian, v_des, A, b, result.v) < 1e-8 * max(1.0, float(np.abs(v_des).max()))
        filtered += result.status == FilterStatus.FILTERED
    assert filtered > 150


@pytest.mark.parametrize("close", [10, 60, 400])
@pytest.mark.parametrize("nv", [20, 35])
def test_rows_that_no_solver_saw_would_change_nothing(nv: int, close: int) -> None:
    """979 rows, of which more than any small solver holds may matter: as one large solver that sees all."""
    rng = np.random.default_rng(close)
    n, hessian = 979, np.eye(nv)
    kept, full = make("ssa", n, nv), make_solver("daqp", nv, n)
    for _ in range(6):
        A, v = rng.normal(scale=0.3, size=(n, nv)), rng.uniform(-1, 1, nv)
        room = np.where(np.arange(n) < close, rng.uniform(0, 0.2, n), 5.0)
        b, v_des = A @ v - room, v + rng.normal(scale=2.0, size=nv)
        result = kept.apply(rows_demanding(A, b, ETA), v_des)
        assert result.status == FilterStatus.FILTERED
        lower, upper = np.append(np.full(nv, -V_MAX), b), np.append(np.full(nv, V_MAX), np.full(n, UNBOUNDED))
        solution = full.solve(hessian, -v_des, A, lower, upper)
        assert solution.status == "optimal"
        np.testing.assert_allclose(result.v, solution.x, rtol=0, atol=1e-7)


def infeasible(rng: np.random.Generator, nv: int = 4, n: int = 9) -> tuple[Array, Array, Array]:
    A = rng.normal(size=(n, nv))
    A[1] = -A[0]
    b = rng.normal(scale=0.5, size=n)
    b[:2] = rng.uniform(0.1, 1.0, 2)
    return A, b, rng.normal(scale=2.0, size=nv)


def test_relaxed_conditions_have_the_least_sum_of_squares_of_a_second_solver() -> None:
    rng = np.random.default_rng(20)
    kept = make("pssa", 9, 4)
    for _ in range(200):
        A, b, v_des = infeasible(rng)
        result = kept.apply(rows_demanding(A, b, ETA), v_des)
        assert result.status == FilterStatus.RELAXED
        _, slack = explicit(np.eye(4), v_des, A, b, 1.0, pull=0.0)
        own = np.maximum(0.0, b - A @ result.v)
        # phase II may use up the rounding, and then has less of another row's
        assert (own <= slack + 1e-6).all()
        assert own @ own == pytest.approx(slack @ slack, abs=1e-6)
        # phase II: the nearest velocity under the rows relaxed by that
        assert kkt_residual(np.eye(4), v_des, A, b - own, result.v) < 1e-8 * max(1.0, float(np.abs(v_des).max()))


def test_projection_is_plain_ssa_where_that_has_an_answer() -> None:
    rng = np.random.default_rng(21)
    for kind in KINDS_OF_PROBLEM:
        A, b, v_des = feasible(kind, rng)
        one, two = (make(name, 9, 4).apply(rows_demanding(A, b, ETA), v_des) for name in ("ssa", "pssa"))
        assert one.status == two.status
        np.testing.assert_array_equal(one.v, two.v)


@pytest.mark.parametrize("weight", [0.1, 10.0, 1e4])
def test_weighted_slack_is_equation_10_with_explicit_slack_variables(weight: float) -> None:
    rng = np.random.default_rng(22)
    kept = make("rssa", 9, 4, foot_weight=5.0, slack_weight=weight)
    for i in range(200):
        A, b, v_des = infeasible(rng) if i % 2 else feasible(KINDS_OF_PROBLEM[i // 2 % 5], rng)
        feet = rng.normal(size=(2, 4))
        result = kept.apply(rows_demanding(A, b, ETA), v_des, feet)
        # half of |v - v_des|^2 + 1/2 Q |s|^2
        other, slack = explicit(np.eye(4) + 5.0 * feet.T @ feet, v_des, A, b, 0.5 * weight)
        np.testing.assert_allclose(result.v, other, rtol=0, atol=1e-6)
        assert result.slack == pytest.approx(slack.max(), abs=1e-6 * max(1.0, float(np.abs(A).max())))


def test_one_weighted_row_has_the_closed_form() -> None:
    """|v - v_des|^2 + Q/2 s^2 with s = b - a v: v = v_des + a (Q/2) s, so s (1 + Q/2 |a|^2) = b - a v_des."""
    a, b, v_des = np.array([[0.6, -0.3]]), np.array([0.4]), np.array([-0.5, 0.2])
    for weight in (1.0, 10.0):
        result = make("rssa", 1, 2, slack_weight=weight).apply(rows_demanding(a, b, ETA), v_des)
        slack = (b - a @ v_des)[0] / (1 + 0.5 * weight * (a @ a.T)[0, 0])
        assert result.slack == pytest.approx(slack, abs=1e-9)
        assert result.status == FilterStatus.RELAXED
        np.testing.assert_allclose(result.v, v_des + 0.5 * weight * slack * a[0], rtol=0, atol=1e-9)


def test_weights_of_slack_belong_to_their_family() -> None:
    A, b = np.array([[1.0], [-1.0]]), np.array([1.0, 1.0])
    rows = replace(rows_demanding(A, b, ETA), family=np.array([1, OBSTACLE], dtype=np.intp))
    parameters = BarrierParameters(
        self_collision=FamilyParameters(eta=ETA, slack_weight=30.0),
        obstacle=FamilyParameters(eta=ETA, slack_weight=10.0),
    )
    result = SafetyFilter("rssa", 2, parameters, np.ones(1)).apply(rows, np.zeros(1))
    # v^2 + 15 (1 - v)^2 + 5 (1 + v)^2 is least at 21 v = 10
    assert result.v[0] == pytest.approx(10 / 21, abs=1e-9)


def test_weighted_slack_becomes_projection_as_the_weight_grows() -> None:
    rng = np.random.default_rng(23)
    for _ in range(20):
        A, b, v_des = infeasible(rng)
        limit = make("pssa", 9, 4).apply(rows_demanding(A, b, ETA), v_des).v
        weights = 10.0 ** np.arange(2, 8)
        off = [
            np.abs(make("rssa", 9, 4, slack_weight=w).apply(rows_demanding(A, b, ETA), v_des).v - limit).max()
            for w in weights
        ]
        # the error of a penalty falls as the inverse of its weight
        assert off[-1] < 1e-4
        assert off[-1] < 1.1e-2 * off[-3] + 1e-7


def test_issf_becomes_cbf_as_epsilon_grows() -> None:
    rng = np.random.default_rng(24)
    for _ in range(20):
        A, b, v_des = feasible("plain", rng)
        rows = BarrierRows(-b / 5, A, np.zeros(9), np.full(9, OBSTACLE, dtype=np.intp))
        limit = make("cbf", 9, 4).apply(rows, v_des)
        off = [np.abs(make("issf", 9, 4, epsilon=e).apply(rows, v_des).v - limit.v).max() for e in (1e4, 1e6, 1e8)]
        assert off[2] < 1e-6
        assert off[1] <= 1.1e-2 * off[0] + 1e-7


def holds_together(A: Array, b: Array, nv: int) -> bool:
    return bool(linprog(np.zeros(nv), A_ub=-A, b_ub=-b, bounds=(-V_MAX, V_MAX)).status == 0)


@pytest.mark.parametrize("name", ["ssa", "pssa", "rssa"])
def test_conflicts_are_minimal(name: str) -> None:
    rng = np.random.default_rng(25)
    for i in range(40):
        A, b, v_des = infeasible(rng)
        if i % 2:
            # rows that each ask for more than the bounds allow, or together do
            A, b = rng.normal(size=(9, 4)), rng.uniform(0.5, 2.5, 9)
        result = make(name, 9, 4, slack_weight=1e3).apply(rows_demanding(A, b, ETA), v_des)
        chosen = list(result.conflict())
        assert bool(chosen) != holds_together(A, b, 4)
        if chosen:
            assert not holds_together(A[chosen], b[chosen], 4)
            for k in chosen:
                rest = [j for j in chosen if j != k]
                assert holds_together(A[rest], b[rest], 4)


def test_conflicts_refer_to_the_rows_of_their_tick() -> None:
    A, b, v_des = infeasible(np.random.default_rng(26))
    rows = rows_demanding(A, b, ETA)
    result = make("pssa", 9, 4).apply(rows, v_des)
    expected = result.conflict()
    rows.jac[:], rows.dh_dt[:] = 0.0, 0.0
    assert result.conflict() == expected != ()


def test_a_row_that_nothing_moves_is_a_conflict_of_its_own() -> None:
    A, b, v_des = feasible("zero", np.random.default_rng(27))
    b[0] = 0.2
    result = make("pssa", 9, 4).apply(rows_demanding(A, b, ETA), v_des)
    assert result.status == FilterStatus.RELAXED
    np.testing.assert_array_equal(result.relaxed, [0])
    assert result.violation[0] == pytest.approx(0.2, abs=1e-12)
    assert result.conflict() == (0,)
    # the others are held as if it were not there
    others = make("pssa", 8, 4).apply(rows_demanding(A[1:], b[1:], ETA), v_des)
    np.testing.assert_allclose(result.v, others.v, rtol=0, atol=1e-7)


def test_rows_that_can_hold_are_no_conflict() -> None:
    A, b, _ = feasible("plain", np.random.default_rng(28))
    bounds = np.full(4, V_MAX)
    assert minimal_conflict(Candidates(np.arange(9), A, b, -bounds, bounds)) == ()
    assert minimal_conflict(Candidates(np.arange(0), A[:0], b[:0], -bounds, bounds)) == ()


def push_case(seed: int = 30, nv: int = 7) -> tuple[BarrierRows, Array, Array, Array, Array]:
    """Three rows of which the second is the worst; its point's Jacobian, its direction, nominal and feet."""
    rng = np.random.default_rng(seed)
    points, normals = rng.normal(scale=0.3, size=(3, 3, nv)), rng.normal(size=(3, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    jac = np.einsum("ij,ijk->ik", normals, points)
    family = np.full(3, OBSTACLE, dtype=np.intp)
    rows = BarrierRows(np.array([0.02, -0.03, 0.4]), jac, np.zeros(3), family, None, lambda i: (points[i], normals[i]))
    return rows, points[1], normals[1], rng.normal(scale=0.1, size=nv), rng.normal(scale=0.3, size=(2, nv))


def run_push(name: str, rows: BarrierRows, v_des: Array, feet: Array | None = None, push: float = 0.2) -> FilterResult:
    family = FamilyParameters(push_cartesian=push, push_joint=push)
    nv = v_des.size
    safety_filter = SafetyFilter(name, 3, BarrierParameters(obstacle=family), np.full(nv, 50.0), MetricWeights(4.0))
    return safety_filter.apply(rows, v_des, feet)


def test_potential_field_moves_the_worst_point_by_its_push_and_nothing_it_need_not() -> None:
    rows, point, normal, v_des, feet = push_case()
    plain = run_push("pfm", rows, v_des).v
    np.testing.assert_allclose(plain, v_des + np.linalg.pinv(point) @ (0.2 * normal), rtol=0, atol=1e-12)
    change = run_push("pfm", rows, v_des, feet).v - v_des
    np.testing.assert_allclose(point @ change, 0.2 * normal, rtol=0, atol=1e-10)
    # least in the metric: orthogonal in it to every motion that leaves the point where it is
    still = np.linalg.svd(point)[2][3:]
    metric = np.eye(7) + 4.0 * feet.T @ feet
    np.testing.assert_allclose(still @ metric @ change, 0.0, rtol=0, atol=1e-10)


def test_potential_field_pushes_along_the_row_itself_where_there_is_no_point() -> None:
    rows, _, _, v_des, _ = push_case()
    a = rows.jac[1]
    result = run_push("pfm", replace(rows, cartesian=None), v_des)
    np.testing.assert_allclose(result.v, v_des + 0.2 * a / (a @ a), rtol=0, atol=1e-12)


def test_a_point_that_cannot_move_in_some_direction_moves_as_far_as_it_can() -> None:
    rows, point, normal, v_des, _ = push_case()
    flat = np.diag([1.0, 1.0, 0.0]) @ point
    result = run_push("pfm", replace(rows, cartesian=lambda _: (flat, normal)), v_des)
    np.testing.assert_allclose(flat @ (result.v - v_des), 0.2 * normal * [1, 1, 0], rtol=0, atol=1e-10)


def test_sliding_mode_adds_the_worst_rows_gradient() -> None:
    rows, _, _, v_des, feet = push_case()
    a = rows.jac[1]
    np.testing.assert_allclose(run_push("sma", rows, v_des).v, v_des + 0.2 * a, rtol=0, atol=1e-12)
    metric = np.eye(7) + 4.0 * feet.T @ feet
    expected = v_des + 0.2 * np.linalg.inv(metric) @ a
    np.testing.assert_allclose(run_push("sma", rows, v_des, feet).v, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ["pfm", "sma"])
def test_pushes_say_whether_the_worst_row_stops_falling(name: str) -> None:
    rows, _, _, v_des, _ = push_case()
    strong, weak = run_push(name, rows, v_des, push=20.0), run_push(name, rows, v_des - 5 * rows.jac[1], push=1e-3)
    assert strong.status == FilterStatus.FILTERED
    assert rows.jac[1] @ strong.v > 0
    assert weak.status == FilterStatus.RELAXED
    assert weak.worst_row == 1
    assert weak.slack == pytest.approx(-rows.jac[1] @ weak.v)
    assert weak.conflict() == ()


@pytest.mark.parametrize("name", ["ssa", "pssa", "rssa"])
def test_a_row_that_nothing_moved_counts_again_once_it_moves(name: str) -> None:
    """Zero rows in turn with others at the same place: nothing of the one stays with a solver that is kept."""
    rng = np.random.default_rng(31)
    kept = make(name, 9, 4)
    for i in range(60):
        A, b, v_des = feasible("plain", rng)
        if i % 2:
            A[: 1 + i % 3] = 0.0
            b[: 1 + i % 3] = rng.choice([-0.3, 0.0, 0.2], 1 + i % 3)
        result, fresh = (f.apply(rows_demanding(A, b, ETA), v_des) for f in (kept, make(name, 9, 4)))
        assert result.status == fresh.status
        np.testing.assert_allclose(result.v, fresh.v, rtol=0, atol=1e-7)
