"""Stages of a deployment, and that every fault leads to where the table says; without physics, without a network."""

from collections.abc import Callable
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from controllers.deployment.deployment import FAR_FROM_POSTURE, MISSING_IN_A_ROW, SEEN
from controllers.deployment.loop import pack_surroundings, unpack_surroundings
from controllers.deployment.motor_check import HOLD, RAMP, MotorCheck, MotorCheckSettings
from controllers.deployment.motors import PostureRamp, brake, limp, mix
from controllers.deployment.protection import RULES, Protection, ProtectionLimits, Reaction, ReadingCheck, Surroundings
from controllers.deployment.rest import LONG, RestWatch
from controllers.deployment.stages import BUTTONS, STAGES, Stage, row_of
from robots.errors import ConfigError
from robots.messages import MotorCommand, SensorReading
from robots.unitree.g1 import G1Joints
from robots.unitree.messages import StateMessage
from tests.support.fake_g1 import PERIOD, ROBOT, FakeG1

PAGE = Path(__file__).resolve().parents[2] / "docs" / "hardware.md"
SEEN_PERIODS = round(SEEN / PERIOD)
KNEE = ROBOT.joint_names.index("left_knee_joint")
ELBOW = ROBOT.joint_names.index("left_elbow_joint")


def stages_of(robot: FakeG1) -> list[str]:
    return [text.partition(":")[0] for text in robot.said]


# --- stages


def test_nothing_goes_on_without_a_person() -> None:
    robot = FakeG1()
    robot.periods(3000)
    assert robot.is_at(Stage.ZERO_TORQUE) and robot.said == []
    assert robot.gains == (0.0, 0.0, 0.0)


def test_stages_follow_the_table_from_zero_torque_to_the_control_while_hung() -> None:
    robot = FakeG1()
    robot.periods(2)
    assert robot.gains == (0.0, 0.0, 0.0)
    robot.go()
    assert robot.is_at(Stage.DAMPING) and robot.brakes
    robot.go()
    assert robot.is_at(Stage.POSTURE)
    robot.periods(2100)
    np.testing.assert_allclose(robot.q, robot.deployment._posture, atol=1e-6)
    robot.go()
    assert robot.is_at(Stage.CALIBRATION)
    robot.periods(LONG + 5)
    assert robot.is_at(Stage.HUNG)
    order = [row.stage.value for row in STAGES]
    said = [text for text in stages_of(robot) if text in order]
    assert said == order[order.index(Stage.DAMPING.value) : order.index(Stage.HUNG.value) + 1]


def test_the_way_to_the_posture_is_smooth_and_begins_where_the_robot_is() -> None:
    robot = FakeG1()
    robot.periods(2)
    robot.go()
    robot.periods(SEEN_PERIODS)
    start = robot.q.copy()
    robot.period(Surroundings(go=True))
    before, steps = start, []
    for _ in range(2100):
        robot.period()
        now = robot.command.motors["q"][robot.joints.slots].astype(float)
        steps.append(np.abs(now - before).max())
        before = now
    way = np.abs(robot.q - start).max()
    # a quintic's largest rate is 15/8 of the mean one
    assert max(steps) <= 1.01 * 15 / 8 * way * PERIOD / 4.0 + 1e-6


def test_a_robot_that_did_not_arrive_is_not_calibrated() -> None:
    robot = FakeG1()
    robot.q[KNEE] += 2 * FAR_FROM_POSTURE
    robot.follows = False
    robot.periods(2)
    robot.go()
    robot.go()
    robot.periods(2100)
    robot.go()
    assert robot.is_at(Stage.POSTURE) and any("not yet" in text for text in robot.said)


def test_a_robot_that_swings_is_not_calibrated_until_it_is_still() -> None:
    robot = FakeG1()
    robot.to_posture()
    robot.go()
    for i in range(LONG + 10):
        robot.gyro = np.array([0.2 * np.sin(0.01 * i), 0.0, 0.0])
        robot.period()
    assert robot.is_at(Stage.CALIBRATION) and any("begins again: the gyro" in text for text in robot.said)
    robot.gyro = np.array([0.01, -0.02, 0.005])
    robot.periods(2 * LONG + 5)
    assert robot.is_at(Stage.HUNG)
    np.testing.assert_allclose(robot.deployment.estimator.filter.gyro_bias, robot.gyro, atol=2e-4)


def test_hung_under_control_nothing_of_the_controller_is_sent() -> None:
    robot = FakeG1()
    robot.to_hung()
    robot.periods(50)
    kp, _, tau = robot.gains
    assert tau == 0.0 and kp == pytest.approx(float(ROBOT.joint_array("kp").max()))
    robot.go()
    robot.periods(50)
    # its feet carry nothing: it is not handed over
    assert robot.is_at(Stage.LOWERED) and robot.gains[2] == 0.0


@pytest.mark.parametrize("stage", ["zero", "damping", "posture", "hung"])
def test_stop_before_it_stands_brakes_for_good(stage: str) -> None:
    robot = FakeG1()
    robot.periods(2)
    {"zero": lambda: None, "damping": robot.go, "posture": robot.to_posture, "hung": robot.to_hung}[stage]()
    robot.period(Surroundings(stop=True))
    assert robot.is_at(Stage.DAMPED) and robot.brakes and robot.deployment.cause == "stop"
    for _ in range(20):
        robot.period(Surroundings(go=True))
        assert robot.brakes and robot.is_at(Stage.DAMPED)
    said = list(robot.said)
    robot.deployment.damp("once more")
    assert robot.said == said and robot.deployment.end_cause == "stop"


def test_buttons_count_once_for_a_press() -> None:
    robot = FakeG1()
    robot.periods(SEEN_PERIODS)
    robot.buttons = frozenset({"A"})
    robot.periods(2 * SEEN_PERIODS)
    assert robot.is_at(Stage.DAMPING)
    robot.buttons = frozenset()
    robot.periods(2)
    robot.buttons = frozenset({"A"})
    robot.periods(2)
    assert robot.is_at(Stage.POSTURE)
    robot.buttons = frozenset({"select"})
    robot.periods(2)
    assert robot.is_at(Stage.DAMPED)


def test_a_go_that_is_said_twice_or_too_soon_skips_no_stage() -> None:
    robot = FakeG1()
    for _ in range(SEEN_PERIODS - 1):
        robot.period(Surroundings(go=True))
    assert robot.is_at(Stage.ZERO_TORQUE)
    assert robot.said == ["not yet: zero torque has only begun"]
    robot.go()
    for _ in range(SEEN_PERIODS - 2):
        robot.period(Surroundings(go=True))
    assert robot.is_at(Stage.DAMPING)
    assert robot.said[1:] == ["damping", "not yet: damping has only begun"]


def test_a_go_in_latched_damping_lets_the_robot_go_and_none_from_before() -> None:
    robot = FakeG1()
    robot.periods(2)
    robot.period(Surroundings(go=True, damp=True))
    robot.period(Surroundings(go=True))
    assert robot.is_at(Stage.DAMPED) and not robot.deployment.let_go
    robot.go()
    assert robot.deployment.let_go and robot.brakes


# --- faults


def missing_states(robot: FakeG1) -> None:
    for _ in range(MISSING_IN_A_ROW):
        robot.answer()


def broken_states(robot: FakeG1) -> None:
    for _ in range(MISSING_IN_A_ROW):
        data = bytearray(robot.state())
        data[500] ^= 1
        robot.period(data=bytes(data))


def old_states(robot: FakeG1) -> None:
    data = robot.state()
    for _ in range(MISSING_IN_A_ROW + 1):
        robot.period(data=data)


def no_numbers(robot: FakeG1) -> None:
    robot.q[KNEE] = np.nan
    robot.follows = False
    robot.periods(3)


def a_turn(robot: FakeG1) -> None:
    robot.follows = False
    robot.q[KNEE] += 2.0 * np.pi
    robot.periods(3)


def bits(robot: FakeG1) -> None:
    robot.message.motors["motorstate"][int(robot.joints.slots[KNEE])] = 0x1
    robot.periods(2)


def heat(robot: FakeG1) -> None:
    robot.message.motors["temperature"][int(robot.joints.slots[KNEE])] = 30, 86
    robot.periods(2)


def race(robot: FakeG1) -> None:
    for _ in range(2):
        data = StateMessage()
        data.read(robot.state())
        data.motors["dq"][int(robot.joints.slots[KNEE])] = 10.5
        robot.period(data=data.sealed())


def another_variant(robot: FakeG1) -> None:
    robot.message.mode_machine = 6
    robot.periods(2)


def both_buttons(robot: FakeG1) -> None:
    robot.buttons = frozenset({"L2", "B"})
    robot.period()


FAULTS: dict[str, Callable[[FakeG1], None]] = {
    "no new sound state": missing_states,
    "wrong check sum": broken_states,
    "repeated": old_states,
    "left_knee_joint is nan": no_numbers,
    "left_knee_joint jumps by 6.28 rad": a_turn,
    "motor error: left_knee_joint: overcurrent": bits,
    "hot motor: left_knee_joint has 86": heat,
    "joint rate: left_knee_joint turns at 10.5": race,
    "variant: mode_machine is 6": another_variant,
    "person: L2 + B": both_buttons,
    "person: d at the keyboard": lambda robot: robot.period(Surroundings(damp=True)) and None,
    "stranger: 3 commands": lambda robot: robot.period(Surroundings(strangers=3)) and None,
    "guardian: no sign of the guardian for 25 ms": lambda robot: (
        robot.period(Surroundings(guardian_age=0.025)) and None
    ),
    "late: 25 commands": lambda robot: robot.period(Surroundings(late=25)) and None,
}


@pytest.mark.parametrize("cause", FAULTS)
def test_a_fault_of_a_hanging_robot_brakes_it_for_good_and_is_named(cause: str) -> None:
    robot = FakeG1()
    robot.to_posture()
    assert robot.deployment.cause is None
    FAULTS[cause](robot)
    assert robot.is_at(Stage.DAMPED) and robot.brakes
    assert cause in str(robot.deployment.cause) and cause in robot.said[-1]
    first = robot.deployment.cause
    for _ in range(10):
        robot.answer(Surroundings(go=True, damp=True))
        assert robot.brakes and robot.deployment.cause == first


def test_what_passes_is_bridged() -> None:
    robot = FakeG1()
    robot.to_posture()
    robot.follows = False
    for _ in range(MISSING_IN_A_ROW - 1):
        robot.answer()
    robot.periods(1)
    good = robot.q[KNEE]
    robot.q[KNEE] = np.nan
    robot.periods(2)
    robot.q[KNEE] = good
    robot.periods(3)
    robot.q[KNEE] = good + 2 * np.pi
    robot.periods(2)
    robot.q[KNEE] = good
    robot.periods(20)
    assert robot.is_at(Stage.POSTURE) and robot.deployment.cause is None
    assert robot.deployment.bridged == MISSING_IN_A_ROW - 1 + 2 + 2


def test_a_joint_that_jumps_is_not_pulled_where_it_is_not() -> None:
    """The drive reads the same encoder: from the first wrong state on it is only told to brake that joint."""
    robot = FakeG1()
    robot.to_posture()
    robot.follows = False
    robot.q[KNEE] += 2 * np.pi
    robot.period()
    motors = robot.command.motors[robot.joints.slots]
    assert motors["kp"][KNEE] == 0.0 and motors["tau"][KNEE] == 0.0 and motors["kd"][KNEE] > 0.0
    assert (np.delete(motors["kp"], KNEE) > 0.0).all()


def test_a_mistake_in_the_program_brakes_the_motors(caplog: pytest.LogCaptureFixture) -> None:
    robot = FakeG1()
    robot.to_posture()

    def broken(stamp: float) -> MotorCommand:
        raise KeyError("no such thing")

    robot.deployment._ramp.command = broken  # type: ignore[union-attr]
    robot.period()
    assert robot.brakes and robot.is_at(Stage.DAMPED)
    assert "KeyError" in str(robot.deployment.cause) and "no such thing" in caplog.text


def test_a_command_that_is_no_number_brakes_the_motors() -> None:
    robot = FakeG1()
    robot.to_posture()
    nothing = np.full(29, np.nan)
    robot.deployment._ramp.command = lambda stamp: MotorCommand(  # type: ignore[union-attr]
        nothing, nothing, nothing, nothing, nothing, stamp
    )
    robot.period()
    assert robot.brakes and "nan" in str(robot.deployment.cause)


# --- rules


def test_every_rule_has_its_line_in_the_docs() -> None:
    page = PAGE.read_text(encoding="utf-8")
    for rule in RULES:
        assert f"| {rule.name} | {rule.limit} |" in page, rule.name
    for row in STAGES:
        assert f"| {row.stage.value} | {row.motors} | {row.person} | {row.ends} |" in page, row.stage
    for button, text in BUTTONS:
        assert f"| {button} | {text} |" in page


def protection() -> tuple[Protection, StateMessage]:
    robot = FakeG1()
    message = StateMessage()
    message.read(robot.state())
    return Protection(G1Joints(ROBOT)), message


@pytest.mark.parametrize(
    ("around", "rule"),
    [
        (Surroundings(battery=19.0), "battery"),
        (Surroundings(damp=True), "person"),
        (Surroundings(strangers=1), "stranger"),
        (Surroundings(guardian_age=0.021), "guardian"),
        (Surroundings(late=25), "late"),
    ],
)
def test_a_rule_counts_its_periods(around: Surroundings, rule: str) -> None:
    periods = next(r.periods for r in RULES if r.name == rule)
    reaction = next(r.reaction for r in RULES if r.name == rule)
    watched, message = protection()
    rng = np.random.default_rng(0)
    for _ in range(periods - 1):
        message.imu["gyroscope"], message.imu["accelerometer"] = rng.standard_normal((2, 3))
        assert watched.inspect(message, around, True).reaction is Reaction.NONE
    message.imu["gyroscope"], message.imu["accelerometer"] = rng.standard_normal((2, 3))
    verdict = watched.inspect(message, around, True)
    assert verdict.reaction is reaction and verdict.cause.startswith(rule)
    # and forgets them
    message.imu["gyroscope"], message.imu["accelerometer"] = rng.standard_normal((2, 3))
    assert watched.inspect(message, Surroundings(), True).reaction is Reaction.NONE


def test_an_unknown_battery_is_not_low() -> None:
    watched, message = protection()
    for i in range(1000):
        message.imu["gyroscope"] = message.imu["accelerometer"] = i
        assert watched.inspect(message, Surroundings(), True).reaction is Reaction.NONE


def test_an_imu_of_which_a_part_stands_still_is_noticed() -> None:
    rng = np.random.default_rng(0)
    for field, other in (("gyroscope", "accelerometer"), ("accelerometer", "gyroscope")):
        watched, message = protection()
        verdicts = []
        for _ in range(52):
            message.imu[other] = rng.standard_normal(3)
            verdicts.append(watched.inspect(message, Surroundings(), True))
        assert [v.reaction for v in verdicts[:50]] == [Reaction.NONE] * 50
        assert verdicts[51].reaction is Reaction.FADE and "stands still" in verdicts[51].cause, field


def test_motors_may_wait_for_their_first_command() -> None:
    watched, message = protection()
    message.motors["motorstate"] = 0x40000000
    for i in range(5):
        message.imu["gyroscope"] = message.imu["accelerometer"] = i
        assert watched.inspect(message, Surroundings(), False).reaction is Reaction.NONE
    for i in range(5, 7):
        message.imu["gyroscope"] = message.imu["accelerometer"] = i
        verdict = watched.inspect(message, Surroundings(), True)
    assert verdict.reaction is Reaction.DAMP and "waited too long" in verdict.cause


def test_the_strongest_reaction_wins() -> None:
    watched, message = protection()
    for _ in range(3):
        verdict = watched.inspect(message, Surroundings(strangers=1, late=30), True)
    assert verdict.reaction is Reaction.DAMP


def test_a_fast_joint_is_no_jump() -> None:
    check, speed = ReadingCheck(G1Joints(ROBOT)), ROBOT.joint_array("velocity")
    zero = np.zeros(29)
    for i in range(100):
        q = 0.9 * speed * PERIOD * i
        assert check.inspect(SensorReading(q, speed, zero, np.zeros(3), np.zeros(3), PERIOD * i)) is None
    far = q.copy()
    far[KNEE] += ProtectionLimits().jump + 2.5 * speed[KNEE] * PERIOD
    assert "jumps" in str(check.inspect(SensorReading(far, zero, zero, np.zeros(3), np.zeros(3), PERIOD * 100)))
    assert check.lost[KNEE] and check.lost.sum() == 1


@pytest.mark.parametrize("name", ["joint_velocity", "torque", "gyro", "accelerometer"])
def test_numbers_that_are_none_are_named(name: str) -> None:
    values = {f.name: np.zeros(29 if "joint" in f.name or f.name == "torque" else 3) for f in fields(SensorReading)}
    values["stamp"] = 0.0
    values[name][0] = np.inf
    check = ReadingCheck(G1Joints(ROBOT))
    assert name.replace("_", " ") in str(check.inspect(SensorReading(**values)))


def test_surroundings_come_back_from_the_log() -> None:
    around = Surroundings(True, False, True, 71.0, 3, 0.004, 2)
    assert unpack_surroundings(pack_surroundings(around)) == around
    assert np.isnan(unpack_surroundings(pack_surroundings(Surroundings())).battery)


def test_a_state_that_is_judged_twice_counts_once() -> None:
    """One broken state and a lost one after it are not two broken ones."""
    watched, message = protection()
    message.motors["dq"][3] = 11.0
    for _ in range(5):
        watched.inspect(message, Surroundings(), True, fresh=False)
    assert watched.inspect(message, Surroundings(), True, fresh=True).reaction is Reaction.NONE
    message.imu["gyroscope"] = message.imu["accelerometer"] = 1.0
    assert watched.inspect(message, Surroundings(), True, fresh=True).reaction is Reaction.DAMP


# --- rest


def reading(gyro: np.ndarray, force: np.ndarray, stamp: float = 0.0) -> SensorReading:
    zero = np.zeros(29)
    return SensorReading(zero, zero, zero, gyro, force, stamp)


@pytest.mark.parametrize(
    ("gyro", "force", "words"),
    [
        (np.array([0.01, 0.0, 0.0]), np.array([0.0, 0.0, 9.81]), ""),
        (np.array([0.06, 0.0, 0.0]), np.array([0.0, 0.0, 9.81]), "turns at 0.06"),
        (np.zeros(3), np.array([0.0, 0.0, 1.0]), "not gravity"),
        (np.full(3, np.nan), np.array([0.0, 0.0, 9.81]), "differ"),
    ],
)
def test_what_is_no_rest_is_named(gyro: np.ndarray, force: np.ndarray, words: str) -> None:
    rest = RestWatch()
    for _ in range(LONG - 1):
        rest.add(reading(gyro, force))
    assert not rest.full
    rest.add(reading(gyro, force))
    assert rest.full and (words in rest.describe_motion() if words else rest.describe_motion() == "")


def test_a_swing_is_no_rest_and_not_calm() -> None:
    rest, up = RestWatch(), np.array([0.0, 0.0, 9.81])
    for i in range(LONG):
        rest.add(reading(np.array([0.3 * np.sin(0.05 * i), 0.0, 0.0]), up))
    assert "differ by" in rest.describe_motion() and not rest.calm()
    for _ in range(LONG):
        rest.add(reading(np.zeros(3), up))
    assert rest.describe_motion() == "" and rest.calm()
    rest.restart()
    assert not rest.full and not rest.calm()


def test_a_robot_that_hangs_for_long_keeps_its_tilt_and_its_bias() -> None:
    """The gyro's bias drifts away; nothing but rest tells it in the air."""
    robot = FakeG1()
    robot.to_hung()
    for i in range(8_000):
        robot.gyro = np.array([1.5e-6 * i, 0.0, 0.0])
        robot.period()
    q = robot.deployment.state.q  # type: ignore[union-attr]
    assert 2 * np.linalg.norm(q[3:5]) < 0.01
    np.testing.assert_allclose(robot.deployment.estimator.filter.gyro_bias, robot.gyro, atol=5e-3)
    robot.go()
    assert robot.is_at(Stage.LOWERED)


def test_a_robot_that_has_swung_for_long_is_not_handed_over(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("controllers.deployment.deployment.OLD_BIAS", 4.0)
    robot = FakeG1()
    robot.to_hung()
    for i in range(2100):
        robot.gyro = np.array([0.2 * np.sin(0.01 * i), 0.0, 0.0])
        robot.period()
    robot.go()
    assert robot.is_at(Stage.HUNG) and any("too old" in text for text in robot.said)
    robot.gyro = np.zeros(3)
    robot.periods(2 * LONG)
    robot.go()
    assert robot.is_at(Stage.LOWERED)


# --- commands


def random_command(rng: np.random.Generator) -> MotorCommand:
    q, v, tau = rng.standard_normal((3, 29))
    return MotorCommand(q, v, tau, rng.uniform(0, 100, 29), rng.uniform(0, 5, 29), 0.0)


def test_a_mixture_has_the_mixed_torque_whatever_the_robot_does() -> None:
    rng = np.random.default_rng(3)
    for share in (0.0, 0.3, 1.0):
        before, after = random_command(rng), random_command(rng)
        after.kp[:4] = before.kp[:4] = 0.0
        mixed = mix(before, after, share)
        for _ in range(5):
            q, v = rng.standard_normal((2, 29))
            expected = (1 - share) * before.torque(q, v) + share * after.torque(q, v)
            np.testing.assert_allclose(mixed.torque(q, v), expected, atol=1e-10)


def test_commands_beside_the_controllers_have_what_their_names_say() -> None:
    nothing, braking = limp(29, 1.0), brake(ROBOT, 1.0)
    assert not nothing.kp.any() and not nothing.kd.any() and not nothing.tau.any()
    assert not braking.kp.any() and not braking.tau.any()
    np.testing.assert_array_equal(braking.kd, ROBOT.joint_array("kd"))
    ramp = PostureRamp(ROBOT, np.zeros(29), np.ones(29), 2.0, 4.0)
    first, last = ramp.command(2.0), ramp.command(6.0)
    assert not first.kp.any() and not first.q.any() and not first.v.any()
    np.testing.assert_array_equal(last.kp, ROBOT.joint_array("kp"))
    np.testing.assert_allclose(last.q, 1.0)
    step = 1e-5
    between = (ramp.command(4.0 + step).q - ramp.command(4.0 - step).q) / (2 * step)
    np.testing.assert_allclose(ramp.command(4.0).v, between, rtol=1e-6)
    assert not ramp.arrived(5.99) and ramp.arrived(6.0)


# --- one motor


@pytest.mark.parametrize("low_pass", [0.0, 5.0])
def test_a_motor_check_ramps_one_torque_up_and_down(low_pass: float) -> None:
    check = MotorCheck(ROBOT, MotorCheckSettings("left_elbow_joint", 2.0, low_pass))
    robot = FakeG1(check)
    robot.to_posture()
    robot.go()
    assert robot.is_at(Stage.TASK)
    torques = []
    for _ in range(int(check.duration / PERIOD) + 10):
        robot.period()
        motors = robot.command.motors[robot.joints.slots]
        assert not np.delete(motors["tau"], ELBOW).any()
        torques.append(float(motors["tau"][ELBOW]))
    assert max(torques) == pytest.approx(2.0, abs=0.01) and min(torques) >= -1e-6
    steps = np.abs(np.diff(torques[: int((2 * HOLD + RAMP) / PERIOD)]))
    assert steps.max() <= 1.05 * 2.0 * PERIOD / RAMP
    assert robot.is_at(Stage.DAMPED) and robot.deployment.cause == "the motor check is over"
    torque, vibration = check.report()[-1]
    assert torque == 2.0 and vibration == pytest.approx(0.0, abs=1e-9)


def test_a_motor_check_sees_vibration_at_the_torque_where_it_is() -> None:
    check = MotorCheck(ROBOT, MotorCheckSettings("left_elbow_joint", 2.0))
    zero = np.zeros(29)
    for i in range(int(check.duration / PERIOD)):
        t = PERIOD * i
        rate = np.zeros(29)
        rate[ELBOW] = 0.5 * np.sin(2 * np.pi * 60 * t) if check.asked(t) > 1.5 else 0.0
        reading = SensorReading(zero, rate, zero, np.zeros(3), np.zeros(3), t)
        check.command(limp(29, t), reading, t)
    low, high = check.report()[1][1], check.report()[-1][1]
    assert low < 0.01 and high == pytest.approx(0.5 / np.sqrt(2), rel=0.05)


@pytest.mark.parametrize(
    ("settings", "name"),
    [
        (MotorCheckSettings("elbow"), "joint"),
        (MotorCheckSettings(torque=1e3), "torque"),
        (MotorCheckSettings(torque=float("nan")), "torque"),
        (MotorCheckSettings(low_pass=-1.0), "low_pass"),
    ],
)
def test_a_motor_check_refuses_what_it_cannot_do(settings: MotorCheckSettings, name: str) -> None:
    with pytest.raises(ConfigError, match=name):
        MotorCheck(ROBOT, settings)


def test_every_stage_has_its_row() -> None:
    assert [row.stage for row in STAGES] == list(Stage)
    assert all(row_of(stage).stage is stage for stage in Stage)
