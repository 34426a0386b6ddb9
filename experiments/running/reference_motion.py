"""The motion that a run's references ask for: KinWBC alone, without filter and without dynamics."""

import numpy as np

from controllers.agent import Agent
from robots.messages import Array, RobotState
from safety.barriers.barrier_set import standard_barriers


def reference_motion(agent: Agent, q: Array, duration: float) -> dict[str, Array]:
    """Smallest self-collision barrier of the reference motion: KinWBC alone, integrated exactly, no filter.

    This is the motion in which the paper's remaining collision ratio counts "the collisions in the reference hand
    trajectory". A gait sees it as what is measured, and no forces under the feet.

    Args:
        agent: its references and KinWBC are used; it was reset at ``q`` and is of no use afterwards.
        q: shape (nq,) where the motion starts.
        duration: of the motion [s].

    Returns:
        ``h_self_reference``: shape (T,), one per control tick [m].
    """
    controller, kin, dt = agent.controller, agent.controller.kin, agent.dt
    distances = standard_barriers(kin, distances_only=True)
    cut = slice(distances.slices["self_collision"].start, distances.slices["leg_collision"].stop)
    out = np.zeros(round(duration / dt))
    rest, v, torque = np.zeros(kin.nv), np.zeros(kin.nv), np.zeros(kin.nv - 6)
    for i in range(out.size):
        reference = agent.references_at(RobotState(q, v, torque, i * dt))
        kin.update(q, rest)
        out[i] = distances.evaluate(kin).h[cut].min(initial=np.inf)
        v = controller.desired_velocity(reference)
        q = kin.integrate(q, v, dt)
    return {"h_self_reference": out}
