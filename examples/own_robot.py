"""A robot of one's own: a URDF, and a short description of what a URDF does not say, beside it.

python examples/own_robot.py
"""

from pathlib import Path

import safewbc as sw

DESCRIPTION = Path(__file__).parent / "my_robot" / "my_robot.toml"


def main(duration: float = 2.0) -> float:
    """Let the robot stand for ``duration`` [s]; returns the height of its trunk [m]."""
    robot = sw.load_robot(DESCRIPTION)
    print(f"{robot.title}: {len(robot.joints)} joints, {robot.total_mass:.1f} kg")
    body = sw.MujocoPlant(robot)
    agent = sw.Agent(robot)
    for _ in range(round(duration / agent.dt)):
        body.send(agent.tick(body.state()).command)
        body.advance(agent.dt)
    height = float(body.frame_position(robot.roles["torso"])[2])
    print(f"after {duration:g} s the trunk is {height:.3f} m above the ground, stop: {agent.stop_cause}")
    return height


if __name__ == "__main__":
    main()
