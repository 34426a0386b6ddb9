"""Hands sent where arms go straight: the commanded velocity does not jump, with and without a filter."""

import numpy as np
import pytest

from controllers.reference import reference_here
from controllers.supervisor import Supervisor
from controllers.whole_body.config import TaskTuning
from controllers.whole_body.controller import WholeBodyController
from controllers.whole_body.robot_config import controller_config, from_table
from robots.description import RobotDescription
from robots.messages import Array
from robots.pinocchio_model import standing_configuration
from sims.plant import MujocoPlant, PlantConfig

LARGEST_STEP = 0.3
"""Of a joint's commanded velocity from one tick of 2 ms to the next [rad/s]."""

WAYS = {"up": np.array([0.0, 0.0, 1.0]), "out": np.array([0.0, 1.0, 0.0]), "ahead": np.array([1.0, 0.0, 0.0])}
"""What is added to the left hand's target, the right hand's mirrors it [m]."""


def commanded(robot: RobotDescription, way: str, name: str, ramp: float, singular: str = "damped") -> Array:
    """Filtered joint velocities (ticks, nj) of 3.5 s; the targets go their way in ``ramp`` [s] from 0.3 s on."""
    tasks = from_table(TaskTuning, robot, "tasks")
    config = controller_config(robot, filter=name, tasks=TaskTuning(**{**fields_of(tasks), "singular": singular}))
    plant = MujocoPlant(robot, PlantConfig(), np.random.default_rng(0))
    plant.reset(standing_configuration(robot, "hands_front"))
    controller = WholeBodyController(robot, config, with_hands=True)
    controller.reset(plant.measured_state())
    supervisor, reference = Supervisor(controller), reference_here(controller.kin, with_hands=True)
    assert reference.hands is not None
    start, out = [hand.position.copy() for hand in reference.hands], []
    for i in range(round(3.5 / config.dt)):
        fraction = min(1.0, max(0.0, (i * config.dt - 0.3) / ramp)) if ramp > 0 else float(i * config.dt > 0.3)
        for hand, place, side in zip(reference.hands, start, (1.0, -1.0), strict=True):
            hand.position = place + fraction * WAYS[way] * np.array([1.0, side, 1.0])
        command, result = supervisor.tick(plant.measured_state(), reference)
        assert result is not None
        out.append(result.safety.v[6:])
        plant.send(command)
        for _ in range(round(config.dt / plant.config.dt)):
            plant.step()
    return np.array(out)


def fields_of(tasks: TaskTuning) -> dict[str, float | str]:
    return {name: getattr(tasks, name) for name in TaskTuning.__slots__}


@pytest.mark.parametrize(
    ("way", "name", "ramp"),
    [("up", "none", 1.0), ("out", "none", 0.0), ("ahead", "none", 1.0), ("up", "issf", 0.0), ("out", "issf", 1.0)],
)
def test_a_hand_out_of_reach_comes_to_rest_without_a_jump(
    robot: RobotDescription, way: str, name: str, ramp: float
) -> None:
    """Whether the target moves or jumps there; the arm is at rest in the end, and no cycle is left."""
    velocity = commanded(robot, way, name, ramp)
    steps = np.abs(np.diff(velocity, axis=0)).max(axis=1)
    assert steps.max() <= LARGEST_STEP
    assert steps[-100:].max() <= 0.02


def test_with_the_cut_of_the_paper_it_jumps(robot: RobotDescription) -> None:
    """What the damping is for: eq. (13) with singular values cut off, by rad/s, in many ticks."""
    steps = np.abs(np.diff(commanded(robot, "up", "none", 1.0, "cut"), axis=0)).max(axis=1)
    assert (steps > 10 * LARGEST_STEP).sum() >= 10
