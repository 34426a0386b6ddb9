"""Conditions on the velocity, row by row, and the parameters they refuse."""

import numpy as np
import pytest

from robots.errors import ConfigError
from robots.messages import Array
from safety.conditions import BarrierParameters, FamilyParameters, cbf, issf_cbf
from safety.rows import FAMILIES, BarrierRows

ALPHAS = (3.0, 5.0, 7.0, 11.0, 13.0, 17.0)
EPSILONS = (0.5, 2.0, 4.0, 8.0, 16.0, 32.0)
N, NV = 40, 9


def parameters(epsilon_factor: float = 1.0) -> BarrierParameters:
    pairs = zip(FAMILIES, ALPHAS, EPSILONS, strict=True)
    return BarrierParameters(**{f: FamilyParameters(a, epsilon_factor * e) for f, a, e in pairs})


@pytest.fixture
def rows() -> BarrierRows:
    """Every family, in no order."""
    rng = np.random.default_rng(0)
    family = rng.permutation(np.arange(N) % len(FAMILIES)).astype(np.intp)
    return BarrierRows(rng.normal(size=N), rng.normal(size=(N, NV)), rng.normal(size=N), family)


def expected_bounds(rows: BarrierRows, margin: bool) -> Array:
    """Right-hand sides by the formulas, one row at a time."""
    b = []
    for h, jac, drift, f in zip(rows.h, rows.jac, rows.drift, rows.family, strict=True):
        b.append(-ALPHAS[f] * h - drift + (sum(x * x for x in jac) / EPSILONS[f] if margin else 0.0))
    return np.array(b)


def test_cbf_is_equation_5_row_by_row(rows: BarrierRows) -> None:
    spaces = cbf(rows, parameters())
    np.testing.assert_array_equal(spaces.A, rows.jac)
    np.testing.assert_allclose(spaces.b, expected_bounds(rows, margin=False), rtol=1e-14, atol=1e-14)
    assert spaces.active.all()


def test_issf_is_equation_32_row_by_row(rows: BarrierRows) -> None:
    spaces = issf_cbf(rows, parameters())
    np.testing.assert_array_equal(spaces.A, rows.jac)
    np.testing.assert_allclose(spaces.b, expected_bounds(rows, margin=True), rtol=1e-13, atol=1e-13)
    assert spaces.active.all()


def test_joint_limit_rows_are_equations_39_and_40() -> None:
    nj, h = 3, np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    jac = np.vstack([np.eye(nj), -np.eye(nj)])
    rows = BarrierRows(h, jac, np.zeros(6), np.zeros(6, dtype=np.intp))
    np.testing.assert_allclose(issf_cbf(rows, parameters()).b, -ALPHAS[0] * h + 1 / EPSILONS[0], rtol=1e-14)


def test_obstacle_rows_are_equation_49() -> None:
    # an obstacle that comes nearer at v along -n: v_AO = n . v_O stands on the right-hand side with its own sign
    n, v_obstacle = np.array([1.0, 0, 0]), np.array([0.3, 0.5, 0.0])
    rows = BarrierRows(np.array([0.2]), n.reshape(1, 3), np.array([-n @ v_obstacle]), np.array([3], dtype=np.intp))
    assert cbf(rows, parameters()).b[0] == pytest.approx(n @ v_obstacle - ALPHAS[3] * 0.2)


def test_issf_demands_more_than_cbf_and_less_as_epsilon_grows(rows: BarrierRows) -> None:
    plain = cbf(rows, parameters()).b
    excess = [issf_cbf(rows, parameters(10.0**k)).b - plain for k in range(5)]
    assert all((e > 0).all() for e in excess)
    for k, e in enumerate(excess):
        np.testing.assert_allclose(e * 10.0**k, excess[0], rtol=1e-9)
    np.testing.assert_allclose(issf_cbf(rows, parameters(1e12)).b, plain, rtol=0, atol=1e-10)


@pytest.mark.parametrize("condition", [cbf, issf_cbf])
def test_conditions_leave_the_rows_alone(condition: object, rows: BarrierRows) -> None:
    before = [x.copy() for x in (rows.h, rows.jac, rows.drift, rows.family)]
    spaces = condition(rows, parameters())  # type: ignore[operator]
    for x, y in zip((rows.h, rows.jac, rows.drift, rows.family), before, strict=True):
        np.testing.assert_array_equal(x, y)
    assert not any(np.shares_memory(spaces.b, x) for x in (rows.h, rows.drift))


@pytest.mark.parametrize("condition", [cbf, issf_cbf])
def test_no_rows_make_no_half_spaces(condition: object) -> None:
    none = BarrierRows(np.zeros(0), np.zeros((0, NV)), np.zeros(0), np.zeros(0, dtype=np.intp))
    spaces = condition(none, parameters())  # type: ignore[operator]
    assert spaces.A.shape == (0, NV)
    assert spaces.b.shape == spaces.active.shape == (0,)


def test_parameters_come_in_the_order_of_the_families() -> None:
    np.testing.assert_array_equal(parameters().values("alpha"), ALPHAS)
    np.testing.assert_array_equal(parameters().values("epsilon"), EPSILONS)


@pytest.mark.parametrize("name", ["alpha", "epsilon"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf, -np.inf, "5", None])
def test_parameters_that_are_not_positive_numbers_are_refused_by_name(name: str, value: object) -> None:
    with pytest.raises(ConfigError, match=rf"{name} = .*: must be a finite number above 0") as error:
        FamilyParameters(**{"alpha": 1.0, "epsilon": 1.0} | {name: value})  # type: ignore[arg-type]
    assert error.value.name == name
    assert error.value.value is value
