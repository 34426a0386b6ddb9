"""The continuous form of prioritised inverse kinematics: against its formulas, eq. (13), and what it guarantees."""

import itertools
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array
from robots.pinocchio_model import standing_configuration
from wbc.damped_priorities import damped_velocity
from wbc.kinwbc import KinWbc, prioritised_velocity
from wbc.posture import RIDGE
from wbc.task_block import Level
from wbc.tasks import FramePositionTask, PostureTask, TaskGains

seeds = st.integers(0, 2**32 - 1)
EXACT = 1e-9
NV = 20


def plain(levels: Sequence[Level], nv: int, thresholds: Sequence[float], posture: Array | None = None) -> Array:
    """The formulas of the module in full matrices, by numpy's SVD."""
    velocity, freedom, penalty = np.zeros(nv), np.eye(nv), RIDGE * np.eye(nv)
    for (jacobian, command), threshold in zip(levels, thresholds, strict=True):
        u, sigma, vt = np.linalg.svd(jacobian @ freedom, full_matrices=False)
        inverse, fraction = sigma / np.maximum(sigma, threshold) ** 2, np.minimum(1.0, (sigma / threshold) ** 2)
        velocity = velocity + freedom @ (vt.T @ (inverse * (u.T @ (command - jacobian @ velocity))))
        freedom = freedom @ (np.eye(nv) - vt.T @ np.diag(fraction) @ vt)
        penalty += sum(s**2 * np.outer(v, v) for s, v in zip(fraction, vt, strict=True))
    if posture is not None:
        chosen = np.eye(nv)[nv - posture.size :]
        moved = chosen @ freedom
        left = posture - chosen @ velocity
        velocity = velocity + freedom @ np.linalg.solve(moved.T @ moved + penalty, moved.T @ left)
    return velocity


def level(rng: np.random.Generator, sigma: Sequence[float], nv: int = NV) -> Level:
    """A level with these singular values."""
    left, _ = np.linalg.qr(rng.normal(size=(len(sigma), len(sigma))))
    right, _ = np.linalg.qr(rng.normal(size=(nv, len(sigma))))
    return left @ np.diag(sigma) @ right.T, rng.normal(size=len(sigma))


def random_levels(rng: np.random.Generator, count: int, least: float, nv: int = NV) -> list[Level]:
    """Levels with singular values between 10^least and 10, some of them repeated or without rank."""
    levels: list[Level] = []
    for _ in range(count):
        kind, m = rng.integers(4), int(rng.integers(0, 7))
        if kind == 0 and levels:
            source, _ = levels[rng.integers(len(levels))]
            levels.append((source.copy(), rng.normal(size=source.shape[0])))
        elif kind == 1:
            jacobian, command = level(rng, [1.0] * m, nv)
            levels.append((np.repeat(jacobian[:1], m, axis=0), command) if m else (jacobian, command))
        else:
            levels.append(level(rng, list(10.0 ** rng.uniform(least, 1.0, m)), nv))
    return levels


@given(seeds, st.integers(0, 5), st.floats(-6.0, 0.0), st.booleans())
def test_velocities_are_those_of_the_formulas(seed: int, count: int, least: float, with_posture: bool) -> None:
    """Levels of any rank, below a posture or not; the ridge divides the posture's rounding by 1e-9 at the most."""
    rng = np.random.default_rng(seed)
    levels = random_levels(rng, count, least)
    thresholds = list(10.0 ** rng.uniform(-2.0, 0.0, count))
    posture = rng.normal(size=NV - 6) if with_posture else None
    expected = plain(levels, NV, thresholds, posture)
    scale = max(1.0, float(np.linalg.norm(expected)))
    velocity = damped_velocity(levels, NV, thresholds, posture)
    np.testing.assert_allclose(velocity, expected, rtol=0, atol=(1e-5 if with_posture else EXACT) * scale)


@given(seeds, st.integers(1, 4))
def test_above_the_thresholds_it_is_the_recursion_of_the_paper(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    levels = [(rng.normal(size=(m, NV)), rng.normal(size=m)) for m in rng.integers(1, 5, count)]
    levels[0] = (np.hstack([np.eye(6), 0.3 * rng.normal(size=(6, NV - 6))]), rng.normal(size=6))
    posture = rng.normal(size=NV - 6)
    chosen = np.hstack([np.zeros((NV - 6, 6)), np.eye(NV - 6)])
    # the cut below every singular value, and the threshold too
    expected = prioritised_velocity([*levels, (chosen, posture)], NV, 1e-9)
    velocity = damped_velocity(levels, NV, [1e-6] * count, posture)
    np.testing.assert_allclose(velocity, expected, rtol=0, atol=1e3 * RIDGE * max(1.0, abs(expected).max()))
    np.testing.assert_allclose(
        damped_velocity(levels, NV, [1e-6] * count), prioritised_velocity(levels, NV, 1e-9), rtol=0, atol=EXACT
    )
    for jacobian, command in levels:
        np.testing.assert_allclose(jacobian @ velocity, command, rtol=0, atol=EXACT)


@settings(max_examples=20)
@given(seeds, st.floats(0.05, 0.3), st.booleans())
def test_velocities_are_continuous_where_a_singular_value_goes_through_zero(
    seed: int, threshold: float, with_posture: bool
) -> None:
    """Along a path on which a direction of the second of three levels is lost and comes back, no step is a jump.

    Halving the step of the path halves the largest step of the velocity; the recursion with a cut jumps by the same
    amount however small the steps are.
    """
    rng = np.random.default_rng(seed)
    # the base is held, as by feet: else a posture that hardly sees it moves it without bound
    top = (np.hstack([np.eye(6), 0.3 * rng.normal(size=(6, NV - 6))]), rng.normal(size=6))
    low = level(rng, [1.0, 0.9, 0.5])
    left, right = (np.linalg.qr(rng.normal(size=(n, 3)))[0] for n in (3, NV))
    command, posture = rng.normal(size=3), rng.normal(size=NV - 6) if with_posture else None

    def at(x: float) -> list[Level]:
        return [top, (left @ np.diag([1.0, 0.6, x]) @ right.T, command), low]

    def largest(path: Sequence[Array]) -> float:
        return max(float(np.linalg.norm(b - a)) for a, b in itertools.pairwise(path))

    smooth, cut = [], []
    for steps in (200, 400):
        places = np.linspace(-2.0 * threshold, 2.0 * threshold, steps + 1)
        path = [damped_velocity(at(x), NV, [0.05, threshold, 0.05], posture) for x in places]
        smooth.append(largest(path))
        cut.append(largest([prioritised_velocity(at(x), NV, threshold) for x in places]))
    assert smooth[1] < 0.6 * smooth[0]
    assert cut[1] > 0.8 * cut[0]


@given(seeds, st.lists(st.tuples(st.integers(1, 8), st.floats(-12.0, 1.0)), min_size=1, max_size=5))
def test_velocities_are_bounded_by_residuals_over_the_thresholds(seed: int, shapes: list[tuple[int, float]]) -> None:
    """g(sigma) <= 1 / sigma_d, whatever the singular values are, and Z does not lengthen."""
    rng = np.random.default_rng(seed)
    levels: list[Level] = []
    bound, threshold = 0.0, 0.1
    for m, exponent in shapes:
        before = damped_velocity(levels, NV, [threshold] * len(levels))
        levels.append(level(rng, list(10.0 ** rng.uniform(min(exponent, 0.0), 1.0, m))))
        bound += float(np.linalg.norm(levels[-1][1] - levels[-1][0] @ before)) / threshold
        velocity = damped_velocity(levels, NV, [threshold] * len(levels))
        assert np.isfinite(velocity).all()
        assert np.linalg.norm(velocity) <= bound * (1 + 1e-12)


@given(seeds, st.floats(0.0, 1.0), st.floats(0.02, 0.3))
def test_levels_below_disturb_a_damped_direction_by_no_more_than_is_stated(
    seed: int, fraction: float, threshold: float
) -> None:
    """By sigma (1 - s) times their step, at most 2 / (3 sqrt 3) of the threshold; other directions not at all."""
    rng = np.random.default_rng(seed)
    sigma = fraction * threshold
    high = level(rng, [1.0, 0.5, sigma])
    low = (rng.normal(size=(4, NV)), 10.0 * rng.normal(size=4))
    alone = damped_velocity([high], NV, [threshold])
    both = damped_velocity([high, low], NV, [threshold, 0.01])
    u, _, vt = np.linalg.svd(high[0], full_matrices=False)
    change = u.T @ (high[0] @ (both - alone))
    np.testing.assert_allclose(change[:2], 0.0, rtol=0, atol=EXACT * np.linalg.norm(both))
    left = 1.0 - fraction**2
    # the step in the coordinates of Z is longer along the damped direction by 1 / (1 - s)
    if left > 1e-3:
        step = both - alone
        in_z = step + (1.0 / left - 1.0) * vt[2] * (vt[2] @ step)
        assert abs(change[2]) <= sigma * left * np.linalg.norm(in_z) * (1 + 1e-6) + EXACT
    assert sigma * left <= 2.0 / (3.0 * np.sqrt(3.0)) * threshold * (1 + 1e-12)


@given(seeds)
def test_axes_of_a_level_may_be_turned(seed: int) -> None:
    rng = np.random.default_rng(seed)
    levels = random_levels(rng, 4, -3.0)
    thresholds, posture = [0.1, 0.2, 0.05, 0.1], rng.normal(size=NV - 6)
    turned = []
    for jacobian, command in levels:
        turn = np.linalg.qr(rng.normal(size=(command.size, command.size)))[0] if command.size else np.zeros((0, 0))
        turned.append((turn @ jacobian, turn @ command))
    velocity = damped_velocity(levels, NV, thresholds, posture)
    other = damped_velocity(turned, NV, thresholds, posture)
    np.testing.assert_allclose(other, velocity, rtol=0, atol=1e-5 * max(1.0, np.linalg.norm(velocity)))


def test_a_posture_that_the_levels_leave_nothing_to_changes_nothing() -> None:
    """More rows than freedom above it, and a base that no joint moves."""
    rng = np.random.default_rng(3)
    levels = [(rng.normal(size=(NV, NV)), rng.normal(size=NV))]
    expected = damped_velocity(levels, NV, [1e-4])
    np.testing.assert_allclose(damped_velocity(levels, NV, [1e-4], np.ones(NV - 6)), expected, rtol=0, atol=1e-6)
    alone = damped_velocity([], NV, [], np.ones(NV - 6))
    np.testing.assert_allclose(alone, np.append(np.zeros(6), np.ones(NV - 6)), rtol=0, atol=2 * RIDGE)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_a_number_ends_soon_and_is_not_hidden(bad: float) -> None:
    rng = np.random.default_rng(4)
    levels = [(rng.normal(size=(6, NV)), rng.normal(size=6)) for _ in range(3)]
    levels[1][0][2, 3] = bad
    assert not np.isfinite(damped_velocity(levels, NV, [0.1] * 3, np.zeros(NV - 6))).all()
    levels[1][0][2, 3], levels[1][1][0] = 0.0, bad
    assert not np.isfinite(damped_velocity(levels, NV, [0.1] * 3, np.zeros(NV - 6))).all()


# --- in the stack of a robot


def arms(kin: Kinematics) -> tuple[KinWbc, list[FramePositionTask]]:
    """Two hands above the posture, damped."""
    hands = [
        FramePositionTask(kin.frame_id(kin.robot.roles[r]), TaskGains(10.0, 0.5)) for r in ("left_hand", "right_hand")
    ]
    posture = PostureTask(kin.nv - 6, TaskGains(5.0))
    posture.joints = kin.q[7:].copy()
    return KinWbc(kin.nv, [hands, [posture]], damped_below=[0.08, 0.08]), hands


def test_a_stack_solves_the_rows_it_has_evaluated_as_any_other_rows(robot_name: str) -> None:
    """The block of rows and the same levels as a list; highest levels alone; in a singular posture too."""
    kin = Kinematics(load_robot(robot_name))
    q = standing_configuration(kin.robot)
    for straight in (False, True):
        if straight:
            q[7:] = 0.0
        kin.update(q, np.zeros(kin.nv))
        solver, hands = arms(kin)
        for hand in hands:
            hand.position = np.array([0.3, 0.1, 0.2])
        levels = solver.evaluate(kin)
        expected = plain(levels[:1], kin.nv, [0.08], levels[1][1])
        np.testing.assert_allclose(solver.solve(levels), expected, rtol=0, atol=1e-6)
        np.testing.assert_array_equal(solver.solve(levels), solver.solve([(j.copy(), c.copy()) for j, c in levels]))
        np.testing.assert_allclose(solver.solve(levels[:1]), plain(levels[:1], kin.nv, [0.08]), rtol=0, atol=EXACT)


def test_one_threshold_a_level_each_above_zero(kin_g1: Kinematics) -> None:
    posture = PostureTask(29, TaskGains(5.0))
    for bad in ([], [0.1, 0.1], [0.0], [-1.0], [float("nan")]):
        with pytest.raises(ConfigError, match="damped_below"):
            KinWbc(kin_g1.nv, [[posture]], damped_below=bad)


@pytest.fixture
def kin_g1() -> Kinematics:
    return Kinematics(load_robot("g1"))
