"""Pushes: a robot that stands is pushed to the side for 0.1 s, harder and harder until it steps or falls.

python examples/pushes.py
"""

from collections.abc import Sequence

import numpy as np

import safewbc as sw

LENGTH = 0.1
"""How long a push is [s]."""

FALLEN = 0.6
"""Height of the torso below which the robot falls, of its height when it stands."""


def after_a_push(force: float, duration: float) -> tuple[float, int]:
    """How low the torso comes, of its height when it stands, and in how many steps, after a push to the left [N]."""
    robot = sw.load_robot("g1")
    body = sw.MujocoPlant(robot)
    config = sw.controller_config(robot, **sw.walking_changes(robot))
    agent = sw.Agent(robot, config, gait=lambda kin: sw.Walking(kin, sw.walk_tuning(kin.robot)))
    agent.reset(body.state())
    torso = robot.roles["torso"]
    upright = body.frame_position(torso)[2]
    lowest = 1.0
    for _ in range(round(duration / agent.dt)):
        pushed = 0.5 <= body.time < 0.5 + LENGTH
        body.push(np.array([0.0, force if pushed else 0.0, 0.0]))
        body.send(agent.tick(body.state()).command)
        body.advance(agent.dt)
        lowest = min(lowest, body.frame_position(torso)[2] / upright)
        if lowest < FALLEN:
            break
    assert isinstance(agent.gait, sw.Walking)
    return lowest, agent.gait.steps


def main(duration: float = 4.0, forces: Sequence[float] = (50.0, 150.0, 600.0)) -> list[tuple[float, int]]:
    """Push with each of ``forces`` [N]; returns what came of each."""
    outcomes = [after_a_push(force, duration) for force in forces]
    for force, (lowest, steps) in zip(forces, outcomes, strict=True):
        fell = "falls" if lowest < FALLEN else "stays up"
        print(f"{force:.0f} N for {LENGTH} s: {fell}, torso down to {100 * lowest:.0f} % of its height, {steps} steps")
    return outcomes


if __name__ == "__main__":
    main()
