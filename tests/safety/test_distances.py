"""Closest points, distances and gradients of spheres and capsules: against coal, a numpy oracle and special cases."""

from dataclasses import dataclass

import coal
import numpy as np
import pytest

from robots.messages import Array
from safety.kernels import DEGENERATE, closest_parameters, fallback_normal, self_collision_rows, workspace_rows

SAME = 1e-9
KINDS = ("sphere", "capsule")
PERPENDICULAR = np.array([[1.0, 0, 0], [0, 1.0, 0]])


@dataclass(frozen=True)
class Capsule:
    """Centre line from ``start`` to ``end`` [m], a sphere where they coincide."""

    start: Array
    end: Array
    radius: float

    @property
    def direction(self) -> Array:
        return self.end - self.start

    def moved(self, rotation: Array, translation: Array) -> "Capsule":
        return Capsule(rotation @ self.start + translation, rotation @ self.end + translation, self.radius)


def random_rotation(rng: np.random.Generator) -> Array:
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.linalg.det(q)


def random_capsule(rng: np.random.Generator, kind: str) -> Capsule:
    start, end = rng.normal(scale=0.3, size=(2, 3))
    return Capsule(start, start if kind == "sphere" else end, rng.uniform(0.02, 0.4))


def rows_of(a: Capsule, b: Capsule) -> tuple[float, Array]:
    """Signed distance and gradient (6,) by the kernel, for A carried by a free joint and B fixed to the world."""
    h, jac = np.zeros(1), np.zeros((1, 6))
    origin, direction = np.array([a.start, b.start]), np.array([a.direction, b.direction])
    joints, pairs = np.array([1, 0], dtype=np.intp), np.array([[0, 1]], dtype=np.intp)
    support = np.vstack([np.zeros(6), np.ones(6)])
    radius = np.array([a.radius, b.radius])
    self_collision_rows(origin, direction, radius, joints, pairs, np.asfortranarray(np.eye(6)), support, h, jac)
    return float(h[0]), jac[0]


def closest_points(a: Capsule, b: Capsule) -> tuple[Array, Array]:
    s, t = closest_parameters(a.start, a.direction, b.start, b.direction)
    assert 0.0 <= s <= 1.0
    assert 0.0 <= t <= 1.0
    return a.start + s * a.direction, b.start + t * b.direction


def place_on(p: Array, a: Capsule) -> Array:
    """Point of A's centre line closest to ``p``."""
    squared = a.direction @ a.direction
    s = np.clip((p - a.start) @ a.direction / squared, 0.0, 1.0) if squared > 0 else 0.0
    return a.start + s * a.direction


def oracle_distance(a: Capsule, b: Capsule) -> float:
    """Distance of two centre lines by cases: an end against the other line, or two inner points."""
    candidates = [np.linalg.norm(p - place_on(p, b)) for p in (a.start, a.end)]
    candidates += [np.linalg.norm(p - place_on(p, a)) for p in (b.start, b.end)]
    basis = np.column_stack([a.direction, -b.direction])
    if np.linalg.matrix_rank(basis) == 2:
        inner = np.linalg.lstsq(basis, b.start - a.start, rcond=None)[0]
        if ((inner >= 0) & (inner <= 1)).all():
            candidates.append(np.linalg.norm(a.start - b.start + basis @ inner))
    return float(min(candidates))


def coal_distance(a: Capsule, b: Capsule) -> float:
    shapes = [coal_shape(c) for c in (a, b)]
    return float(coal.distance(*shapes[0], *shapes[1], coal.DistanceRequest(), coal.DistanceResult()))


def coal_shape(c: Capsule) -> tuple[coal.ShapeBase, coal.Transform3s]:
    """The shape and its place; coal's capsules lie along z about their centre."""
    length = np.linalg.norm(c.direction)
    if length == 0:
        return coal.Sphere(c.radius), coal.Transform3s(np.eye(3), c.start)
    axes = np.linalg.svd(c.direction.reshape(1, 3) / length)[2]
    rotation = np.column_stack([axes[1], np.cross(c.direction / length, axes[1]), c.direction / length])
    return coal.Capsule(c.radius, length), coal.Transform3s(rotation, 0.5 * (c.start + c.end))


@pytest.mark.parametrize("kind_a", KINDS)
@pytest.mark.parametrize("kind_b", KINDS)
def test_signed_distance_is_coals_penetration_included(kind_a: str, kind_b: str) -> None:
    rng = np.random.default_rng(1)
    signs = set()
    for _ in range(300):
        a, b = random_capsule(rng, kind_a), random_capsule(rng, kind_b)
        h, _ = rows_of(a, b)
        assert h == pytest.approx(coal_distance(a, b), abs=SAME)
        signs.add(h > 0)
    assert signs == {True, False}


@pytest.mark.parametrize("kind_a", KINDS)
@pytest.mark.parametrize("kind_b", KINDS)
def test_signed_distance_is_the_numpy_oracles(kind_a: str, kind_b: str) -> None:
    rng = np.random.default_rng(2)
    for _ in range(300):
        a, b = random_capsule(rng, kind_a), random_capsule(rng, kind_b)
        assert rows_of(a, b)[0] == pytest.approx(oracle_distance(a, b) - a.radius - b.radius, abs=1e-12)


def test_gradient_is_the_wrench_of_the_unit_normal_at_the_closest_point() -> None:
    rng = np.random.default_rng(3)
    for _ in range(200):
        a, b = random_capsule(rng, "capsule"), random_capsule(rng, "capsule")
        p_a, p_b = closest_points(a, b)
        n = (p_a - p_b) / np.linalg.norm(p_a - p_b)
        on_surfaces = p_a - a.radius * n, p_b + b.radius * n
        for point in (p_a, p_b, *on_surfaces):
            np.testing.assert_allclose(rows_of(a, b)[1], np.concatenate([n, np.cross(point, n)]), rtol=0, atol=1e-11)


def test_closest_points_satisfy_the_optimality_conditions() -> None:
    rng = np.random.default_rng(4)
    for _ in range(500):
        a, b = random_capsule(rng, "capsule"), random_capsule(rng, "capsule")
        p_a, p_b = closest_points(a, b)
        np.testing.assert_allclose(place_on(p_b, a), p_a, rtol=0, atol=1e-9)
        np.testing.assert_allclose(place_on(p_a, b), p_b, rtol=0, atol=1e-9)


def test_swapping_the_pair_changes_nothing_but_the_side() -> None:
    rng = np.random.default_rng(5)
    for _ in range(200):
        a, b = (random_capsule(rng, rng.choice(KINDS)) for _ in range(2))
        (h_ab, jac_ab), (h_ba, jac_ba) = rows_of(a, b), rows_of(b, a)
        assert h_ab == pytest.approx(h_ba, abs=1e-14)
        np.testing.assert_allclose(jac_ab, -jac_ba, rtol=0, atol=1e-11)


def test_turning_a_centre_line_round_changes_nothing() -> None:
    rng = np.random.default_rng(6)
    for _ in range(200):
        a, b = random_capsule(rng, "capsule"), random_capsule(rng, "capsule")
        turned = Capsule(a.end, a.start, a.radius)
        assert rows_of(turned, b)[0] == pytest.approx(rows_of(a, b)[0], abs=1e-14)


def test_distance_does_not_depend_on_the_frame() -> None:
    rng = np.random.default_rng(7)
    for _ in range(200):
        a, b = random_capsule(rng, "capsule"), random_capsule(rng, "capsule")
        rotation, translation = random_rotation(rng), rng.normal(size=3)
        h, jac = rows_of(a, b)
        moved = rows_of(a.moved(rotation, translation), b.moved(rotation, translation))
        assert moved[0] == pytest.approx(h, abs=1e-13)
        np.testing.assert_allclose(moved[1][:3], rotation @ jac[:3], rtol=0, atol=1e-11)


# each: A's centre line, B's centre line, distance of the two by hand
SPECIAL = {
    "parallel, side by side": ([0, 0, 0], [1, 0, 0], [0, 0.3, 0], [1, 0.3, 0], 0.3),
    "parallel, overlapping in part": ([0, 0, 0], [1, 0, 0], [0.6, 0.4, 0], [2, 0.4, 0], 0.4),
    "parallel, opposite directions": ([0, 0, 0], [1, 0, 0], [2, 0.4, 0], [0.6, 0.4, 0], 0.4),
    "parallel, not facing": ([0, 0, 0], [1, 0, 0], [4, 4, 0], [9, 4, 0], 5.0),
    "collinear, apart": ([0, 0, 0], [0, 0, 1], [0, 0, 3], [0, 0, 5], 2.0),
    "collinear, overlapping": ([0, 0, 0], [0, 0, 1], [0, 0, 0.5], [0, 0, 5], 0.0),
    "collinear, end to end": ([0, 0, 0], [0, 0, 1], [0, 0, 1], [0, 0, 2], 0.0),
    "crossing": ([-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], 0.0),
    "crossing above": ([-1, 0, 0], [1, 0, 0], [0, -1, 0.2], [0, 1, 0.2], 0.2),
    "end against the middle": ([-1, 0, 0], [1, 0, 0], [0.5, 0.25, 0], [0.5, 2, 0], 0.25),
    "same line": ([0, 0, 0], [1, 1, 1], [0, 0, 0], [1, 1, 1], 0.0),
    "two points": ([0, 0, 0], [0, 0, 0], [3, 4, 0], [3, 4, 0], 5.0),
    "same point": ([1, 2, 3], [1, 2, 3], [1, 2, 3], [1, 2, 3], 0.0),
    "point beside a line": ([0.5, 0.2, 0], [0.5, 0.2, 0], [0, 0, 0], [1, 0, 0], 0.2),
    "line beside a point": ([0, 0, 0], [1, 0, 0], [0.5, 0.2, 0], [0.5, 0.2, 0], 0.2),
    "point on a line": ([0.5, 0, 0], [0.5, 0, 0], [0, 0, 0], [1, 0, 0], 0.0),
    "point beyond a line": ([2, 0, 0], [2, 0, 0], [0, 0, 0], [1, 0, 0], 1.0),
    "shorter than a nanometre": ([0, 0, 0], [1e-10, 0, 0], [0, 0, 1], [0, 0, 1 + 1e-10], 1.0),
}


@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize("case", SPECIAL)
def test_special_configurations_by_hand(case: str, swapped: bool) -> None:
    *lines, distance = SPECIAL[case]
    start_a, end_a, start_b, end_b = (np.array(x, dtype=float) for x in lines)
    a, b = Capsule(start_a, end_a, 0.1), Capsule(start_b, end_b, 0.15)
    h, jac = rows_of(b, a) if swapped else rows_of(a, b)
    assert h == pytest.approx(distance - 0.25, abs=SAME)
    assert np.isfinite(jac).all()
    assert np.linalg.norm(jac[:3]) == pytest.approx(1.0, abs=1e-12)


def test_touching_capsules_have_no_distance() -> None:
    a, b = np.zeros(3), np.array([0.0, 0.0, 0.5])
    h, jac = rows_of(Capsule(a, a, 0.2), Capsule(b, np.array([1.0, 0.0, 0.5]), 0.3))
    assert h == pytest.approx(0.0, abs=1e-15)
    np.testing.assert_allclose(jac, [0, 0, -1, 0, 0, 0], rtol=0, atol=1e-15)


def test_parallel_segments_touch_in_the_middle_of_the_interval() -> None:
    a = Capsule(np.zeros(3), np.array([1.0, 0, 0]), 0.1)
    for start, end in (((0.6, 0.4, 0), (2.0, 0.4, 0)), ((2.0, 0.4, 0), (0.6, 0.4, 0))):
        b = Capsule(np.array(start), np.array(end), 0.1)
        for p, q in (closest_points(a, b), closest_points(b, a)[::-1]):
            np.testing.assert_allclose([p, q], [[0.8, 0, 0], [0.8, 0.4, 0]], rtol=0, atol=1e-15)


@pytest.mark.parametrize("angle", [1e-3, 1e-5, 2e-6, 1e-6, 5e-7, 1e-8, 1e-10])
def test_nearly_parallel_segments_lose_no_more_than_their_angle_allows(angle: float) -> None:
    rng = np.random.default_rng(8)
    limit = 1e-6
    for _ in range(50):
        rotation, offset = random_rotation(rng), rng.normal(size=3)
        a = Capsule(np.zeros(3), np.array([0.4, 0, 0]), 0.1).moved(rotation, offset)
        tilted = 0.5 * np.array([np.cos(angle), np.sin(angle), 0])
        start = np.array([rng.uniform(-0.2, 0.2), 0.05, rng.uniform(-0.1, 0.1)])
        b = Capsule(start, start + tilted, 0.1).moved(rotation, offset)
        p_a, p_b = closest_points(a, b)
        # below the limit the middle is taken for the nearer end: at most half a length times the angle away
        allowed = 0.25 * angle if angle <= limit else 1e-12
        assert 0 <= np.linalg.norm(p_a - p_b) - oracle_distance(a, b) + 1e-12 <= allowed + 2e-12


def test_normal_of_crossing_centre_lines_is_across_both() -> None:
    rng = np.random.default_rng(9)
    for _ in range(100):
        d1, d2, middle = rng.normal(size=(3, 3))
        a, b = Capsule(middle - d1, middle + 2 * d1, 0.1), Capsule(middle - 2 * d2, middle + d2, 0.1)
        h, jac = rows_of(a, b)
        assert h == pytest.approx(-0.2, abs=1e-12)
        normal = np.array(fallback_normal(a.direction, b.direction))
        assert np.linalg.norm(normal) == pytest.approx(1.0, abs=1e-12)
        np.testing.assert_allclose(np.array([d1, d2]) @ normal, 0.0, atol=1e-12)
        # not the direction in which rounding has put the points apart
        np.testing.assert_allclose(jac[:3], normal, rtol=0, atol=1e-12)


@pytest.mark.parametrize("d1", [np.zeros(3), np.array([0, 0, 2.0]), np.array([1.0, 2.0, 3.0])])
@pytest.mark.parametrize("factor", [0.0, 1.0, -0.3])
def test_fallback_normal_of_parallel_lines_is_a_unit_vector_across_the_longer(d1: Array, factor: float) -> None:
    for normal in (fallback_normal(d1, factor * d1), fallback_normal(factor * d1, d1)):
        assert np.linalg.norm(normal) == pytest.approx(1.0, abs=1e-12)
        assert np.dot(normal, d1) == pytest.approx(0.0, abs=1e-12)


def test_distance_is_continuous_where_the_normal_is_chosen() -> None:
    for offset in (0.0, 0.5 * DEGENERATE, DEGENERATE, 2 * DEGENERATE):
        shift = np.array([0, 0, offset])
        a = Capsule(-PERPENDICULAR[0] + shift, PERPENDICULAR[0] + shift, 0.1)
        b = Capsule(-PERPENDICULAR[1], PERPENDICULAR[1], 0.1)
        h, jac = rows_of(a, b)
        assert h == pytest.approx(offset - 0.2, abs=1e-15)
        np.testing.assert_allclose(np.abs(jac[:3]), [0, 0, 1], rtol=0, atol=1e-12)


def test_workspace_points_that_coincide_have_no_gradient() -> None:
    transforms = np.vstack([np.concatenate([np.eye(3).ravel(), p]) for p in ([0, 0, 0], [1.0, 2.0, 3.0])])
    points = np.array([[[0.5, 0, 0], [1.5, 2.0, 3.0]]])
    h, jac = np.zeros(1), np.ones((1, 6))
    support = np.vstack([np.zeros(6), np.ones(6)])
    joints = np.array([[1, 0]], dtype=np.intp)
    workspace_rows(transforms, joints, points, np.array([0.4]), np.asfortranarray(np.eye(6)), support, h, jac)
    assert h[0] == 0.4
    assert not jac.any()
