"""Wrench distribution: momentum balance about the centre of mass, centres of pressure inside the soles."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robots.description import RobotDescription
from robots.kinematics import Kinematics
from robots.messages import Array
from robots.pinocchio_model import standing_configuration
from wbc.wrench import GRAVITY, distribute_wrench, load_from_zmp, reference_wrenches

Soles = list[tuple[Array, Array]]
WIDE = np.full((2, 2), 1e6)
NO_LIMITS = np.ones(2)
seeds = st.integers(0, 2**32 - 1)


def distribute(mass: float, com: Array, acceleration: Array, soles: Soles, load: Array, half_sizes: Array) -> Array:
    """The kernel, with placements as pinocchio keeps them: rotation column by column, then position."""
    placements = np.array([np.append(rotation.T.ravel(), position) for rotation, position in soles])
    return distribute_wrench(mass, com, acceleration, placements, load, half_sizes)


def fraction(zmp: Array, centres: Array, in_contact: Array, load_limits: Array = NO_LIMITS) -> Array:
    return load_from_zmp(zmp, np.ascontiguousarray(centres), in_contact, load_limits)


def random_soles(rng: np.random.Generator, tilt: float) -> Soles:
    """Two soles anywhere near the ground, any yaw, roll and pitch up to ``tilt`` [rad]."""
    out = []
    for side in (1.0, -1.0):
        rpy = np.append(rng.uniform(-tilt, tilt, 2), rng.uniform(-np.pi, np.pi))
        place = np.array([rng.uniform(-0.4, 0.4), 0.12 * side + rng.uniform(-0.1, 0.1), rng.uniform(-0.1, 0.1)])
        out.append((pin.rpy.rpyToMatrix(rpy), place))
    return out


def random_motion(rng: np.random.Generator) -> tuple[Array, Array]:
    """Centre of mass [m] and its acceleration [m/s^2]; the total force points up."""
    return np.append(rng.uniform(-0.2, 0.2, 2), 0.7), rng.uniform([-6.0, -6.0, -7.0], [6.0, 6.0, 7.0])


def centres_of_pressure(wrenches: Array) -> Array:
    """Shape (n, 2), in sole axes: where the normal force acts."""
    parts = wrenches.reshape(-1, 6)
    return np.column_stack([-parts[:, 4], parts[:, 3]]) / parts[:, 2:3]


def sum_about(wrenches: Array, soles: Soles, about: Array) -> Array:
    """Net wrench from one application point per foot."""
    force, moment = np.zeros(3), np.zeros(3)
    for part, (rotation, position) in zip(wrenches.reshape(-1, 6), soles, strict=True):
        f = rotation @ part[:3]
        force += f
        moment += rotation @ part[3:] + np.cross(position - about, f)
    return np.concatenate([force, moment])


@given(seeds, st.floats(0.0, 1.0))
def test_unclipped_wrenches_accelerate_the_centre_of_mass_and_do_not_turn_the_robot(seed: int, left: float) -> None:
    rng = np.random.default_rng(seed)
    mass, soles = rng.uniform(20.0, 120.0), random_soles(rng, 0.5)
    com, acceleration = random_motion(rng)
    wrenches = distribute(mass, com, acceleration, soles, np.array([left, 1.0 - left]), WIDE)
    total = sum_about(wrenches, soles, com)
    force = mass * (acceleration + np.array([0.0, 0.0, GRAVITY]))
    np.testing.assert_allclose(total[:3], force, rtol=0, atol=1e-11 * np.linalg.norm(force))
    np.testing.assert_allclose(total[3:], 0.0, rtol=0, atol=1e-11 * np.linalg.norm(force))


@given(seeds, st.floats(0.0, 1.0))
def test_each_foot_carries_its_share_of_the_force_clipped_or_not(seed: int, left: float) -> None:
    rng = np.random.default_rng(seed)
    soles = random_soles(rng, 0.5)
    com, acceleration = random_motion(rng)
    load, half = np.array([left, 1.0 - left]), rng.uniform(0.02, 0.15, (2, 2))
    wrenches = distribute(50.0, com, acceleration, soles, load, half).reshape(2, 6)
    force = 50.0 * (acceleration + np.array([0.0, 0.0, GRAVITY]))
    for fraction, part, (rotation, _) in zip(load, wrenches, soles, strict=True):
        np.testing.assert_allclose(rotation @ part[:3], fraction * force, rtol=0, atol=1e-10)


@given(seeds, st.floats(0.01, 0.99))
def test_centres_of_pressure_stay_inside_the_soles(seed: int, left: float) -> None:
    rng = np.random.default_rng(seed)
    half = rng.uniform(0.02, 0.15, (2, 2))
    com, acceleration = random_motion(rng)
    wrenches = distribute(50.0, com, acceleration, random_soles(rng, 0.3), np.array([left, 1.0 - left]), half).reshape(
        2, 6
    )
    for part, (x, y) in zip(wrenches, half, strict=True):
        if part[2] > 0:  # else the sole is turned away from the force
            cop = centres_of_pressure(part)[0]
            assert abs(cop[0]) <= x * (1 + 1e-12)
            assert abs(cop[1]) <= y * (1 + 1e-12)


def test_clipping_moves_a_centre_of_pressure_to_the_nearest_edge_and_leaves_the_other_axis() -> None:
    soles = [(np.eye(3), np.array([0.0, 0.1, 0.0])), (np.eye(3), np.array([0.0, -0.1, 0.0]))]
    com = np.array([0.3, 0.005, 0.7])
    half = np.array([[0.1, 0.03], [0.1, 0.03]])
    wrenches = distribute(40.0, com, np.zeros(3), soles, np.array([0.5, 0.5]), half)
    np.testing.assert_allclose(centres_of_pressure(wrenches), [[0.1, 0.005]] * 2, rtol=0, atol=1e-12)


@given(seeds, st.sampled_from([0, 1]))
def test_in_single_support_the_other_foot_is_free_and_the_zmp_is_the_centre_of_pressure(seed: int, foot: int) -> None:
    """Level sole: the centre of pressure is the ZMP, and the force line through it meets the centre of mass."""
    rng = np.random.default_rng(seed)
    soles = random_soles(rng, 0.0)
    com, acceleration = random_motion(rng)
    wrenches = distribute(50.0, com, acceleration, soles, np.eye(2)[foot], WIDE).reshape(2, 6)
    assert not wrenches[1 - foot].any()
    rotation, position = soles[foot]
    cop = position + rotation @ np.append(centres_of_pressure(wrenches[foot])[0], 0.0)
    zmp = com[:2] - (com[2] - position[2]) * acceleration[:2] / (acceleration[2] + GRAVITY)
    np.testing.assert_allclose(cop[:2], zmp, rtol=0, atol=1e-10)
    force = rotation @ wrenches[foot, :3]
    yaw = rotation @ wrenches[foot, 3:] - np.cross(cop - position, force)
    np.testing.assert_allclose(np.cross(com - cop, force), yaw, rtol=0, atol=1e-8)


@pytest.mark.parametrize("vertical", [-GRAVITY, -GRAVITY - 1.0])
def test_no_foot_pulls_when_falling_freely_or_faster(vertical: float) -> None:
    soles = [(np.eye(3), np.array([0.0, y, 0.0])) for y in (0.1, -0.1)]
    acceleration = np.array([0.1, 0.0, vertical])
    assert not distribute(50.0, np.array([0.0, 0.0, 0.7]), acceleration, soles, np.full(2, 0.5), WIDE).any()


def test_inputs_are_not_written_to() -> None:
    rng = np.random.default_rng(3)
    soles = random_soles(rng, 0.2)
    com, acceleration = random_motion(rng)
    load, half = np.array([0.4, 0.6]), np.full((2, 2), 0.05)
    before = [x.copy() for x in (com, acceleration, load, half, *soles[0], *soles[1])]
    distribute(50.0, com, acceleration, soles, load, half)
    for a, b in zip((com, acceleration, load, half, *soles[0], *soles[1]), before, strict=True):
        assert np.array_equal(a, b)


def plain_wrenches(
    mass: float, com: Array, acceleration: Array, soles: Soles, contact: Array, limits: Array, half: Array
) -> Array:
    """The reference wrenches step by step, in matrices."""
    centres = np.array([position[:2] for _, position in soles])
    height = com[2] - 0.5 * (soles[0][1][2] + soles[1][1][2])
    zmp = com[:2] - acceleration[:2] * height / (GRAVITY + acceleration[2])
    load = contact.astype(float)
    if contact.all():
        line = centres[0] - centres[1]
        left = np.clip((zmp - centres[1]) @ line / (line @ line), 1.0 - limits[1], limits[0])
        load = np.array([np.clip(left, 0.0, 1.0), 1.0 - np.clip(left, 0.0, 1.0)])
    force = mass * (acceleration + np.array([0.0, 0.0, GRAVITY]))
    if force[2] <= 0:
        return np.zeros(12)
    moment = np.cross(com - load @ np.array([position for _, position in soles]), force)
    out = []
    for part, (rotation, _), (x, y) in zip(load, soles, half, strict=True):
        f, m = part * rotation.T @ force, part * rotation.T @ moment
        bound = np.array([y, x]) * max(f[2], 0.0)
        out += [f, np.append(np.clip(m[:2], -bound, bound), m[2])]
    return np.concatenate(out)


@given(seeds, st.sampled_from([(True, True), (True, False), (False, True), (False, False)]), st.booleans())
def test_reference_wrenches_are_those_of_the_plain_form(seed: int, contact: tuple[bool, bool], limited: bool) -> None:
    rng = np.random.default_rng(seed)
    soles, (com, acceleration) = random_soles(rng, 0.4), random_motion(rng)
    jacobian, half = np.asfortranarray(rng.normal(size=(3, 9))), rng.uniform(0.02, 0.15, (2, 2))
    command = np.linalg.pinv(jacobian) @ acceleration
    limits = np.array([0.7, 0.6]) if limited else NO_LIMITS
    transforms = np.array([np.append(rotation.T.ravel(), position) for rotation, position in reversed(soles)])
    wrenches = reference_wrenches(
        50.0, com, jacobian, command, transforms, np.array([1, 0]), np.array(contact), limits, half
    )
    expected = plain_wrenches(50.0, com, acceleration, soles, np.array(contact), limits, half)
    np.testing.assert_allclose(wrenches, expected, rtol=0, atol=1e-9)


def standing(robot: RobotDescription) -> tuple[Kinematics, Soles]:
    kin = Kinematics(robot)
    kin.update(standing_configuration(robot), np.zeros(kin.nv))
    return kin, [kin.frame_placement(kin.frame_id(sole.frame)) for sole in robot.soles]


def test_standing_still_each_foot_carries_half_the_weight(robot: RobotDescription) -> None:
    kin, soles = standing(robot)
    zmp, centres = kin.com[:2], np.array([position[:2] for _, position in soles])
    load = fraction(zmp, centres, np.array([True, True]))
    half = np.array([[sole.half_length, sole.half_width] for sole in robot.soles])
    wrenches = distribute(robot.total_mass, kin.com, np.zeros(3), soles, load, half).reshape(2, 6)
    weight = robot.total_mass * GRAVITY
    expected = np.array([(kin.com[1] - centres[1, 1]), (centres[0, 1] - kin.com[1])]) * weight
    expected /= centres[0, 1] - centres[1, 1]
    np.testing.assert_allclose(wrenches[:, 2], expected, rtol=1e-6)
    assert wrenches[:, 2].sum() == pytest.approx(weight, rel=1e-12)
    np.testing.assert_allclose(sum_about(wrenches.ravel(), soles, kin.com)[3:], 0.0, rtol=0, atol=1e-9 * weight)


def test_gravity_is_that_of_the_model(robot: RobotDescription) -> None:
    kin, _ = standing(robot)
    np.testing.assert_array_equal(kin.model.gravity.linear, [0.0, 0.0, -GRAVITY])
    assert kin.bias[2] == pytest.approx(robot.total_mass * GRAVITY, rel=1e-12)


BOTH = np.array([True, True])


@given(seeds)
def test_load_is_the_place_of_the_zmp_between_the_feet(seed: int) -> None:
    rng = np.random.default_rng(seed)
    centres, zmp = rng.normal(size=(2, 2)), rng.normal(size=2)
    load = fraction(zmp, centres, BOTH)
    assert load.shape == (2,)
    assert (load >= 0).all()
    assert load.sum() == pytest.approx(1.0, abs=1e-15)
    # the loaded point is the point of the segment nearest to the ZMP
    place = load @ centres
    for other in np.linspace(0.0, 1.0, 11):
        assert (
            np.linalg.norm(place - zmp) <= np.linalg.norm(other * centres[0] + (1 - other) * centres[1] - zmp) + 1e-12
        )


@given(seeds, st.floats(0.0, 1.0), st.floats(-1.0, 1.0))
def test_load_does_not_depend_on_the_offset_across_the_line(seed: int, left: float, across: float) -> None:
    centres = np.random.default_rng(seed).normal(size=(2, 2))
    line = centres[0] - centres[1]
    zmp = left * centres[0] + (1 - left) * centres[1] + across * np.array([-line[1], line[0]])
    np.testing.assert_allclose(fraction(zmp, centres, BOTH), [left, 1 - left], rtol=0, atol=1e-9)


@given(seeds)
def test_exchanging_the_feet_exchanges_the_loads(seed: int) -> None:
    rng = np.random.default_rng(seed)
    centres, zmp = rng.normal(size=(2, 2)), rng.normal(size=2)
    swapped = fraction(zmp, centres[::-1], BOTH)
    np.testing.assert_allclose(fraction(zmp, centres, BOTH), swapped[::-1], rtol=0, atol=1e-12)


def test_load_ends_at_the_feet_and_stays_there() -> None:
    centres = np.array([[0.1, 0.12], [-0.05, -0.12]])
    line = centres[0] - centres[1]
    for beyond in (0.0, 0.3, 5.0):
        np.testing.assert_allclose(fraction(centres[0] + beyond * line, centres, BOTH), [1.0, 0.0], atol=1e-15)
        np.testing.assert_allclose(fraction(centres[1] - beyond * line, centres, BOTH), [0.0, 1.0], atol=1e-15)
    np.testing.assert_allclose(fraction(centres.mean(axis=0), centres, BOTH), [0.5, 0.5], atol=1e-15)


@given(seeds, st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_no_foot_is_loaded_above_its_limit_and_the_load_is_the_nearest_that_is_allowed(
    seed: int, one: float, other: float
) -> None:
    rng = np.random.default_rng(seed)
    limits = np.array([one, max(other, 1.0 - one)])
    centres, zmp = rng.normal(size=(2, 2)), rng.normal(size=2)
    load = fraction(zmp, centres, BOTH, limits)
    assert load.sum() == pytest.approx(1.0, abs=1e-15)
    assert (load >= 0).all()
    assert (load <= limits + 1e-12).all()
    free = fraction(zmp, centres, BOTH)[0]
    np.testing.assert_allclose(load[0], np.clip(free, 1.0 - limits[1], limits[0]), rtol=0, atol=1e-12)
    np.testing.assert_array_equal(fraction(zmp, centres, np.array([True, False]), limits), [1.0, 0.0])


def test_feet_in_one_place_share_equally() -> None:
    np.testing.assert_array_equal(fraction(np.ones(2), np.zeros((2, 2)), BOTH), [0.5, 0.5])


@pytest.mark.parametrize("contact", [(True, False), (False, True), (False, False)])
def test_only_feet_on_the_ground_are_loaded(contact: tuple[bool, bool]) -> None:
    centres = np.array([[0.0, 0.1], [0.0, -0.1]])
    np.testing.assert_array_equal(fraction(np.array([0.0, 0.3]), centres, np.array(contact)), contact)
