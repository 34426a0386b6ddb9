"""What every filter promises, whatever its condition and resolution, for velocities and for accelerations."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from controllers.config import ControllerConfig
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.messages import Array
from robots.pinocchio_model import standing_configuration
from safety.barriers import standard_barriers
from safety.conditions import BarrierParameters, FamilyParameters
from safety.filters import CONDITIONS, FILTERS, KINDS, RELAXED, FilterResult, FilterStatus, SafetyFilter, explain
from safety.rows import FAMILIES, BarrierRows, HalfSpaces
from safety.second_order import ecbf_rows, index_rows, without_margin

SAFE = [(name, order) for name in FILTERS for order in KINDS[name].orders if name != "none"]
LADDER = [(name, order) for name, order in SAFE if KINDS[name].resolution in {"qp", "two_phase"}]
PARAMETERS = BarrierParameters(
    **{f: FamilyParameters(4.0 + i, 3.0 + i, slope=6.0 + i, index_gain=0.3 + 0.1 * i) for i, f in enumerate(FAMILIES)}
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
        found = [r.h, r.jac, r.drift, r.family, r.curvature, self.nominal, self.feet, self.velocity]
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


def make(name: str, order: int, nv: int, n: int, **options: object) -> SafetyFilter:
    bounds = np.full(nv, 3.0)
    if order == 2:
        options = {"order": 2, "velocity_max": np.full(nv, 0.5), "dt": DT} | options
        bounds = np.full(nv, 20.0)
    return SafetyFilter(name, n, PARAMETERS, bounds, **options)  # type: ignore[arg-type]


def apply(safety_filter: SafetyFilter, case: Case, age: float = 0.0) -> FilterResult:
    return safety_filter.apply(case.rows, case.nominal, case.feet, age=age, velocity=case.velocity)


def conditions_of(name: str, order: int, case: Case) -> HalfSpaces:
    """The rows that are active, as the filter's own condition has them."""
    rows, p = case.rows, PARAMETERS.of_rows(case.rows.family, KINDS[name].margins)
    if order == 2:
        rows = (ecbf_rows if name == "ecbf" else index_rows)(rows, case.velocity, p)
        p = without_margin(p)
    return CONDITIONS[name](rows, p)


def check_honest(name: str, order: int, case: Case, result: FilterResult) -> None:
    """Slack, rows, status and bounds belong to the input that is returned."""
    spaces = conditions_of(name, order, case)
    shortfall = np.where(spaces.active, np.maximum(0.0, spaces.b - spaces.A @ result.v), 0.0)
    assert result.slack == pytest.approx(shortfall.max(), abs=1e-12)
    assert result.worst_row == (int(shortfall.argmax()) if shortfall.max() > 0 else -1)
    np.testing.assert_array_equal(result.relaxed, np.flatnonzero(shortfall > RELAXED))
    np.testing.assert_allclose(result.shortfall, shortfall[result.relaxed], rtol=0, atol=1e-12)
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
    words = {"h": "rows", "jac": "rows", "drift": "rows", "nominal": "nominal"}
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


@pytest.mark.parametrize(("name", "order"), SAFE)
def test_rows_of_another_shape_are_refused(name: str, order: int) -> None:
    nv, n = SIZES[0]
    case = random_case(np.random.default_rng(6), nv, n)
    result = apply(make(name, order, nv, n + 1), case)
    assert result.status == FilterStatus.FAILED
    assert f"({n}, {nv}, {nv}), expected ({n + 1}, {nv}, {nv})" in result.cause


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
        check_honest(name, order, case, unsafe)
        check_bounds(order, case, unsafe)
        if order == 1:
            np.testing.assert_array_equal(unsafe.v, np.clip(case.nominal, -3, 3))
        total = [float(np.sum(r.shortfall**2)) for r in (relaxed, unsafe)]
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
    assert f"short by {result.shortfall[0]:.3g}: row {result.relaxed[0]}" in text
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
def test_options_are_refused_by_name(options: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        SafetyFilter("cbf", 1, PARAMETERS, np.ones(35), **({"order": 2} | options))  # type: ignore[arg-type]


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
