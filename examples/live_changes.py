"""What may change between ticks: targets of the hands, obstacles that appear and go, and a stop that keeps balance.

python examples/live_changes.py
"""

import numpy as np

import safewbc as sw


def main(duration: float = 6.0) -> tuple[float, float]:
    """Returns how far the left hand is from its target while a wall is there, and after it has gone [mm]."""
    robot = sw.load_robot("g1")
    body = sw.MujocoPlant(robot)
    body.reset(sw.standing_configuration(robot, "hands_front"))
    agent = sw.Agent(robot, motions=[sw.HandTargets], with_hands=True, obstacle_slots=("half_space",))
    agent.reset(body.state())
    hands = next(motion for motion in agent.motions if isinstance(motion, sw.HandTargets))
    name = robot.roles["left_hand"]
    start = body.frame_position(name)
    target = start + np.array([0.08, 0.0, 0.05])
    wall = sw.Obstacle.half_space(start + np.array([0.12, 0.0, 0.0]), np.array([-1.0, 0.0, 0.0]))

    distances = []
    hands.set("left", target)
    for part in ("wall", "no wall"):
        if part == "no wall":
            agent.forget("wall")
        for _ in range(round(0.5 * duration / agent.dt)):
            detections = [sw.Detection("wall", body.time, wall)] if part == "wall" else []
            body.send(agent.tick(body.state(), detections).command)
            body.advance(agent.dt)
        distances.append(1e3 * float(np.linalg.norm(body.frame_position(name) - target)))
        print(f"{part}: the left hand is {distances[-1]:.1f} mm from its target")
    agent.hold("the show is over")
    body.send(agent.tick(body.state()).command)
    print(f"stopped because {agent.stop_cause}")
    return distances[0], distances[1]


if __name__ == "__main__":
    main()
