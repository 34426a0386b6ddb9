"""Standing on one leg: the order of things, references without jumps, the foot's touchdown, the way back."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from controllers.gaits.footholds import LEFT, RIGHT
from controllers.gaits.one_leg import LANDING_TIME, HandsThereAndBack, OneLeg, OneLegTuning, Phase
from controllers.reference import reference_here
from controllers.whole_body.config import FilterTuning
from controllers.whole_body.controller import WholeBodyController
from controllers.whole_body.robot_config import controller_config, from_table
from robots.description import RobotDescription
from robots.errors import ConfigError, DescriptionError
from robots.kinematics import Kinematics
from robots.messages import Array, RobotState
from robots.pinocchio_model import standing_configuration

TUNING = OneLegTuning(
    shift_time=1.0, lift_time=0.5, hold_time=0.6, lower_time=0.5, return_time=0.8, late_depth=0.04, late_time=0.5
)
DT = 0.005

Forces = Callable[[OneLeg, float], Array | None]


class Drive:
    """A gait beside a body that follows the CoM's reference as a whole, and feet whose forces are made up."""

    def __init__(self, robot: RobotDescription, tuning: OneLegTuning = TUNING, stance: int = LEFT) -> None:
        self.robot, self.kin = robot, Kinematics(robot)
        self.q = standing_configuration(robot)
        self.weight = 9.81 * robot.total_mass
        self.kin.update(self.q, np.zeros(self.kin.nv))
        self.start = self.kin.com.copy()
        self.reference = reference_here(self.kin, with_hands=True)
        self.soles = [point.position.copy() for point in self.reference.soles]
        self.gait = OneLeg(self.kin, tuning, stance)
        self.free = 1 - stance
        self.t = 0.0

    def state(self, shift: Array, forces: Array | None) -> RobotState:
        q = self.q.copy()
        q[:3] += shift
        return RobotState(q, np.zeros(self.kin.nv), np.zeros(len(self.robot.joints)), 0.0, forces)

    def loaded(self, gait: OneLeg, t: float) -> Array:
        """The free foot touches while it is meant to be on the ground, and once it has come all the way down."""
        down = self.reference.soles[self.free].position[2] <= self.soles[self.free][2] + 1e-3
        force = np.full(2, 0.5 * self.weight)
        if gait.phase in (Phase.LIFT, Phase.HOLD) or (gait.phase is Phase.LOWER and not down):
            force[self.free] = 0.0
        return force

    def step(self, forces: Forces | None = None, error: Array | None = None) -> None:
        shift = self.reference.com.position - self.start
        shift[2] = 0.0
        if error is not None:
            shift = shift + error
        self.apply(self.state(shift, (forces or self.loaded)(self.gait, self.t)))
        self.t += DT

    def apply(self, state: RobotState) -> None:
        self.kin.update(state.q, state.v)
        self.gait.apply(self.reference, self.t, state, self.kin)

    def until(self, phase: Phase, limit: float = 10.0, forces: Forces | None = None) -> None:
        while self.gait.phase is not phase:
            assert self.t < limit, f"{phase} is not reached"
            self.step(forces)

    def run(self, duration: float, forces: Forces | None = None) -> list[tuple[Array, Array]]:
        """Positions of the CoM and of the free sole from now on."""
        out = []
        for _ in range(round(duration / DT)):
            self.step(forces)
            out.append((self.reference.com.position.copy(), self.reference.soles[self.free].position.copy()))
        return out

    def assert_at_rest_on_both_feet(self) -> None:
        reference = self.reference
        assert reference.in_contact.all()
        middle = 0.5 * (reference.soles[0].position + reference.soles[1].position)
        np.testing.assert_allclose(reference.com.position[:2], middle[:2], atol=1e-9)
        for point in (reference.com, *reference.soles):
            np.testing.assert_allclose([point.velocity, point.acceleration], 0.0, atol=1e-12)


def assert_smooth(path: Array, velocity: Array, acceleration: Array) -> None:
    """No jump of a path (T, k), and its rates are those that it has: central differences."""
    inner = velocity[1:-1]
    jump = 1e-9 + 0.5 * DT * (np.abs(np.diff(acceleration, axis=0)).max() + np.abs(acceleration).max())
    np.testing.assert_allclose((path[2:] - path[:-2]) / (2 * DT), inner, atol=jump)
    assert np.abs(np.diff(velocity, axis=0)).max() <= DT * np.abs(acceleration).max() * 1.01 + 1e-9


@pytest.mark.parametrize("stance", [LEFT, RIGHT])
def test_the_whole_sequence(robot: RobotDescription, stance: int) -> None:
    """Load over, foot up for the time asked, down, load back; the standing foot is never asked to move."""
    drive = Drive(robot, stance=stance)
    phases, heights, contact = [], [], []
    while drive.t < 5.0:
        drive.step()
        phases.append(drive.gait.phase)
        heights.append(drive.reference.soles[drive.free].position[2] - drive.soles[drive.free][2])
        contact.append(drive.reference.in_contact.copy())
        if phases[-1] in (Phase.LIFT, Phase.HOLD, Phase.LOWER):
            np.testing.assert_array_equal(drive.reference.soles[stance].position, drive.soles[stance])
            np.testing.assert_allclose(drive.reference.com.position[:2], drive.soles[stance][:2], atol=1e-9)
    order = [p for p, before in zip(phases, [None, *phases], strict=False) if p is not before]
    assert order == list(Phase)
    assert max(heights) == pytest.approx(TUNING.lift_height)
    held = DT * sum(p is Phase.HOLD for p in phases)
    assert held == pytest.approx(TUNING.hold_time, abs=1.5 * DT)
    down = np.array([p in (Phase.SHIFT, Phase.RETURN) for p in phases])
    np.testing.assert_array_equal(np.array(contact)[:, drive.free], down)
    assert np.array(contact)[:, stance].all()
    drive.assert_at_rest_on_both_feet()


def test_references_do_not_jump(robot: RobotDescription) -> None:
    """Positions, velocities and accelerations of CoM and foot belong together, through every change of phase."""
    drive = Drive(robot)
    rows = []
    while drive.t < 5.0:
        drive.step()
        foot = drive.reference.soles[RIGHT]
        com = drive.reference.com
        rows.append([getattr(p, name) for name in ("position", "velocity", "acceleration") for p in (com, foot)])
    position, velocity, acceleration = np.array(rows).reshape(len(rows), 3, 6).swapaxes(0, 1)
    for i in range(6):
        assert_smooth(position[:, i : i + 1], velocity[:, i : i + 1], acceleration[:, i : i + 1])


def test_the_zmp_of_the_path_is_the_com(robot: RobotDescription) -> None:
    """With the times of the paper c - c_dd / omega^2 is within a millimetre of c."""
    drive = Drive(robot, OneLegTuning())
    apart = []
    while drive.t < 10.0:
        drive.step()
        apart.append(np.abs(drive.reference.com.acceleration[:2]).max() / drive.gait.omega**2)
    assert 0 < max(apart) < 1e-3


def test_the_foot_waits_for_the_load(robot: RobotDescription) -> None:
    """However long it takes, a foot is not lifted while the DCM is not over the other one."""
    drive = Drive(robot)
    away = np.array([0.0, -2 * TUNING.ready_error, 0.0])
    while drive.t < 4.0:
        drive.step(error=away)
        assert drive.gait.phase is Phase.SHIFT
        assert drive.reference.in_contact.all()
    drive.step(error=0.4 * away)
    assert drive.gait.phase is Phase.LIFT


def test_speed_counts_for_the_dcm(robot: RobotDescription) -> None:
    """A CoM over the sole that moves away is not over it."""
    drive = Drive(robot)
    drive.until(Phase.LIFT)
    fast = Drive(robot)
    while fast.t < 3.0:
        shift = fast.reference.com.position - fast.start
        state = fast.state(np.array([*shift[:2], 0.0]), fast.loaded(fast.gait, fast.t))
        state.v[1] = 2 * TUNING.ready_error * fast.gait.omega
        fast.apply(state)
        fast.t += DT
    assert fast.gait.phase is Phase.SHIFT


def test_early_contact_counts_in_the_second_half_only(robot: RobotDescription) -> None:
    drive = Drive(robot)
    drive.until(Phase.LOWER)
    begin = drive.t
    drive.until(Phase.RETURN, forces=lambda gait, t: np.full(2, 0.5 * drive.weight))
    assert drive.t - begin == pytest.approx(0.5 * TUNING.lower_time, abs=3 * DT)


def test_a_foot_that_lands_early_is_taken_as_it_is(robot: RobotDescription) -> None:
    """The foot's reference goes from where it was to where the foot is, without a jump, and stays there."""
    drive = Drive(robot)
    drive.until(Phase.LOWER)
    touching: Forces = lambda gait, t: np.full(2, 0.5 * drive.weight)  # noqa: E731
    drive.until(Phase.RETURN, forces=touching)
    before = drive.reference.soles[RIGHT].position[2]
    assert before > drive.soles[RIGHT][2] + 0.01
    speed = abs(drive.reference.soles[RIGHT].velocity[2])
    path = np.array([foot[2] for _, foot in drive.run(1.0, touching)])
    assert np.abs(np.diff([before, *path])).max() <= 2.0 * DT * (speed + 2 * (before - path[-1]) / LANDING_TIME)
    after = round(LANDING_TIME / DT)
    np.testing.assert_allclose(path[after:], drive.soles[RIGHT][2], atol=1e-9)


def test_a_late_foot_goes_on_down_and_no_further_than_allowed(robot: RobotDescription) -> None:
    """It keeps all load on the other foot until its own force says that it stands."""
    drive = Drive(robot)
    nothing: Forces = lambda gait, t: np.array([drive.weight, 0.0])  # noqa: E731
    drive.until(Phase.LOWER)
    path = np.array([foot[2] for _, foot in drive.run(2.0, nothing)])
    assert [drive.gait.phase] == [Phase.LOWER]
    assert not drive.reference.in_contact[RIGHT]
    assert (np.diff(path) <= 1e-12).all()
    assert path[-1] == pytest.approx(drive.soles[RIGHT][2] - TUNING.late_depth)
    drive.run(1.5)
    assert drive.gait.phase is Phase.RETURN
    drive.assert_at_rest_on_both_feet()


def test_without_measured_forces_the_clock_decides(robot: RobotDescription) -> None:
    drive = Drive(robot)
    drive.until(Phase.LOWER, forces=lambda gait, t: None)
    begin = drive.t
    drive.until(Phase.RETURN, forces=lambda gait, t: None)
    assert drive.t - begin == pytest.approx(TUNING.lower_time, abs=2 * DT)


@pytest.mark.parametrize("phase", list(Phase))
def test_a_stop_ends_on_both_feet(robot: RobotDescription, phase: Phase) -> None:
    """From wherever it is; CoM and foot go on without a jump, a foot in the air comes down first."""
    drive = Drive(robot)
    drive.until(phase)
    drive.run(0.2)
    drive.gait.stop()
    com, foot = drive.reference.com.position.copy(), drive.reference.soles[RIGHT].position.copy()
    path = drive.run(2.5)
    points = np.array([(com, foot), *path])
    assert np.abs(np.diff(points, axis=0)).max() < 1.0 * DT
    lifted = points[:, 1, 2].max() - drive.soles[RIGHT][2]
    assert lifted <= TUNING.lift_height + 1e-9
    if phase is Phase.SHIFT:
        assert lifted < 1e-9
    drive.assert_at_rest_on_both_feet()


def test_hands_go_there_and_back(robot: RobotDescription) -> None:
    """At the targets while the foot is up, at their starts in the end, and their rates are those of their paths."""
    drive = Drive(robot)
    starts = (np.array([0.2, 0.2, 0.8]), np.array([0.2, -0.2, 0.8]))
    targets = (starts[0] + [0.0, 0.6, 0.6], starts[1] - [0.0, 0.3, 0.3])
    hands = HandsThereAndBack(drive.gait, starts, targets, TUNING)
    rows = []
    while drive.t < 5.0:
        t = drive.t
        drive.step()
        hands.apply(drive.reference, t)
        assert drive.reference.hands is not None
        left, right = drive.reference.hands
        rows.append(np.concatenate([np.concatenate([h.position, h.velocity, h.acceleration]) for h in (left, right)]))
        if drive.gait.phase in (Phase.LIFT, Phase.HOLD, Phase.LOWER):
            np.testing.assert_allclose([left.position, right.position], targets, atol=1e-12)
    np.testing.assert_allclose([left.position, right.position], starts, atol=1e-12)
    both = np.array(rows).reshape(-1, 2, 3, 3)
    for i in (0, 1):
        assert_smooth(both[:, i, 0], both[:, i, 1], both[:, i, 2])


@pytest.mark.parametrize("name", ["shift_time", "lift_height", "ready_error", "touch_fraction", "late_time"])
def test_settings_are_checked(name: str) -> None:
    for value in (0.0, -1.0, np.nan):
        with pytest.raises(ConfigError, match=name):
            OneLegTuning(**{name: value})
    with pytest.raises(ConfigError, match="hold_time"):
        OneLegTuning(hold_time=-1.0)


def test_settings_come_from_the_description(robot: RobotDescription) -> None:
    tuned = dataclasses.replace(robot, tuning={"taichi": {"lift_height": 0.07}})
    assert from_table(OneLegTuning, tuned, "taichi").lift_height == 0.07
    with pytest.raises(DescriptionError, match="lift_hight"):
        from_table(OneLegTuning, dataclasses.replace(robot, tuning={"taichi": {"lift_hight": 0.07}}), "taichi")


def test_a_foot_in_the_air_keeps_its_path_by_its_own_weight(robot: RobotDescription) -> None:
    """The base cannot follow, and something has to give way: the foot without a weight of its own, not with one."""
    off = {}
    for weight in (0.0, 1e6):
        tuning = FilterTuning(
            base_linear=0.03, foot_weight=1.0, swing_weight=weight, balance_weight=0.0, hand_weight=0.0
        )
        controller = WholeBodyController(robot, controller_config(robot, safety=tuning), with_hands=False)
        nj = len(robot.joints)
        state = RobotState(standing_configuration(robot), np.zeros(6 + nj), np.zeros(nj), 0.0)
        controller.reset(state)
        reference = reference_here(controller.kin, with_hands=False)
        reference.in_contact = np.array([True, False])
        for point in (reference.com, reference.soles[RIGHT]):
            point.position = point.position + np.array([0.0, 0.03, 0.05])
        result = controller.tick(state, reference)
        foot = controller.kin.frame_jacobian(controller.kin.frame_id(robot.roles["right_sole"]))[:3]
        off[weight] = np.linalg.norm(foot @ (result.safety.v - result.v_des))
    assert off[0.0] > 0.01
    assert off[1e6] < 1e-2 * off[0.0]
