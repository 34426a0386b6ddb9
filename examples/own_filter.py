"""A filter of one's own: a CBF that comes near no faster than it could brake, with a parameter of its own.

python examples/own_filter.py
"""

from dataclasses import dataclass

import numpy as np

import safewbc as sw
from safety.barriers.rows import BarrierRows, HalfSpaces
from safety.filters.conditions import RowParameters
from safety.filters.filter_kind import FilterKind
from safety.filters.registry import register
from safety.filters.resolutions import NEAREST


@dataclass(frozen=True)
class Braking:
    """What the filter has beside alpha: the deceleration that it counts on [m/s^2, rad/s^2]."""

    deceleration: float = 0.5


def braking_cbf(rows: BarrierRows, parameters: RowParameters) -> HalfSpaces:
    """Half-spaces of dh/dt >= -min(alpha h, sqrt(2 a h)): the second is the speed from which a brakes within h."""
    brakes = np.sqrt(2.0 * parameters.own["deceleration"] * np.maximum(rows.h, 0.0))
    fastest = np.where(rows.h > 0.0, np.minimum(parameters.alpha * rows.h, brakes), parameters.alpha * rows.h)
    return HalfSpaces(rows.jac, -fastest - rows.dh_dt, np.ones(rows.h.size, dtype=bool))


BRAKING = FilterKind("braking", "braking CBF", braking_cbf, NEAREST, "this script", parameters=Braking())


def main(duration: float = 4.0) -> float:
    """Hands that circle through the torso; returns the smallest self-collision barrier [mm]."""
    register(BRAKING)
    robot = sw.load_robot("g1")
    body = sw.MujocoPlant(robot)
    body.reset(sw.standing_configuration(robot, "hands_front"))
    config = sw.controller_config(robot, filter="braking")
    agent = sw.Agent(robot, config, motions=[sw.HandCircles.for_robot], with_hands=True)
    kin = sw.Kinematics(robot)
    barriers = sw.standard_barriers(kin)
    smallest = np.inf
    for _ in range(round(duration / agent.dt)):
        body.send(agent.tick(body.state()).command)
        body.advance(agent.dt)
        kin.update_geometry(body.true_state().q)
        smallest = min(smallest, barriers.evaluate(kin).h[barriers.slices["self_collision"]].min())
    print(f"{BRAKING.title}: smallest self-collision barrier {1e3 * smallest:.1f} mm")
    return 1e3 * smallest


if __name__ == "__main__":
    main()
