"""What the filter guarantees: nothing changed without need, conditions and bounds kept, never a nominal in doubt."""

from dataclasses import replace

import numpy as np
import pytest

from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.messages import Array
from robots.pinocchio_model import standing_configuration
from safety.barriers.barrier_set import BarrierSet, standard_barriers
from safety.barriers.rows import FAMILIES, BarrierRows, HalfSpaces
from safety.filters.conditions import BarrierParameters, FamilyParameters
from safety.filters.safety_filter import (
    ACTIVE,
    FILTERS,
    KINDS,
    FilterResult,
    FilterStatus,
    MetricWeights,
    SafetyFilter,
)
from wbc.qp import UNBOUNDED

PARAMETERS = BarrierParameters(
    joint_limit=FamilyParameters(10.0, 10.0),
    self_collision=FamilyParameters(5.0, 2.0),
    leg_collision=FamilyParameters(5.0, 10.0),
    obstacle=FamilyParameters(5.0, 5.0),
    workspace=FamilyParameters(5.0, 5.0),
)
ROOM = 1e-8
QP_FILTERS = ("cbf", "issf", "ssa", "pssa", "sss")
VELOCITY_FILTERS = tuple(n for n in FILTERS if 1 in KINDS[n].orders)
PARTS = ("v_des", "h", "jac", "dh_dt")


@pytest.fixture(scope="module")
def barriers(kin: Kinematics) -> BarrierSet:
    return standard_barriers(kin)


@pytest.fixture(scope="module")
def v_max(robot: RobotDescription) -> Array:
    return np.concatenate([np.full(3, 2.0), np.full(3, 4.0), 0.5 * robot.joint_array("velocity")])


@pytest.fixture(params=QP_FILTERS)
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def safety_filter(name: str, barriers: BarrierSet, v_max: Array) -> SafetyFilter:
    return SafetyFilter(name, barriers.size, PARAMETERS, v_max)


def rows_near(kin: Kinematics, barriers: BarrierSet, rng: np.random.Generator) -> BarrierRows:
    """Rows at a configuration about the hands' posture, with dh_dt as of obstacles."""
    q = standing_configuration(kin.robot, "hands_front")
    lower, upper = kin.robot.position_limits
    q[7:] = np.clip(q[7:] + rng.normal(scale=0.1, size=q.size - 7), lower, upper)
    kin.update_geometry(q)
    rows = barriers.evaluate(kin)
    return BarrierRows(rows.h.copy(), rows.jac.copy(), rng.normal(scale=0.02, size=rows.h.size), rows.family)


def contradictory(rows: BarrierRows, joint: int = 3, depth: float = 0.5) -> BarrierRows:
    """A joint beyond both its limits at once."""
    h = rows.h.copy()
    h[[joint, joint + (rows.jac.shape[1] - 6)]] = -depth
    return replace(rows, h=h)


def conditions_of(name: str, rows: BarrierRows) -> HalfSpaces:
    condition = KINDS[name].condition
    assert condition is not None
    spaces = condition(rows, PARAMETERS.of_rows(rows.family, KINDS[name].margins))
    return replace(spaces, b=np.where(spaces.active, spaces.b, -UNBOUNDED))


def check_report(name: str, rows: BarrierRows, result: FilterResult, v_max: Array) -> None:
    """What is reported is what the returned velocity does."""
    spaces = conditions_of(name, rows)
    gap = spaces.A @ result.v - spaces.b
    assert result.slack == max(0.0, -gap.min())
    assert result.worst_row == (int(gap.argmin()) if gap.min() < 0 else -1)
    assert result.active == (gap < ACTIVE).sum()
    assert (np.abs(result.v) <= v_max).all()


def test_filtered_velocities_satisfy_every_condition_and_bound(
    name: str, safety_filter: SafetyFilter, kin: Kinematics, barriers: BarrierSet, v_max: Array
) -> None:
    rng = np.random.default_rng(1)
    statuses = []
    for scale in np.repeat([0.5, 2.0, 20.0], 12):
        rows, v_des = rows_near(kin, barriers, rng), scale * rng.normal(size=kin.nv)
        result = safety_filter.apply(rows, v_des)
        check_report(name, rows, result, v_max)
        if result.status == FilterStatus.FILTERED:
            assert result.slack <= ROOM
            assert not np.array_equal(result.v, v_des)
        statuses.append(result.status)
    assert statuses.count(FilterStatus.FILTERED) >= 18
    assert FilterStatus.FAILED not in statuses


def test_far_from_danger_the_nominal_comes_back_bit_for_bit(
    safety_filter: SafetyFilter, kin: Kinematics, barriers: BarrierSet
) -> None:
    rng = np.random.default_rng(2)
    for _ in range(10):
        rows = rows_near(kin, barriers, rng)
        far = replace(rows, h=np.full(rows.h.size, 10.0))
        v_des = 0.3 * rng.normal(size=kin.nv)
        result = safety_filter.apply(far, v_des, rng.normal(size=(12, kin.nv)))
        assert result.status == FilterStatus.UNCHANGED
        assert result.v.tobytes() == v_des.tobytes()
        assert not np.shares_memory(result.v, v_des)
        assert (result.slack, result.worst_row, result.active) == (0.0, -1, 0)


def test_a_velocity_that_just_satisfies_is_unchanged_and_one_that_just_does_not_is_filtered(name: str) -> None:
    rows = BarrierRows(np.array([0.01]), np.array([[1.0, 0.0]]), np.zeros(1), np.zeros(1, dtype=np.intp))
    limit = float(conditions_of(name, rows).b[0])
    one = SafetyFilter(name, 1, PARAMETERS, np.full(2, 100.0))
    assert one.apply(rows, np.array([limit, 1.0])).status == FilterStatus.UNCHANGED
    result = one.apply(rows, np.array([limit - 1e-3, 1.0]))
    assert result.status == FilterStatus.FILTERED
    np.testing.assert_allclose(result.v, [limit, 1.0], rtol=0, atol=1e-9)


@pytest.mark.parametrize("situation", ["filtered", "relaxed"])
def test_the_input_is_not_changed(
    situation: str, safety_filter: SafetyFilter, kin: Kinematics, barriers: BarrierSet, v_max: Array
) -> None:
    rng = np.random.default_rng(3)
    rows, v_des, feet = rows_near(kin, barriers, rng), 5 * rng.normal(size=kin.nv), rng.normal(size=(12, kin.nv))
    rows = replace(rows, h=np.maximum(rows.h, 0.06))
    if situation == "relaxed":
        rows = contradictory(rows)
    arrays = (rows.h, rows.jac, rows.dh_dt, rows.family, v_des, feet, v_max)
    before = [a.copy() for a in arrays]
    result = safety_filter.apply(rows, v_des, feet)
    assert result.status.name.lower() == situation
    for array, copy in zip(arrays, before, strict=True):
        np.testing.assert_array_equal(array, copy)


def test_a_result_outlives_the_next_call(safety_filter: SafetyFilter, kin: Kinematics, barriers: BarrierSet) -> None:
    rng = np.random.default_rng(4)
    first = safety_filter.apply(rows_near(kin, barriers, rng), 5 * rng.normal(size=kin.nv))
    kept = first.v.copy()
    for _ in range(3):
        safety_filter.apply(contradictory(rows_near(kin, barriers, rng)), 5 * rng.normal(size=kin.nv))
        safety_filter.apply(rows_near(kin, barriers, rng), 5 * rng.normal(size=kin.nv))
    np.testing.assert_array_equal(first.v, kept)


@pytest.mark.parametrize("filter_name", VELOCITY_FILTERS)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("part", PARTS)
def test_numbers_that_are_not_finite_stop_the_robot(
    part: str, value: float, filter_name: str, kin: Kinematics, barriers: BarrierSet, v_max: Array
) -> None:
    rng = np.random.default_rng(5)
    rows, v_des = rows_near(kin, barriers, rng), rng.normal(size=kin.nv)
    array = v_des if part == "v_des" else getattr(rows, part)
    array.flat[rng.integers(array.size)] = value
    result = SafetyFilter(filter_name, barriers.size, PARAMETERS, v_max).apply(rows, v_des)
    assert result.status == FilterStatus.FAILED
    assert result.v.shape == (kin.nv,)
    assert not result.v.any()
    assert result.slack == np.inf


@pytest.mark.parametrize("part", ["feet", "balance"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_spared_jacobians_that_are_not_finite_stop_the_robot(
    value: float, part: str, safety_filter: SafetyFilter, kin: Kinematics, barriers: BarrierSet
) -> None:
    rng = np.random.default_rng(6)
    rows, jacobian = rows_near(kin, barriers, rng), np.ones((12, kin.nv))
    jacobian[4, 7] = value
    with np.errstate(invalid="ignore"):
        result = safety_filter.apply(rows, 20 * rng.normal(size=kin.nv), **{part: jacobian})
    assert result.status == FilterStatus.FAILED
    assert not result.v.any()


def test_after_bad_numbers_the_filter_works_as_before(
    name: str, safety_filter: SafetyFilter, kin: Kinematics, barriers: BarrierSet, v_max: Array
) -> None:
    rng = np.random.default_rng(7)
    rows, v_des = rows_near(kin, barriers, rng), 5 * rng.normal(size=kin.nv)
    expected = SafetyFilter(name, barriers.size, PARAMETERS, v_max).apply(rows, v_des)
    safety_filter.apply(replace(rows, h=np.full(rows.h.size, np.nan)), v_des)
    assert safety_filter.apply(rows, v_des).status == expected.status == FilterStatus.FILTERED
    np.testing.assert_allclose(safety_filter.apply(rows, v_des).v, expected.v, rtol=0, atol=1e-8)


def test_conditions_that_cannot_be_met_relax_and_the_nominal_is_not_passed_on(
    name: str, safety_filter: SafetyFilter, kin: Kinematics, barriers: BarrierSet, v_max: Array
) -> None:
    rng = np.random.default_rng(8)
    for depth in (0.05, 0.5, 5.0):
        rows, v_des = contradictory(rows_near(kin, barriers, rng), 3, depth), 20 * rng.normal(size=kin.nv)
        result = safety_filter.apply(rows, v_des)
        assert result.status == FilterStatus.RELAXED
        check_report(name, rows, result, v_max)
        # v >= low and -v >= high, low + high > 0: the least squares share the violation
        low, high = conditions_of(name, rows).b[[3, 3 + kin.nv - 6]]
        assert result.slack == pytest.approx(0.5 * (low + high), abs=1e-6)
        assert result.v[9] == pytest.approx(0.5 * (low - high), abs=1e-6)


@pytest.mark.parametrize("name", ["cbf", "issf", "sss"])
@pytest.mark.parametrize("depth", [1e35, 1e100, 1e140])
def test_a_problem_beyond_all_solvers_stops_the_robot(
    name: str, safety_filter: SafetyFilter, kin: Kinematics, barriers: BarrierSet, v_max: Array, depth: float
) -> None:
    rng = np.random.default_rng(9)
    rows = contradictory(rows_near(kin, barriers, rng), 3, depth)
    result = safety_filter.apply(rows, rng.normal(size=kin.nv))
    assert result.status == FilterStatus.FAILED
    assert not result.v.any()
    check_report(name, rows, result, v_max)


def test_a_margin_that_overflows_stops_the_robot() -> None:
    cautious = replace(PARAMETERS, joint_limit=FamilyParameters(1.0, 1e-3))
    rows = BarrierRows(np.ones(1), np.array([[1e153, 0.0]]), np.zeros(1), np.zeros(1, dtype=np.intp))
    with np.errstate(over="ignore"):
        result = SafetyFilter("issf", 1, cautious, np.ones(2)).apply(rows, np.zeros(2))
    assert result.status == FilterStatus.FAILED
    assert not result.v.any()
    assert result.slack == np.inf


def test_without_danger_the_bounds_alone_clip_each_velocity(
    safety_filter: SafetyFilter, kin: Kinematics, barriers: BarrierSet, v_max: Array
) -> None:
    rng = np.random.default_rng(10)
    rows = replace(rows_near(kin, barriers, rng), h=np.full(barriers.size, 1e3))
    v_des = 100 * rng.normal(size=kin.nv)
    result = safety_filter.apply(rows, v_des)
    assert result.status == FilterStatus.FILTERED
    np.testing.assert_allclose(result.v, np.clip(v_des, -v_max, v_max), rtol=0, atol=1e-9)


def test_a_filter_without_rows_only_bounds(name: str) -> None:
    none = BarrierRows(np.zeros(0), np.zeros((0, 3)), np.zeros(0), np.zeros(0, dtype=np.intp))
    bounds = SafetyFilter(name, 0, PARAMETERS, np.ones(3))
    assert bounds.apply(none, np.full(3, 0.5)).status == FilterStatus.UNCHANGED
    result = bounds.apply(none, np.array([5.0, -5.0, 0.5]))
    assert result.status == FilterStatus.FILTERED
    np.testing.assert_allclose(result.v, [1.0, -1.0, 0.5], rtol=0, atol=1e-9)


def test_none_passes_everything_through(kin: Kinematics, barriers: BarrierSet, v_max: Array) -> None:
    rng = np.random.default_rng(11)
    rows, v_des = contradictory(rows_near(kin, barriers, rng)), 100 * rng.normal(size=kin.nv)
    result = SafetyFilter("none", barriers.size, PARAMETERS, v_max).apply(rows, v_des)
    assert result.status == FilterStatus.UNCHANGED
    assert result.v.tobytes() == v_des.tobytes()
    assert not np.shares_memory(result.v, v_des)


def test_a_filter_that_has_worked_answers_as_a_new_one(
    name: str, safety_filter: SafetyFilter, kin: Kinematics, barriers: BarrierSet, v_max: Array
) -> None:
    rng = np.random.default_rng(12)
    seen = set()
    for i in range(30):
        rows, v_des = rows_near(kin, barriers, rng), (0.1, 3.0, 20.0)[i % 3] * rng.normal(size=kin.nv)
        rows = contradictory(rows, i % 7) if i % 4 == 1 else replace(rows, h=rows.h + 1.0) if i % 4 == 3 else rows
        feet = rng.normal(scale=0.3, size=(12, kin.nv)) if i % 2 else None
        kept = safety_filter.apply(rows, v_des, feet)
        fresh = SafetyFilter(name, barriers.size, PARAMETERS, v_max).apply(rows, v_des, feet)
        assert kept.status == fresh.status
        np.testing.assert_allclose(kept.v, fresh.v, rtol=0, atol=1e-7)
        seen.add(kept.status)
    assert seen == {FilterStatus.UNCHANGED, FilterStatus.FILTERED, FilterStatus.RELAXED}


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf])
def test_bounds_that_are_not_positive_numbers_are_refused(bad: float) -> None:
    with pytest.raises(ConfigError, match="v_max"):
        SafetyFilter("cbf", 1, PARAMETERS, np.array([1.0, bad]))


def test_unknown_filter_and_bad_weight_are_refused_by_name() -> None:
    with pytest.raises(ConfigError, match=r"filter = 'cbf2': must be one of none, cbf, issf"):
        SafetyFilter("cbf2", 1, PARAMETERS, np.ones(2))
    for weight in ("foot_weight", "balance_weight"):
        with pytest.raises(ConfigError, match=rf"{weight} = -1"):
            SafetyFilter("cbf", 1, PARAMETERS, np.ones(2), MetricWeights(**{weight.removesuffix("_weight"): -1}))


def test_bounds_given_to_a_filter_may_change_afterwards() -> None:
    bounds = np.ones(2)
    kept = SafetyFilter("cbf", 0, PARAMETERS, bounds)
    bounds[:] = 1e-3
    none = BarrierRows(np.zeros(0), np.zeros((0, 2)), np.zeros(0), np.zeros(0, dtype=np.intp))
    assert kept.apply(none, np.full(2, 0.5)).status == FilterStatus.UNCHANGED


def test_conditions_that_are_not_active_do_not_bind(robot: RobotDescription) -> None:
    """A filter whose condition leaves a violated row out: as if the row were not there, slack and count included."""
    nv = 6 + len(robot.joints)
    rng = np.random.default_rng(5)
    jac = rng.standard_normal((4, nv))
    v_des = rng.standard_normal(nv)
    # rows 0 and 2 are violated by the nominal velocity; row 2 is not active
    b = jac @ v_des + np.array([0.5, -0.5, 0.5, -0.5])
    rows = BarrierRows(-b, jac, np.zeros(4), np.full(4, FAMILIES.index("self_collision"), dtype=np.intp))
    active = np.array([True, True, False, True])

    def partly(given: BarrierRows, _: object) -> HalfSpaces:
        return HalfSpaces(given.jac, -given.h, active)

    def wholly(given: BarrierRows, _: object) -> HalfSpaces:
        return HalfSpaces(given.jac, -given.h, np.ones(3, dtype=bool))

    fewer = BarrierRows(rows.h[active], rows.jac[active], rows.dh_dt[active], rows.family[active])

    bounds = np.full(nv, 100.0)
    results = []
    for condition, given in ((partly, rows), (wholly, fewer)):
        kind = replace(KINDS["cbf"], condition=condition)
        results.append(SafetyFilter(kind, given.h.size, PARAMETERS, bounds).apply(given, v_des))
    np.testing.assert_allclose(results[0].v, results[1].v, rtol=0, atol=1e-9)
    assert results[0].active == results[1].active
    assert results[0].slack == pytest.approx(results[1].slack, abs=1e-9)
