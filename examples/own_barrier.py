"""A barrier of one's own: the left hand stays behind a wall that only this script knows.

python examples/own_barrier.py
"""

import numpy as np

import safewbc as sw
from robots.messages import Array

WALL = 0.33
"""Where the wall is, ahead of the robot's start [m]."""


class Wall(sw.Barrier):
    """h = x_wall - x_hand: one row, and its gradient is a row of the hand's Jacobian."""

    family = "custom"  # its alpha, epsilon and margin are those of [tuning.safety.custom]
    size = 1

    def __init__(self, kin: sw.Kinematics) -> None:
        self.hand = kin.frame_id(kin.robot.roles["left_hand"])

    def write(self, kin: sw.Kinematics, h: Array, jac: Array, dh_dt: Array) -> None:
        """See :meth:`safety.barriers.barrier.Barrier.write`."""
        h[0] = WALL - kin.frame_placement(self.hand)[1][0]
        jac[0] = -kin.frame_jacobian(self.hand)[0]
        dh_dt[0] = 0.0

    def labels(self) -> tuple[str, ...]:
        """See :meth:`safety.barriers.barrier.Barrier.labels`."""
        return ("left hand - wall",)


def main(duration: float = 2.5) -> float:
    """Send the hand 10 cm into the wall; returns its smallest distance from the wall [mm]."""
    robot = sw.load_robot("g1")
    body = sw.MujocoPlant(robot)
    body.reset(sw.standing_configuration(robot, "hands_front"))
    config = sw.controller_config(robot, filter="cbf")
    agent = sw.Agent(robot, config, motions=[sw.HandTargets], with_hands=True, extra_barriers=lambda kin: [Wall(kin)])
    agent.reset(body.state())
    hand = robot.roles["left_hand"]
    target = np.array([WALL + 0.1, *body.frame_position(hand)[1:]])
    for motion in agent.motions:
        if isinstance(motion, sw.HandTargets):
            motion.set("left", target)
    smallest = np.inf
    for _ in range(round(duration / agent.dt)):
        body.send(agent.tick(body.state()).command)
        body.advance(agent.dt)
        smallest = min(smallest, WALL - body.frame_position(hand)[0])
    print(f"asked 100 mm beyond the wall, the hand came to within {1e3 * smallest:.1f} mm of it")
    return 1e3 * smallest


if __name__ == "__main__":
    main()
