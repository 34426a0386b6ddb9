"""Walking by commands that may change at any time, as a joystick would change them.

python examples/walk_by_commands.py
"""

import numpy as np

import safewbc as sw

COMMANDS = (
    (0.0, sw.VelocityCommand(vx=0.25)),
    (4.0, sw.VelocityCommand(vx=0.15, wz=0.3)),
    (8.0, sw.VelocityCommand()),
)
"""From when on [s], what is asked for."""


def main(duration: float = 11.0) -> tuple[float, int]:
    """Walk for ``duration`` [s]; returns how far the robot came [m], and in how many steps."""
    robot = sw.load_robot("g1")
    body = sw.MujocoPlant(robot)
    config = sw.controller_config(robot, **sw.walking_changes(robot))
    agent = sw.Agent(robot, config, gait=lambda kin: sw.Walking(kin, sw.walk_tuning(kin.robot)))
    agent.reset(body.state())
    walking = agent.gait
    assert isinstance(walking, sw.Walking)
    start = body.center_of_mass()
    for _ in range(round(duration / agent.dt)):
        walking.command = next(command for since, command in reversed(COMMANDS) if body.time >= since)
        body.send(agent.tick(body.state()).command)
        body.advance(agent.dt)
    way = float(np.linalg.norm((body.center_of_mass() - start)[:2]))
    print(f"{way:.2f} m in {walking.steps} steps, stop: {agent.stop_cause}")
    return way, walking.steps


if __name__ == "__main__":
    main()
