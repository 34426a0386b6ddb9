"""What walking asks of the whole body: DCM, CoM, heading."""

import math
from dataclasses import replace

import numpy as np
import pytest

from controllers.gaits.commands import VelocityCommand
from controllers.gaits.foot_state import Feet
from controllers.gaits.walking import Walking, walk_tuning
from controllers.reference import reference_here
from controllers.whole_body.controller import WholeBodyController
from controllers.whole_body.robot_config import controller_config
from robots.description import RobotDescription
from robots.messages import Array
from tests.support.ideal_walk import DT, IdealWalk
from tests.support.states import at_rest, kinematics_of

AHEAD = VelocityCommand(vx=0.2)


@pytest.fixture
def walk() -> IdealWalk:
    return IdealWalk()


def test_the_measured_dcm_is_that_of_a_pendulum_as_high_as_the_com(robot: RobotDescription) -> None:
    state = at_rest(robot)
    kin = kinematics_of(robot, state)
    feet = Feet(kin)
    soles = [kin.frame_placement(kin.frame_id(robot.roles[r]))[1] for r in ("left_sole", "right_sole")]
    height = kin.com[2] - 0.5 * (soles[0][2] + soles[1][2])
    assert feet.omega**2 * height == pytest.approx(9.81)
    assert feet.width == pytest.approx(abs(soles[0][1] - soles[1][1]))
    np.testing.assert_allclose(feet.middle, 0.5 * (soles[0] + soles[1])[:2], rtol=0, atol=1e-12)
    np.testing.assert_allclose(feet.dcm, kin.com[:2], rtol=0, atol=1e-12)
    moving = replace(state, v=np.random.default_rng(4).normal(size=state.v.size))
    kin.update(moving.q, moving.v)
    feet.update(kin)
    expected = kin.com[:2] + kin.com_velocity[:2] / feet.omega
    np.testing.assert_allclose(feet.dcm, expected, rtol=0, atol=1e-12)


def test_the_com_accelerates_as_the_pendulum_does(robot: RobotDescription) -> None:
    """Horizontal acceleration of eq. (15), bias included: omega^2 (c - p), p the DCM feedback's ZMP in the soles."""
    rng = np.random.default_rng(3)
    config = controller_config(robot, filter="none", compensate_bias=True)
    controller = WholeBodyController(robot, config, with_hands=False)
    state = at_rest(robot)
    controller.reset(state)
    controller.kin.update(state.q, state.v)
    walking = Walking(controller.kin, walk_tuning(robot))
    reference = reference_here(controller.kin, with_hands=False)
    walking.apply(reference, 0.0, state, controller.kin)
    dcm = reference.dcm
    assert dcm is not None
    for size, clipped in ((0.01, False), (2.0, True)):
        velocity = size * rng.normal(size=state.v.size)
        moving = replace(state, v=velocity)
        result = controller.tick(moving, reference)
        kin = controller.kin
        xi = kin.com[:2] + kin.com_velocity[:2] / dcm.omega
        zmp = xi - dcm.velocity / dcm.omega + config.balance.dcm_gain / dcm.omega * (xi - dcm.position)
        acceleration = controller.dynwbc.acceleration_reference(result.safety.v, velocity, config.dt)
        actual = (kin.com_jacobian @ acceleration + kin.com_bias_acceleration)[:2]
        if not clipped:
            np.testing.assert_allclose(actual, dcm.omega**2 * (kin.com[:2] - zmp), rtol=0, atol=1e-6)
        used = kin.com[:2] - actual / dcm.omega**2
        centres = np.array([p.position[:2] for p in reference.soles])
        room = np.array([s.half_length for s in robot.soles]) + 1e-6
        assert (np.abs(used[0] - centres[:, 0]) <= room).all()
        assert centres[:, 1].min() - room[0] <= used[1] <= centres[:, 1].max() + room[0]


def test_the_reference_com_is_that_of_the_planned_dcm(walk: IdealWalk) -> None:
    """The CoM follows the plan's DCM by its own law, and keeps its height over the feet."""
    walk.walking.command = AHEAD
    places, dcms = [], []
    for _ in range(round(3.0 / DT)):
        walk.tick()
        places.append(walk.reference.com.position.copy())
        dcms.append(walk.ticks[-1].dcm)
    com, dcm = np.array(places), np.array(dcms)
    omega = walk.reference.dcm.omega if walk.reference.dcm else 0.0
    rate = (com[2:, :2] - com[:-2, :2]) / (2 * DT)
    np.testing.assert_allclose(rate, omega * (dcm - com[:, :2])[1:-1], rtol=0, atol=5e-3)
    heights = com[:, 2]
    np.testing.assert_allclose(heights, heights[0], rtol=0, atol=1e-9)


def test_body_and_feet_turn_together(walk: IdealWalk) -> None:
    walk.walking.command = VelocityCommand(wz=0.3, stepping=True)
    before, angles, rates = walk.reference.base_rotation.copy(), [], []
    for _ in range(round(4.0 / DT)):
        walk.tick()
        turned = walk.reference.base_rotation @ before.T
        angles.append(math.atan2(turned[1, 0], turned[0, 0]))
        assert turned[2, 2] == pytest.approx(1.0, abs=1e-9)
        assert walk.reference.torso_rotation[2, 2] > 0.99
        assert angles[-1] == pytest.approx(0.5 * walk.body.soles[:, 3].sum(), abs=1e-9)
        rates.append(walk.reference.turn_rate)
    assert angles[-1] > 0.3
    # the rate is the angle's: between touchdowns both are smooth
    slope = np.gradient(np.array(angles), DT)
    assert np.median(np.abs(slope - rates)) < 1e-3
    assert np.percentile(np.abs(slope - rates), 98) < 1e-2


def kept_arrays(walk: IdealWalk) -> list[Array]:
    """Every array that the reference of the last tick holds, not copied."""
    r = walk.reference
    assert r.dcm is not None
    points = [a for p in (*r.soles, r.com) for a in (p.position, p.velocity, p.acceleration)]
    axes = [*r.sole_rotations, r.base_rotation, r.torso_rotation]
    return [*points, *axes, r.sole_turns, r.load_limits, r.in_contact, r.dcm.position, r.dcm.velocity]


def test_references_of_a_tick_may_be_kept(walk: IdealWalk) -> None:
    """No later tick changes an array that was handed out, whatever ticks share; through all phases and a push."""
    walk.walking.command = VelocityCommand(vx=0.2, wz=0.2)
    kept, copies = [], []
    for i in range(round(4.0 / DT)):
        walk.body.error = np.array([0.05, 0.0]) if 1000 < i < 1020 else np.zeros(2)
        walk.tick()
        kept.append(kept_arrays(walk))
        copies.append([a.copy() for a in kept[-1]])
    assert walk.walking.steps >= 3
    for arrays, before in zip(kept, copies, strict=True):
        for a, b in zip(arrays, before, strict=True):
            np.testing.assert_array_equal(a, b)
