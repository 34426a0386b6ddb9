"""What the played robot's board takes, what it refuses and why, and what its motors do when commands stop."""

import numpy as np
import pytest

from robots.errors import ConfigError
from robots.loader import load_robot
from robots.messages import MotorCommand
from robots.unitree.g1 import MODE_MACHINE, G1Joints
from robots.unitree.messages import CommandMessage
from sims.twin.board import DAMPING, Board

ROBOT = load_robot("g1")
JOINTS = G1Joints(ROBOT)
NJ = len(ROBOT.joints)


def message(kp: float = 10.0) -> CommandMessage:
    """Every joint towards its posture."""
    zero, out = np.zeros(NJ), CommandMessage()
    q = ROBOT.posture("standing").joints
    JOINTS.write(MotorCommand(q, zero, zero + 2.0, zero + kp, zero + 1.0, 0.0), out, MODE_MACHINE)
    return out


def refused(board: Board) -> dict[str, int]:
    return {cause: n for cause, n in board.refused.items() if n}


def test_a_sound_command_is_what_the_motors_are_told() -> None:
    board = Board(JOINTS)
    assert not board.command(0.0).kp.any() and not board.command(0.0).kd.any()
    board.take(message().sealed(), 1.0)
    command = board.command(1.05)
    np.testing.assert_allclose(command.q, ROBOT.posture("standing").joints, rtol=1e-6, atol=1e-7)
    assert (command.kp == 10.0).all() and (command.tau == 2.0).all()
    assert (board.received, board.accepted, refused(board)) == (1, 1, {})
    assert board.age(1.05) == pytest.approx(0.05)
    assert board.command(1.06) is command


def test_what_is_not_sound_is_counted_by_its_cause_and_changes_nothing() -> None:
    board = Board(JOINTS)
    board.take(message().sealed(), 1.0)
    before = board.command(1.0)
    good = message(kp=50.0)
    broken = bytearray(good.sealed())
    broken[200] ^= 1
    other_way, other_robot, no_number = message(50.0), message(50.0), message(50.0)
    other_way.mode_pr, other_robot.mode_machine = 1, 6
    no_number.motors["dq"][4] = np.nan
    for data, cause in [
        (b"", "length"),
        (good.sealed()[:-1], "length"),
        (b"\1\1\1\1" + good.sealed()[4:], "length"),
        (bytes(broken), "check sum"),
        (other_way.sealed(), "mode_pr"),
        (other_robot.sealed(), "mode_machine"),
        (no_number.sealed(), "not finite"),
    ]:
        n = board.refused[cause]
        board.take(data, 1.01)
        assert board.refused[cause] == n + 1
    assert board.command(1.01) is before
    assert (board.received, board.accepted) == (8, 1)
    board.mode_machine = 6
    board.take(other_robot.sealed(), 1.02)
    assert board.accepted == 2


def test_a_motor_that_is_off_has_no_torque() -> None:
    board, out = Board(JOINTS), message()
    slot = int(JOINTS.slots[3])
    out.enable(slot, False)
    board.take(out.sealed(), 0.0)
    command = board.command(0.0)
    assert (command.kp[3], command.kd[3], command.tau[3]) == (0.0, 0.0, 0.0)
    assert (np.delete(command.kp, 3) == 10.0).all()


@pytest.mark.parametrize("reaction", ["hold", "damp"])
def test_motors_without_a_command_time_out(reaction: str) -> None:
    board = Board(JOINTS, 0.1, reaction)
    assert not board.timed_out(100.0)
    board.take(message().sealed(), 1.0)
    told = board.command(1.0)
    assert not board.timed_out(1.09) and board.timed_out(1.11)
    after = board.command(1.11)
    if reaction == "hold":
        assert after is told
    else:
        assert not after.kp.any() and not after.tau.any() and not after.v.any() and (after.kd == DAMPING).all()
        assert board.command(1.2) is after
    board.take(message(20.0).sealed(), 2.0)
    assert not board.timed_out(2.0) and (board.command(2.0).kp == 20.0).all()


def test_the_drives_damp_only_what_was_on() -> None:
    board, out = Board(JOINTS, 0.1, "damp"), message()
    out.enable(int(JOINTS.slots[3]), False)
    board.take(out.sealed(), 0.0)
    assert board.command(1.0).kd[3] == 0.0 and board.command(1.0).kd[4] == DAMPING


def test_while_the_service_has_the_motors_others_are_not_heard_and_its_release_leaves_them_limp() -> None:
    board = Board(JOINTS)
    zero = np.zeros(NJ)
    board.service = MotorCommand(zero, zero, zero, zero + 5.0, zero, 0.0)
    board.take(message().sealed(), 0.0)
    assert refused(board) == {"service": 1} and board.command(0.0) is board.service
    assert np.isnan(board.age(0.0)) and not board.timed_out(9.0)
    board.release()
    assert not any(getattr(board.command(0.0), name).any() for name in ("kp", "kd", "tau"))
    board.take(message().sealed(), 0.1)
    board.release()
    assert not board.command(0.1).kp.any()


def test_settings_that_are_none_are_refused() -> None:
    with pytest.raises(ConfigError, match="motor_timeout"):
        Board(JOINTS, 0.0)
    with pytest.raises(ConfigError, match="hold, damp"):
        Board(JOINTS, 0.1, "run")
