"""The motion that a run's references ask for: KinWBC alone, without filter and without dynamics."""

import numpy as np

from controllers.whole_body.controller import WholeBodyController
from experiments.scenarios.scenario import Cast
from robots.messages import Array, RobotState
from safety.barriers.barrier_set import standard_barriers


def reference_motion(controller: WholeBodyController, cast: Cast, q: Array, duration: float) -> dict[str, Array]:
    """Smallest self-collision barrier of the reference motion: KinWBC alone, integrated exactly, no filter.

    This is the motion in which the paper's remaining collision ratio counts "the collisions in the reference hand
    trajectory". A gait sees it as what is measured, and no forces under the feet.

    Args:
        controller: its KinWBC is used.
        cast: references at the start, and what moves them; used up.
        q: shape (nq,) where the motion starts.
        duration: of the motion [s].

    Returns:
        ``h_self_reference``: shape (T,), one per control tick [m].
    """
    kin, dt = controller.kin, controller.config.dt
    distances = standard_barriers(kin, distances_only=True)
    cut = slice(distances.slices["self_collision"].start, distances.slices["leg_collision"].stop)
    out = np.zeros(round(duration / dt))
    rest, v, torque = np.zeros(kin.nv), np.zeros(kin.nv), np.zeros(kin.nv - 6)
    for i in range(out.size):
        if cast.gait is not None:
            kin.update(q, v)
            cast.gait.apply(cast.reference, i * dt, RobotState(q, v, torque, i * dt), kin)
        for motion in cast.motions:
            motion.apply(cast.reference, i * dt)
        kin.update(q, rest)
        out[i] = distances.evaluate(kin).h[cut].min(initial=np.inf)
        v = controller.desired_velocity(cast.reference)
        q = kin.integrate(q, v, dt)
    return {"h_self_reference": out}
