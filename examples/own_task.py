"""A task of one's own: the height of the left hand, below balance and torso and above the posture.

python examples/own_task.py
"""

from collections.abc import Sequence

import numpy as np

import safewbc as sw
from robots.messages import Array


class HandHeight(sw.Task):
    """One row: the height of the left hand goes to a target; where it is across is left free."""

    rows = 1

    def __init__(self, kin: sw.Kinematics, height: float) -> None:
        super().__init__(sw.TaskGains(k=3.0, max_correction=0.3), name="left hand height")
        self.frame = kin.frame_id(kin.robot.roles["left_hand"])
        self.height = height

    def evaluate(self, kin: sw.Kinematics) -> tuple[Array, Array]:
        """See :meth:`wbc.tasks.task.Task.evaluate`."""
        error = self.height - kin.frame_placement(self.frame)[1][2]
        return kin.frame_jacobian(self.frame)[2:3], self.gains.correction(np.array([error]))


def main(duration: float = 3.0, height: float = 1.0) -> float:
    """Raise the hand to ``height`` [m]; returns how far off it is in the end [mm]."""
    robot = sw.load_robot("g1")
    body = sw.MujocoPlant(robot)

    def tasks(kin: sw.Kinematics) -> Sequence[sw.PlacedTask]:
        return [sw.PlacedTask(HandHeight(kin, height), role="hands", priority=50)]

    agent = sw.Agent(robot, extra_tasks=tasks)
    for _ in range(round(duration / agent.dt)):
        body.send(agent.tick(body.state()).command)
        body.advance(agent.dt)
    reached = body.frame_position(robot.roles["left_hand"])[2]
    print(f"the left hand is {reached:.3f} m high, asked for were {height:g} m, stop: {agent.stop_cause}")
    return 1e3 * float(abs(reached - height))


if __name__ == "__main__":
    main()
