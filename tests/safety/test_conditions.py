"""Conditions on the velocity, row by row, and the parameters they refuse."""

from dataclasses import replace

import numpy as np
import pytest

from robots.errors import ConfigError
from robots.messages import Array
from safety.barriers.rows import FAMILIES, BarrierRows
from safety.filters.conditions import (
    SET_MARGINS,
    BarrierParameters,
    FamilyParameters,
    RowParameters,
    cbf,
    issf_cbf,
    ssa,
    sss,
    worst_row,
)
from safety.filters.registry import KINDS

ALPHAS = (3.0, 5.0, 7.0, 11.0, 13.0, 17.0)
EPSILONS = (0.5, 2.0, 4.0, 8.0, 16.0, 32.0)
N, NV = 40, 9
ALL = (cbf, issf_cbf, ssa, sss, worst_row)


def parameters(epsilon_factor: float = 1.0) -> BarrierParameters:
    pairs = zip(FAMILIES, ALPHAS, EPSILONS, strict=True)
    return BarrierParameters(**{f: FamilyParameters(a, epsilon_factor * e) for f, a, e in pairs})


def of_rows(rows: BarrierRows, epsilon_factor: float = 1.0) -> RowParameters:
    return parameters(epsilon_factor).of_rows(rows.family)


@pytest.fixture
def rows() -> BarrierRows:
    """Every family, in no order."""
    rng = np.random.default_rng(0)
    family = rng.permutation(np.arange(N) % len(FAMILIES)).astype(np.intp)
    return BarrierRows(rng.normal(size=N), rng.normal(size=(N, NV)), rng.normal(size=N), family)


def expected_bounds(rows: BarrierRows, margin: bool) -> Array:
    """Right-hand sides by the formulas, one row at a time."""
    b = []
    for h, jac, dh_dt, f in zip(rows.h, rows.jac, rows.dh_dt, rows.family, strict=True):
        b.append(-ALPHAS[f] * h - dh_dt + (sum(x * x for x in jac) / EPSILONS[f] if margin else 0.0))
    return np.array(b)


def test_cbf_is_equation_5_row_by_row(rows: BarrierRows) -> None:
    spaces = cbf(rows, of_rows(rows))
    np.testing.assert_array_equal(spaces.A, rows.jac)
    np.testing.assert_allclose(spaces.b, expected_bounds(rows, margin=False), rtol=1e-14, atol=1e-14)
    assert spaces.active.all()


def test_issf_is_equation_32_row_by_row(rows: BarrierRows) -> None:
    spaces = issf_cbf(rows, of_rows(rows))
    np.testing.assert_array_equal(spaces.A, rows.jac)
    np.testing.assert_allclose(spaces.b, expected_bounds(rows, margin=True), rtol=1e-13, atol=1e-13)
    assert spaces.active.all()


def test_joint_limit_rows_are_equations_39_and_40() -> None:
    nj, h = 3, np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    jac = np.vstack([np.eye(nj), -np.eye(nj)])
    rows = BarrierRows(h, jac, np.zeros(6), np.zeros(6, dtype=np.intp))
    np.testing.assert_allclose(issf_cbf(rows, of_rows(rows)).b, -ALPHAS[0] * h + 1 / EPSILONS[0], rtol=1e-14)


def test_obstacle_rows_are_equation_49() -> None:
    # an obstacle that comes nearer at v along -n: v_AO = n . v_O stands on the right-hand side with its own sign
    n, v_obstacle = np.array([1.0, 0, 0]), np.array([0.3, 0.5, 0.0])
    rows = BarrierRows(np.array([0.2]), n.reshape(1, 3), np.array([-n @ v_obstacle]), np.array([3], dtype=np.intp))
    assert cbf(rows, of_rows(rows)).b[0] == pytest.approx(n @ v_obstacle - ALPHAS[3] * 0.2)


def test_issf_demands_more_than_cbf_and_less_as_epsilon_grows(rows: BarrierRows) -> None:
    plain = cbf(rows, of_rows(rows)).b
    excess = [issf_cbf(rows, of_rows(rows, 10.0**k)).b - plain for k in range(5)]
    assert all((e > 0).all() for e in excess)
    for k, e in enumerate(excess):
        np.testing.assert_allclose(e * 10.0**k, excess[0], rtol=1e-9)
    np.testing.assert_allclose(issf_cbf(rows, of_rows(rows, 1e12)).b, plain, rtol=0, atol=1e-10)


@pytest.mark.parametrize("condition", ALL)
def test_conditions_leave_the_rows_alone(condition: object, rows: BarrierRows) -> None:
    before = [x.copy() for x in (rows.h, rows.jac, rows.dh_dt, rows.family)]
    spaces = condition(rows, of_rows(rows))
    for x, y in zip((rows.h, rows.jac, rows.dh_dt, rows.family), before, strict=True):
        np.testing.assert_array_equal(x, y)
    assert not any(np.shares_memory(spaces.b, x) for x in (rows.h, rows.dh_dt))


@pytest.mark.parametrize("condition", ALL)
def test_no_rows_make_no_half_spaces(condition: object) -> None:
    none = BarrierRows(np.zeros(0), np.zeros((0, NV)), np.zeros(0), np.zeros(0, dtype=np.intp))
    spaces = condition(none, of_rows(none))
    assert spaces.A.shape == (0, NV)
    assert spaces.b.shape == spaces.active.shape == (0,)


def test_parameters_come_in_the_order_of_the_families() -> None:
    np.testing.assert_array_equal(parameters().values("alpha"), ALPHAS)
    np.testing.assert_array_equal(parameters().values("epsilon"), EPSILONS)


@pytest.mark.parametrize("name", [n for n in FamilyParameters.__slots__ if n not in ("margin", "layer")])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf, -np.inf, "5", None])
def test_parameters_that_are_not_positive_numbers_are_refused_by_name(name: str, value: object) -> None:
    with pytest.raises(ConfigError, match=rf"{name} = .*: must be a finite number above 0") as error:
        FamilyParameters(**{"alpha": 1.0, "epsilon": 1.0} | {name: value})
    assert error.value.name == name
    assert error.value.value is value


@pytest.mark.parametrize(
    ("name", "value", "source"),
    [
        ("eta", 0.5, "p-SSA paper, sec. V-C: for every index"),
        ("slack_weight", 10.0, "p-SSA paper, sec. V-E: r-SSA with ten times the identity"),
        ("slope", 10.0, "SPARK, Table 11, G1FixedBase_D1_AG_SO_v0: lambda_sss"),
        ("push_cartesian", 0.1, "SPARK, Table 11, G1FixedBase_D1_AG_SO_v0: c_pfm"),
        ("push_joint", 40.0, "SPARK, Table 11, G1FixedBase_D1_AG_SO_v0: c_sma"),
        ("index_power", 1.0, "SPARK, second-order index: n = 1 is the linear one, that of the p-SSA paper's eq. (3)"),
        ("index_gain", 1.0, "ours: SPARK leaves k to the user"),
        ("alpha", 5.0, "ours"),
        ("epsilon", 5.0, "ours"),
    ],
)
def test_defaults_are_those_of_the_papers(name: str, value: float, source: str) -> None:
    assert getattr(FamilyParameters(), name) == value, source
    np.testing.assert_array_equal(BarrierParameters().values(name), np.full(len(FAMILIES), value), err_msg=source)


@pytest.mark.parametrize(
    ("family", "margin", "source"),
    [
        ("obstacle", 0.05, "p-SSA paper, sec. V-B: d_min,env"),
        ("self_collision", 0.01, "p-SSA paper, sec. V-B: d_min,self"),
        ("leg_collision", 0.01, "p-SSA paper, sec. V-B: d_min,self"),
        ("joint_limit", 0.05, "ours: 10 rad/s for 5 ms"),
        ("workspace", 0.02, "ours: 4 m/s for 5 ms"),
        ("custom", 0.0, "ours: unit and range unknown"),
    ],
)
def test_default_margins_are_those_of_the_papers(family: str, margin: float, source: str) -> None:
    index = FAMILIES.index(family)
    assert FamilyParameters().margin is None
    for name in ("ssa", "rssa", "pssa", "sss", "pfm", "sma"):
        assert BarrierParameters().margins(KINDS[name].margins)[index] == margin, source
    # those of Lee et al. act on the barrier as it is
    for name in ("none", "cbf", "issf", "ecbf"):
        assert BarrierParameters().margins(KINDS[name].margins)[index] == 0.0


@pytest.mark.parametrize("value", [-1e-9, np.nan, np.inf, "0.1"])
def test_margins_that_are_not_distances_are_refused(value: object) -> None:
    with pytest.raises(ConfigError, match=r"margin = .*0 or above"):
        FamilyParameters(margin=value)


def test_an_index_with_infinite_slope_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"index_power = 0\.5: must be 1 or above"):
        FamilyParameters(index_power=0.5)


def with_margins(rows: BarrierRows) -> RowParameters:
    """Every parameter another in each family; margins of one family its own, of the rest the filter's."""
    families = {
        f: FamilyParameters(3.0 + i, 0.5 + i, 0.3 if f == "obstacle" else None, eta=0.2 + i, slope=2.0 + i)
        for i, f in enumerate(FAMILIES)
    }
    return BarrierParameters(**families).of_rows(rows.family, SET_MARGINS)


def margin_of(family: int) -> float:
    return 0.3 if FAMILIES[family] == "obstacle" else SET_MARGINS[FAMILIES[family]]


def test_margins_are_the_familys_own_or_else_the_filters(rows: BarrierRows) -> None:
    np.testing.assert_array_equal(with_margins(rows).margin, [margin_of(f) for f in rows.family])
    assert (parameters().margins(dict.fromkeys(FAMILIES, 0.0)) == 0).all()


def test_cbf_with_a_margin_is_cbf_of_h_less_the_margin(rows: BarrierRows) -> None:
    expected = [
        -(3.0 + f) * (h - margin_of(f)) - dh_dt for h, dh_dt, f in zip(rows.h, rows.dh_dt, rows.family, strict=True)
    ]
    np.testing.assert_allclose(cbf(rows, with_margins(rows)).b, expected, rtol=1e-14, atol=1e-14)


@pytest.mark.parametrize("condition", [ssa, sss])
def test_ssa_and_sss_hold_rows_inside_their_margin_only(condition: object, rows: BarrierRows) -> None:
    spaces = condition(rows, with_margins(rows))
    assert 0 < spaces.active.sum() < N
    for i, (h, dh_dt, f) in enumerate(zip(rows.h, rows.dh_dt, rows.family, strict=True)):
        phi = margin_of(f) - h
        assert spaces.active[i] == (phi >= 0)
        # d/dt phi <= -eta; d/dt phi <= -lambda phi
        rate = 0.2 + f if condition is ssa else (2.0 + f) * phi
        assert spaces.b[i] == pytest.approx(rate - dh_dt, abs=1e-13)


def test_a_row_exactly_at_its_margin_is_held() -> None:
    for condition, rate in ((ssa, 0.2 + 3), (sss, 0.0), (worst_row, 0.0)):
        rows = BarrierRows(np.array([0.3]), np.ones((1, 2)), np.array([0.1]), np.array([3], dtype=np.intp))
        spaces = condition(rows, with_margins(rows))
        assert spaces.active.all()
        assert spaces.b[0] == pytest.approx(rate - 0.1, abs=1e-15)


def test_worst_row_is_the_deepest_inside_its_margin_and_none_outside(rows: BarrierRows) -> None:
    p = with_margins(rows)
    spaces = worst_row(rows, p)
    assert spaces.active.sum() == 1
    assert spaces.active[np.argmax(p.margin - rows.h)]
    np.testing.assert_array_equal(spaces.b, -rows.dh_dt)
    assert not worst_row(replace(rows, h=p.margin + np.abs(rows.h) + 1e-12), p).active.any()


def test_the_worst_row_is_that_of_the_largest_number_whatever_its_unit() -> None:
    joint, obstacle = FAMILIES.index("joint_limit"), FAMILIES.index("obstacle")
    family = np.array([joint, obstacle], dtype=np.intp)
    p = BarrierParameters().of_rows(family, SET_MARGINS)
    for h, worst in (([-0.02, -0.01], 0), ([-0.01, -0.02], 1)):
        rows = BarrierRows(np.array(h), np.eye(2), np.zeros(2), family)
        np.testing.assert_array_equal(np.flatnonzero(worst_row(rows, p).active), [worst])
