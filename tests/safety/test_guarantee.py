"""What the conditions guarantee under a disturbance, against the equations that it follows from."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from robots.errors import ConfigError
from robots.messages import Array
from safety.barriers.rows import FAMILIES
from safety.filters.conditions import BarrierParameters, FamilyParameters
from safety.filters.guarantee import (
    RowBound,
    SafetyBound,
    cbf_bound,
    cbf_running_bound,
    issf_bound,
    issf_running_bound,
    safety_bounds,
    settle,
)

DT = 0.002
STEPS = 400

PARAMETERS = st.tuples(st.floats(0.5, 20.0), st.floats(0.2, 20.0))
SEEDS = st.integers(0, 10**6)


def random_walk(seed: int, nv: int = 4) -> tuple[Array, Array]:
    """Gradients and disturbances (STEPS, nv) that change from step to step, in size too."""
    rng = np.random.default_rng(seed)
    jac = rng.normal(size=(STEPS, nv)) * rng.uniform(0.0, 2.0, (STEPS, 1))
    return jac, rng.uniform(-1.0, 1.0, (STEPS, nv)) * rng.uniform(0.0, 2.0, (STEPS, 1))


def least_barrier(alpha: float, forcing: Array, start: float) -> Array:
    """Lowest h that a condition allows: dh/dt = -alpha h + forcing, integrated numerically with tight tolerances."""
    out, h = [], start
    for f in forcing:
        solution = solve_ivp(lambda _, y, f=f: -alpha * y + f, (0.0, DT), [h], rtol=1e-12, atol=1e-15)
        h = float(solution.y[0, -1])
        out.append(h)
    return np.array(out)


def exact_barrier(alpha: float, forcing: Array, start: float) -> Array:
    out, h = [], np.array([start])
    for f in forcing:
        h = settle(h, alpha, np.array([f]), DT)
        out.append(h[0])
    return np.array(out)


@given(alpha=st.floats(0.5, 20.0), forcing=st.floats(-5.0, 5.0), start=st.floats(-1.0, 1.0))
def test_one_step_solves_the_equation(alpha: float, forcing: float, start: float) -> None:
    solution = solve_ivp(lambda _, y: -alpha * y + forcing, (0.0, 0.3), [start], rtol=1e-12, atol=1e-14)
    ours = settle(np.array([start]), alpha, np.array([forcing]), 0.3)
    np.testing.assert_allclose(ours, solution.y[:, -1], rtol=1e-9, atol=1e-11)


def test_the_recursion_is_that_of_the_equation() -> None:
    """The exact barrier that the tests below compare with, itself against an integrator."""
    forcing = np.random.default_rng(1).normal(size=30)
    np.testing.assert_allclose(exact_barrier(5.0, forcing, 0.1), least_barrier(5.0, forcing, 0.1), rtol=1e-9, atol=0)


@given(parameters=PARAMETERS, seed=SEEDS, start=st.floats(-0.2, 0.2))
def test_issf_never_falls_below_its_bounds(parameters: tuple[float, float], seed: int, start: float) -> None:
    alpha, epsilon = parameters
    jac, d = random_walk(seed)
    h = exact_barrier(alpha, np.vecdot(jac, jac) / epsilon + np.vecdot(jac, d), start)
    sizes = np.linalg.norm(d, axis=1)
    running = issf_running_bound(alpha, epsilon, sizes, DT, min(start, 0.0))
    assert (h - running >= -1e-12).all()
    if start >= 0:
        assert (running >= issf_bound(alpha, epsilon, sizes.max()) - 1e-12).all()


@given(parameters=PARAMETERS, seed=SEEDS)
def test_the_issf_bound_is_attained_by_the_worst_disturbance(parameters: tuple[float, float], seed: int) -> None:
    """d against a gradient of the length |J| = epsilon |d| / 2; any other length of J leaves h above."""
    alpha, epsilon = parameters
    _, d = random_walk(seed)
    sizes = np.linalg.norm(d, axis=1)
    bound = issf_running_bound(alpha, epsilon, sizes, DT)
    for factor, attained in ((1.0, True), (0.5, False), (1.5, False)):
        jac = -0.5 * factor * epsilon * d
        h = exact_barrier(alpha, np.vecdot(jac, jac) / epsilon + np.vecdot(jac, d), 0.0)
        assert np.allclose(h, bound, rtol=1e-9, atol=1e-14) is attained
        assert (h >= bound * (1 + 1e-12)).all()


@given(alpha=st.floats(0.5, 20.0), seed=SEEDS, start=st.floats(-0.2, 0.2))
def test_cbf_never_falls_below_its_bounds_and_attains_them(alpha: float, seed: int, start: float) -> None:
    jac, d = random_walk(seed)
    gradient, sizes = np.linalg.norm(jac, axis=1), np.linalg.norm(d, axis=1)
    running = cbf_running_bound(alpha, gradient, sizes, DT, min(start, 0.0))
    assert (exact_barrier(alpha, np.vecdot(jac, d), start) - running >= -1e-12).all()
    if start >= 0:
        assert (running >= cbf_bound(alpha, gradient.max(), sizes.max()) - 1e-12).all()
    against = -jac * (sizes / gradient)[:, None]
    worst = exact_barrier(alpha, np.vecdot(jac, against), min(start, 0.0))
    np.testing.assert_allclose(worst, running, rtol=1e-9, atol=1e-12)


@given(parameters=PARAMETERS, size=st.floats(0.1, 3.0))
def test_a_constant_disturbance_approaches_gamma(parameters: tuple[float, float], size: float) -> None:
    alpha, epsilon = parameters
    time = DT * np.arange(1, STEPS + 1)
    approach = 1.0 - np.exp(-alpha * time)
    constant = np.full(STEPS, size)
    gamma = epsilon * size**2 / (4.0 * alpha)
    assert issf_bound(alpha, epsilon, size) == pytest.approx(-gamma, rel=1e-14)
    np.testing.assert_allclose(issf_running_bound(alpha, epsilon, constant, DT), -gamma * approach, rtol=1e-9)
    np.testing.assert_allclose(
        cbf_running_bound(alpha, constant, constant, DT), -(size**2) / alpha * approach, rtol=1e-9
    )
    # one step as long as a thousand time constants
    assert issf_running_bound(alpha, epsilon, np.array([size]), 1e3 / alpha)[0] == pytest.approx(-gamma, rel=1e-14)


@given(parameters=PARAMETERS, seed=SEEDS, parts=st.integers(2, 5))
def test_how_the_time_is_cut_into_steps_does_not_matter(parameters: tuple[float, float], seed: int, parts: int) -> None:
    _, d = random_walk(seed)
    sizes = np.linalg.norm(d, axis=1)
    coarse = issf_running_bound(*parameters, sizes, DT, -0.05)
    fine = issf_running_bound(*parameters, np.repeat(sizes, parts), DT / parts, -0.05)
    np.testing.assert_allclose(fine[parts - 1 :: parts], coarse, rtol=1e-10, atol=1e-15)


def test_without_a_disturbance_nothing_is_lost() -> None:
    zero = np.zeros(STEPS)
    for value in (issf_bound(5.0, 2.0, 0.0), cbf_bound(5.0, 1.0, 0.0), cbf_bound(5.0, 0.0, 1.0)):
        assert value == 0.0
    assert (issf_running_bound(5.0, 2.0, zero, DT) == 0.0).all()
    recovered = issf_running_bound(5.0, 2.0, zero, DT, -0.1)
    np.testing.assert_allclose(recovered, -0.1 * np.exp(-5.0 * DT * np.arange(1, STEPS + 1)), rtol=1e-10)


@pytest.mark.parametrize("condition", ["cbf", "issf"])
def test_a_point_that_is_pushed_to_a_wall_stops_at_the_bound_at_most(condition: str) -> None:
    """A filtered point drawn to the centre of a disc, and pushed there by a disturbance that the filter ignores."""
    parameters, size, radius = FamilyParameters(alpha=4.0, epsilon=6.0), 0.7, 0.5
    nominal = 1.0

    def rate(_: float, p: Array) -> Array:
        n = p / np.linalg.norm(p)
        h = np.linalg.norm(p) - radius
        least = -parameters.alpha * h + (1.0 / parameters.epsilon if condition == "issf" else 0.0)
        v = -nominal * n
        return v + max(0.0, least - n @ v) * n - size * n

    solution = solve_ivp(rate, (0.0, 6.0), [0.8, 0.3], rtol=1e-10, atol=1e-12, max_step=0.01)
    h = np.linalg.norm(solution.y, axis=0) - radius
    bound = SafetyBound(condition, parameters).bound(size, 1.0)
    assert h.min() >= bound - 1e-9
    # at rest of the filtered motion: alpha h = 1 / epsilon - size, or -size for the CBF, which is its bound
    rest = (1.0 / parameters.epsilon if condition == "issf" else 0.0) - size
    assert h[-1] == pytest.approx(rest / parameters.alpha, rel=1e-6)
    assert bool(np.isclose(bound, h[-1], rtol=1e-6, atol=0)) is (condition == "cbf")


@pytest.mark.parametrize("condition", ["cbf", "issf"])
@given(seed=SEEDS, margin=st.floats(0.01, 0.1), h=st.floats(-0.2, 0.2))
def test_a_margin_shifts_everything_by_itself(condition: str, seed: int, margin: float, h: float) -> None:
    jac, d = random_walk(seed)
    gradient, sizes = np.linalg.norm(jac, axis=1), np.linalg.norm(d, axis=1)
    plain, kept = (SafetyBound(condition, FamilyParameters(5.0, 2.0, m)) for m in (None, margin))
    assert kept.bound(0.7, 1.3) == pytest.approx(margin + plain.bound(0.7, 1.3), rel=1e-12)
    shifted = margin + plain.running_bound(h - margin, sizes, gradient, DT)
    np.testing.assert_allclose(kept.running_bound(h, sizes, gradient, DT), shifted, rtol=1e-12, atol=1e-15)
    rows = [RowBound(p, DT) for p in (plain, kept)]
    for j, e in zip(jac[:20], d[:20], strict=True):
        free, held = (row.advance(np.array([x]), j[None], e) for row, x in zip(rows, (h - margin, h), strict=True))
        assert held == pytest.approx(margin + free, rel=1e-10, abs=1e-13)


@pytest.mark.parametrize("condition", ["cbf", "issf"])
def test_bounds_of_rows_follow_rows_whose_condition_is_active(condition: str) -> None:
    """Three rows that obey the condition with equality lie on their bounds; those with room to spare lie above."""
    guarantee = SafetyBound(condition, FamilyParameters(alpha=5.0, epsilon=2.0))
    rng = np.random.default_rng(3)
    jac, d = rng.normal(size=(STEPS, 3, 4)), rng.normal(size=(STEPS, 4))
    tight, roomy = RowBound(guarantee, DT), RowBound(guarantee, DT)
    h = room = np.array([0.1, 0.02, 0.3])
    for i in range(STEPS):
        if i:
            forcing = np.einsum("ij,j->i", jac[i], d[i])
            if condition == "issf":
                forcing += (jac[i] ** 2).sum(axis=1) / 2.0
            h = exact = settle(h, 5.0, forcing, DT)
            room = settle(room, 5.0, forcing + 0.5, DT)
            assert tight.advance(h, jac[i], d[i]) == pytest.approx(exact.min(), rel=1e-10, abs=1e-13)
            assert roomy.advance(room, jac[i], d[i]) < room.min()
        else:
            assert tight.advance(h, jac[i], d[i]) == roomy.advance(room, jac[i], d[i]) == 0.02


def test_row_bounds_are_above_the_bound_from_the_size_of_the_disturbance() -> None:
    guarantee = SafetyBound("issf", FamilyParameters(alpha=5.0, epsilon=2.0))
    jac, d = random_walk(5)
    row = RowBound(guarantee, DT)
    by_row = [row.advance(np.zeros(1), j[None], e) for j, e in zip(jac, d, strict=True)]
    by_size = guarantee.running_bound(0.0, np.linalg.norm(d[1:], axis=1), np.linalg.norm(jac[1:], axis=1), DT)
    assert (np.array(by_row[1:]) > by_size).all()


def test_where_the_filter_does_not_run_nothing_is_guaranteed() -> None:
    sizes = np.array([0.1, 0.2, np.nan, 0.1])
    assert np.isnan(issf_running_bound(5.0, 2.0, sizes, DT)).tolist() == [False, False, True, True]
    assert np.isnan(cbf_running_bound(5.0, np.ones(4), sizes, DT)).tolist() == [False, False, True, True]
    row = RowBound(SafetyBound("issf", FamilyParameters()), DT)
    jac = np.ones((2, 3))
    for d, known in ((0.1, True), (0.1, True), (np.nan, False), (0.1, False)):
        assert np.isfinite(row.advance(np.ones(2), jac, np.full(3, d))) == known
    assert np.isnan(
        RowBound(SafetyBound("cbf", FamilyParameters()), DT).advance(np.zeros(0), np.zeros((0, 3)), np.ones(3))
    )


def test_every_family_has_the_guarantee_of_its_own_parameters() -> None:
    parameters = BarrierParameters(obstacle=FamilyParameters(alpha=3.0, epsilon=7.0))
    found = safety_bounds("issf", parameters)
    assert tuple(found) == FAMILIES
    assert found["obstacle"].bound(0.5, 9.9) == issf_bound(3.0, 7.0, 0.5)
    assert safety_bounds("cbf", parameters)["obstacle"].bound(0.5, 9.9) == cbf_bound(3.0, 9.9, 0.5)
    assert safety_bounds("none", parameters) == {}


@pytest.mark.parametrize(
    ("name", "call"),
    [
        ("alpha", lambda: issf_bound(0.0, 1.0, 1.0)),
        ("epsilon", lambda: issf_bound(1.0, -1.0, 1.0)),
        ("disturbance", lambda: issf_bound(1.0, 1.0, float("inf"))),
        ("alpha", lambda: cbf_bound(float("nan"), 1.0, 1.0)),
        ("gradient", lambda: cbf_bound(1.0, -1.0, 1.0)),
        ("disturbance", lambda: cbf_bound(1.0, 1.0, -1.0)),
        ("alpha", lambda: issf_running_bound(-1.0, 1.0, np.ones(2), DT)),
        ("epsilon", lambda: issf_running_bound(1.0, 0.0, np.ones(2), DT)),
        ("disturbance", lambda: issf_running_bound(1.0, 1.0, -np.ones(2), DT)),
        ("disturbance", lambda: issf_running_bound(1.0, 1.0, np.ones((2, 2)), DT)),
        ("gradient", lambda: cbf_running_bound(1.0, np.full(2, np.inf), np.ones(2), DT)),
        ("dt", lambda: issf_running_bound(1.0, 1.0, np.ones(2), 0.0)),
        ("start", lambda: issf_running_bound(1.0, 1.0, np.ones(2), DT, 0.1)),
        ("dt", lambda: settle(np.zeros(1), 1.0, np.zeros(1), -DT)),
        ("dt", lambda: RowBound(SafetyBound("issf", FamilyParameters()), 0.0)),
        ("condition", lambda: SafetyBound("none", FamilyParameters())),
    ],
)
def test_what_is_not_allowed_is_named(name: str, call: Any) -> None:
    with pytest.raises(ConfigError, match=rf"^{name} = "):
        call()
