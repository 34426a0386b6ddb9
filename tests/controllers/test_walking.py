"""Walking by itself: feet that go where they are told, a DCM that does as planned, forces and pushes as scripted."""

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import pytest

import controllers.gaits.walking
from controllers.gaits.foot_state import Feet
from controllers.gaits.footsteps import LEFT, RIGHT, Foothold, VelocityCommand
from controllers.gaits.walking import Support, Walking
from controllers.gaits.walking_config import WalkTuning, walk_tuning
from controllers.reference import WholeBodyReference, reference_here
from controllers.whole_body.controller import WholeBodyController
from controllers.whole_body.robot_config import controller_config
from robots.description import RobotDescription
from robots.kinematics import Kinematics
from robots.loader import load_robot
from robots.messages import Array, RobotState
from robots.pinocchio_model import standing_configuration

DT = 0.002
ROBOT = load_robot("g1")
AHEAD = VelocityCommand(vx=0.2)
FAST = VelocityCommand(vx=0.41)
"""Fast enough for a step to take longer."""
STOP = VelocityCommand()


def at_rest(robot: RobotDescription = ROBOT) -> RobotState:
    nj = len(robot.joints)
    return RobotState(standing_configuration(robot), np.zeros(6 + nj), np.zeros(nj), 0.0)


@dataclass
class World:
    """What the ideal robot does: soles follow their references down to the ground, the DCM follows the plan's.

    Attributes:
        soles: shape (2, 4) x, y, height, yaw.
        dcm: shape (2,).
        error: shape (2,) of the DCM against the plan's.
        ground: height of the ground under each foot.
        measured: whether forces are.
    """

    soles: Array
    dcm: Array
    error: Array = field(default_factory=lambda: np.zeros(2))
    ground: Array = field(default_factory=lambda: np.zeros(2))
    measured: bool = True

    def follow(self, reference: WholeBodyReference) -> None:
        for foot in (LEFT, RIGHT):
            rotation = reference.sole_rotations[foot]
            self.soles[foot] = [*reference.soles[foot].position, math.atan2(rotation[1, 0], rotation[0, 0])]
        self.soles[:, 2] = np.maximum(self.soles[:, 2], self.ground)
        assert reference.dcm is not None
        self.dcm = reference.dcm.position + self.error

    def forces(self) -> Array | None:
        return np.where(self.soles[:, 2] <= self.ground + 1e-9, 200.0, 0.0) if self.measured else None


@dataclass
class Tick:
    t: float
    support: Support
    contact: Array
    soles: Array
    rates: Array
    accelerations: Array
    dcm: Array
    zmp: Array
    limits: Array
    steps: int


class Bench:
    """A walk of the ideal robot, with what happened in each tick."""

    def __init__(
        self, monkeypatch: pytest.MonkeyPatch, tuning: WalkTuning | None = None, planner: object | None = None
    ) -> None:
        bench, state = self, at_rest()

        class IdealFeet(Feet):
            def update(self, state: RobotState) -> None:
                self.dcm = bench.world.dcm.copy()

            def _sole(self, foot: int) -> tuple[Array, Array]:
                x, y, z, yaw = bench.world.soles[foot]
                c, s = math.cos(yaw), math.sin(yaw)
                return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), np.array([x, y, z])

        kin = Kinematics(ROBOT)
        kin.update(state.q, state.v)
        places = [kin.frame_placement(kin.frame_id(ROBOT.roles[r]))[1] for r in ("left_sole", "right_sole")]
        soles = np.array([[*p, 0.0] for p in places])
        self.world = World(soles, soles[:, :2].mean(axis=0), ground=soles[:, 2].copy())
        self.reference = reference_here(kin, with_hands=False)
        monkeypatch.setattr(controllers.gaits.walking, "Feet", IdealFeet)
        self.tuning = tuning or walk_tuning(ROBOT)
        self.walking = Walking(ROBOT, self.tuning, state, planner)
        self.state, self.t, self.ticks = state, 0.0, list[Tick]()

    def tick(self) -> Tick:
        state = replace(self.state, foot_forces=self.world.forces())
        self.walking.apply(self.reference, self.t, state)
        reference, dcm = self.reference, self.reference.dcm
        assert dcm is not None
        self.ticks.append(
            Tick(
                self.t,
                self.walking.support,
                reference.in_contact.copy(),
                np.array([p.position for p in reference.soles]),
                np.array([p.velocity for p in reference.soles]),
                np.array([p.acceleration for p in reference.soles]),
                dcm.position,
                dcm.zmp,
                reference.load_limits.copy(),
                self.walking.steps,
            )
        )
        self.world.follow(reference)
        self.t = round(self.t + DT, 9)
        return self.ticks[-1]

    def run(self, seconds: float) -> "Bench":
        for _ in range(round(seconds / DT)):
            self.tick()
        return self

    def until(self, condition: Callable[[Tick], bool], limit: float = 6.0) -> Tick:
        end = self.t + limit
        while self.t < end:
            if condition(tick := self.tick()):
                return tick
        raise AssertionError("it did not happen")

    def until_single(self) -> Tick:
        return self.until(lambda tick: tick.support is Support.SINGLE)

    def series(self, name: str) -> Array:
        return np.array([getattr(tick, name) for tick in self.ticks])

    def foothold(self, foot: int) -> Foothold:
        x, y, _, yaw = self.world.soles[foot]
        return Foothold(float(x), float(y), float(yaw))

    def inwards(self, size: float) -> Array:
        """An error (2,) of the DCM by ``size`` [m] from the foot that has just landed towards the other one."""
        landed = self.foothold(int(np.argmin(self.reference.load_limits)))
        way = self.world.soles[:, :2].mean(axis=0) - landed.point
        return size * way / float(np.linalg.norm(way))

    def apart(self) -> tuple[float, float, float]:
        """The left foot as seen from the right one."""
        return self.foothold(RIGHT).relative(self.foothold(LEFT))


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Bench:
    return Bench(monkeypatch)


def swinging(tick: Tick) -> int:
    (foot,) = np.flatnonzero(~tick.contact)
    return int(foot)


def assert_side_by_side(bench: Bench) -> None:
    assert bench.walking.support is Support.STAND
    assert bench.reference.in_contact.all()
    np.testing.assert_allclose(bench.apart(), (0.0, bench.walking.limits.width, 0.0), rtol=0, atol=1e-6)


# --- the cycle


def test_it_stands_where_it_is_until_it_is_told_to_walk(bench: Bench) -> None:
    soles = bench.world.soles.copy()
    bench.run(1.0)
    assert all(t.support is Support.STAND and t.contact.all() for t in bench.ticks)
    np.testing.assert_allclose(bench.series("soles"), np.tile(soles[:, :3], (500, 1, 1)), rtol=0, atol=1e-12)
    np.testing.assert_allclose(bench.series("dcm"), np.tile(soles[:, :2].mean(axis=0), (500, 1)), rtol=0, atol=1e-12)
    np.testing.assert_array_equal(bench.series("limits"), 1.0)


def test_feet_swing_in_turn_for_the_times_of_the_tuning(bench: Bench) -> None:
    bench.walking.command = AHEAD
    bench.run(6.0)
    contact, tuning = bench.series("contact"), bench.tuning
    assert contact.any(axis=1).all()
    lifts = [(i, swinging(bench.ticks[i + 1])) for i in np.flatnonzero(np.diff(contact.sum(axis=1)) < 0)]
    assert len(lifts) >= 6
    feet = [foot for _, foot in lifts]
    assert all(a != b for a, b in pairwise(feet))
    np.testing.assert_allclose(
        np.diff([i for i, _ in lifts]) * DT,
        tuning.timing.period(AHEAD.foot_speed(bench.walking.limits.width)),
        rtol=0,
        atol=2.01 * DT,
    )
    single = (contact.sum(axis=1) == 1).sum() * DT / len(lifts)
    assert single == pytest.approx(tuning.single_support, abs=0.1)
    first = lifts[0][0] * DT
    assert first == pytest.approx(tuning.stop_time + tuning.start_time, abs=2.01 * DT)


@pytest.mark.parametrize(
    "command", [AHEAD, FAST, VelocityCommand(vx=-0.15), VelocityCommand(vy=0.08), VelocityCommand(vx=0.1, wz=0.3)]
)
def test_the_feet_go_as_fast_as_the_command(bench: Bench, command: VelocityCommand) -> None:
    """Over four pairs of steps at full speed the left foot moves by Exp of the command, half a width off the body."""
    bench.walking.command = command
    bench.until(lambda tick: tick.steps == 4, 8.0)
    start, counted, at = bench.foothold(LEFT), bench.walking.steps, bench.ticks[-1].t
    bench.until(lambda tick: tick.steps == counted + 8, 10.0)
    seconds = 8 * bench.tuning.timing.period(command.foot_speed(bench.walking.limits.width))
    # lift-off waits for the next tick, touchdown for that and for the force to be seen twice
    assert seconds - DT < bench.ticks[-1].t - at < seconds + 8 * 3 * DT + DT
    half, turn = 0.5 * bench.walking.limits.width, command.wz * seconds
    a, b = (1.0, 0.0) if turn == 0.0 else (math.sin(turn) / turn, (1 - math.cos(turn)) / turn)
    body = seconds * np.array([a * command.vx - b * command.vy, b * command.vx + a * command.vy])
    x, y, yaw = start.relative(bench.foothold(LEFT))
    expected = body + np.array([-half * math.sin(turn), half * math.cos(turn) - half])
    np.testing.assert_allclose([x, y], expected, rtol=0, atol=1e-6)
    assert math.remainder(yaw - turn, math.tau) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("command", "first"),
    [
        (VelocityCommand(vy=0.08), LEFT),
        (VelocityCommand(vy=-0.08), RIGHT),
        (VelocityCommand(wz=0.3), LEFT),
        (VelocityCommand(wz=-0.3), RIGHT),
    ],
)
def test_a_walk_begins_with_the_foot_on_the_side_it_goes_to(bench: Bench, command: VelocityCommand, first: int) -> None:
    bench.walking.command = command
    assert swinging(bench.until_single()) == first


# --- no jumps


def test_references_do_not_jump(bench: Bench) -> None:
    """Start, stepping, walking, stop: soles, DCM and ZMP, tick to tick, with feet that land in time."""
    bench.walking.command = VelocityCommand(vx=0.2, wz=0.2)
    bench.run(5.0)
    bench.walking.command = STOP
    bench.run(4.0)
    assert_side_by_side(bench)
    soles = np.linalg.norm(np.diff(bench.series("soles"), axis=0), axis=2)
    assert soles.max() < 2.0 * DT
    landing = np.diff(bench.series("steps")) > 0
    dcm, zmp = (np.linalg.norm(np.diff(bench.series(name), axis=0), axis=1) for name in ("dcm", "zmp"))
    assert dcm[~landing].max() < 1.0 * DT
    # from sole to sole in double support: no faster than their distance allows
    assert zmp[~landing].max() < 0.5 / bench.tuning.double_support * DT
    # a change of speed moves the end of the next step, and the DCM by what is left of that at its beginning
    assert bench.reference.dcm is not None
    period = bench.tuning.timing.period(0.0)
    growth = math.exp(bench.reference.dcm.omega * period)
    assert dcm[landing].max() < 1.1 * bench.tuning.speed_change * period / (growth - 1.0)


def test_at_a_constant_command_the_dcm_does_not_jump_at_touchdowns(bench: Bench) -> None:
    bench.walking.command = VelocityCommand(vx=0.15)
    bench.run(5.0)
    dcm = bench.series("dcm")
    assert bench.walking.steps >= 5
    # a touchdown comes up to two ticks late: that much of the DCM's way is lost, no more
    assert np.linalg.norm(np.diff(dcm, axis=0), axis=1).max() < 1.0 * DT


def test_load_goes_over_in_the_load_time(bench: Bench) -> None:
    """A foot gives up its load before it lifts, and takes it on from nothing after it has landed."""
    bench.walking.command = AHEAD
    bench.run(5.0)
    contact, limits = bench.series("contact"), bench.series("limits")
    rate = 1.01 * DT / bench.tuning.load_time
    for foot in (LEFT, RIGHT):
        change = np.diff(contact[:, foot].astype(int))
        for lift in np.flatnonzero(change < 0):
            assert limits[lift, foot] <= rate
        for land in np.flatnonzero(change > 0) + 1:
            assert limits[land, foot] == 0.0
            assert limits[land + round(bench.tuning.load_time / DT) + 1, foot] == 1.0
        both = contact[1:].all(axis=1) & contact[:-1].all(axis=1)
        assert np.abs(np.diff(limits[:, foot]))[both].max() <= rate
    assert (limits.sum(axis=1) >= 1.0 - 1e-9).all()
    assert (limits.min(axis=1) >= 0.0).all()


def test_a_second_start_takes_the_load_over_as_smoothly_as_the_first(bench: Bench) -> None:
    """From standing, where both feet have borne the weight for long, no foot's share is cut at once."""
    for _ in range(2):
        bench.walking.command = AHEAD
        bench.until(lambda tick: tick.steps > 0 and tick.support is Support.SINGLE)
        bench.walking.command = STOP
        bench.until(lambda tick: tick.support is Support.STAND)
        bench.run(0.5)
    contact, limits = bench.series("contact"), bench.series("limits")
    both = contact[1:].all(axis=1) & contact[:-1].all(axis=1)
    assert np.abs(np.diff(limits, axis=0))[both].max() <= 1.01 * DT / bench.tuning.load_time


def test_a_foot_that_lands_to_stand_takes_on_its_load_smoothly_whatever_came_before(bench: Bench) -> None:
    """Also where the double support before the last step was made longer by a wait."""
    bench.walking.command = VelocityCommand(stepping=True)
    bench.until(lambda tick: tick.steps == 1)
    bench.walking.command = STOP
    bench.until(lambda tick: tick.steps == 2 or tick.support is Support.STAND)
    assert bench.walking.support is Support.DOUBLE
    bench.world.error = bench.inwards(0.04)
    bench.run(bench.tuning.double_support + 0.2)
    assert bench.walking.support is Support.DOUBLE
    bench.world.error = np.zeros(2)
    bench.until_single()
    landed = bench.until(lambda tick: tick.support is not Support.SINGLE)
    assert landed.support is Support.STAND
    assert landed.limits.min() == 0.0


# --- touchdown by force


def test_early_ground_ends_the_step(bench: Bench) -> None:
    """Ground 2 cm up under the swinging foot: it lands before its time, and the walk goes on from there."""
    bench.walking.command = AHEAD
    tick = bench.until_single()
    foot, lifted = swinging(tick), tick.t
    bench.run(0.3 * bench.tuning.single_support)
    bench.world.ground[foot] += 0.02
    landed = bench.until(lambda tick: tick.support is Support.DOUBLE)
    assert 0.5 * bench.tuning.single_support <= landed.t - lifted < bench.tuning.single_support - 3 * DT
    assert landed.soles[foot, 2] == pytest.approx(bench.world.ground[foot], abs=2e-3)
    bench.world.ground[:] = bench.world.ground[foot]
    height = bench.reference.com.position[2]
    bench.run(3.0)
    assert bench.walking.steps >= 4
    # the other foot is up there too by now, and the CoM over both
    assert bench.reference.com.position[2] - height == pytest.approx(0.01, abs=2e-3)


def test_a_touch_in_the_first_half_is_no_landing(bench: Bench) -> None:
    """A foot that still scrapes the ground it leaves has not come down."""
    bench.walking.command = AHEAD
    tick = bench.until_single()
    foot, lifted = swinging(tick), tick.t
    bench.world.ground[foot] += 0.5
    landed = bench.until(lambda tick: tick.support is Support.DOUBLE)
    assert landed.t - lifted == pytest.approx(0.5 * bench.tuning.single_support, abs=2 * DT)


def test_late_ground_is_felt_for_at_the_touch_speed(bench: Bench) -> None:
    bench.walking.command = AHEAD
    tick = bench.until_single()
    foot, lifted, tuning = swinging(tick), tick.t, bench.tuning
    bench.world.ground[foot] -= 0.5 * tuning.late_limit * tuning.touch_speed
    bench.until(lambda tick: tick.t - lifted > tuning.single_support + 0.4 * tuning.late_limit)
    assert bench.ticks[-1].rates[foot, 2] == pytest.approx(-tuning.touch_speed, rel=1e-6)
    landed = bench.until(lambda tick: tick.support is Support.DOUBLE)
    assert landed.t - lifted == pytest.approx(tuning.single_support + 0.5 * tuning.late_limit, abs=5 * DT)


def test_without_any_ground_the_step_ends_at_the_late_limit(bench: Bench) -> None:
    bench.walking.command = AHEAD
    tick = bench.until_single()
    bench.world.ground[swinging(tick)] -= 1.0
    landed = bench.until(lambda tick: tick.support is Support.DOUBLE)
    expected = bench.tuning.single_support + bench.tuning.late_limit
    assert landed.t - tick.t == pytest.approx(expected, abs=2 * DT)


def test_without_measured_forces_the_clock_lands_the_foot(bench: Bench) -> None:
    bench.world.measured = False
    bench.walking.command = AHEAD
    tick = bench.until_single()
    landed = bench.until(lambda tick: tick.support is Support.DOUBLE)
    assert landed.t - tick.t == pytest.approx(bench.tuning.single_support, abs=2 * DT)
    bench.run(2.0)
    assert bench.walking.steps >= 3


def test_forces_that_are_not_numbers_land_no_foot_early(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    bench.walking.command = AHEAD
    tick = bench.until_single()
    monkeypatch.setattr(World, "forces", lambda self: np.array([np.nan, np.nan]))
    landed = bench.until(lambda tick: tick.support is Support.DOUBLE)
    assert landed.t - tick.t == pytest.approx(bench.tuning.single_support + bench.tuning.late_limit, abs=2 * DT)
    assert np.isfinite(landed.soles).all() and np.isfinite(landed.dcm).all()


# --- commands and stop


def test_a_command_is_heeded_from_the_next_step_on(bench: Bench) -> None:
    bench.walking.command = VelocityCommand(stepping=True)
    bench.until_single()
    bench.run(0.1)
    bench.walking.command = VelocityCommand(vx=0.1)
    bench.until(lambda tick: tick.steps == 1)
    assert bench.apart()[0] == pytest.approx(0.0, abs=1e-6)
    bench.until(lambda tick: tick.steps == 2)
    assert abs(bench.apart()[0]) == pytest.approx(0.1 * bench.tuning.timing.period(0.1), abs=1e-6)


@pytest.mark.parametrize(
    "after",
    [VelocityCommand(), VelocityCommand(stepping=True), VelocityCommand(vx=-0.2), VelocityCommand(0.1, 0.0, 0.4)],
)
@pytest.mark.parametrize("before", [FAST, VelocityCommand(0.2, 0.0, 0.4), VelocityCommand(0.2, 0.1, 0.0)])
def test_no_foot_is_sent_faster_than_its_bound_whatever_the_command_turns_into(
    monkeypatch: pytest.MonkeyPatch, before: VelocityCommand, after: VelocityCommand
) -> None:
    """A low bound, so that every step's time hangs on it; up to speed, from one command to the other, and on."""
    bench = Bench(monkeypatch, WalkTuning(swing_acceleration=4.0, forward=1.0, widest=2.5))
    bench.walking.command = before
    bench.until(lambda tick: tick.steps == 5, 12.0)
    bench.walking.command = after
    bench.run(5.0)
    peaks = np.linalg.norm(bench.series("accelerations")[:, :, :2], axis=2)
    assert peaks.max() <= 4.0 * (1.0 + 1e-6)
    assert peaks.max() > 3.5
    standing = bench.series("contact").astype(bool)
    np.testing.assert_array_equal(bench.series("accelerations")[standing], 0.0)


def test_speed_changes_step_by_step(monkeypatch: pytest.MonkeyPatch) -> None:
    tuning = WalkTuning(speed_change=0.1, turn_change=0.05)
    bench = Bench(monkeypatch, tuning)
    bench.walking.command = VelocityCommand(vx=0.25)
    strides = []
    for step in range(1, 5):
        bench.until(lambda tick, step=step: tick.steps == step)  # type: ignore[misc]
        strides.append(abs(bench.apart()[0]))
    expected = [speed * tuning.timing.period(speed) for speed in (0.1, 0.2, 0.25, 0.25)]
    np.testing.assert_allclose(strides, expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize("when", [0.3, 0.9, 1.5, 1.75, 1.9, 2.05, 2.2])
def test_a_stop_at_any_instant_ends_on_both_feet_side_by_side(bench: Bench, when: float) -> None:
    bench.walking.command = VelocityCommand(vx=0.25, wz=0.2)
    bench.run(when)
    bench.walking.stop()
    bench.run(5.0)
    assert_side_by_side(bench)
    ended = bench.ticks[-1]
    np.testing.assert_allclose(ended.dcm, ended.soles[:, :2].mean(axis=0), rtol=0, atol=1e-9)
    np.testing.assert_allclose(ended.zmp, ended.dcm, rtol=0, atol=1e-9)
    # a command after a stop is not heeded
    bench.walking.command = AHEAD
    assert bench.walking.command == STOP
    steps = bench.walking.steps
    bench.run(2.0)
    assert bench.walking.steps == steps
    assert_side_by_side(bench)


def test_a_last_step_that_a_push_sends_elsewhere_is_not_the_last(bench: Bench) -> None:
    """The feet are side by side when the robot stands, also where a push came in the step that should close them."""
    bench.walking.command = VelocityCommand(stepping=True)
    bench.until(lambda tick: tick.steps == 2)
    bench.walking.stop()
    bench.until_single()
    bench.run(0.1)
    bench.world.error = np.array([0.08, 0.0])
    bench.run(bench.tuning.single_support - 0.1 - 0.5 * bench.tuning.frozen_time)
    bench.world.error = np.zeros(2)
    bench.run(5.0)
    assert_side_by_side(bench)


def test_stepping_on_the_spot_stays_on_the_spot(bench: Bench) -> None:
    soles = bench.world.soles.copy()
    bench.walking.command = VelocityCommand(stepping=True)
    bench.run(4.0)
    assert bench.walking.steps >= 4
    bench.walking.command = STOP
    bench.run(2.0)
    np.testing.assert_allclose(bench.world.soles[:, :2], soles[:, :2], rtol=0, atol=1e-6)


# --- pushes


@pytest.mark.parametrize("push", [np.array([0.05, 0.0]), np.array([-0.05, 0.0])])
def test_the_foot_goes_where_the_push_goes(bench: Bench, push: Array) -> None:
    bench.walking.command = VelocityCommand(stepping=True)
    foot = swinging(bench.until_single())
    before = bench.foothold(1 - foot)
    bench.run(0.1)
    bench.world.error = push
    bench.run(0.04)
    bench.world.error = np.zeros(2)
    target = bench.walking._goal()
    assert np.sign(target[0] - before.x) == np.sign(push[0])
    assert abs(target[0] - before.x) > 0.02
    # and the plan knows of it: once landed there the ZMP goes to that foot
    end = bench.walking._plan.evaluate(bench.walking._single + bench.tuning.double_support + 1e-6)
    np.testing.assert_allclose(end.zmp, target[:2], rtol=0, atol=1e-6)


def test_a_push_too_strong_for_the_longest_step_makes_it_shorter_in_time(bench: Bench) -> None:
    bench.walking.command = VelocityCommand(stepping=True)
    lifted = bench.until_single()
    bench.run(0.05)
    bench.world.error = np.array([0.12, 0.0])
    bench.run(0.02)
    bench.world.error = np.zeros(2)
    landed = bench.until(lambda tick: tick.support is Support.DOUBLE)
    assert bench.tuning.shortest_step - DT <= landed.t - lifted.t < bench.tuning.single_support - 0.03
    assert bench.foothold(swinging(lifted)).x - lifted.soles[0, 0] <= bench.tuning.forward + 1e-6


def test_no_foothold_changes_just_before_it_is_reached(bench: Bench) -> None:
    bench.walking.command = VelocityCommand(stepping=True)
    lifted = bench.until_single()
    bench.run(bench.tuning.single_support - bench.tuning.frozen_time + 2 * DT)
    bench.world.error = np.array([0.1, 0.0])
    bench.until(lambda tick: tick.support is Support.DOUBLE)
    np.testing.assert_allclose(bench.world.soles[:, 0], lifted.soles[:, 0], rtol=0, atol=1e-6)


@pytest.mark.parametrize(("side", "lifts"), [(1.0, RIGHT), (-1.0, LEFT)])
def test_pushed_in_standing_it_steps_at_once_with_the_foot_that_is_not_loaded(
    bench: Bench, side: float, lifts: int
) -> None:
    bench.run(0.1)
    bench.world.error = np.array([0.0, 0.25 * side])
    pushed = bench.tick().t
    tick = bench.until_single()
    assert swinging(tick) == lifts
    assert tick.t - pushed <= bench.tuning.catch_time + 3 * DT


def test_small_errors_in_standing_make_no_step(bench: Bench) -> None:
    bench.run(0.1)
    for error in ([0.02, 0.0], [0.0, 0.05], [-0.02, 0.04]):
        bench.world.error = np.array(error)
        bench.run(0.3)
    assert all(tick.support is Support.STAND for tick in bench.ticks)


def test_a_foot_waits_to_lift_while_an_error_would_send_it_elsewhere(bench: Bench) -> None:
    """At most for the wait's limit, its load not given up; and it goes as soon as the error has gone."""
    times, tuning = [], bench.tuning
    for error, lasts in ((0.0, 0.0), (0.04, 9.0), (0.04, 0.3)):
        bench.walking.command = VelocityCommand(stepping=True)
        began = bench.until(lambda tick: tick.support is Support.DOUBLE and tick.steps > 0)
        bench.world.error = bench.inwards(error)
        limits = []
        while bench.walking.support is Support.DOUBLE:
            tick = bench.tick()
            if tick.t - began.t > lasts:
                bench.world.error = np.zeros(2)
            limits.append(tick.limits)
            if lasts == 9.0 and tuning.double_support < tick.t - began.t < tuning.wait_limit:
                # it stands still meanwhile
                np.testing.assert_array_equal(tick.zmp, tick.dcm)
        times.append(bench.ticks[-1].t - began.t)
        bench.world.error = np.zeros(2)
        assert (np.sum(limits, axis=1) >= 1.0 - 1e-9).all()
        bench.until(lambda tick: tick.support is Support.DOUBLE)
        bench.until_single()
    assert times[0] == pytest.approx(tuning.double_support, abs=2 * DT)
    assert times[1] == pytest.approx(tuning.double_support + tuning.wait_limit, abs=4 * DT)
    assert times[2] == pytest.approx(0.3 + tuning.load_time, abs=6 * DT)


def test_who_falls_as_the_last_step_lands_makes_another_one(bench: Bench) -> None:
    bench.walking.command = VelocityCommand(stepping=True)
    bench.until(lambda tick: tick.steps == 1)
    bench.walking.stop()
    lifted = bench.until(lambda tick: tick.support is Support.SINGLE and tick.steps == 2)
    bench.until(lambda tick: tick.t - lifted.t > bench.tuning.single_support - 0.5 * bench.tuning.frozen_time)
    bench.world.error = np.array([0.2, 0.0])
    landed = bench.until(lambda tick: tick.steps == 3)
    assert landed.support is Support.DOUBLE
    bench.world.error = np.zeros(2)
    bench.run(5.0)
    assert_side_by_side(bench)


# --- planners of one's own


class Far:
    """A planner that asks for what no leg can do."""

    def __init__(self, x: float) -> None:
        self.x = x

    def next_foothold(self, stance: Foothold, swing: int, command: VelocityCommand) -> Foothold:
        return stance.compose(self.x if command.walks else 0.0, 0.24 if swing == LEFT else -0.24, 0.0)


def test_a_planner_of_ones_own_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch, planner=Far(0.07))
    bench.walking.command = AHEAD
    bench.until(lambda tick: tick.steps == 3)
    np.testing.assert_allclose(np.abs(bench.apart()[:2]), [0.07, 0.24], rtol=0, atol=1e-6)


def test_footholds_of_ones_own_planner_stay_within_reach(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch, planner=Far(2.0))
    bench.walking.command = AHEAD
    while bench.walking.steps < 2:
        bench.tick()
        assert abs(bench.apart()[0]) <= bench.tuning.forward + 1e-6
        assert np.linalg.norm(bench.ticks[-1].dcm) < 1.0


# --- the whole body


def test_the_measured_dcm_is_that_of_a_pendulum_as_high_as_the_com(robot: RobotDescription) -> None:
    state = at_rest(robot)
    feet, kin = Feet(robot, state), Kinematics(robot)
    kin.update(state.q, state.v)
    soles = [kin.frame_placement(kin.frame_id(robot.roles[r]))[1] for r in ("left_sole", "right_sole")]
    height = kin.com[2] - 0.5 * (soles[0][2] + soles[1][2])
    assert feet.omega**2 * height == pytest.approx(9.81)
    assert feet.width == pytest.approx(abs(soles[0][1] - soles[1][1]))
    np.testing.assert_allclose(feet.middle, 0.5 * (soles[0] + soles[1])[:2], rtol=0, atol=1e-12)
    np.testing.assert_allclose(feet.dcm, kin.com[:2], rtol=0, atol=1e-12)
    moving = replace(state, v=np.random.default_rng(4).normal(size=state.v.size))
    feet.update(moving)
    kin.update(moving.q, moving.v)
    expected = kin.com[:2] + kin.com_velocity[:2] / feet.omega
    np.testing.assert_allclose(feet.dcm, expected, rtol=0, atol=1e-12)


def test_the_com_accelerates_as_the_pendulum_does(robot: RobotDescription) -> None:
    """Horizontal acceleration of eq. (15), drift included: omega^2 (c - p), p the DCM feedback's ZMP in the soles."""
    rng = np.random.default_rng(3)
    config = controller_config(robot, filter="none", without_drift=True)
    controller = WholeBodyController(robot, config, with_hands=False)
    state = at_rest(robot)
    controller.reset(state)
    walking = Walking(robot, walk_tuning(robot), state)
    reference = reference_here(controller.kin, with_hands=False)
    walking.apply(reference, 0.0, state)
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
        actual = (kin.com_jacobian @ acceleration + kin.com_drift)[:2]
        if not clipped:
            np.testing.assert_allclose(actual, dcm.omega**2 * (kin.com[:2] - zmp), rtol=0, atol=1e-6)
        used = kin.com[:2] - actual / dcm.omega**2
        centres = np.array([p.position[:2] for p in reference.soles])
        room = np.array([s.half_length for s in robot.soles]) + 1e-6
        assert (np.abs(used[0] - centres[:, 0]) <= room).all()
        assert centres[:, 1].min() - room[0] <= used[1] <= centres[:, 1].max() + room[0]


def test_the_load_estimate_survives_forces_that_are_not_numbers(robot: RobotDescription) -> None:
    config = controller_config(robot)
    balance = replace(config.balance, load_time=1.0)
    controller = WholeBodyController(robot, replace(config, balance=balance), with_hands=False)
    state = at_rest(robot)
    controller.reset(state)
    reference = reference_here(controller.kin, with_hands=False)
    good, bad = (replace(state, foot_forces=np.array([force, 300.0])) for force in (300.0, np.nan))
    # a state that is refused leaves nothing behind either
    with suppress(ValueError):
        controller.tick(bad, reference)
    result = controller.tick(good, reference)
    assert np.isfinite(result.command.tau).all()
    assert controller.load is not None
    assert 0.6 <= controller.load.scale <= 1.6


def test_the_reference_com_is_that_of_the_planned_dcm(bench: Bench) -> None:
    """The CoM follows the plan's DCM by its own law, and keeps its height over the feet."""
    bench.walking.command = AHEAD
    places, dcms = [], []
    for _ in range(round(3.0 / DT)):
        bench.tick()
        places.append(bench.reference.com.position.copy())
        dcms.append(bench.ticks[-1].dcm)
    com, dcm = np.array(places), np.array(dcms)
    omega = bench.reference.dcm.omega if bench.reference.dcm else 0.0
    rate = (com[2:, :2] - com[:-2, :2]) / (2 * DT)
    np.testing.assert_allclose(rate, omega * (dcm - com[:, :2])[1:-1], rtol=0, atol=5e-3)
    heights = com[:, 2]
    np.testing.assert_allclose(heights, heights[0], rtol=0, atol=1e-9)


def test_body_and_feet_turn_together(bench: Bench) -> None:
    bench.walking.command = VelocityCommand(wz=0.3, stepping=True)
    before, angles, rates = bench.reference.base_rotation.copy(), [], []
    for _ in range(round(4.0 / DT)):
        bench.tick()
        turned = bench.reference.base_rotation @ before.T
        angles.append(math.atan2(turned[1, 0], turned[0, 0]))
        assert turned[2, 2] == pytest.approx(1.0, abs=1e-9)
        assert bench.reference.torso_rotation[2, 2] > 0.99
        assert angles[-1] == pytest.approx(0.5 * bench.world.soles[:, 3].sum(), abs=1e-9)
        rates.append(bench.reference.turn_rate)
    assert angles[-1] > 0.3
    # the rate is the angle's: between touchdowns both are smooth
    slope = np.gradient(np.array(angles), DT)
    assert np.median(np.abs(slope - rates)) < 1e-3
    assert np.percentile(np.abs(slope - rates), 98) < 1e-2
