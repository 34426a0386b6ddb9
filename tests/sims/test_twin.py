"""The twin as a whole, without a network and at its own time: states, service, release, time-outs, faults, record."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from robots.errors import ConfigError
from robots.loader import load_robot
from robots.messages import MotorCommand
from robots.mujoco_spec import PhysicalChanges
from robots.pinocchio_model import standing_configuration
from robots.unitree.g1 import MODE_MACHINE, MOTOR_NAMES, G1Joints
from robots.unitree.layout import BATTERY, IMU, unpacked
from robots.unitree.messages import CommandMessage, StateMessage
from robots.unitree.motor_faults import TIMED_OUT
from robots.unitree.remote import read_remote
from sims.plant import PlantConfig
from sims.sensors import NO_ERRORS, SensorErrors
from sims.twin.instruments import roll_pitch_yaw
from sims.twin.orders import read_script
from sims.twin.ports import MemoryPorts
from sims.twin.record import Record
from sims.twin.twin import Twin, TwinConfig

ROBOT = load_robot("g1")
JOINTS = G1Joints(ROBOT)
NJ = len(ROBOT.joints)
KNEE = MOTOR_NAMES.index("left_knee")


class Played:
    """A twin, and a controller that holds the posture."""

    def __init__(self, *script: str, record: Record | None = None, **settings: object) -> None:
        self.ports = MemoryPorts()
        self.lines: list[str] = []
        config = TwinConfig(**{"errors": NO_ERRORS} | settings)
        script_ = read_script(script)
        self.twin = Twin(ROBOT, config, self.ports, self.ports, script_, record, self.lines.append)
        zero, self.message = np.zeros(NJ), CommandMessage()
        q, gains = ROBOT.posture("standing").joints, (ROBOT.joint_array("kp"), ROBOT.joint_array("kd"))
        JOINTS.write(MotorCommand(q, zero, zero, *gains, 0.0), self.message, MODE_MACHINE)
        self.data = self.message.sealed()

    def run(self, seconds: float, commands: bool = True) -> "Played":
        """Time goes on, with a command every 2 ms if asked for."""
        for i in range(round(1e3 * seconds)):
            if commands and i % 2 == 0:
                self.ports.inbox.append(self.data)
            self.twin.step(self.twin.time)
        return self

    def released(self) -> "Played":
        self.ports.name = ""
        self.run(0.02)
        self.ports.states.clear()
        return self

    def states(self) -> list[StateMessage]:
        """Those that have gone out since the last look, all sound."""
        taken, self.ports.states = self.ports.states[:], []
        return [sound(data) for data in taken]

    def last(self) -> StateMessage:
        return self.states()[-1]


def sound(data: bytes) -> StateMessage:
    message = StateMessage()
    assert message.read(data)
    return message


def ticks(messages: list[StateMessage]) -> NDArray[np.int64]:
    return np.array([message.tick for message in messages])


def test_states_say_what_is_true_every_two_milliseconds() -> None:
    played = Played().run(1.0, commands=False)
    states = played.states()
    np.testing.assert_array_equal(ticks(states), 2 * np.arange(1, 501))
    state, true = states[-1], played.twin.plant.true_state()
    np.testing.assert_allclose(state.motors["q"][JOINTS.slots], true.q[7:], atol=1e-6)
    np.testing.assert_allclose(state.motors["tau_est"][JOINTS.slots], true.tau, rtol=1e-5, atol=1e-5)
    assert (state.mode_pr, state.mode_machine) == (0, MODE_MACHINE)
    imu = state.imu[0]
    np.testing.assert_allclose(imu["quaternion"], true.q[[6, 3, 4, 5]], atol=1e-6)
    np.testing.assert_allclose(imu["accelerometer"], [0.0, 0.0, 9.81], atol=1e-3)
    np.testing.assert_allclose(imu["rpy"], 0.0, atol=1e-6)
    motors = state.motors[:29]
    assert (motors["temperature"] == 35).all() and (motors["vol"] == 48.0).all() and not motors["motorstate"].any()
    assert not state.motors[29:]["q"].any()
    remote = read_remote(state.remote)
    assert remote.heard and not remote.buttons
    assert len(played.ports.torso_imu) == 500 and len(played.ports.battery) == 1
    assert unpacked(played.ports.battery[0], BATTERY)["soc"] == 90
    assert unpacked(played.ports.torso_imu[-1], IMU)["accelerometer"][0][2] == pytest.approx(9.81, abs=1e-3)


def test_the_imu_in_the_torso_turns_and_accelerates_as_its_place_does() -> None:
    """Against differences of its place and its axes, while the robot swings and turns on the rope."""
    played = Played()
    data = played.twin.plant.data
    data.qvel[:6] = 0.4, 0.3, 0.0, 0.0, 0.0, 1.0
    played.run(0.1, commands=False)
    places, axes = [], []
    for _ in range(20):
        played.run(0.002, commands=False)
        site = data.site("imu_in_torso")
        places.append(site.xpos.copy())
        axes.append(site.xmat.reshape(3, 3).copy())
    readings = [unpacked(sent, IMU)[0] for sent in played.ports.torso_imu[-20:]]
    for k in range(1, 19):
        turned = (axes[k - 1].T @ axes[k + 1] - axes[k + 1].T @ axes[k - 1]) / 2.0
        rate = np.array([turned[2, 1], turned[0, 2], turned[1, 0]]) / 0.004
        # readings are those of the step that led there: half a millisecond old
        np.testing.assert_allclose(readings[k]["gyroscope"], rate, atol=0.01)
        acceleration = (places[k + 1] - 2.0 * places[k] + places[k - 1]) / 0.002**2 + [0.0, 0.0, 9.81]
        np.testing.assert_allclose(readings[k]["accelerometer"], axes[k].T @ acceleration, atol=0.1)
    assert np.abs(readings[-1]["gyroscope"]).max() > 0.2
    assert np.linalg.norm(readings[-1]["accelerometer"] - [0.0, 0.0, 9.81]) > 0.2


def test_sensors_have_their_errors_and_a_seed_gives_the_same_ones() -> None:
    runs = [Played(errors=SensorErrors(), seed=seed).run(0.02, commands=False) for seed in (1, 1, 2)]
    sent = [run.ports.states + run.ports.torso_imu for run in runs]
    assert sent[0] == sent[1] != sent[2]
    gyro = np.array([state.imu[0]["gyroscope"] for state in runs[0].states()])
    assert 0.001 < np.abs(gyro).max() < 0.05


@pytest.mark.parametrize(("axis", "i"), [("x", 0), ("y", 1), ("z", 2)])
def test_angles_of_the_imu(axis: str, i: int) -> None:
    quaternion = np.array([0.0, 0.0, 0.0, np.cos(0.3)])
    quaternion[i] = np.sin(0.3)
    np.testing.assert_allclose(roll_pitch_yaw(quaternion), 0.6 * np.eye(3)[i], atol=1e-12)


def test_the_robots_own_service_holds_it_and_writes_for_all_to_see_until_it_is_released() -> None:
    played = Played().run(1.0)
    assert len(played.ports.own_commands) == 50
    written = CommandMessage()
    assert written.read(played.ports.own_commands[-1]) and written.mode_machine == MODE_MACHINE
    assert np.abs(played.twin.plant.true_state().v).max() < 1e-3
    assert played.twin.board.refused["service"] == played.twin.board.received == 500
    played.ports.name = ""
    played.run(0.02, commands=False)
    assert "[    1.000] released" in played.lines
    n, command = len(played.ports.own_commands), played.twin.board.command(played.twin.time)
    assert not any(getattr(command, name).any() for name in ("kp", "kd", "tau"))
    played.run(0.2, commands=False)
    assert len(played.ports.own_commands) == n
    assert np.abs(played.twin.plant.true_state().v[6:]).max() > 0.1
    assert not played.last().motors["motorstate"].any()


def test_a_service_that_is_selected_again_leaves_the_motors_limp() -> None:
    played = Played().released().run(0.1)
    played.ports.name, played.ports.selected = "ai", 1
    played.run(0.02)
    assert played.lines[-1].endswith("selected ai")
    assert not played.twin.board.command(0.0).kp.any() and played.twin.board.refused["service"] > 0


def test_commands_of_a_controller_hold_the_robot_after_the_release() -> None:
    played = Played().run(0.1).released().run(3.0)
    board = played.twin.board
    assert board.accepted == board.received - board.refused["service"] > 1500
    assert np.abs(played.twin.plant.true_state().v[6:]).max() < 0.02
    error = played.twin.plant.true_state().q[7:] - standing_configuration(ROBOT)[7:]
    assert np.abs(error).max() < 0.1


@pytest.mark.parametrize("reaction", ["hold", "damp"])
def test_motors_time_out_and_say_so(reaction: str, tmp_path: Path) -> None:
    record = Record(tmp_path / "a.npz")
    played = Played(on_timeout=reaction, motor_timeout=0.05, record=record).released().run(0.5)
    assert not played.last().motors["motorstate"].any()
    played.run(0.2, commands=False)
    assert (played.last().motors["motorstate"][:29] == TIMED_OUT).all()
    played.run(0.2)
    assert not played.last().motors["motorstate"].any()
    record.save(played.twin.events)
    with np.load(tmp_path / "a.npz") as saved:
        assert saved["q"].shape == (len(saved["time"]), 36) and saved["foot_wrench"].shape[1:] == (2, 6)
        damped = saved["damped"]
        assert damped.any() == (reaction == "damp")
        assert (saved["applied_kp_max"][damped] == 0.0).all() and (saved["applied_tau_max"][damped] == 0.0).all()
        if reaction == "damp":
            # from the time-out to the next command, in steps of 2 ms
            assert 2e-3 * damped.sum() == pytest.approx(0.15, abs=5e-3)
        assert np.nanmax(saved["lowcmd_age"]) == pytest.approx(0.2, abs=5e-3)
        assert list(saved["events"]) == ["released", f"motors timed out: they {reaction}", "motors are commanded again"]


def test_a_script_lowers_the_robot_to_the_ground_and_ends_it() -> None:
    played = Played("0 lower", "4.5 end", plant=PlantConfig(changes=PhysicalChanges(mass_scale=1.2))).released()
    played.run(4.0)
    assert played.twin.plant.contact_wrenches()[:, 2].min() > 50.0
    assert played.twin.hoist.tension < 0.8 * played.twin.plant.total_mass * 9.81
    assert not played.twin.ended
    played.run(0.6)
    assert played.twin.ended and played.lines[0] == "[    0.000] lower" and played.lines[-1] == "[    4.500] end"


def test_an_order_that_is_wrong_is_told_of_and_nothing_else_happens() -> None:
    played = Played()
    assert played.twin.obey("encoder tail 1") is None
    assert played.lines == ["[    0.000] refused: " + str(caught_by("encoder tail 1"))]
    played.run(0.1)
    order = played.twin.obey("status")
    assert order is not None and order.verb == "status"


def caught_by(line: str) -> ConfigError:
    with pytest.raises(ConfigError) as caught:
        read_script([f"0 {line}"])
    error = caught.value
    return ConfigError(error.name.removeprefix("script line 1: "), error.value, error.allowed)


def test_a_step_of_the_physics_that_is_none_of_a_twin_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"0\.001"):
        TwinConfig(PlantConfig(dt=0.002))
