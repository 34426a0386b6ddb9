"""A deployment's log, computed again: the same commands bit by bit, the first one that differs, and its recording."""

from pathlib import Path

import numpy as np
import pytest

from controllers.deployment.ring import CHUNK, PAGE, Kind, Record, read_log
from controllers.deployment.stages import Stage
from experiments.cli.replay import replay
from experiments.metrics.deployment import DEPLOYMENT
from experiments.recording.deployment_channels import DEPLOYMENT_CHANNELS, require_declared
from experiments.recording.recording import GUARANTEED, load_recording
from experiments.running.deployment_replay import Period, describe, read_deployment, replay_log
from experiments.running.deployment_tasks import read_task
from experiments.scenarios.hardware_options import MotorCheckOptions
from experiments.scenarios.options import ReplayOptions
from experiments.scenarios.stand import Stand
from experiments.scenarios.walk import Walk
from robots.errors import ConfigError, SafeWbcError, WithoutEffectError
from robots.messages import MotorCommand
from robots.unitree.g1 import MODE_MACHINE
from robots.unitree.messages import CommandMessage, StateMessage
from tests.support.deployments import JOINTS, ROBOT, deployed, rewritten
from tests.support.page import Page


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Up to the controller beside a hanging robot."""
    return deployed(tmp_path_factory.mktemp("stand") / "a", Walk(duration=5.0), Stage.HUNG)


@pytest.fixture(scope="module")
def periods(log: Path) -> list[tuple[Stage, bool]]:
    """Stage of every period, and whether an agent was asked in it."""
    found: list[tuple[Stage, bool]] = []

    def watch(period: Period) -> None:
        found.append((period.deployment.stage, period.output is not None))
        assert (period.agent is None) == (period.output is None)
        assert period.sent and 0.0 <= period.done - period.begun < 1e-3

    result = replay_log(log, watch)
    assert result.same and result.periods == len(found) and result.different == 0
    return found


def test_every_command_is_the_same_bit_by_bit(log: Path, periods: list[tuple[Stage, bool]]) -> None:
    commands = [r for r in read_log(log) if r.kind is Kind.COMMAND]
    assert len(commands) == len(periods) > 4000
    stages = list(dict.fromkeys(stage for stage, _ in periods))
    assert stages == [
        Stage.ZERO_TORQUE, Stage.DAMPING, Stage.POSTURE, Stage.CALIBRATION, Stage.HUNG, Stage.DAMPED
    ]  # fmt: skip
    asked = [stage for stage, ticked in periods if ticked]
    assert len(asked) > 50 and set(asked) == {Stage.HUNG}
    result = replay_log(log.parent)
    assert [text for _, text in result.events][-2:] == ["hung under control", "latched damping: stop"]


@pytest.mark.parametrize(
    ("task", "last", "dry"),
    [
        (Stand(), Stage.HUNG, True),
        (MotorCheckOptions("left_elbow_joint", 1.5, 20.0), Stage.TASK, False),
    ],
)
def test_a_dry_run_and_a_motor_check_are_computed_again(task: object, last: Stage, dry: bool, tmp_path: Path) -> None:
    log = deployed(tmp_path, task, last, dry)
    assert replay_log(log).same
    assert read_task(read_deployment(log).head["task"]) == task


def test_one_bit_of_a_state_is_found_by_the_command_that_it_changes(
    log: Path, periods: list[tuple[Stage, bool]], tmp_path: Path
) -> None:
    """The way to the posture begins where the state before it has the joints."""
    first = [stage for stage, _ in periods].index(Stage.POSTURE) + 1
    state = [r for r in read_log(log) if r.kind is Kind.STATE][first - 1]
    knee = int(JOINTS.slots[ROBOT.joint_names.index("left_knee_joint")])

    def change(record: Record) -> bytes:
        if record.number != state.number:
            return record.data
        message = StateMessage()
        assert message.read(record.data)
        message.motors["q"][knee : knee + 1].view(np.uint8)[0] ^= 1
        return message.sealed()

    result = replay_log(rewritten(log, tmp_path / "log.bin", change))
    assert not result.same and result.difference is not None
    number, what = result.difference
    assert number == first + 1
    assert what.startswith("q of left_knee: ") and " in the log, " in what
    assert 0 < result.different < result.periods


def test_differences_are_named_by_motor_and_field() -> None:
    zero = np.zeros(29)
    one, other = CommandMessage(), CommandMessage()
    JOINTS.write(MotorCommand(zero, zero, zero, zero, zero, 0.0), one, MODE_MACHINE)
    tau = zero.copy()
    tau[[3, 5]] = 2.5
    JOINTS.write(MotorCommand(zero, zero, tau, zero, zero, 0.0), other, MODE_MACHINE)
    assert describe(one.sealed(), other.sealed()) == "tau of left_knee: 0 in the log, 2.5 now; 1 more differ"
    other.mode_machine = 6
    assert describe(one.sealed(), other.sealed()).startswith("mode_machine: 5 in the log, 6 now")
    assert describe(one.sealed(), b"12") == f"{one.size} bytes in the log, 2 now"


def test_a_ring_that_began_again_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = deployed(tmp_path, Stand(), Stage.POSTURE, size=1)
    result = replay_log(log)
    assert result.overwritten and not result.same and result.periods == 0
    assert replay(ReplayOptions(tmp_path)) == 1
    assert "ring of the log has begun again" in capsys.readouterr().out


def test_a_damaged_record_ends_the_comparison(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = bytearray(log.read_bytes())
    data[PAGE + CHUNK // 2] ^= 1
    (tmp_path / "log.bin").write_bytes(data)
    result = replay_log(tmp_path)
    assert result.hole is not None and not result.same
    assert result.difference is None and 0 < result.periods < read_deployment(log).commands
    assert replay(ReplayOptions(tmp_path / "log.bin")) == 1
    assert f"record {result.hole} of" in capsys.readouterr().out


def test_the_command_line_says_what_came_of_it(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert replay(ReplayOptions(log.parent)) == 0
    commands = read_deployment(log).commands
    assert capsys.readouterr().out == f"{commands} commands, all the same bit by bit\n"


def test_a_deployment_is_recorded_and_shown_like_a_run(
    log: Path, periods: list[tuple[Stage, bool]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = rewritten(log, tmp_path / "log.bin", lambda record: record.data)
    assert replay(ReplayOptions(copy, report=True)) == 0
    assert str(tmp_path / "run" / "report.html") in capsys.readouterr().out
    # once more, in place of the first
    assert replay(ReplayOptions(tmp_path, report=True)) == 0
    recording = load_recording(tmp_path / "run")
    series, n = recording.series, len(periods)
    # the agent that stands has no gait
    assert set(series) == {c.name for c in DEPLOYMENT_CHANNELS} - {"dcm_ref", "zmp_ref"}
    assert {len(values) for values in series.values()} == {n}
    assert [recording.config["stages"][i] for i in series["stage"]] == [stage.value for stage, _ in periods]
    hung = np.array([ticked for _, ticked in periods])
    assert np.isfinite(series["v_safe"][hung]).all() and np.isnan(series["v_safe"][~hung]).all()
    after = np.flatnonzero(hung)[0]
    assert np.isfinite(series["q_estimated"][after:]).all() and np.isnan(series["q_estimated"][: after - 1]).all()
    assert series["h_estimated"].shape == (n, len(GUARANTEED))
    # what was measured is what the robot in memory says
    assert (series["torque"] == 0.5).all()
    np.testing.assert_allclose(np.linalg.norm(series["accelerometer"], axis=1), 9.81, atol=0.01)
    summary = recording.summary
    assert summary["cause"] == "stop" and summary["periods"] == n and summary["different"] == 0
    assert summary["controlled_s"] == 0.0 and summary["bridged"] == 0
    assert {metric.key for metric in DEPLOYMENT} >= {k for k in summary if k not in KEPT_FOR_THE_FILE}
    page = Page((tmp_path / "run" / "report.html").read_text(encoding="utf-8"))
    assert page.headings == [
        "Figures", "Base", "Feet", "Torques", "Deadlines", "Distances, estimated", "Filter and balance",
        "Motors and battery",
    ]  # fmt: skip
    assert all(reference.startswith("data:") for reference in page.references)


KEPT_FOR_THE_FILE = ("events", "began_monotonic_s", "versions")


def test_what_is_not_declared_is_refused() -> None:
    require_declared({"time", "stage"})
    with pytest.raises(ConfigError, match="true_q"):
        require_declared({"time", "true_q"})


def test_what_is_no_deployment_is_refused(tmp_path: Path) -> None:
    (tmp_path / "log.bin").write_bytes(b"something else")
    for path in (tmp_path, tmp_path / "log.bin", tmp_path / "nothing"):
        with pytest.raises(ConfigError, match="log of a deployment"):
            read_deployment(path)
    for options in ({"report": True}, {"mcap": tmp_path / "a.mcap"}):
        with pytest.raises(WithoutEffectError):
            replay(ReplayOptions(tmp_path, **options))
    with pytest.raises(SafeWbcError, match="torque"):
        read_task({"torque": 1.0})
    with pytest.raises(SafeWbcError, match="no-such"):
        read_task({"scenario": "no-such"})
