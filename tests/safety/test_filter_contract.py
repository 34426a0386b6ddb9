"""What every filter guarantees, whatever its condition and resolution, for velocities and for accelerations."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from controllers.whole_body.config import ControllerConfig
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.messages import Array
from robots.pinocchio_model import standing_configuration
from safety.barriers.barrier_set import standard_barriers
from safety.barriers.rows import FAMILIES, BarrierRows, HalfSpaces
from safety.filters.conditions import BarrierParameters, FamilyParameters, RowParameters
from safety.filters.resolution import ResolutionKind, Resolved
from safety.filters.results import report
from safety.filters.safety_filter import (
    FILTERS,
    KINDS,
    RELAXED,
    FilterKind,
    FilterResult,
    FilterSettings,
    FilterStatus,
    SafetyFilter,
    explain,
)
from safety.filters.second_order import ecbf_rows, index_rows, without_margin
from safety.filters.working_set import Problem

SAFE = [(name, order) for name in FILTERS for order in KINDS[name].orders if name != "none"]
LADDER = [(name, order) for name, order in SAFE if KINDS[name].resolution.name in {"qp", "two_phase"}]
MARGINS: dict[str, float | None] = dict.fromkeys(FAMILIES) | {"custom": 0.05}
"""The filters' own, but for the family that has none: every family is to be inside its margin at times."""

PARAMETERS = BarrierParameters(
    **{
        f: FamilyParameters(4.0 + i, 3.0 + i, MARGINS[f], slope=6.0 + i, index_gain=0.3 + 0.1 * i)
        for i, f in enumerate(FAMILIES)
    }
)
DT = 0.004
SIZES = ((35, 221), (39, 297))
"""Velocities and rows of G1 and TOCABI."""


@dataclass
class Case:
    """One input of a filter."""

    rows: BarrierRows
    nominal: Array
    feet: Array | None
    velocity: Array

    def arrays(self) -> list[Array]:
        r = self.rows
        found = [r.h, r.jac, r.dh_dt, r.family, r.curvature, self.nominal, self.feet, self.velocity]
        return [a for a in found if a is not None]


def random_case(rng: np.random.Generator, nv: int, n: int, close: float = 0.05) -> Case:
    """Rows of all families, of which about a twentieth is close to the limit or beyond it."""
    jac = rng.normal(scale=0.2, size=(n, nv))
    h = np.where(rng.random(n) < close, rng.normal(scale=0.03, size=n), rng.uniform(0.3, 2.0, n))
    family = np.sort(rng.integers(0, len(FAMILIES), n)).astype(np.intp)
    normals = rng.normal(size=(n, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = rng.normal(scale=0.2, size=(3, nv))

    def cartesian(i: int) -> tuple[Array, Array]:
        normal = normals[i]
        return points + np.outer(normal, jac[i] - normal @ points), normal

    rows = BarrierRows(h, jac, rng.normal(scale=0.02, size=n), family, rng.normal(scale=0.1, size=n), cartesian)
    return Case(rows, rng.normal(size=nv), rng.normal(scale=0.3, size=(12, nv)), rng.normal(scale=0.2, size=nv))


def in_conflict(case: Case) -> Case:
    """The same with two opposite rows deep inside their limits."""
    h, jac = case.rows.h.copy(), case.rows.jac.copy()
    h[:2], jac[1] = -0.5, -jac[0]
    return replace(case, rows=replace(case.rows, h=h, jac=jac, cartesian=None))


def far(case: Case) -> Case:
    return replace(case, rows=replace(case.rows, h=case.rows.h + 1e3), nominal=0.1 * case.nominal)


def make(kind: str | FilterKind, order: int, nv: int, n: int, **options: Any) -> SafetyFilter:
    bounds = np.full(nv, 3.0)
    if order == 2:
        options = {"order": 2, "velocity_max": np.full(nv, 0.5), "dt": DT} | options
        bounds = np.full(nv, 20.0)
    return SafetyFilter(kind, n, PARAMETERS, bounds, settings=FilterSettings(**options))


def apply(safety_filter: SafetyFilter, case: Case, age: float = 0.0) -> FilterResult:
    return safety_filter.apply(case.rows, case.nominal, case.feet, age=age, velocity=case.velocity)


def conditions_of(name: str, order: int, case: Case) -> HalfSpaces:
    """The rows that are active, as the filter's own condition has them."""
    rows, p = case.rows, PARAMETERS.of_rows(case.rows.family, KINDS[name].margins)
    if order == 2:
        rows = (ecbf_rows if name == "ecbf" else index_rows)(rows, case.velocity, p)
        p = without_margin(p)
    condition = KINDS[name].condition
    assert condition is not None
    return condition(rows, p)


def check_honest(name: str, order: int, case: Case, result: FilterResult) -> None:
    """Slack, rows, status and bounds belong to the input that is returned."""
    spaces = conditions_of(name, order, case)
    violation = np.where(spaces.active, np.maximum(0.0, spaces.b - spaces.A @ result.v), 0.0)
    assert result.slack == pytest.approx(violation.max(), abs=1e-12)
    assert result.worst_row == (int(violation.argmax()) if violation.max() > 0 else -1)
    np.testing.assert_array_equal(result.relaxed, np.flatnonzero(violation > RELAXED))
    np.testing.assert_allclose(result.violation, violation[result.relaxed], rtol=0, atol=1e-12)
    if result.status == FilterStatus.UNCHANGED:
        assert result.slack == 0.0
        assert result.v.tobytes() == case.nominal.tobytes()
    elif result.status == FilterStatus.FILTERED:
        assert result.slack <= RELAXED
    else:
        assert result.slack > RELAXED
    assert (result.cause == "") == (result.status not in {FilterStatus.FAILED, FilterStatus.UNSAFE})


def check_bounds(order: int, case: Case, result: FilterResult) -> None:
    if order == 1:
        assert (np.abs(result.v) <= 3.0).all()
        return
    assert (np.abs(result.v) <= 20.0).all()
    too_fast = np.abs(case.velocity + DT * result.v) > 0.5 + 1e-12
    # only where it was too fast for one step, and then it brakes as hard as it may
    np.testing.assert_array_equal(result.v[too_fast], -20.0 * np.sign(case.velocity[too_fast]))


@pytest.mark.parametrize(("name", "order"), SAFE)
@pytest.mark.parametrize(("nv", "n"), SIZES)
def test_reports_are_honest_bounds_hold_and_inputs_stay(name: str, order: int, nv: int, n: int) -> None:
    rng = np.random.default_rng(1)
    safety_filter = make(name, order, nv, n)
    seen = set()
    for i in range(24):
        case = random_case(rng, nv, n)
        case = (case, in_conflict(case), far(case), replace(case, nominal=20 * case.nominal))[i % 4]
        before = [a.copy() for a in case.arrays()]
        result = apply(safety_filter, case)
        for array, copy in zip(case.arrays(), before, strict=True):
            np.testing.assert_array_equal(array, copy)
        check_honest(name, order, case, result)
        check_bounds(order, case, result)
        seen.add(result.status)
    assert {FilterStatus.UNCHANGED, FilterStatus.RELAXED} <= seen
    assert FilterStatus.FAILED not in seen
    assert FilterStatus.UNSAFE not in seen


@pytest.mark.parametrize(("name", "order"), SAFE)
@pytest.mark.parametrize(("nv", "n"), SIZES)
def test_far_from_danger_the_nominal_comes_back(name: str, order: int, nv: int, n: int) -> None:
    rng = np.random.default_rng(2)
    safety_filter = make(name, order, nv, n)
    for _ in range(10):
        case = far(random_case(rng, nv, n))
        result = apply(safety_filter, replace(case, velocity=0.1 * case.velocity))
        assert result.status == FilterStatus.UNCHANGED
        assert result.v.tobytes() == case.nominal.tobytes()
        assert not np.shares_memory(result.v, case.nominal)
        assert (result.slack, result.worst_row, result.active, result.conflict()) == (0.0, -1, 0, ())


@pytest.mark.parametrize(("name", "order"), SAFE)
def test_filters_that_have_worked_answer_as_new_ones(name: str, order: int) -> None:
    rng = np.random.default_rng(3)
    nv, n = SIZES[0]
    kept = make(name, order, nv, n)
    first = random_case(rng, nv, n)
    answer = apply(kept, first)
    for i in range(20):
        case = random_case(rng, nv, n, close=(0.01, 0.2)[i % 2])
        case = in_conflict(case) if i % 3 == 0 else case
        result, fresh = apply(kept, case), apply(make(name, order, nv, n), case)
        assert result.status == fresh.status
        np.testing.assert_allclose(result.v, fresh.v, rtol=0, atol=1e-7)
    again = apply(kept, first)
    assert again.status == answer.status
    np.testing.assert_allclose(again.v, answer.v, rtol=0, atol=1e-7)


@pytest.mark.parametrize(("name", "order"), [*SAFE, ("none", 1), ("none", 2)])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_numbers_that_are_not_finite_are_refused(name: str, order: int, value: float) -> None:
    rng = np.random.default_rng(4)
    nv, n = SIZES[0]
    safety_filter = make(name, order, nv, n)
    words = {"h": "rows", "jac": "rows", "dh_dt": "rows", "nominal": "nominal"}
    if order == 2:
        words |= {"velocity": "velocity", "curvature": "curvature"}
    for part, word in words.items():
        case = random_case(rng, nv, n)
        array = getattr(case, part) if hasattr(case, part) else getattr(case.rows, part)
        array.flat[rng.integers(array.size)] = value
        result = apply(safety_filter, case)
        assert result.status == FilterStatus.FAILED
        assert result.slack == np.inf
        assert word in result.cause
        assert "finite" in result.cause
        stop = np.zeros(nv)
        if order == 2 and part != "velocity":
            stop = np.clip(-case.velocity / DT, -20, 20)
        np.testing.assert_array_equal(result.v, stop)


@pytest.mark.parametrize(("name", "order"), [*SAFE, ("none", 1)])
def test_old_inputs_are_refused(name: str, order: int) -> None:
    nv, n = SIZES[0]
    case = far(random_case(np.random.default_rng(5), nv, n))
    case = replace(case, velocity=0.1 * case.velocity)
    safety_filter = make(name, order, nv, n)
    assert apply(safety_filter, case, age=0.1).status == FilterStatus.UNCHANGED
    for age, text in ((0.3, "input is 0.30 s old, allowed are 0.10 s"), (np.nan, "nan s old"), (-0.3, "-0.30 s old")):
        result = apply(safety_filter, case, age)
        assert result.status == FilterStatus.FAILED
        assert text in result.cause
        assert not np.array_equal(result.v, case.nominal)
    assert apply(make(name, order, nv, n, max_age=0.5), case, age=0.3).status == FilterStatus.UNCHANGED


def misshapen(nv: int, n: int, order: int) -> list[tuple[str, tuple[int, ...], str]]:
    """Inputs, shapes that they must not have, and the shapes expected."""
    wrong: list[tuple[str, tuple[int, ...], str]] = [
        ("jac", (n, nv - 1), f"({n}, {nv})"),
        ("jac", (n + 1, nv), f"({n}, {nv})"),
        ("jac", (n * nv,), f"({n}, {nv})"),
    ]
    for part in ("h", "dh_dt", "family", *(("curvature",) if order == 2 else ())):
        # the first one is what numpy would stretch over all rows
        wrong += [(part, shape, f"({n},)") for shape in ((1,), (), (n - 1,), (n + 1,), (n, 1), (1, n))]
    for part in ("nominal", *(("velocity",) if order == 2 else ())):
        wrong += [(part, shape, f"({nv},)") for shape in ((1,), (), (nv + 1,), (nv, 1))]
    for part in ("feet", "balance", "hands"):
        wrong += [(part, shape, f"(any number, {nv})") for shape in ((3, nv - 1), (nv,), (3, 1), (1, 3, nv))]
    return wrong


@pytest.mark.parametrize(("name", "order"), [*SAFE, ("none", 1), ("none", 2)])
def test_arrays_of_another_shape_are_refused_by_name(name: str, order: int) -> None:
    nv, n = SIZES[0]
    case = random_case(np.random.default_rng(6), nv, n)
    safety_filter = make(name, order, nv, n)
    for part, shape, expected in misshapen(nv, n, order):
        rows, inputs = case.rows, {"v_des": case.nominal, "velocity": case.velocity}
        if hasattr(rows, part):
            rows = replace(rows, **{part: np.ones(shape, dtype=getattr(rows, part).dtype)})
        else:
            inputs["v_des" if part == "nominal" else part] = np.ones(shape)
        result = safety_filter.apply(rows, **inputs)
        assert result.status == FilterStatus.FAILED
        assert part in result.cause
        assert f"has shape {shape}, expected {expected}" in result.cause
        assert result.v.shape == (nv,)
        np.testing.assert_array_equal(result.v, stop(order, inputs["velocity"], nv))
    # Jacobians of no rows are none
    for part in ("feet", "balance", "hands"):
        few = safety_filter.apply(case.rows, case.nominal, velocity=case.velocity, **{part: np.zeros((0, nv))})
        assert few.status != FilterStatus.FAILED


def stop(order: int, velocity: Array, nv: int) -> Array:
    """The stop action: for accelerations it brakes wherever the velocity can be read."""
    if order == 1 or velocity.shape != (nv,):
        return np.zeros(nv)
    return np.clip(-np.clip(velocity, -1e3, 1e3) / DT, -20, 20)


@pytest.mark.parametrize(("name", "order"), SAFE)
@pytest.mark.parametrize("family", [-1, len(FAMILIES), 0.5])
def test_rows_of_no_family_are_refused(name: str, order: int, family: float) -> None:
    nv, n = SIZES[0]
    case = random_case(np.random.default_rng(11), nv, n)
    safety_filter = make(name, order, nv, n)
    families = case.rows.family.astype(type(family))
    families[n // 2] = family
    # twice: what was refused once is not taken for known
    for _ in range(2):
        result = apply(safety_filter, replace(case, rows=replace(case.rows, family=families)))
        assert result.status == FilterStatus.FAILED
        assert "family of the barrier rows has to be integers from 0 to 5" in result.cause
    assert apply(safety_filter, case).status != FilterStatus.FAILED


PUSHES = [(name, order) for name, order in SAFE if KINDS[name].resolution.acts_when_met]


def check_failed(order: int, case: Case, result: FilterResult, cause: str) -> None:
    assert result.status == FilterStatus.FAILED
    assert cause in result.cause
    np.testing.assert_array_equal(result.v, stop(order, case.velocity, case.nominal.size))


@pytest.mark.parametrize("order", KINDS["pfm"].orders)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300])
def test_points_that_are_pushed_have_finite_jacobians_and_directions(order: int, value: float) -> None:
    nv, n = SIZES[0]
    case = random_case(np.random.default_rng(12), nv, n, close=0.3)
    safety_filter = make("pfm", order, nv, n)
    given = case.rows.cartesian
    assert given is not None
    for part in range(2):

        def cartesian(i: int, part: int = part) -> tuple[Array, Array]:
            arrays = given(i)[0].copy(), given(i)[1].copy()
            arrays[part].flat[1] = value
            return arrays

        # a direction of 1e300 is a large push, and clipped like any other
        if part == 0 or not np.isfinite(value):
            result = apply(safety_filter, replace(case, rows=replace(case.rows, cartesian=cartesian)))
            check_failed(order, case, result, "point is not finite")


@pytest.mark.parametrize("order", KINDS["pfm"].orders)
@pytest.mark.parametrize("shapes", [((3, 34), (3,)), ((35,), (1,)), ((3, 35), (1,)), ((3, 35), (3, 1))])
def test_points_that_are_pushed_have_jacobians_and_directions_that_fit(
    order: int, shapes: tuple[tuple[int, ...], tuple[int, ...]]
) -> None:
    nv, n = SIZES[0]
    case = random_case(np.random.default_rng(13), nv, n, close=0.3)
    rows = replace(case.rows, cartesian=lambda _: (np.ones(shapes[0]), np.ones(shapes[1])))
    result = apply(make("pfm", order, nv, n), replace(case, rows=rows))
    check_failed(order, case, result, f"shapes {shapes[0]} and {shapes[1]}, expected (k, {nv}) and (k,)")


@pytest.mark.parametrize(("name", "order"), PUSHES)
def test_pushes_without_a_finite_answer_are_refused(name: str, order: int) -> None:
    nv, n = SIZES[0]
    case = random_case(np.random.default_rng(14), nv, n, close=0.3)
    safety_filter = make(name, order, nv, n)
    # one row in all columns: the metric is singular to rounding
    singular = apply(safety_filter, replace(case, feet=np.full((3, nv), 1e8)))
    check_failed(order, case, singular, "linear equations have no answer")
    family = FamilyParameters(push_cartesian=1e308, push_joint=1e308, margin=0.1)
    parameters = BarrierParameters(**dict.fromkeys(FAMILIES, family))
    settings = FilterSettings(order=order, dt=DT)
    hard = SafetyFilter(name, n, parameters, np.full(nv, 20.0), settings=settings)
    stretched = replace(
        case, rows=replace(case.rows, jac=1e3 * case.rows.jac, cartesian=lambda _: (np.eye(1, nv), np.full(1, 10.0)))
    )
    check_failed(order, case, apply(hard, stretched), "the push is not finite")


class Broken:
    """A resolution that finds an answer with a number that is none."""

    def __init__(self, nv: int, value: float) -> None:
        self._answer = np.ones(nv)
        self._answer[3] = value

    def set_parameters(self, parameters: RowParameters) -> None:
        """None are needed."""

    def resolve(self, problem: Problem, rows: BarrierRows) -> Resolved:
        return Resolved(self._answer)


@pytest.mark.parametrize(("name", "order"), SAFE)
def test_an_answer_that_is_not_finite_is_refused(name: str, order: int) -> None:
    nv, n = SIZES[0]
    case = random_case(np.random.default_rng(15), nv, n, close=0.3)
    assert apply(make(name, order, nv, n), case).status in {FilterStatus.FILTERED, FilterStatus.RELAXED}
    for value in (np.nan, np.inf):
        broken = ResolutionKind(
            "broken", lambda nv, n_rows, infeasible, x=value: Broken(nv, x), KINDS[name].joint, True
        )
        kind = replace(KINDS[name], resolution=broken)
        check_failed(order, case, apply(make(kind, order, nv, n), case), "the answer is not finite")


@pytest.mark.parametrize(("name", "order"), SAFE)
@pytest.mark.parametrize("value", [1e308, -1e308])
def test_numbers_that_overflow_fail_and_raise_nothing(name: str, order: int, value: float) -> None:
    """One number near the largest there is, in each array, while numpy is told to raise."""
    rng = np.random.default_rng(16)
    nv, n = SIZES[0]
    safety_filter = make(name, order, nv, n)
    parts = ("h", "jac", "dh_dt", "nominal", "feet", *(("curvature", "velocity") if order == 2 else ()))
    for part in parts:
        case = random_case(rng, nv, n)
        array = getattr(case, part) if hasattr(case, part) else getattr(case.rows, part)
        array.flat[rng.integers(array.size)] = value
        with np.errstate(all="raise"):
            result = apply(safety_filter, case)
        assert np.isfinite(result.v).all()
        assert not np.isnan(result.slack)
        if result.status == FilterStatus.FAILED:
            np.testing.assert_array_equal(result.v, stop(order, case.velocity, nv))
        else:
            with np.errstate(all="ignore"):
                check_honest(name, order, case, result)


@pytest.mark.parametrize(("name", "order"), [c for c in SAFE if c[0] in {"cbf", "issf", "ecbf"}])
@pytest.mark.parametrize("value", [1e308, -1e308])
def test_conditions_that_overflow_are_refused(name: str, order: int, value: float) -> None:
    nv, n = SIZES[0]
    case = far(random_case(np.random.default_rng(17), nv, n))
    case.rows.h[5] = value
    result = apply(make(name, order, nv, n), case)
    check_failed(order, case, result, "conditions are not finite")
    # at the stop action it holds, or is violated, without bound
    assert result.slack == (0.0 if value > 0 else np.inf)


@pytest.mark.parametrize("value", [np.nan, -np.inf])
@pytest.mark.parametrize("status", [FilterStatus.UNCHANGED, FilterStatus.FILTERED, FilterStatus.UNSAFE])
def test_a_condition_without_a_number_is_never_reported_as_held(status: FilterStatus, value: float) -> None:
    A, b = np.ones((4, 2)), np.array([-9.0, 0.0, -9.0, 7.0])
    A[2, 1] = value
    result = report(np.ones(2), status, HalfSpaces(A, b, np.ones(4, dtype=bool)))
    assert result.status == FilterStatus.FAILED
    assert (result.slack, result.worst_row, result.active) == (np.inf, 2, 2)
    assert result.cause == "condition 2 is not finite at the answer"


@pytest.mark.parametrize("name", ["cbf", "issf"])
def test_a_nominal_input_at_which_a_condition_has_no_number_is_not_passed(name: str) -> None:
    """The gain of the index makes a row overflow that is finite itself."""
    parameters = BarrierParameters(obstacle=FamilyParameters(index_gain=1e10))
    safety_filter = SafetyFilter(name, 2, parameters, np.full(2, 20.0), settings=FilterSettings(order=2, dt=DT))
    family = np.full(2, FAMILIES.index("obstacle"), dtype=np.intp)
    rows = BarrierRows(np.ones(2), np.array([[1e300, -1e300], [0.0, 1.0]]), np.zeros(2), family, np.zeros(2))
    case = Case(rows, np.full(2, 0.5), None, np.array([0.01, 0.01]))
    check_failed(2, case, apply(safety_filter, case), "not finite")


def test_without_a_filter_bounds_are_not_looked_at() -> None:
    nv, n = SIZES[0]
    for order in (1, 2):
        case = random_case(np.random.default_rng(18), nv, n)
        result = apply(make("none", order, nv, n), replace(case, nominal=1e3 * case.nominal))
        assert result.status == FilterStatus.UNCHANGED
        np.testing.assert_array_equal(result.v, 1e3 * case.nominal)


@pytest.mark.parametrize("name", [name for name, order in SAFE if order == 2])
def test_where_the_velocity_is_not_known_the_stop_action_coasts(name: str) -> None:
    nv, n = SIZES[0]
    case = random_case(np.random.default_rng(19), nv, n)
    safety_filter = make(name, 2, nv, n)
    np.testing.assert_array_equal(safety_filter.apply(case.rows, case.nominal).v, np.zeros(nv))
    known = safety_filter.apply(case.rows, case.nominal, age=1.0, velocity=case.velocity)
    np.testing.assert_array_equal(known.v, np.clip(-case.velocity / DT, -20, 20))


@pytest.mark.parametrize("name", [n for n in FILTERS if n != "none"])
def test_second_order_needs_velocity_and_curvature(name: str) -> None:
    nv, n = SIZES[0]
    case = random_case(np.random.default_rng(7), nv, n)
    safety_filter = make(name, 2, nv, n)
    without = safety_filter.apply(case.rows, case.nominal)
    assert without.status == FilterStatus.FAILED
    assert "velocity is missing" in without.cause
    flat = safety_filter.apply(replace(case.rows, curvature=None), case.nominal, velocity=case.velocity)
    assert flat.status == FilterStatus.FAILED
    assert "curvature" in flat.cause


@pytest.mark.parametrize(("name", "order"), LADDER)
def test_conflicts_relax_by_default_and_pass_the_nominal_only_where_that_was_asked_for(name: str, order: int) -> None:
    rng = np.random.default_rng(8)
    nv, n = SIZES[0]
    naive = make(name, order, nv, n, infeasible="unsafe_pass_nominal")
    for _ in range(5):
        case = in_conflict(random_case(rng, nv, n))
        relaxed, unsafe = apply(make(name, order, nv, n), case), apply(naive, case)
        assert relaxed.status == FilterStatus.RELAXED
        assert set(relaxed.relaxed) >= {0, 1}
        if name == "pssa":
            assert unsafe.status == FilterStatus.RELAXED
            continue
        assert unsafe.status == FilterStatus.UNSAFE
        assert unsafe.cause == "no solution found: the nominal input is passed on"
        check_honest(name, order, case, unsafe)
        check_bounds(order, case, unsafe)
        if order == 1:
            np.testing.assert_array_equal(unsafe.v, np.clip(case.nominal, -3, 3))
        total = [float(np.sum(r.violation**2)) for r in (relaxed, unsafe)]
        assert total[0] < total[1]


def test_explanations_name_the_rows() -> None:
    nv, n = SIZES[0]
    case = in_conflict(random_case(np.random.default_rng(9), nv, n, close=0.0))
    result = apply(make("pssa", 1, nv, n), case)
    labels = [f"row {i}" for i in range(n)]
    text = explain(result, labels)
    assert text.splitlines()[0] == "relaxed"
    assert result.conflict() == (0, 1)
    assert "cannot hold together within the bounds: row 0; row 1" in text
    assert f"short by {result.violation[0]:.3g}: row {result.relaxed[0]}" in text
    refused = apply(make("pssa", 1, nv, n), case, age=1.0)
    assert explain(refused, labels) == "failed: input is 1.00 s old, allowed are 0.10 s"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"infeasible": "hope"}, "infeasible = 'hope': must be one of least_slack, unsafe_pass_nominal"),
        ({"max_age": 0.0}, "max_age = 0"),
        ({"order": 3}, "order = 3"),
        ({"dt": -1.0}, "dt = -1"),
        ({"velocity_max": np.zeros(35)}, "velocity_max"),
        ({"velocity_max": np.ones(3)}, "velocity_max"),
    ],
)
def test_options_are_refused_by_name(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        SafetyFilter("cbf", 1, PARAMETERS, np.ones(35), settings=FilterSettings(**({"order": 2} | options)))


def test_exponential_barriers_are_for_accelerations() -> None:
    with pytest.raises(ConfigError, match=r"filter = 'ecbf'.*acts on accelerations"):
        SafetyFilter("ecbf", 1, PARAMETERS, np.ones(2))


@pytest.mark.parametrize("setting", [{"filter": "none"}, {"infeasible": "unsafe_pass_nominal"}])
def test_nothing_unsafe_drives_hardware(setting: dict[str, str]) -> None:
    ControllerConfig(**setting)
    ControllerConfig(drives="hardware")
    name, value = next(iter(setting.items()))
    with pytest.raises(ConfigError, match=f"{name} = '{value}': .*hardware"):
        ControllerConfig(drives="hardware", **setting)


def test_every_filter_says_where_it_comes_from() -> None:
    assert FILTERS == ("none", "cbf", "issf", "ecbf", "ssa", "rssa", "pssa", "sss", "pfm", "sma")
    for name, kind in KINDS.items():
        assert kind.name == name
        assert kind.title
        assert kind.source
        assert set(kind.margins) == set(FAMILIES)


@pytest.mark.parametrize(("name", "order"), SAFE)
def test_on_a_robots_own_rows(name: str, order: int, robot: RobotDescription) -> None:
    rng = np.random.default_rng(10)
    kin = Kinematics(robot)
    barriers = standard_barriers(kin)
    lower, upper = robot.position_limits
    safety_filter = make(name, order, kin.nv, barriers.size)
    for spread in (0.05, 0.3, 1.0):
        q = standing_configuration(robot, "hands_front")
        q[7:] = np.clip(q[7:] + rng.normal(scale=spread, size=q.size - 7), lower, upper)
        kin.update_geometry(q)
        rows = replace(barriers.evaluate(kin), curvature=np.zeros(barriers.size))
        case = Case(rows, rng.normal(size=kin.nv), None, 0.1 * rng.normal(size=kin.nv))
        result = apply(safety_filter, case)
        check_honest(name, order, case, result)
        check_bounds(order, case, result)


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({"n_rows": -1}, "n_rows"),
        ({"n_rows": 2.5}, "n_rows"),
        ({"parameters": None}, "parameters"),
        ({"v_max": 1.0}, "v_max"),
        ({"v_max": [1.0, -1.0]}, "v_max"),
        ({"v_max": [[1.0, 1.0]]}, "v_max"),
    ],
)
def test_what_a_filter_cannot_be_made_of_is_refused_by_name(arguments: dict[str, Any], name: str) -> None:
    usual: dict[str, Any] = {"n_rows": 3, "parameters": BarrierParameters(), "v_max": np.ones(2)}
    with pytest.raises(ConfigError) as caught:
        SafetyFilter("cbf", **(usual | arguments))
    assert caught.value.name == name


def test_bounds_may_be_a_list() -> None:
    rows = BarrierRows(np.ones(1), np.eye(2)[:1], np.zeros(1), np.zeros(1, dtype=np.intp))
    filtered = SafetyFilter("cbf", 1, BarrierParameters(), [1.0, 2.0])
    np.testing.assert_array_equal(filtered.apply(rows, np.array([3.0, -3.0])).v, [1.0, -2.0])
