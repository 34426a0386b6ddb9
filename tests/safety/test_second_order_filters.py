"""Filters of accelerations: their rows against differences, their half-spaces against the equations, and over time."""

from dataclasses import replace

import numpy as np
import pytest

from robots.messages import Array
from safety.barriers.rows import FAMILIES, BarrierRows
from safety.filters.conditions import NO_MARGINS, BarrierParameters, FamilyParameters, RowParameters, cbf
from safety.filters.safety_filter import FILTERS, KINDS, FilterSettings, FilterStatus, SafetyFilter
from safety.filters.second_order import acceleration_bounds, ecbf, ecbf_rows, index_rows, without_margin

OBSTACLE = FAMILIES.index("obstacle")
NAMES = tuple(n for n in FILTERS if n != "none")
DT = 0.002


class PointAmongSpheres:
    """A point (3,) that sees spheres which move at constant velocity: h, its gradient, dh_dt and curvature."""

    def __init__(self, centres: Array, velocities: Array, radii: Array) -> None:
        self.centres, self.velocities, self.radii = centres, velocities, radii

    def rows(self, x: Array, v: Array, time: float = 0.0) -> BarrierRows:
        offset = x - self.centres - time * self.velocities
        distance = np.linalg.norm(offset, axis=1)
        normal = offset / distance[:, None]
        relative = v - self.velocities
        along = np.vecdot(normal, relative)
        curvature = (np.vecdot(relative, relative) - along**2) / distance
        dh_dt = -np.vecdot(normal, self.velocities)
        family = np.full(distance.size, OBSTACLE, dtype=np.intp)
        return BarrierRows(distance - self.radii, normal, dh_dt, family, curvature)


@pytest.fixture
def scene() -> PointAmongSpheres:
    rng = np.random.default_rng(0)
    return PointAmongSpheres(rng.normal(size=(6, 3)), 0.3 * rng.normal(size=(6, 3)), rng.uniform(0.1, 2.0, 6))


def parameters(n: int, **values: float | None) -> RowParameters:
    family = FamilyParameters(**values)
    return BarrierParameters(obstacle=family).of_rows(np.full(n, OBSTACLE, dtype=np.intp), NO_MARGINS)


@pytest.mark.parametrize("power", [1.0, 1.5, 2.0, 3.0])
def test_rates_of_the_index_and_of_the_exponential_barrier_are_their_differences(
    power: float, scene: PointAmongSpheres
) -> None:
    rng = np.random.default_rng(1)
    p = parameters(6, margin=0.2, index_gain=0.7, index_power=power, alpha=3.0)
    for _ in range(10):
        x, v, u = rng.normal(size=3), rng.normal(size=3), rng.normal(size=3)

        def later(make: object, t: float, x: Array = x, v: Array = v, u: Array = u) -> Array:
            velocity = v + t * u
            return make(scene.rows(x + t * v + 0.5 * t**2 * u, velocity, t), velocity, p).h

        for make in (index_rows, ecbf_rows):
            rows, step = make(scene.rows(x, v), v, p), 1e-5
            difference = (later(make, step) - later(make, -step)) / (2 * step)
            np.testing.assert_allclose(rows.jac @ u + rows.dh_dt, difference, rtol=1e-6, atol=1e-7)


def test_the_index_is_sparks_with_its_signs_put_right(scene: PointAmongSpheres) -> None:
    x, v = np.array([3.0, 0.1, 0.2]), np.array([-0.4, 0.2, 0.1])
    rows = scene.rows(x, v)
    assert (rows.h > 0).all()
    rate = rows.jac @ v + rows.dh_dt
    p = parameters(6, margin=0.3, index_gain=0.6, index_power=2.0)
    np.testing.assert_allclose(index_rows(rows, v, p).h, rows.h**2 - 0.3**2 + 0.6 * rate, rtol=1e-14)
    # as printed, a body far away and at rest would count as unsafe
    still = replace(rows, dh_dt=np.zeros(6))
    np.testing.assert_array_equal(index_rows(still, 0 * v, p).h > 0, rows.h > 0.3)
    # in penetration the index goes on falling
    deep = replace(still, h=-rows.h)
    np.testing.assert_allclose(index_rows(deep, 0 * v, p).h, -(rows.h**2) - 0.3**2, rtol=1e-14)


def test_exponential_barrier_is_equations_54_and_55(scene: PointAmongSpheres) -> None:
    x, v, alpha = np.array([1.0, 0.1, 0.2]), np.array([-0.4, 0.2, 0.1]), 3.0
    rows = scene.rows(x, v)
    assert rows.curvature is not None
    rate = rows.jac @ v + rows.dh_dt
    spaces = ecbf(rows, v, parameters(6, alpha=alpha))
    # h_ddot + 2 alpha h_dot + alpha^2 h >= 0
    np.testing.assert_array_equal(spaces.A, rows.jac)
    np.testing.assert_allclose(spaces.b, -rows.curvature - 2 * alpha * rate - alpha**2 * rows.h, rtol=1e-13, atol=1e-13)
    assert spaces.active.all()


def test_linear_index_with_gain_one_over_alpha_is_the_exponential_barrier(scene: PointAmongSpheres) -> None:
    x, v, alpha = np.array([1.0, 0.1, 0.2]), np.array([-0.4, 0.2, 0.1]), 4.0
    p = parameters(6, alpha=alpha, index_gain=1 / alpha, margin=0.1)
    index, exponential = (make(scene.rows(x, v), v, p) for make in (index_rows, ecbf_rows))
    for a, b in ((index.h, exponential.h), (index.jac, exponential.jac), (index.dh_dt, exponential.dh_dt)):
        np.testing.assert_allclose(alpha * a, b, rtol=1e-13, atol=1e-13)
    one, two = cbf(index, without_margin(p)), ecbf(scene.rows(x, v), v, p)
    np.testing.assert_allclose(alpha * one.b, two.b, rtol=1e-12, atol=1e-12)


def test_rows_without_curvature_are_no_second_order_rows(scene: PointAmongSpheres) -> None:
    rows = replace(scene.rows(np.ones(3), np.ones(3)), curvature=None)
    for make in (index_rows, ecbf_rows, ecbf):
        with pytest.raises(ValueError, match="curvature"):
            make(rows, np.ones(3), parameters(6))


def test_bounds_keep_velocity_after_a_step_and_brake_what_is_too_fast() -> None:
    limit, v_max = np.full(4, 10.0), np.full(4, 1.0)
    v = np.array([0.0, 0.995, -1.0, 1.5])
    lower, upper = acceleration_bounds(limit, v, v_max, DT)
    np.testing.assert_allclose(lower, [-10, -10, 0, -10], rtol=0, atol=1e-12)
    np.testing.assert_allclose(upper, [10, 2.5, 10, -10], rtol=0, atol=1e-12)
    assert acceleration_bounds(limit, v, None, DT)[1] is limit


def make(name: str, n: int) -> SafetyFilter:
    family = FamilyParameters(margin=0.05, index_gain=0.3, push_joint=60.0, push_cartesian=10.0, slack_weight=1e4)
    return SafetyFilter(
        name, n, BarrierParameters(obstacle=family), np.full(3, 20.0), settings=FilterSettings(order=2, dt=DT)
    )


@pytest.mark.parametrize("name", NAMES)
def test_a_point_thrown_at_a_sphere_stops_before_it(name: str) -> None:
    """Double integrator, nominal acceleration towards the sphere: h stays above zero, without a filter it does not."""
    scene = PointAmongSpheres(np.zeros((1, 3)), np.array([[-0.1, 0.0, 0.0]]), np.array([0.3]))
    lowest = {}
    for chosen in (name, "none"):
        safety_filter = make(chosen, 1)
        x, v, heights = np.array([-1.0, 0.05, 0.0]), np.array([0.5, 0.0, 0.0]), []
        for k in range(1000):
            rows = scene.rows(x, v, k * DT)
            result = safety_filter.apply(rows, np.array([1.0, 0.0, 0.0]), velocity=v)
            # weighted slack always leaves some violation where the nominal asks for it
            assert result.status <= (FilterStatus.RELAXED if name == "rssa" else FilterStatus.FILTERED)
            x, v = x + DT * v + 0.5 * DT**2 * result.v, v + DT * result.v
            heights.append(rows.h[0])
        lowest[chosen] = min(heights)
    assert lowest["none"] < -0.1
    # the index reaches zero on a straight line h + k h_dot = margin, so h never passes the margin
    assert lowest[name] > (0.05 if KINDS[name].resolution.name.endswith("qp") or name == "pssa" else 0.04)
