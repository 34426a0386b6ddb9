"""The supervisor: what cannot be a state is named, a stop is latched and damped, single failures are outlived."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from controllers.reference import PointReference, WholeBodyReference, reference_here
from controllers.supervisor import FADE_TIME, HOLD_TIME, LARGEST, MAX_FAILURES, Supervisor, describe_fault
from controllers.whole_body.controller import TickResult, WholeBodyController
from controllers.whole_body.robot_config import controller_config
from robots.description import RobotDescription
from robots.errors import ConfigError
from robots.loader import load_robot
from robots.messages import MotorCommand, RobotState
from safety.filters.safety_filter import FilterStatus
from safety.geometry.shapes import Obstacle
from tests.support.states import at_rest

BASE_Q = ["base x", "base y", "base z", *(f"base quaternion {a}" for a in "xyzw")]
BASE_V = [f"base {kind} velocity {a}" for kind in ("linear", "angular") for a in "xyz"]


def supervised(robot: RobotDescription) -> tuple[Supervisor, WholeBodyReference]:
    supervisor = Supervisor(WholeBodyController(robot, controller_config(robot), with_hands=False))
    supervisor.controller.reset(at_rest(robot))
    return supervisor, reference_here(supervisor.controller.kin, with_hands=False)


def among_obstacles(robot: RobotDescription, kinds: tuple[str, ...]) -> tuple[Supervisor, WholeBodyReference]:
    controller = WholeBodyController(robot, controller_config(robot), with_hands=False, obstacle_kinds=kinds)
    controller.reset(at_rest(robot))
    return Supervisor(controller), reference_here(controller.kin, with_hands=False)


def finite(command: MotorCommand) -> bool:
    return all(np.isfinite(x).all() for x in (command.q, command.v, command.tau, command.kp, command.kd))


def with_entry(state: RobotState, part: str, index: int, value: float) -> RobotState:
    values = getattr(state, part).copy()
    values[index] = value
    return replace(state, **{part: values})


# --- faults


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e200, -1.1 * LARGEST])
def test_every_bad_entry_is_named(robot: RobotDescription, value: float) -> None:
    names_q = [*BASE_Q, *(f"position of {n}" for n in robot.joint_names)]
    names_v = [*BASE_V, *(f"velocity of {n}" for n in robot.joint_names)]
    for part, names in (("q", names_q), ("v", names_v)):
        for i, name in enumerate(names):
            fault = describe_fault(robot, with_entry(at_rest(robot), part, i, value))
            assert fault == f"measured {name} is {value:g}"


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.1 * LARGEST])
def test_a_bad_force_under_a_foot_is_named(robot: RobotDescription, value: float) -> None:
    state = replace(at_rest(robot), foot_forces=np.array([150.0, 160.0]))
    assert describe_fault(robot, state) is None
    for i, foot in enumerate(("left", "right")):
        fault = describe_fault(robot, with_entry(state, "foot_forces", i, value))
        assert fault == f"measured force on the {foot} sole is {value:g}"
    assert "2" in (describe_fault(robot, replace(state, foot_forces=np.zeros(3))) or "")


def test_a_sound_state_has_no_fault(robot: RobotDescription) -> None:
    rng = np.random.default_rng(0)
    for _ in range(100):
        state = at_rest(robot)
        lower, upper = robot.position_limits
        # soft limits give way by some tenths of a radian at most
        state.q[:3], state.q[7:] = rng.uniform(-100, 100, 3), rng.uniform(lower - 0.4, upper + 0.4)
        quaternion = rng.standard_normal(4)
        state.q[3:7] = quaternion / np.linalg.norm(quaternion)
        state.v[:] = rng.uniform(-100, 100, state.v.size)
        assert describe_fault(robot, state) is None


def test_an_encoder_that_jumps_by_a_turn_is_named_and_its_joint_only_braked(robot: RobotDescription) -> None:
    """A drive holds what it is told by the same encoder: its stiffness would slam the joint by a turn."""
    for i in (0, 3, 8, len(robot.joints) - 1):
        for turn in (-2 * np.pi, 2 * np.pi):
            supervisor, reference = supervised(robot)
            supervisor.tick(at_rest(robot), reference)
            state = at_rest(robot, stamp=0.002)
            command, result = supervisor.tick(with_entry(state, "q", 7 + i, state.q[7 + i] + turn), reference)
            name, value = robot.joint_names[i], state.q[7 + i] + turn
            assert result is None and supervisor.cause is not None
            assert supervisor.cause.startswith(f"measured position of {name} is {value:.3g}, far outside its limits")
            assert (command.kp[i], command.tau[i]) == (0.0, 0.0) and command.kd[i] > 0.0
            others = np.arange(len(robot.joints)) != i
            assert (command.kp[others] > 0.0).all()
            # the encoder comes back: the joint stays let go
            command, _ = supervisor.tick(at_rest(robot, stamp=0.004), reference)
            assert command.kp[i] == 0.0


@pytest.mark.parametrize("scale", [0.0, 0.9, 1.1])
def test_a_quaternion_that_is_no_rotation_is_a_fault(robot: RobotDescription, scale: float) -> None:
    state = at_rest(robot)
    state.q[3:7] *= scale
    assert describe_fault(robot, state) == f"measured base quaternion has length {scale:g} instead of 1"


def test_a_state_of_another_size_is_a_fault(robot: RobotDescription) -> None:
    state = at_rest(robot)
    n = state.q.size
    short = describe_fault(robot, replace(state, q=state.q[:-1]))
    long = describe_fault(robot, replace(state, v=np.append(state.v, 0.0)))
    assert short == f"measured state has {n - 1} numbers instead of {n}"
    assert long == f"measured state has {n} numbers instead of {n - 1}"


# --- stop


@pytest.mark.parametrize("first", [True, False])
def test_a_bad_state_stops_at_once_and_for_good(robot: RobotDescription, first: bool) -> None:
    """Also as the very first one; sound states afterwards do not start the robot again, and the cause stays."""
    supervisor, reference = supervised(robot)
    if not first:
        _, result = supervisor.tick(at_rest(robot), reference)
        assert result is not None
        assert supervisor.cause is None
    bad = with_entry(at_rest(robot, stamp=0.5), "q", 7, np.nan)
    worse = with_entry(at_rest(robot, stamp=0.6), "v", 0, np.inf)
    kd = supervisor.controller.config.gain_scale * robot.joint_array("kd")
    for state in (bad, worse, at_rest(robot, stamp=0.7)):
        command, result = supervisor.tick(state, reference)
        assert result is None
        assert supervisor.cause == f"measured position of {robot.joint_names[0]} is nan"
        assert supervisor.stopped_at == 0.5
        assert command.stamp == state.stamp
        assert finite(command)
        np.testing.assert_array_equal(command.kd, kd)
        np.testing.assert_array_equal(command.v, 0)
        if first:
            # nothing was commanded yet, so there is nothing to hold
            np.testing.assert_array_equal(command.tau, 0)
            np.testing.assert_array_equal(command.kp, 0)


def test_a_fade_out_holds_then_fades(robot: RobotDescription) -> None:
    supervisor, reference = supervised(robot)
    last, _ = supervisor.tick(at_rest(robot), reference)
    dt = supervisor.controller.config.dt
    fractions = []
    for i in range(1, round((HOLD_TIME + FADE_TIME) / dt) + 5):
        state = with_entry(at_rest(robot, stamp=i * dt), "q", 8, np.nan)
        command, _ = supervisor.tick(state, reference)
        np.testing.assert_array_equal(command.q, last.q)
        fraction = float(command.kp[0] / last.kp[0])
        np.testing.assert_allclose(command.kp, fraction * last.kp, rtol=1e-12, atol=0)
        np.testing.assert_allclose(command.tau, fraction * last.tau, rtol=1e-12, atol=0)
        fractions.append(fraction)
    held = round(HOLD_TIME / dt)
    np.testing.assert_allclose(fractions[:held], 1.0)
    assert (np.diff(fractions[held:]) <= 0).all()
    assert np.abs(np.diff(fractions)).max() <= 1.01 * dt / FADE_TIME
    assert fractions[-1] == 0.0


def test_the_end_of_a_fade_out_brakes_every_joint(robot: RobotDescription) -> None:
    """The motors' power is negative whatever the velocity, and no position is asked for."""
    supervisor, reference = supervised(robot)
    command, _ = supervisor.tick(with_entry(at_rest(robot), "q", 8, np.nan), reference)
    rng = np.random.default_rng(1)
    v = rng.standard_normal(len(robot.joints))
    anywhere = rng.uniform(-3, 3, v.size)
    power = command.torque(anywhere, v) * v
    assert (power[command.kd > 0] < 0).all()
    assert (command.kd > 0).all()


def test_the_first_cause_is_kept() -> None:
    supervisor, _ = supervised(load_robot("g1"))
    supervisor.latch("first", 1.0)
    supervisor.latch("second", 2.0)
    assert (supervisor.cause, supervisor.stopped_at) == ("first", 1.0)


def test_a_wrong_number_of_obstacles_stops_the_robot() -> None:
    supervisor, reference = supervised(load_robot("g1"))
    far = Obstacle.sphere(np.array([9.0, 0.0, 0.0]), 0.1)
    _, result = supervisor.tick(at_rest(load_robot("g1")), reference, [far])
    assert result is None
    assert supervisor.cause is not None
    assert supervisor.cause.startswith("the controller gives no command: 1 obstacle")


def passing_capsule(t: float) -> Obstacle:
    """Far enough not to matter, moving and turning."""
    start = np.array([3.0 - 0.4 * t, 0.5 * t, 1.0])
    end = start + np.array([0.0, 0.2 + 0.1 * t, 0.3])
    return Obstacle.capsule(
        start, end, 0.1, velocity=np.array([-0.4, 0.5, 0.0]), angular_velocity=np.array([0.1, 0.0, 0.7])
    )


# --- what the controller refuses


def assert_stopped_blindly(supervisor: Supervisor, sound: MotorCommand, stamp: float, tick: Any, cause: str) -> None:
    """``tick`` ends in the sound command held at rest, for good, and under this cause."""
    for _ in range(2):
        command, result = tick()
        assert result is None
        assert finite(command)
        assert command.stamp == stamp
        np.testing.assert_array_equal(command.q, sound.q)
        np.testing.assert_array_equal(command.tau, sound.tau)
        np.testing.assert_array_equal(command.v, 0.0)
        assert supervisor.cause == cause
        assert supervisor.stopped_at == stamp


def test_an_obstacle_of_another_kind_stops_the_robot(robot: RobotDescription) -> None:
    supervisor, reference = among_obstacles(robot, ("sphere",))
    far = Obstacle.sphere(np.array([9.0, 0.0, 0.0]), 0.1)
    sound, _ = supervisor.tick(at_rest(robot), reference, [far])
    cause = "the controller gives no command: obstacle 0 is a capsule, announced was a sphere"
    state, strange = at_rest(robot, stamp=0.1), passing_capsule(0.0)
    assert_stopped_blindly(supervisor, sound, 0.1, lambda: supervisor.tick(state, reference, [strange]), cause)
    _, result = supervisor.tick(at_rest(robot, stamp=0.2), reference, [far])
    assert result is None


def test_missing_hands_stop_the_robot(robot: RobotDescription) -> None:
    supervisor = Supervisor(WholeBodyController(robot, controller_config(robot), with_hands=True))
    supervisor.controller.reset(at_rest(robot))
    reference = reference_here(supervisor.controller.kin, with_hands=True)
    sound, _ = supervisor.tick(at_rest(robot), reference)
    reference.hands = None
    state = at_rest(robot, stamp=0.1)
    said = "the hands are tasks of this controller, but the reference gives none"
    cause = f"the controller gives no command: {said}"
    assert_stopped_blindly(supervisor, sound, 0.1, lambda: supervisor.tick(state, reference), cause)


@pytest.mark.parametrize(
    "error",
    [np.linalg.LinAlgError("Singular matrix"), ConfigError("alpha", -1.0, "above 0"), ValueError("no such thing")],
    ids=lambda e: type(e).__name__,
)
@pytest.mark.parametrize("first", [True, False])
def test_an_error_of_a_tick_stops_the_robot(error: Exception, first: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    g1 = load_robot("g1")
    supervisor, reference = supervised(g1)
    sound = supervisor.last if first else supervisor.tick(at_rest(g1), reference)[0]

    def broken(*_: object) -> TickResult:
        raise error

    monkeypatch.setattr(supervisor.controller, "respond", broken)
    state, cause = at_rest(g1, stamp=0.1), f"the controller gives no command: {error}"
    assert_stopped_blindly(supervisor, sound, 0.1, lambda: supervisor.tick(state, reference), cause)


def test_an_error_of_a_tick_after_a_stop_fades_out_under_the_first_cause(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    g1 = load_robot("g1")
    supervisor, reference = supervised(g1)
    supervisor.tick(at_rest(g1), reference)
    supervisor.latch("first", 0.05)

    def broken(*_: object) -> TickResult:
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr(supervisor.controller, "respond", broken)
    _, result = supervisor.tick(at_rest(g1, stamp=0.1), reference)
    assert result is None
    assert (supervisor.cause, supervisor.stopped_at) == ("first", 0.05)


def test_a_mistake_in_the_program_is_named_by_its_kind_and_logged(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    g1 = load_robot("g1")
    supervisor, reference = supervised(g1)
    sound, _ = supervisor.tick(at_rest(g1), reference)

    def mistaken(*_: object) -> TickResult:
        raise AttributeError("no such name")

    monkeypatch.setattr(supervisor.controller, "respond", mistaken)
    cause = "the controller gives no command: AttributeError: no such name"
    assert_stopped_blindly(supervisor, sound, 0.1, lambda: supervisor.tick(at_rest(g1, stamp=0.1), reference), cause)
    assert "mistaken" in caplog.text


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_torque_that_is_no_number_is_named(robot: RobotDescription, value: float) -> None:
    state = at_rest(robot)
    fault = describe_fault(robot, with_entry(state, "tau", 3, value))
    assert fault == f"measured torque of {robot.joint_names[3]} is {value:g}"
    assert describe_fault(robot, replace(state, tau=np.zeros(3))) == (
        f"measured state has 3 torques instead of {len(robot.joints)}"
    )


# --- solvers without answer


class Scripted:
    """Stands in for the controller: a sound result whose statuses follow a script."""

    def __init__(self, supervisor: Supervisor, sound: TickResult, failing: Iterable[bool], part: str) -> None:
        self.robot = supervisor.controller.robot
        self.config, self.kin = supervisor.controller.config, supervisor.controller.kin
        self.sound, self._failing, self._part = sound, iter(failing), part

    def update(self, _: RobotState) -> None:
        pass

    def respond(self, *_: Any) -> TickResult:
        if not next(self._failing):
            return self.sound
        if self._part == "safety":
            failed = replace(self.sound.safety, status=FilterStatus.FAILED, cause="rows are odd")
            return replace(self.sound, safety=failed)
        return replace(self.sound, dynwbc=replace(self.sound.dynwbc, status=self._part))


def scripted(failing: Iterable[bool], part: str) -> tuple[Supervisor, RobotState, WholeBodyReference]:
    supervisor, reference = supervised(load_robot("g1"))
    state = at_rest(load_robot("g1"))
    sound = supervisor.controller.tick(state, reference)
    supervisor.controller = Scripted(supervisor, sound, failing, part)
    return supervisor, state, reference


PARTS = pytest.mark.parametrize("part", ["safety", "infeasible", "failed"])


@PARTS
def test_failures_in_a_row_stop_the_robot(part: str) -> None:
    supervisor, state, reference = scripted([True] * MAX_FAILURES, part)
    for _ in range(MAX_FAILURES - 1):
        supervisor.tick(state, reference)
        assert supervisor.cause is None
    supervisor.tick(state, reference)
    assert supervisor.cause is not None
    assert f"no solution for {MAX_FAILURES} ticks" in supervisor.cause
    assert ("filter failed: rows are odd" if part == "safety" else part) in supervisor.cause
    command, result = supervisor.tick(state, reference)
    assert result is None
    np.testing.assert_array_equal(command.v, 0)


@PARTS
def test_failures_with_answers_between_them_do_not(part: str) -> None:
    script = ([True] * (MAX_FAILURES - 1) + [False]) * 5
    supervisor, state, reference = scripted(script, part)
    for i in range(len(script)):
        _, result = supervisor.tick(replace(state, stamp=0.002 * i), reference)
        assert result is not None
    assert supervisor.cause is None


def test_a_single_failure_does_not_stop_the_robot() -> None:
    supervisor, state, reference = scripted([True, False, False], "failed")
    for _ in range(3):
        supervisor.tick(state, reference)
    assert supervisor.cause is None


def test_a_state_that_is_not_renewed_stops_the_robot(robot: RobotDescription) -> None:
    supervisor, reference = supervised(robot)
    for _ in range(MAX_FAILURES):
        supervisor.tick(at_rest(robot, stamp=1.0), reference)
        assert supervisor.cause is None
    supervisor.tick(at_rest(robot, stamp=1.0), reference)
    assert supervisor.cause == f"measured state is stale: stamp 1 s for {MAX_FAILURES + 1} ticks"


@pytest.mark.parametrize("stamp", [0.9, np.nan])
def test_a_stamp_that_goes_back_stops_the_robot(robot: RobotDescription, stamp: float) -> None:
    supervisor, reference = supervised(robot)
    supervisor.tick(at_rest(robot, stamp=1.0), reference)
    _, result = supervisor.tick(at_rest(robot, stamp=stamp), reference)
    assert result is None
    assert supervisor.cause == f"measured state has stamp {stamp:g} s after one of 1 s"


def test_a_command_that_is_not_finite_is_never_sent() -> None:
    supervisor, state, reference = scripted([False], "failed")
    sound = supervisor.controller.sound  # type: ignore[attr-defined]
    broken = replace(sound.command, tau=sound.command.tau * np.nan)
    supervisor.controller.sound = replace(sound, command=broken)  # type: ignore[attr-defined]
    command, _ = supervisor.tick(state, reference)
    assert finite(command)
    assert supervisor.cause == "the controller's command is not finite"


def test_a_reference_that_is_not_finite_ends_in_a_stop_and_never_in_a_bad_command(robot: RobotDescription) -> None:
    """No solver accepts it: the filter answers with zero velocity, DynWBC with its last torques, then all stops."""
    supervisor, reference = supervised(robot)
    supervisor.tick(at_rest(robot), reference)
    reference.com = PointReference(np.full(3, np.nan))
    for i in range(MAX_FAILURES + 1):
        command, _ = supervisor.tick(at_rest(robot, stamp=0.002 * (i + 1)), reference)
        assert finite(command)
    assert supervisor.cause is not None
    assert "no solution" in supervisor.cause


def test_extreme_but_finite_states_give_finite_commands(robot: RobotDescription) -> None:
    rng = np.random.default_rng(2)
    for exponent in range(1, 7):
        supervisor, reference = supervised(robot)
        state = at_rest(robot)
        size = 0.99 * 10.0**exponent
        state.q[7:] = size * rng.uniform(-1, 1, len(robot.joints))
        state.v[:] = size * rng.uniform(-1, 1, state.v.size)
        command, _ = supervisor.tick(state, reference)
        assert finite(command)
