"""Standing: a robot that is 20 % heavier than its model keeps its balance.

python examples/stand.py
"""

import numpy as np

import safewbc as sw


def main(duration: float = 3.0) -> float:
    """Stand for ``duration`` [s]; returns how far the centre of mass is from where it is asked to be [mm]."""
    robot = sw.load_robot("g1")
    body = sw.MujocoPlant(robot, sw.PlantConfig(changes=sw.PhysicalChanges(mass_scale=1.2)))
    agent = sw.Agent(robot)
    for _ in range(round(duration / agent.dt)):
        out = agent.tick(body.state())
        body.send(out.command)
        body.advance(agent.dt)
    error = 1e3 * float(np.linalg.norm(body.center_of_mass() - out.reference.com.position))
    print(f"{robot.title}: after {duration:g} s the CoM is {error:.1f} mm from its reference, stop: {agent.stop_cause}")
    return error


if __name__ == "__main__":
    main()
