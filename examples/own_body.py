"""A driver of one's own: whatever has state, send and advance can be driven, here one with an encoder's resolution.

python examples/own_body.py
"""

from dataclasses import replace

import numpy as np

import safewbc as sw
from robots.messages import Array

STEP = 2 * np.pi / 2**14
"""Resolution of the joints' encoders: 14 bits a turn [rad]."""


class Driver:
    """What a robot's driver would be: joints read in steps, commands as numbers that go over a bus."""

    def __init__(self, plant: sw.MujocoPlant) -> None:
        self.plant = plant
        self.sent: dict[str, Array] = {}

    def state(self) -> sw.RobotState:
        """See :meth:`robots.ports.Body.state`."""
        state = self.plant.state()
        joints = STEP * np.round(state.q[7:] / STEP)
        return replace(state, q=np.concatenate([state.q[:7], joints]))

    def send(self, command: sw.MotorCommand) -> None:
        """See :meth:`robots.ports.Body.send`."""
        self.sent = {"q": command.q, "dq": command.v, "tau": command.tau, "kp": command.kp, "kd": command.kd}
        self.plant.send(command)

    def advance(self, dt: float) -> None:
        """See :meth:`robots.ports.Body.advance`: a real driver would wait for its bus here."""
        self.plant.advance(dt)


def main(duration: float = 2.0) -> float:
    """Stand for ``duration`` [s]; returns how far the CoM is from where it is asked to be [mm]."""
    robot = sw.load_robot("tocabi")
    driver = Driver(sw.MujocoPlant(robot))
    body: sw.Body[sw.MotorCommand] = driver
    agent = sw.Agent(robot)
    for _ in range(round(duration / agent.dt)):
        out = agent.tick(body.state())
        body.send(out.command)
        body.advance(agent.dt)
    error = 1e3 * float(np.linalg.norm(driver.plant.center_of_mass() - out.reference.com.position))
    torque = np.abs(driver.sent["tau"]).max()
    print(f"{robot.title}: CoM {error:.1f} mm from its reference, largest torque of the last command {torque:.0f} N m")
    return error


if __name__ == "__main__":
    main()
