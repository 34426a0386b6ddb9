"""Closest points, distances and gradients of each pair of shapes: against coal, numpy oracles and special cases."""

import ast
import inspect
from dataclasses import dataclass
from types import ModuleType

import coal
import numpy as np
import pinocchio as pin
import pytest

from robots.messages import Array
from safety.geometry import box_faces, boxes
from safety.geometry import contact_rows as kernels
from safety.geometry import segments as geometry
from safety.geometry.boxes import box_contacts
from safety.geometry.contact_rows import contact_gradients
from safety.geometry.segments import (
    CONTACT_SIZE,
    DEGENERATE,
    END_A,
    START_A,
    fallback_normal,
    half_space_contacts,
    point_contacts,
    segment_contacts,
)

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


def contact_of(a: Capsule, b: Capsule) -> Array:
    """Contact (1, CONTACT_SIZE) of two centre lines by the kernel."""
    contacts = np.full((1, CONTACT_SIZE), np.nan)
    origin, direction = np.array([a.start, b.start]), np.array([a.direction, b.direction])
    segment_contacts(origin, direction, origin, direction, np.array([[0, 0, 1, 0]]), contacts)
    return contacts


def rows_of(a: Capsule, b: Capsule) -> tuple[float, Array]:
    """Signed distance and gradient (6,) by the kernel, for A carried by a free joint and B fixed to the world."""
    contacts = contact_of(a, b)
    return float(contacts[0, 6]) - a.radius - b.radius, gradient_of(contacts)


def gradient_of(contacts: Array) -> Array:
    """Gradient (6,) of one contact for a first body carried by a free joint and a second that is fixed."""
    jac, support = np.zeros((1, 6)), np.vstack([np.zeros(6), np.ones(6)])
    joints = np.array([1]), np.array([0])
    contact_gradients(contacts, *joints, np.asfortranarray(np.eye(6)), support, jac)
    return jac[0]


def closest_points(a: Capsule, b: Capsule) -> tuple[Array, Array]:
    """Of two centre lines, which they lie on."""
    contact = contact_of(a, b)[0]
    p, q = contact[:3], contact[:3] - contact[6] * contact[3:6]
    for point, line in ((p, a), (q, b)):
        np.testing.assert_allclose(place_on(point, line), point, rtol=0, atol=1e-12)
    return p, q


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


def test_parallel_segments_touch_at_an_end_of_the_interval() -> None:
    a = Capsule(np.zeros(3), np.array([1.0, 0, 0]), 0.1)
    for start, end in (((0.6, 0.4, 0), (2.0, 0.4, 0)), ((2.0, 0.4, 0), (0.6, 0.4, 0))):
        b = Capsule(np.array(start), np.array(end), 0.1)
        for p, q in (closest_points(a, b), closest_points(b, a)[::-1]):
            np.testing.assert_allclose(q - p, [0, 0.4, 0], rtol=0, atol=1e-15)
            assert min(abs(p[0] - 0.6), abs(p[0] - 1.0)) < 1e-15


@pytest.mark.parametrize("angle", [1e-3, 1e-5, 2e-6, 1e-6, 5e-7, 1e-8, 1e-10])
def test_nearly_parallel_segments_lose_nothing(angle: float) -> None:
    rng = np.random.default_rng(8)
    for _ in range(50):
        rotation, offset = random_rotation(rng), rng.normal(size=3)
        a = Capsule(np.zeros(3), np.array([0.4, 0, 0]), 0.1).moved(rotation, offset)
        tilted = 0.5 * np.array([np.cos(angle), np.sin(angle), 0])
        start = np.array([rng.uniform(-0.2, 0.2), 0.05, rng.uniform(-0.1, 0.1)])
        b = Capsule(start, start + tilted, 0.1).moved(rotation, offset)
        p_a, p_b = closest_points(a, b)
        assert 0 <= np.linalg.norm(p_a - p_b) - oracle_distance(a, b) + 1e-12 <= 2e-12


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
    contacts = np.full((1, CONTACT_SIZE), np.nan)
    point_contacts(transforms, np.array([[1, 0]]), points, contacts)
    assert contacts[0, 6] == 0.0
    assert not gradient_of(contacts).any()


@dataclass(frozen=True)
class Box:
    """Centre, axes in the columns of ``rotation``, half sizes [m]."""

    center: Array
    rotation: Array
    half_sizes: Array

    def contact(self, a: Capsule, feature: int = 0) -> Array:
        """The contact of a segment, or for feature 1 or 2 of its start or end, with the box."""
        contacts = np.full((1, CONTACT_SIZE), np.nan)
        box = self.center[None], self.rotation[None], self.half_sizes[None]
        box_contacts(a.start[None], a.direction[None], *box, np.array([[0, 0, 0, feature]]), contacts)
        return contacts[0]

    def distance_to(self, points: Array) -> Array:
        """Signed distances (n,) of points (n, 3)."""
        beyond = np.abs((points - self.center) @ self.rotation) - self.half_sizes
        return np.linalg.norm(np.maximum(beyond, 0), axis=1) + np.minimum(beyond.max(axis=1), 0)


def random_box(rng: np.random.Generator) -> Box:
    return Box(rng.normal(scale=0.3, size=3), random_rotation(rng), rng.uniform(0.05, 0.4, 3))


def unit(vector: Array) -> Array:
    return np.asarray(vector / np.linalg.norm(vector))


def shifted(a: Capsule, by: Array) -> Capsule:
    return Capsule(a.start + by, a.end + by, a.radius)


@pytest.mark.parametrize("kind", KINDS)
def test_signed_distance_to_a_box_is_coals_penetration_included(kind: str) -> None:
    rng = np.random.default_rng(10)
    signs = set()
    for _ in range(300):
        a, box = random_capsule(rng, kind), random_box(rng)
        h = box.contact(a)[6] - a.radius
        shape = coal.Box(2 * box.half_sizes), coal.Transform3s(box.rotation, box.center)
        expected = coal.distance(*coal_shape(a), *shape, coal.DistanceRequest(), coal.DistanceResult())
        # coal finds it by iteration, to its tolerance of 1e-6
        assert h == pytest.approx(expected, abs=2e-6)
        signs.add((h > 0, box.contact(a)[6] > 0))
    assert signs == {(True, True), (False, True), (False, False)}


@pytest.mark.parametrize("kind", KINDS)
def test_distance_outside_a_box_is_the_least_of_a_dense_search(kind: str) -> None:
    rng = np.random.default_rng(11)
    for _ in range(200):
        a, box = random_capsule(rng, kind), random_box(rng)
        distance = box.contact(a)[6]
        low, high = 0.0, 1.0
        for _ in range(12):
            s = np.linspace(low, high, 41)
            values = box.distance_to(a.start + s[:, None] * a.direction)
            best, cell = s[values.argmin()], (high - low) / 40
            low, high = max(best - cell, 0.0), min(best + cell, 1.0)
        if values.min() > 0:
            assert distance == pytest.approx(values.min(), abs=1e-12)
        else:
            assert distance <= values.min() + 1e-12


def test_the_way_out_of_a_box_is_out_and_the_shortest() -> None:
    rng = np.random.default_rng(12)
    inside = 0
    for _ in range(400):
        a, box = random_capsule(rng, "capsule"), random_box(rng)
        contact = box.contact(a)
        if contact[6] >= 0:
            continue
        inside += 1
        assert box.contact(shifted(a, (1 + 1e-6) * -contact[6] * contact[3:6]))[6] > 0
        for _ in range(30):
            direction = rng.normal(size=3)
            step = 0.999 * contact[6] * direction / np.linalg.norm(direction)
            assert box.contact(shifted(a, step))[6] <= 1e-12
    assert inside > 50


def test_normals_of_boxes_are_the_gradient_of_the_distance() -> None:
    rng = np.random.default_rng(13)
    for _ in range(300):
        a, box = random_capsule(rng, rng.choice(KINDS)), random_box(rng)
        for feature in range(3):
            contact = box.contact(a, feature)
            ends = [box.contact(shifted(a, s * 1e-6 * axis), feature)[6] for axis in np.eye(3) for s in (1, -1)]
            numeric = np.array(ends).reshape(3, 2) @ [0.5e6, -0.5e6]
            np.testing.assert_allclose(contact[3:6], numeric, rtol=0, atol=1e-4 * max(1, 0.01 / abs(contact[6])))


@pytest.mark.parametrize("kind", KINDS)
def test_the_distance_to_a_box_that_turns_changes_no_faster_than_its_corners_move(kind: str) -> None:
    """Also where the way out of it changes to another face or edge, turning at 20 rad/s for half a second."""
    rng = np.random.default_rng(17)
    signs = set()
    for _ in range(10):
        a, box = random_capsule(rng, kind), random_box(rng)
        turn = pin.exp3(20.0 * 0.002 * unit(rng.normal(size=3)))
        step = np.linalg.norm(box.half_sizes) * np.linalg.norm(turn - np.eye(3), 2)
        distance = box.contact(a)[6]
        for _ in range(250):
            box = Box(box.center, turn @ box.rotation, box.half_sizes)
            before, distance = distance, box.contact(a)[6]
            assert abs(distance - before) <= step + 1e-12
            signs.add(bool(distance > 0))
    assert signs == {True, False}


def test_contacts_of_boxes_lie_on_the_segment_and_on_the_box() -> None:
    rng = np.random.default_rng(14)
    for _ in range(300):
        a, box = random_capsule(rng, "capsule"), random_box(rng)
        contact = box.contact(a)
        np.testing.assert_allclose(place_on(contact[:3], a), contact[:3], rtol=0, atol=1e-9)
        on_box = contact[:3] - contact[6] * contact[3:6]
        assert box.distance_to(on_box[None])[0] == pytest.approx(0.0, abs=1e-9)
        for feature, end in ((1, a.start), (2, a.end)):
            np.testing.assert_allclose(box.contact(a, feature)[:3], end, rtol=0, atol=1e-15)
            assert box.contact(a, feature)[6] >= contact[6] - 1e-12
            assert box.contact(a, feature)[6] == pytest.approx(box.distance_to(end[None])[0], abs=1e-12)


def test_distance_to_a_box_does_not_depend_on_frame_or_direction_and_scales_with_the_unit() -> None:
    rng = np.random.default_rng(15)
    for _ in range(200):
        a, box = random_capsule(rng, "capsule"), random_box(rng)
        contact = box.contact(a)
        rotation, translation = random_rotation(rng), rng.normal(size=3)
        turned = Box(rotation @ box.center + translation, rotation @ box.rotation, box.half_sizes)
        moved = turned.contact(a.moved(rotation, translation))
        assert moved[6] == pytest.approx(contact[6], abs=1e-12)
        np.testing.assert_allclose(moved[3:6], rotation @ contact[3:6], rtol=0, atol=1e-9)
        assert box.contact(Capsule(a.end, a.start, a.radius))[6] == pytest.approx(contact[6], abs=1e-12)
        large = Box(1e3 * box.center, box.rotation, 1e3 * box.half_sizes)
        scaled = large.contact(Capsule(1e3 * a.start, 1e3 * a.end, a.radius))
        np.testing.assert_allclose(scaled[:3], 1e3 * contact[:3], rtol=0, atol=1e-8)
        np.testing.assert_allclose(scaled[6], 1e3 * contact[6], rtol=0, atol=1e-8)
        np.testing.assert_allclose(scaled[3:6], contact[3:6], rtol=0, atol=1e-8)


def test_distance_of_segments_scales_with_the_unit() -> None:
    rng = np.random.default_rng(16)
    for _ in range(200):
        a, b = random_capsule(rng, "capsule"), random_capsule(rng, "capsule")
        h, jac = rows_of(a, b)
        for scale in (1e-2, 1e3):
            large = [Capsule(scale * c.start, scale * c.end, scale * c.radius) for c in (a, b)]
            other = rows_of(*large)
            assert other[0] == pytest.approx(scale * h, abs=1e-12 * scale)
            np.testing.assert_allclose(other[1], jac * [1, 1, 1, scale, scale, scale], rtol=0, atol=1e-10 * scale)


def test_half_spaces_see_both_ends_whatever_the_depth() -> None:
    rng = np.random.default_rng(17)
    for _ in range(200):
        a, point, normal = random_capsule(rng, "capsule"), *rng.normal(size=(2, 3))
        normal /= np.linalg.norm(normal)
        contacts = np.full((2, CONTACT_SIZE), np.nan)
        table = np.array([[0, 0, 0, START_A], [1, 0, 0, END_A]])
        half_space_contacts(a.start[None], a.direction[None], point[None], normal[None], table, contacts)
        for contact, end in zip(contacts, (a.start, a.end), strict=True):
            np.testing.assert_array_equal(contact[3:6], normal)
            np.testing.assert_allclose(contact[:3], end, rtol=0, atol=1e-15)
            assert contact[6] == pytest.approx(normal @ (end - point), abs=1e-14)
            frame = np.array([contact[3:6], contact[7:10], contact[10:13]])
            np.testing.assert_allclose(frame @ frame.T, np.eye(3), rtol=0, atol=1e-14)


@pytest.mark.parametrize("module", [geometry, boxes, box_faces, kernels], ids=lambda m: m.__name__)
def test_every_loop_has_a_number_of_turns_known_before_it(module: ModuleType) -> None:
    """Neither ``while`` nor recursion: the time that rows take has a bound, whatever the obstacles do."""
    tree = ast.parse(inspect.getsource(module))
    for function in (n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef)):
        for node in ast.walk(function):
            assert not isinstance(node, ast.While), f"{function.name}, line {node.lineno}"
            if isinstance(node, ast.For):
                # over a range or the numbers of an array
                over = ast.unparse(node.iter)
                assert over.startswith("range(") or over.endswith(".flat"), f"{function.name}, line {node.lineno}"
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                assert node.func.id != function.name
