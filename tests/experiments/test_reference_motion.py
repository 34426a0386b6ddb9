"""The motion that references ask for: what moves them sees it, and nothing else decides."""

import numpy as np
import pytest

from controllers.agent import Agent
from controllers.reference import WholeBodyReference
from experiments.running.reference_motion import reference_motion
from robots.description import RobotDescription
from robots.kinematics import Kinematics
from robots.messages import Array, RobotState
from robots.pinocchio_model import standing_configuration

DURATION, SPEED = 0.3, 0.1


class Closing:
    """Draws the soles together at ``SPEED`` each; keeps what it is shown."""

    def __init__(self) -> None:
        self.seen: list[tuple[float, Array, Array]] = []

    def apply(self, reference: WholeBodyReference, t: float, state: RobotState, kin: Kinematics) -> None:
        assert state.foot_forces is None
        self.seen.append((t, state.q.copy(), state.v.copy()))
        for point, side in zip(reference.soles, (1.0, -1.0), strict=True):
            step = SPEED * (t - (self.seen[-2][0] if len(self.seen) > 1 else 0.0))
            point.position = point.position - np.array([0.0, side * step, 0.0])
            point.velocity = np.array([0.0, -side * SPEED, 0.0])

    def stop(self) -> None:
        raise AssertionError("a reference motion is never stopped")


def motion_of(robot: RobotDescription, gait: Closing | None) -> tuple[Agent, Array]:
    agent, q = (
        Agent(robot, gait=None if gait is None else lambda kin: gait, settle_time=0.0),
        standing_configuration(robot),
    )
    zero = np.zeros(len(robot.joints))
    agent.reset(RobotState(q, np.zeros(q.size - 1), zero, 0.0))
    return agent, reference_motion(agent, q, DURATION)["h_self_reference"]


def test_a_gait_moves_the_reference_and_is_shown_where_it_has_gone(robot: RobotDescription) -> None:
    """Feet drawn together come as much closer as they were told; the states shown are those of one motion."""
    gait = Closing()
    agent, h = motion_of(robot, gait)
    dt, kin = agent.dt, agent.controller.kin
    np.testing.assert_allclose([t for t, _, _ in gait.seen], dt * np.arange(round(DURATION / dt)), rtol=0, atol=1e-12)
    apart, barriers = [], agent.controller.barriers
    pairs = slice(barriers.slices["self_collision"].start, barriers.slices["leg_collision"].stop)
    for (_, q, _), (_, after, v) in zip(gait.seen, gait.seen[1:], strict=False):
        np.testing.assert_allclose(kin.integrate(q, v, dt), after, rtol=0, atol=1e-12)
    for i in (0, -1):
        kin.update(gait.seen[i][1], np.zeros(kin.nv))
        assert h[i] == pytest.approx(barriers.evaluate(kin).h[pairs].min(), abs=1e-12)
        left, right = (kin.frame_placement(kin.frame_id(s.frame))[1] for s in robot.soles)
        apart.append(float(np.linalg.norm(left - right)))
    assert apart[0] - apart[1] == pytest.approx(2 * SPEED * DURATION, rel=0.02)


def test_without_anything_that_moves_the_distance_stays(robot: RobotDescription) -> None:
    agent, h = motion_of(robot, None)
    assert h.shape == (round(DURATION / agent.dt),)
    np.testing.assert_allclose(h, h[0], rtol=0, atol=1e-3)
