"""Every fault of the twin: what it changes, for how long, and that it ends where it is cleared."""

import numpy as np
import pytest

from robots.loader import load_robot
from robots.messages import MotorCommand
from robots.unitree.g1 import MODE_MACHINE, MOTOR_NAMES, G1Joints
from robots.unitree.layout import BATTERY, unpacked
from robots.unitree.messages import CommandMessage, StateMessage
from robots.unitree.remote import read_remote
from sims.sensors import NO_ERRORS
from sims.twin.faults import FAULTS
from sims.twin.link import Link
from sims.twin.orders import read_order
from sims.twin.ports import MemoryPorts
from sims.twin.twin import Twin, TwinConfig

ROBOT = load_robot("g1")
JOINTS = G1Joints(ROBOT)
NJ = len(ROBOT.joints)
KNEE, ELBOW = MOTOR_NAMES.index("left_knee"), MOTOR_NAMES.index("right_elbow")


class Faulty:
    """A twin whose service is released, with a controller that holds the posture."""

    def __init__(self) -> None:
        self.ports = MemoryPorts(name="")
        self.twin = Twin(ROBOT, TwinConfig(errors=NO_ERRORS), self.ports, self.ports)
        zero, message = np.zeros(NJ), CommandMessage()
        q, gains = ROBOT.posture("standing").joints, (ROBOT.joint_array("kp"), ROBOT.joint_array("kd"))
        JOINTS.write(MotorCommand(q, zero, zero, *gains, 0.0), message, MODE_MACHINE)
        self.data = message.sealed()
        self.run(0.1)

    def run(self, seconds: float, commands: bool = True) -> list[bytes]:
        """Time goes on; returns the states that went out."""
        self.ports.states.clear()
        for i in range(round(1e3 * seconds)):
            if commands and i % 2 == 0:
                self.ports.inbox.append(self.data)
            self.twin.step(self.twin.time)
        return self.ports.states[:]

    def order(self, line: str) -> None:
        self.twin.carry_out(read_order(line))

    def last(self, seconds: float = 0.002) -> StateMessage:
        return sound(self.run(seconds)[-1])

    def numbers(self, seconds: float) -> list[int]:
        """Which states went out, counted from now on: 1 for the first."""
        start = round(500 * self.twin.time)
        return [sound(data).tick // 2 - start for data in self.run(seconds)]


@pytest.fixture
def faulty() -> Faulty:
    return Faulty()


def sound(data: bytes) -> StateMessage:
    message = StateMessage()
    assert message.read(data)
    return message


def test_states_stop_for_a_while_or_for_ever(faulty: Faulty) -> None:
    faulty.order("state-stop 0.01")
    assert faulty.numbers(0.02) == [5, 6, 7, 8, 9, 10]
    faulty.order("state-stop")
    assert faulty.numbers(0.5) == []
    faulty.order("clear state-stop")
    assert faulty.numbers(0.004) == [1, 2]


def test_states_are_lost(faulty: Faulty) -> None:
    faulty.order("state-lost 3")
    assert faulty.numbers(0.01) == [4, 5]
    faulty.order("state-lost")
    assert faulty.numbers(0.004) == [2]


def test_states_are_held_back_and_come_in_a_burst(faulty: Faulty) -> None:
    faulty.order("state-late 9")
    assert faulty.numbers(0.008) == []
    assert faulty.numbers(0.002) == [-3, -2, -1, 0, 1]
    assert faulty.numbers(0.004) == [1, 2]


def test_a_state_is_repeated(faulty: Faulty) -> None:
    faulty.order("state-repeated 2")
    assert faulty.numbers(0.008) == [0, 0, 3, 4]


def test_two_states_are_exchanged(faulty: Faulty) -> None:
    faulty.order("state-swapped")
    assert faulty.numbers(0.008) == [2, 1, 3, 4]


def test_check_sums_are_wrong(faulty: Faulty) -> None:
    faulty.order("state-crc 2")
    assert [StateMessage().read(data) for data in faulty.run(0.008)] == [False, False, True, True]


def test_a_position_is_no_number_under_a_right_check_sum(faulty: Faulty) -> None:
    faulty.order("state-nan 2 right_elbow")
    states = [sound(data) for data in faulty.run(0.008)]
    assert [int(np.isnan(state.motors["q"]).sum()) for state in states] == [1, 1, 0, 0]
    assert np.isnan(states[0].motors["q"][ELBOW])
    faulty.order("state-nan")
    assert np.isnan(faulty.last().motors["q"][KNEE])


def test_an_encoder_is_off_by_turns_and_the_drive_believes_it(faulty: Faulty) -> None:
    before = faulty.last().motors["q"].copy()
    faulty.order("encoder right_elbow -1")
    after = faulty.last().motors["q"] - before
    assert after[ELBOW] == pytest.approx(-2.0 * np.pi, abs=0.02)
    assert np.abs(np.delete(after, ELBOW)).max() < 0.02
    # the service holds its posture: the drive turns the joint to where the encoder would be right
    later = faulty.last(0.1).motors["q"] - before
    assert later[ELBOW] > after[ELBOW] + 0.5
    faulty.order("clear encoder")
    assert faulty.last().motors["q"][ELBOW] > before[ELBOW] + 0.3


def test_a_motor_becomes_hot_at_its_pace_and_cools_down_again(faulty: Faulty) -> None:
    faulty.order("hot left_knee 55")
    assert list(faulty.last(0.5).motors["temperature"][KNEE]) == [45, 45]
    hot = faulty.last(1.0).motors["temperature"]
    assert list(hot[KNEE]) == [55, 55] and (hot[ELBOW] == 35).all()
    faulty.order("clear hot")
    assert list(faulty.last(0.5).motors["temperature"][KNEE]) == [45, 45]


def test_a_motor_has_an_error(faulty: Faulty) -> None:
    faulty.order("motor-error left_knee 0x80000200")
    errors = faulty.last().motors["motorstate"]
    assert errors[KNEE] == 0x80000200 and not np.delete(errors, KNEE).any()
    faulty.order("clear")
    assert not faulty.last().motors["motorstate"].any()


def test_the_battery_is_low(faulty: Faulty) -> None:
    faulty.order("battery 15")
    faulty.run(1.0)
    assert unpacked(faulty.ports.battery[-1], BATTERY)["soc"] == 15


def test_somebody_else_writes_commands(faulty: Faulty) -> None:
    accepted = faulty.twin.board.accepted
    faulty.order("foreign-writer 0.1")
    faulty.run(0.1, commands=False)
    assert faulty.twin.board.accepted - accepted == 50
    command = faulty.twin.board.command(faulty.twin.time)
    assert not any(getattr(command, name).any() for name in ("kp", "kd", "tau"))
    accepted = faulty.twin.board.accepted
    faulty.run(0.05, commands=False)
    assert faulty.twin.board.accepted == accepted


def test_a_robot_with_its_waist_locked_is_another_one(faulty: Faulty) -> None:
    faulty.order("waist-locked")
    assert faulty.last(0.02).mode_machine == 6
    assert faulty.twin.board.refused["mode_machine"] == 10
    faulty.order("clear waist-locked")
    assert faulty.last().mode_machine == MODE_MACHINE


def test_an_imu_says_the_same_for_ever(faulty: Faulty) -> None:
    faulty.order("imu-stuck")
    faulty.twin.plant.data.qvel[3:6] = 0.5, 0.5, 0.5
    stuck = [sound(data).imu[0].copy() for data in faulty.run(0.1)]
    for name in ("gyroscope", "accelerometer", "quaternion", "rpy"):
        assert (stuck[0][name] == stuck[-1][name]).all()
    faulty.order("clear imu-stuck")
    assert (faulty.last().imu[0]["gyroscope"] != stuck[0]["gyroscope"]).any()


def test_a_gyro_is_off_by_a_step(faulty: Faulty) -> None:
    before = faulty.last().imu[0]["gyroscope"].copy()
    faulty.order("gyro-step 0.2")
    np.testing.assert_allclose(faulty.last().imu[0]["gyroscope"] - before, [0.2, 0.0, 0.0], atol=5e-3)


def test_motors_take_torques_for_others(faulty: Faulty) -> None:
    faulty.run(2.0)
    before = faulty.last().motors["tau_est"].copy()
    faulty.order("torque-constant 0.8")
    np.testing.assert_allclose(faulty.last().motors["tau_est"], 0.8 * before, atol=0.05)


def test_a_push_pushes_for_its_time_beside_the_rope(faulty: Faulty) -> None:
    torso, data = faulty.twin.plant.data.body("torso_link").id, faulty.twin.plant.data
    faulty.run(0.002)
    rope = data.xfrc_applied[torso].copy()
    faulty.order("push 60 0 -10 0.1")
    faulty.order("push 0 5 0 0.2")
    faulty.run(0.001)
    np.testing.assert_allclose((data.xfrc_applied[torso] - rope)[:3], [60.0, 5.0, -10.0], atol=1.0)
    faulty.run(0.15)
    # swinging from the first push costs the rope's sideways part some newtons
    assert abs(data.xfrc_applied[torso][0]) < 40.0
    speed = faulty.twin.plant.true_state().v[0]
    assert speed > 0.05


def test_a_person_uses_the_remote(faulty: Faulty) -> None:
    faulty.order("remote L2 B")
    faulty.order("stick 0.5 -0.25 1")
    remote = read_remote(faulty.last(0.2).remote)
    assert remote.buttons == {"L2", "B"} and remote.left == (0.5, -0.25) and remote.right == (1.0, 0.0)
    remote = read_remote(faulty.last(0.11).remote)
    assert not remote.buttons and remote.left == (0.5, -0.25)
    faulty.order("remote-lost")
    assert not faulty.last().remote.any()
    faulty.order("clear")
    remote = read_remote(faulty.last().remote)
    assert remote.heard and remote.left == (0.0, 0.0)


def test_the_switcher_refuses(faulty: Faulty) -> None:
    faulty.order("switcher-refuses")
    faulty.run(0.02)
    assert faulty.ports.refuses
    faulty.order("clear switcher-refuses")
    faulty.run(0.02)
    assert not faulty.ports.refuses


def test_a_network_delays_both_directions(faulty: Faulty) -> None:
    faulty.order("network 20 0")
    accepted = faulty.twin.board.accepted
    assert faulty.numbers(0.02) == []
    assert faulty.twin.board.accepted == accepted
    assert faulty.numbers(0.01) == [-9, -8, -7, -6, -5]
    assert faulty.twin.board.accepted == accepted + 5
    faulty.order("clear network")
    late = faulty.numbers(0.1)
    assert sorted(late) == sorted([*range(-9, 1), *range(1, 51)])


def test_a_network_loses_and_exchanges_what_it_carries() -> None:
    link: Link[int] = Link(np.random.default_rng(0))
    fault = read_order("network 4 6 20").fault
    assert fault is not None
    link.begin(fault, 0.0)
    came: list[tuple[int, int]] = []
    for t in range(3000):
        link.send(t, 1e-3 * t)
        came += [(thing, t - thing) for thing in link.due(1e-3 * t)]
    things, delays = np.array(came).T
    # 0.2 +- 0.007 (one deviation) of 3000
    assert 0.77 < len(things) / 3000 < 0.83
    assert delays.min() >= 4 and delays.max() <= 10
    assert (np.diff(things) < 0).any() and len(set(things)) == len(things)


def test_every_fault_belongs_to_a_part_of_the_twin(faulty: Faulty) -> None:
    twin = faulty.twin
    named = {name for part in (twin.defects, twin._stream, twin._out) for name in part.names}
    assert named == set(FAULTS)
