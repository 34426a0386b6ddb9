"""A sphere that flies past the left hand, seen 60 times a second with 5 mm of noise, and kept away from.

python examples/moving_obstacle.py
"""

import numpy as np

import safewbc as sw

RADIUS = 0.06  # of the sphere [m]


def main(duration: float = 4.0) -> tuple[float, float]:
    """Returns the true smallest barrier of the sphere [mm], and the error of its estimated velocity [mm/s]."""
    robot = sw.load_robot("g1")
    body = sw.MujocoPlant(robot)
    body.reset(sw.standing_configuration(robot, "hands_front"))
    agent = sw.Agent(robot, motions=[sw.HandTargets], with_hands=True, obstacle_slots=("sphere",))
    hand = body.frame_position(robot.roles["left_hand"])
    sphere = sw.StraightMotion(hand + np.array([0.8, 0.02, 0.0]), np.array([-0.25, 0.0, 0.0]))
    sensor = sw.PositionSensor(60.0, 0.005, np.random.default_rng(0))

    # the true barrier, by a model of its own
    kin = sw.Kinematics(robot)
    barriers = sw.standard_barriers(kin, obstacle_kinds=("sphere",))
    truth = next(b for b in barriers.barriers if isinstance(b, sw.ObstacleBarrier))
    smallest = np.inf
    for _ in range(round(duration / agent.dt)):
        t, centre = body.time, sphere.position(body.time)
        seen = sensor.measure(centre, t)
        detections = [] if seen is None else [sw.Detection("ball", t, sw.Obstacle.sphere(seen, RADIUS))]
        out = agent.tick(body.state(), detections)
        body.send(out.command)
        body.advance(agent.dt)
        kin.update_geometry(body.true_state().q)
        truth.set_obstacles([sw.Obstacle.sphere(sphere.position(body.time), RADIUS)])
        smallest = min(smallest, barriers.evaluate(kin).h[barriers.slices["obstacle"]].min())
    error = 1e3 * float(np.linalg.norm(out.obstacles[0].velocity - sphere.rate))
    print(f"smallest barrier {1e3 * smallest:.1f} mm, velocity known to {error:.0f} mm/s, stop: {agent.stop_cause}")
    return 1e3 * smallest, error


if __name__ == "__main__":
    main()
