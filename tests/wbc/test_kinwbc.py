"""KinWBC against eq. (13) of Lee et al. written plainly, and the properties that its name guarantees."""

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array
from robots.pinocchio_model import standing_configuration
from wbc.kinwbc import KinWbc, prioritised_velocity
from wbc.task_block import Level
from wbc.tasks import (
    CenterOfMassTask,
    FrameOrientationTask,
    FramePoseTask,
    FramePositionTask,
    PostureTask,
    Task,
    TaskGains,
)

CUT = 0.03
EXACT = 1e-9
seeds = st.integers(0, 2**32 - 1)


def recursion(levels: Sequence[Level], nv: int, sigma_min: float) -> Array:
    """Eq. (13) as it stands: projected Jacobians of full size, pseudo-inverses by truncated SVD."""
    velocity, projector = np.zeros(nv), np.eye(nv)
    for jacobian, command in levels:
        u, sigma, vt = np.linalg.svd(jacobian @ projector, full_matrices=False)
        kept = sigma > sigma_min
        inverse = vt[kept].T @ np.diag(1.0 / sigma[kept]) @ u[:, kept].T
        velocity = velocity + inverse @ (command - jacobian @ velocity)
        # the directions kept are orthonormal, so this is N (I - J^+ J) without its rounding
        projector = projector - vt[kept].T @ vt[kept]
    return velocity


def singular_values(levels: Sequence[Level], nv: int, sigma_min: float) -> Array:
    """Of every projected Jacobian of the recursion."""
    projector, out = np.eye(nv), [np.zeros(0)]
    for jacobian, _ in levels:
        _, sigma, vt = np.linalg.svd(jacobian @ projector, full_matrices=False)
        out.append(sigma)
        projector = projector - vt[sigma > sigma_min].T @ vt[sigma > sigma_min]
    return np.concatenate(out)


def near_the_cut(levels: Sequence[Level], nv: int, sigma_min: float) -> bool:
    """Whether rounding could decide on which side of the cut a singular value lies."""
    sigma = singular_values(levels, nv, sigma_min)
    return bool((abs(sigma - sigma_min) < 1e-9).any())


def assert_follows_the_paper(levels: Sequence[Level], nv: int, sigma_min: float = CUT) -> Array:
    velocity = prioritised_velocity(levels, nv, sigma_min)
    assert velocity.shape == (nv,)
    expected = recursion(levels, nv, sigma_min)
    np.testing.assert_allclose(velocity, expected, rtol=0, atol=EXACT * max(1.0, np.linalg.norm(expected)))
    return velocity


def random_level(rng: np.random.Generator, rows: int, nv: int) -> Level:
    return rng.normal(size=(rows, nv)), rng.normal(size=rows)


def of_rank(rng: np.random.Generator, rows: int, nv: int, rank: int) -> Level:
    return rng.normal(size=(rows, rank)) @ rng.normal(size=(rank, nv)), rng.normal(size=rows)


def with_singular_values(rng: np.random.Generator, sigma: Sequence[float], nv: int) -> Array:
    left, _ = np.linalg.qr(rng.normal(size=(len(sigma), len(sigma))))
    right, _ = np.linalg.qr(rng.normal(size=(nv, len(sigma))))
    return left @ np.diag(sigma) @ right.T


# --- the paper's recursion on matrices


@given(seeds, st.lists(st.integers(1, 7), max_size=6))
def test_random_levels_follow_the_recursion(seed: int, sizes: list[int]) -> None:
    """Up to 42 rows on 20 velocities: from plenty of freedom to more rows than degrees of freedom."""
    rng = np.random.default_rng(seed)
    levels = [random_level(rng, m, 20) for m in sizes]
    if not near_the_cut(levels, 20, CUT):
        assert_follows_the_paper(levels, 20)


@given(seeds, st.lists(st.tuples(st.integers(1, 6), st.integers(0, 6)), min_size=1, max_size=6))
def test_dependent_rows_inside_levels_follow_the_recursion(seed: int, shapes: list[tuple[int, int]]) -> None:
    rng = np.random.default_rng(seed)
    levels = [of_rank(rng, m, 18, min(m, rank)) for m, rank in shapes]
    if not near_the_cut(levels, 18, CUT):
        assert_follows_the_paper(levels, 18)


@given(seeds, st.integers(0, 3), st.integers(1, 5))
def test_dependent_levels_follow_the_recursion(seed: int, above: int, rows: int) -> None:
    """A level that is a combination of the rows above it, in whole or in part, adds nothing or a part."""
    rng = np.random.default_rng(seed)
    levels = [random_level(rng, 4, 16) for _ in range(above + 1)]
    stacked = np.concatenate([j for j, _ in levels])
    jacobian = rng.normal(size=(rows, stacked.shape[0])) @ stacked
    levels.append((jacobian, rng.normal(size=rows)))
    before = prioritised_velocity(levels[:-1], 16, CUT)
    if not near_the_cut(levels, 16, CUT):
        after = assert_follows_the_paper(levels, 16)
        if stacked.shape[0] < 16:
            np.testing.assert_allclose(after, before, rtol=0, atol=EXACT * max(1.0, np.linalg.norm(before)))
        partly = [*levels[:-1], (np.vstack([jacobian, rng.normal(size=16)]), rng.normal(size=rows + 1))]
        if not near_the_cut(partly, 16, CUT):
            assert_follows_the_paper([*partly, random_level(rng, 3, 16)], 16)


@given(seeds, st.sampled_from([0.0, 1e-310, 1e-200, 1e-20, 1e-12]), st.integers(0, 2))
def test_zero_and_vanishing_rows_follow_the_recursion(seed: int, size: float, where: int) -> None:
    rng = np.random.default_rng(seed)
    levels = [random_level(rng, 4, 15) for _ in range(3)]
    levels[where][0][rng.integers(4)] *= size
    assert_follows_the_paper(levels, 15)
    levels[where][0][:] *= size
    assert_follows_the_paper(levels, 15)


@given(seeds, st.integers(2, 4))
def test_a_level_repeated_changes_nothing(seed: int, times: int) -> None:
    rng = np.random.default_rng(seed)
    first, second = random_level(rng, 5, 14), random_level(rng, 4, 14)
    once = assert_follows_the_paper([first, second], 14)
    other = (first[0], rng.normal(size=5))
    for levels in ([first] * times + [second], [first, second, *[first] * times], [first, other, second, other]):
        velocity = assert_follows_the_paper(levels, 14)
        np.testing.assert_allclose(velocity, once, rtol=0, atol=EXACT * max(1.0, np.linalg.norm(once)))


@pytest.mark.parametrize("empty", [[], [(np.zeros((0, 9)), np.zeros(0))], [(np.zeros((4, 9)), np.ones(4))]])
def test_without_anything_to_do_nothing_moves(empty: list[Level]) -> None:
    np.testing.assert_array_equal(prioritised_velocity(empty, 9, CUT), np.zeros(9))


@given(seeds, st.integers(0, 3))
def test_a_level_without_rows_changes_nothing(seed: int, where: int) -> None:
    rng = np.random.default_rng(seed)
    levels = [random_level(rng, 4, 12) for _ in range(3)]
    expected = prioritised_velocity(levels, 12, CUT)
    levels.insert(where, (np.zeros((0, 12)), np.zeros(0)))
    np.testing.assert_allclose(prioritised_velocity(levels, 12, CUT), expected, rtol=0, atol=EXACT)


@given(seeds, st.integers(1, 3))
def test_more_rows_than_degrees_of_freedom_give_the_least_squares_answer(seed: int, above: int) -> None:
    rng = np.random.default_rng(seed)
    nv = 10
    levels = [random_level(rng, 2, nv) for _ in range(above)]
    tall = random_level(rng, 30, nv)
    velocity = assert_follows_the_paper([*levels, tall, random_level(rng, 5, nv)], nv)
    # free to move only where the levels above allow: the gradient of the residual vanishes there
    _, _, vt = np.linalg.svd(np.concatenate([j for j, _ in levels]))
    free = vt[2 * above :].T
    np.testing.assert_allclose(free.T @ tall[0].T @ (tall[0] @ velocity - tall[1]), 0.0, rtol=0, atol=1e-8)


# --- the cut of singular values


@given(seeds, st.floats(1e-3, 0.5), st.booleans())
def test_singular_values_above_the_cut_are_used_and_those_below_are_not(seed: int, cut: float, stacked: bool) -> None:
    rng = np.random.default_rng(seed)
    nv = 12
    above = [random_level(rng, 3, nv)] if stacked else []
    for factor, rank in ((1.0 + 1e-6, 4), (1.0 - 1e-6, 3)):
        jacobian = with_singular_values(rng, [2.0, 1.0, 0.7, cut * factor], nv)
        if above:  # inside the null space of the level above, so that projection leaves the values alone
            _, _, vt = np.linalg.svd(above[0][0])
            jacobian = with_singular_values(rng, [2.0, 1.0, 0.7, cut * factor], nv - 3) @ vt[3:]
        command = rng.normal(size=4)
        velocity = assert_follows_the_paper([*above, (jacobian, command)], nv, cut)
        u, _, _ = np.linalg.svd(jacobian)
        reached = u.T @ (jacobian @ velocity - command)
        base = jacobian @ prioritised_velocity(above, nv, cut)
        np.testing.assert_allclose(reached[:rank], 0.0, rtol=0, atol=1e-8)
        np.testing.assert_allclose(reached[rank:], (u.T @ (base - command))[rank:], rtol=0, atol=1e-8)


@given(seeds, st.floats(-6.0, -0.5))
def test_values_just_above_the_cut_survive_in_a_tall_level(seed: int, exponent: float) -> None:
    """More rows than freedom: an answer through the normal matrix squares the singular values and loses digits."""
    rng = np.random.default_rng(seed)
    smallest = 10.0**exponent
    left, _ = np.linalg.qr(rng.normal(size=(20, 8)))
    right, _ = np.linalg.qr(rng.normal(size=(8, 8)))
    jacobian = left @ np.diag([1.0, 1.0, 0.8, 0.6, 0.4, 0.35, 0.33, smallest]) @ right.T
    levels = [(jacobian, rng.normal(size=20))]
    for cut in (0.9 * smallest, 1.1 * smallest):
        velocity = prioritised_velocity(levels, 8, cut)
        expected = recursion(levels, 8, cut)
        # the answer itself is only defined to eps / sigma
        np.testing.assert_allclose(velocity, expected, rtol=0, atol=1e-13 / smallest * np.linalg.norm(expected) + EXACT)


@given(seeds, st.lists(st.tuples(st.integers(1, 8), st.floats(-12.0, 1.0)), min_size=1, max_size=6))
def test_velocities_are_bounded_by_residuals_over_the_cut(seed: int, shapes: list[tuple[int, float]]) -> None:
    """Whatever the singular values are: ||v|| <= sum of ||command_i - J_i v_(i-1)|| / sigma_min."""
    rng = np.random.default_rng(seed)
    nv = 15
    levels: list[Level] = []
    bound = 0.0
    for m, exponent in shapes:
        sigma = 10.0 ** rng.uniform(min(exponent, 0.0), 1.0, m)
        before = prioritised_velocity(levels, nv, CUT)
        levels.append((with_singular_values(rng, list(sigma), nv), rng.normal(size=m)))
        bound += float(np.linalg.norm(levels[-1][1] - levels[-1][0] @ before)) / CUT
        velocity = prioritised_velocity(levels, nv, CUT)
        assert np.isfinite(velocity).all()
        assert np.linalg.norm(velocity) <= bound * (1 + 1e-12)


# --- priorities and invariance


@given(seeds, st.lists(st.integers(1, 6), min_size=2, max_size=6))
def test_a_lower_level_never_disturbs_the_ones_above(seed: int, sizes: list[int]) -> None:
    """Full or no rank per level: with every level added below, the levels above keep their task velocities."""
    rng = np.random.default_rng(seed)
    levels = [random_level(rng, m, 18) if rng.random() < 0.7 else of_rank(rng, m, 18, m // 2) for m in sizes]
    sigma = singular_values(levels, 18, CUT)
    if ((sigma > 1e-10) & (sigma < CUT + 1e-6)).any():
        return  # a direction that the cut has given up is free by design: see the next test
    velocities = [prioritised_velocity(levels[: k + 1], 18, CUT) for k in range(len(levels))]
    for i, (jacobian, _) in enumerate(levels):
        for after in velocities[i + 1 :]:
            scale = max(1.0, np.linalg.norm(after))
            np.testing.assert_allclose(jacobian @ (after - velocities[i]), 0.0, rtol=0, atol=EXACT * scale)


@given(seeds)
def test_directions_given_up_by_the_cut_are_disturbed_by_no_more_than_the_cut(seed: int) -> None:
    rng = np.random.default_rng(seed)
    high = (with_singular_values(rng, [1.0, 0.5, 0.9 * CUT, 0.1 * CUT], 12), rng.normal(size=4))
    alone = prioritised_velocity([high], 12, CUT)
    both = prioritised_velocity([high, random_level(rng, 6, 12)], 12, CUT)
    assert np.linalg.norm(high[0] @ (both - alone)) <= 0.9 * CUT * np.linalg.norm(both - alone) * (1 + 1e-9)


@given(seeds, st.lists(st.integers(1, 5), min_size=1, max_size=4))
def test_feasible_levels_are_met_exactly(seed: int, sizes: list[int]) -> None:
    rng = np.random.default_rng(seed)
    levels = [random_level(rng, m, 24) for m in sizes]
    sigma = singular_values(levels, 24, CUT)
    if sigma.min() > 2 * CUT:
        velocity = prioritised_velocity(levels, 24, CUT)
        for jacobian, command in levels:
            np.testing.assert_allclose(jacobian @ velocity, command, rtol=0, atol=EXACT)


@given(seeds, st.lists(st.integers(1, 6), min_size=1, max_size=5))
def test_rows_may_be_permuted_and_axes_rotated_inside_a_level(seed: int, sizes: list[int]) -> None:
    rng = np.random.default_rng(seed)
    levels = [random_level(rng, m, 16) if rng.random() < 0.7 else of_rank(rng, m, 16, m // 2) for m in sizes]
    if near_the_cut(levels, 16, CUT):
        return
    velocity = prioritised_velocity(levels, 16, CUT)
    for permute in (True, False):
        turned = []
        for jacobian, command in levels:
            m = command.size
            turn = np.eye(m)[rng.permutation(m)] if permute else np.linalg.qr(rng.normal(size=(m, m)))[0]
            turned.append((turn @ jacobian, turn @ command))
        other = prioritised_velocity(turned, 16, CUT)
        np.testing.assert_allclose(other, velocity, rtol=0, atol=EXACT * max(1.0, np.linalg.norm(velocity)))


@given(seeds)
def test_the_answer_is_linear_in_the_commands(seed: int) -> None:
    rng = np.random.default_rng(seed)
    levels = [of_rank(rng, 5, 16, 3), random_level(rng, 6, 16), random_level(rng, 9, 16)]
    other = [(j, rng.normal(size=c.size)) for j, c in levels]
    if not near_the_cut(levels, 16, CUT):
        total = [(j, 2.0 * c - 3.0 * d) for (j, c), (_, d) in zip(levels, other, strict=True)]
        expected = 2.0 * prioritised_velocity(levels, 16, CUT) - 3.0 * prioritised_velocity(other, 16, CUT)
        velocity = prioritised_velocity(total, 16, CUT)
        np.testing.assert_allclose(velocity, expected, rtol=0, atol=EXACT * max(1.0, np.linalg.norm(expected)))


def test_levels_are_not_written_to() -> None:
    rng = np.random.default_rng(9)
    levels = [random_level(rng, 4, 12), of_rank(rng, 4, 12, 2), random_level(rng, 12, 12)]
    before = [(j.copy(), c.copy()) for j, c in levels]
    prioritised_velocity(levels, 12, CUT)
    for (j, c), (j0, c0) in zip(levels, before, strict=True):
        assert np.array_equal(j, j0)
        assert np.array_equal(c, c0)


def test_any_memory_layout_gives_the_same_answer() -> None:
    rng = np.random.default_rng(10)
    levels = [random_level(rng, 4, 12), random_level(rng, 5, 12), random_level(rng, 12, 12)]
    expected = prioritised_velocity(levels, 12, CUT)
    fortran = [(np.asfortranarray(j), c) for j, c in levels]
    sliced = [(np.repeat(j, 2, axis=0)[::2], np.repeat(c, 2)[::2]) for j, c in levels]
    for other in (fortran, sliced):
        np.testing.assert_allclose(prioritised_velocity(other, 12, CUT), expected, rtol=0, atol=EXACT)


# --- robots


def stack(kin: Kinematics, sigma_min: float = CUT) -> KinWbc:
    """The whole-body stack: feet, centre of mass, base and torso orientation, hands, posture; sent to the origin."""
    gains, roles = TaskGains(8.0), kin.robot.roles
    frame = {role: kin.frame_id(name) for role, name in roles.items()}
    levels: list[list[Task]] = [
        [FramePoseTask(frame["left_sole"], gains), FramePoseTask(frame["right_sole"], gains)],
        [CenterOfMassTask(gains)],
        [FrameOrientationTask(frame["base"], gains), FrameOrientationTask(frame["torso"], gains)],
        [FramePositionTask(frame["left_hand"], gains), FramePositionTask(frame["right_hand"], gains)],
        [PostureTask(kin.nv - 6, gains)],
    ]
    for task in (task for level in levels for task in level):
        to_the_origin(task)
    return KinWbc(kin.nv, levels, sigma_min)


def to_the_origin(task: Task) -> None:
    if isinstance(task, FramePoseTask):
        task.set_target(np.zeros(3), np.eye(3))
    elif isinstance(task, FrameOrientationTask):
        task.set_target(np.eye(3))
    else:
        task.set_target(np.zeros(task.rows))


def random_configuration(kin: Kinematics, rng: np.random.Generator) -> Array:
    quaternion = rng.normal(size=4)
    joints = rng.uniform(*kin.robot.position_limits)
    return np.concatenate([rng.normal(size=3), quaternion / np.linalg.norm(quaternion), joints])


def singular_configurations(kin: Kinematics) -> list[Array]:
    """All joints at zero, at each limit, standing, and standing with straight knees or elbows."""
    low, high = kin.robot.position_limits
    standing = standing_configuration(kin.robot)
    out = [standing]
    for joints in (np.zeros_like(low), low, high):
        out.append(np.concatenate([standing[:7], joints]))
    for words in (("knee",), ("elbow",), ("hip", "knee", "ankle"), ("shoulder", "elbow", "wrist")):
        straight = standing.copy()
        for i, name in enumerate(kin.robot.joint_names):
            if any(word in name.lower() for word in words):
                straight[7 + i] = 0.0
        out.append(straight)
    return out


def randomised(levels: Sequence[Level], rng: np.random.Generator) -> list[Level]:
    """The same Jacobians (copied: some are views into the model) with random commands."""
    return [(jacobian.copy(), rng.normal(size=command.size)) for jacobian, command in levels]


KINEMATICS = {name: Kinematics(load_robot(name)) for name in ("g1", "tocabi")}


@pytest.fixture
def kin(robot_name: str) -> Kinematics:
    return KINEMATICS[robot_name]


def assert_bounded(levels: Sequence[Level], nv: int) -> None:
    bound, before = 0.0, np.zeros(nv)
    for k, (jacobian, command) in enumerate(levels):
        bound += float(np.linalg.norm(command - jacobian @ before)) / CUT
        before = prioritised_velocity(levels[: k + 1], nv, CUT)
        assert np.isfinite(before).all()
        assert np.linalg.norm(before) <= bound * (1 + 1e-12)


def test_random_states_of_the_robots_follow_the_recursion(kin: Kinematics) -> None:
    rng = np.random.default_rng(1)
    solver = stack(kin)
    for _ in range(40):
        kin.update(random_configuration(kin, rng), rng.normal(size=kin.nv))
        levels = randomised(solver.evaluate(kin), rng)
        if not near_the_cut(levels, kin.nv, CUT):
            velocity = assert_follows_the_paper(levels, kin.nv)
            np.testing.assert_array_equal(solver.solve(levels), velocity)
            assert_bounded(levels, kin.nv)


def test_singular_states_of_the_robots_follow_the_recursion(kin: Kinematics) -> None:
    rng = np.random.default_rng(2)
    solver = stack(kin)
    for q in singular_configurations(kin):
        kin.update(q, np.zeros(kin.nv))
        levels = randomised(solver.evaluate(kin), rng)
        if not near_the_cut(levels, kin.nv, CUT):
            assert_follows_the_paper(levels, kin.nv)
        assert_bounded(levels, kin.nv)


@pytest.mark.parametrize("name", sorted(KINEMATICS))
@given(fractions=st.lists(st.floats(0.0, 1.0), min_size=33, max_size=33), seed=seeds)
def test_velocities_are_finite_and_bounded_in_any_configuration(name: str, fractions: list[float], seed: int) -> None:
    kin, rng = KINEMATICS[name], np.random.default_rng(seed)
    low, high = kin.robot.position_limits
    q = random_configuration(kin, rng)
    q[7:] = low + np.array(fractions[: low.size]) * (high - low)
    kin.update(q, np.zeros(kin.nv))
    assert_bounded(randomised(stack(kin).evaluate(kin), rng), kin.nv)


def test_lower_tasks_of_the_robots_do_not_disturb_the_ones_above(kin: Kinematics) -> None:
    rng = np.random.default_rng(3)
    solver = stack(kin)
    for _ in range(15):
        kin.update(random_configuration(kin, rng), rng.normal(size=kin.nv))
        levels = randomised(solver.evaluate(kin), rng)
        velocities = [solver.solve(levels[: k + 1]) for k in range(len(levels))]
        for i, (jacobian, _) in enumerate(levels):
            sigma = singular_values(levels[: i + 1], kin.nv, CUT)
            lost = float(sigma[(sigma < CUT)].max(initial=0.0))
            for after in velocities[i + 1 :]:
                step = after - velocities[i]
                limit = lost + EXACT
                # each level above i may have given up directions: none weighs more than its singular value
                assert np.linalg.norm(jacobian @ step) <= limit * max(1.0, np.linalg.norm(step))


def test_the_stance_is_met_exactly_where_it_is_feasible(kin: Kinematics) -> None:
    """Standing: feet, centre of mass and orientations together are feasible, and the hands follow as well."""
    rng = np.random.default_rng(4)
    solver = stack(kin, 1e-3)
    q = standing_configuration(kin.robot)
    low, high = kin.robot.position_limits
    q[7:] = np.clip(q[7:] + 0.2 * rng.normal(size=low.size), low, high)
    kin.update(q, np.zeros(kin.nv))
    levels = randomised(solver.evaluate(kin), rng)
    assert singular_values(levels[:4], kin.nv, 1e-3).min() > 2e-3
    velocity = solver.solve(levels)
    for jacobian, command in levels[:4]:
        np.testing.assert_allclose(jacobian @ velocity, command, rtol=0, atol=EXACT)


def test_turning_the_world_under_the_robot_turns_only_the_base_task_axes(kin: Kinematics) -> None:
    """Same joints, base turned by R, commands turned by R: joint rates and base velocity in base axes are the same."""
    rng = np.random.default_rng(5)
    solver = stack(kin)
    for _ in range(5):
        q = random_configuration(kin, rng)
        turned = q.copy()
        turned[:3], turned[3:7] = [-q[1], q[0], q[2]], quaternion_after_quarter_turn(q[3:7])
        quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        kin.update(q, np.zeros(kin.nv))
        levels = randomised(solver.evaluate(kin), rng)
        if near_the_cut(levels, kin.nv, CUT):
            continue
        velocity = solver.solve(levels)
        kin.update(turned, np.zeros(kin.nv))
        rotated = []
        for (jacobian, _), (_, command) in zip(solver.evaluate(kin), levels, strict=True):
            posture = command.size == kin.nv - 6
            rotated.append((jacobian, command if posture else (command.reshape(-1, 3) @ quarter.T).ravel()))
        np.testing.assert_allclose(solver.solve(rotated), velocity, rtol=0, atol=1e-8 * max(1, abs(velocity).max()))


def quaternion_after_quarter_turn(quaternion: Array) -> Array:
    """The product of a quarter turn about world z with a quaternion x, y, z, w."""
    x, y, z, w = quaternion
    return np.array([x - y, y + x, z + w, w - z]) / np.sqrt(2.0)


# --- the class


def test_evaluate_stacks_the_tasks_of_a_level_in_order(kin: Kinematics) -> None:
    kin.update(random_configuration(kin, np.random.default_rng(6)), np.zeros(kin.nv))
    gains = TaskGains(5.0)
    com = CenterOfMassTask(gains)
    hand, other = (FramePositionTask(kin.frame_id(kin.robot.roles[r]), gains) for r in ("left_hand", "right_hand"))
    com.position, hand.position, other.position = np.arange(9.0).reshape(3, 3)
    (jacobian, command), (single, _) = KinWbc(kin.nv, [[com, hand], [other]]).evaluate(kin)
    np.testing.assert_array_equal(jacobian, np.vstack([com.evaluate(kin)[0], hand.evaluate(kin)[0]]))
    np.testing.assert_array_equal(command, np.concatenate([com.evaluate(kin)[1], hand.evaluate(kin)[1]]))
    np.testing.assert_array_equal(single, other.evaluate(kin)[0])


def test_a_task_in_two_places_is_refused(kin: Kinematics) -> None:
    task = CenterOfMassTask(TaskGains(5.0))
    with pytest.raises(ConfigError, match="CenterOfMassTask"):
        KinWbc(kin.nv, [[task], [task]])


def test_tracking_with_the_integrated_velocity_brings_every_task_to_rest(robot: RobotDescription) -> None:
    """Eq. (14): stepping q + v dt with reachable references drives the errors of all levels but the last to zero."""
    kin = Kinematics(robot)
    solver = stack(kin, 1e-3)
    rng = np.random.default_rng(7)
    target = standing_configuration(robot)
    low, high = robot.position_limits
    target[7:] = np.clip(target[7:] + 0.1 * rng.normal(size=low.size), low, high)
    kin.update(target, np.zeros(kin.nv))
    hold_here(solver, kin)
    q = kin.integrate(target, 0.05 * rng.normal(size=kin.nv), 1.0)
    for _ in range(400):
        kin.update(q, np.zeros(kin.nv))
        levels = solver.evaluate(kin)
        q = kin.integrate(q, solver.solve(levels), 0.01)
    assert max(abs(command).max() for _, command in levels) < 1e-8


def hold_here(solver: KinWbc, kin: Kinematics) -> None:
    """Set every task's reference to where the robot is."""
    for task in (t for level in solver.levels for t in level):
        if isinstance(task, CenterOfMassTask):
            task.position = kin.com.copy()
        elif isinstance(task, PostureTask):
            task.joints = kin.q[7:].copy()
        elif isinstance(task, FramePositionTask | FramePoseTask | FrameOrientationTask):
            rotation, position = (x.copy() for x in kin.frame_placement(task.frame_id))
            if not isinstance(task, FrameOrientationTask):
                task.position = position
            if not isinstance(task, FramePositionTask):
                task.rotation = rotation


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_a_bad_cut_is_refused(value: float) -> None:
    with pytest.raises(ConfigError, match="sigma_min"):
        KinWbc(10, [], value)


def test_without_tasks_nothing_moves() -> None:
    kin = KINEMATICS["g1"]
    solver = KinWbc(kin.nv, [])
    assert solver.evaluate(kin) == []
    np.testing.assert_array_equal(solver.solve([]), np.zeros(kin.nv))
