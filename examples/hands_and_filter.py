"""Hands that are asked to circle through the torso, without a filter and with the ISSf-CBF.

python examples/hands_and_filter.py
"""

import numpy as np

import safewbc as sw


def smallest_distance(name: str, duration: float) -> float:
    """Smallest self-collision barrier of the true state over a run with the filter ``name`` [mm]."""
    robot = sw.load_robot("g1")
    body = sw.MujocoPlant(robot, sw.PlantConfig(changes=sw.PhysicalChanges(mass_scale=1.2)))
    body.reset(sw.standing_configuration(robot, "hands_front"))
    config = sw.controller_config(robot, filter=name)
    agent = sw.Agent(robot, config, motions=[sw.HandCircles.for_robot], with_hands=True)

    # a model of its own: what the controller believes does not enter
    kin = sw.Kinematics(robot)
    barriers = sw.standard_barriers(kin)
    smallest = np.inf
    for _ in range(round(duration / agent.dt)):
        body.send(agent.tick(body.state()).command)
        body.advance(agent.dt)
        kin.update_geometry(body.true_state().q)
        smallest = min(smallest, barriers.evaluate(kin).h[barriers.slices["self_collision"]].min())
    return 1e3 * smallest


def main(duration: float = 4.0) -> tuple[float, float]:
    """Run both for ``duration`` [s]; returns the smallest barrier without and with the filter [mm]."""
    found = smallest_distance("none", duration), smallest_distance("issf", duration)
    for name, smallest in zip(("no filter", "ISSf-CBF"), found, strict=True):
        print(f"{name}: smallest self-collision barrier {smallest:.1f} mm")
    return found


if __name__ == "__main__":
    main()
