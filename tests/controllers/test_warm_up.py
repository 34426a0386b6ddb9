"""warm_up: nothing is left to compile or to load after it, and nothing else is different."""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from controllers.reference import reference_here
from controllers.whole_body.controller import TickResult, WholeBodyController
from controllers.whole_body.robot_config import controller_config
from controllers.whole_body.warm_up import BEYOND, CONTACTS, obstacles_at, situations
from robots.description import RobotDescription
from robots.loader import load_robot
from robots.messages import Array, RobotState
from robots.pinocchio_model import standing_configuration
from safety.barriers.barrier_set import CollisionBodies, ObstacleBarrier
from safety.filters.safety_filter import FILTERS, KINDS, FilterStatus
from safety.geometry.shapes import KINDS as OBSTACLE_KINDS

ROOT = Path(__file__).resolve().parents[2]


def states_near(robot: RobotDescription, seed: int, count: int) -> list[RobotState]:
    """Around the standing posture, moving, with torques and foot forces measured."""
    rng, nj = np.random.default_rng(seed), len(robot.joints)
    out = []
    for k in range(count):
        q = standing_configuration(robot)
        q[7:] += rng.uniform(-0.4, 0.4, nj)
        out.append(RobotState(q, rng.uniform(-0.3, 0.3, 6 + nj), rng.normal(size=nj), 0.002 * k, np.full(2, 150.0)))
    return out


def numbers(result: TickResult) -> tuple[Array, ...]:
    """All that a tick says, but for how long it took."""
    command, safety, dynamic = result.command, result.safety, result.dynwbc
    said = np.array([safety.slack, safety.status, safety.worst_row, safety.active, dynamic.iterations, dynamic.relaxed])
    return command.q, command.v, command.tau, result.v_des, safety.v, dynamic.acceleration, dynamic.wrench, said


def answers(robot: RobotDescription, filter_name: str, warm: Sequence[int]) -> list[tuple[Array, ...]]:
    """Of a controller that is warmed up before the ticks ``warm``, and that estimates its load."""
    config = controller_config(robot, filter=filter_name)
    controller = WholeBodyController(robot, config, with_hands=True, obstacle_kinds=OBSTACLE_KINDS)
    states = states_near(robot, 3, 8)
    controller.reset(states[0])
    reference = reference_here(controller.kin, with_hands=True)
    out = []
    for k, state in enumerate(states):
        if k in warm:
            controller.warm_up()
        hand = reference.soles[0].position + np.array([0.3, 0.0, 0.6])
        out.append(numbers(controller.tick(state, reference, obstacles_at(hand, OBSTACLE_KINDS))))
    return out


@pytest.mark.parametrize("name", FILTERS)
def test_answers_are_the_same_bit_for_bit_whenever_it_is_called(robot: RobotDescription, name: str) -> None:
    plain = answers(robot, name, ())
    for warm in ((0,), (0, 4, 5)):
        for a, b in zip(plain, answers(robot, name, warm), strict=True):
            for x, y in zip(a, b, strict=True):
                np.testing.assert_array_equal(x, y)


def test_kinematics_keep_the_state_that_references_are_made_of(robot: RobotDescription) -> None:
    controller = WholeBodyController(robot, controller_config(robot), with_hands=True)
    state = states_near(robot, 5, 1)[0]
    controller.reset(state)
    before = [x.copy() for x in (controller.kin.q, controller.kin.v, controller.kin.com, controller.kin.mass_matrix)]
    controller.warm_up()
    after = (controller.kin.q, controller.kin.v, controller.kin.com, controller.kin.mass_matrix)
    for x, y in zip(before, after, strict=True):
        np.testing.assert_array_equal(x, y)


def test_a_clock_of_ones_own_does_not_run(robot: RobotDescription) -> None:
    def clock() -> float:
        raise AssertionError("asked for the time")

    WholeBodyController(robot, controller_config(robot), with_hands=False, clock=clock).warm_up()


@pytest.mark.parametrize("with_hands", [True, False])
@pytest.mark.parametrize("name", [n for n in FILTERS if KINDS[n].joint])
def test_the_situations_leave_no_path_of_the_filter_out(robot: RobotDescription, name: str, with_hands: bool) -> None:
    """Conditions at work that can hold, and such as cannot; where all hold, a filter of rows on velocities is idle."""
    controller = WholeBodyController(robot, controller_config(robot, filter=name), with_hands, OBSTACLE_KINDS)
    found = {
        controller.tick(state, reference, obstacles).safety.status
        for state, reference, obstacles in situations(controller.kin, with_hands, OBSTACLE_KINDS)
    }
    assert FilterStatus.RELAXED in found
    assert not {FilterStatus.FAILED, FilterStatus.UNSAFE} & found
    if name != "rssa":
        # its slack is paid for from the start, so it rarely keeps a condition exactly
        assert FilterStatus.FILTERED in found
    if name != "ecbf":
        assert FilterStatus.UNCHANGED in found


def test_the_situations_have_all_contacts_all_kinds_and_both_kinds_of_balance(robot: RobotDescription) -> None:
    controller = WholeBodyController(robot, controller_config(robot), True, OBSTACLE_KINDS)
    all_of_them = list(situations(controller.kin, True, OBSTACLE_KINDS))
    for with_dcm in (True, False):
        chosen = [r for _, r, _ in all_of_them if (r.dcm is not None) == with_dcm]
        assert {tuple(r.in_contact.tolist()) for r in chosen} == set(CONTACTS)
    assert all(tuple(o.kind for o in obstacles) == OBSTACLE_KINDS for _, _, obstacles in all_of_them)
    upper = controller.kin.position_limits[1]
    assert max((s.q[7:] - upper).min() for s, _, _ in all_of_them) == pytest.approx(BEYOND, rel=1e-12)
    assert {s.foot_forces is None for s, _, _ in all_of_them} == {True, False}


PROGRAM = """
import sys
import numpy as np
from controllers.whole_body.robot_config import controller_config
from controllers.reference import reference_here
from controllers.whole_body.warm_up import obstacles_at
from controllers.whole_body.controller import WholeBodyController
from experiments.running.warmup import kernels
from robots.loader import load_robot
from robots.messages import RobotState
from robots.pinocchio_model import standing_configuration
from safety.geometry.shapes import KINDS

robot = load_robot("g1")
controller = WholeBodyController(robot, controller_config(robot, filter=sys.argv[1]), True, KINDS)
controller.warm_up()
before = sum(len(k.overloads) for k in kernels())
q, rng = standing_configuration(robot), np.random.default_rng(0)
controller.kin.update(q, np.zeros(q.size - 1))
reference = reference_here(controller.kin, with_hands=True)
for k in range(40):
    q = standing_configuration(robot)
    q[7:] += rng.uniform(-1.0, 1.0, q.size - 7)
    reference.in_contact[:] = k % 2, k // 2 % 2
    state = RobotState(q, rng.uniform(-1.0, 1.0, q.size - 1), np.zeros(q.size - 7), 0.0)
    controller.tick(state, reference, obstacles_at(reference.hands[0].position + rng.uniform(-0.2, 0.2, 3), KINDS))
print(before, sum(len(k.overloads) for k in kernels()))
"""


@pytest.mark.parametrize("name", ["issf", "ecbf", "pssa", "rssa", "pfm", "sma"])
def test_no_kernel_is_compiled_or_loaded_after_it(name: str) -> None:
    """In a process of its own: here other tests have run the kernels already."""
    run = subprocess.run([sys.executable, "-c", PROGRAM, name], cwd=ROOT, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    before, after = map(int, run.stdout.split())
    assert after == before > 0


def test_obstacles_of_a_barrier_of_ones_own_are_warmed_up_too() -> None:
    """Given through ``extra_barriers``, where none are announced."""
    robot = load_robot("g1")
    controller = WholeBodyController(
        robot,
        controller_config(robot),
        True,
        extra_barriers=lambda kin: [ObstacleBarrier(CollisionBodies(kin), ("sphere", "box"))],
    )
    controller.warm_up()
