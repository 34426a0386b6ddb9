"""A deployment's log as an MCAP file, read back by the format's own reader and decoded by hand."""

import json
import re
import struct
import sys
from pathlib import Path

import pytest
from mcap.reader import make_reader

from controllers.deployment.ring import Kind, Record, read_head, read_log
from controllers.deployment.stages import Stage
from experiments.cli.replay import replay
from experiments.recording.mcap_file import write_mcap
from experiments.recording.ros_schemas import LOW_CMD, LOW_STATE
from experiments.scenarios.options import ReplayOptions
from experiments.scenarios.stand import Stand
from robots.errors import ConfigError, SafeWbcError
from robots.unitree.layout import COMMAND_SIZE, STATE_SIZE
from robots.unitree.messages import StateMessage
from tests.support.deployments import deployed

SIZES = {"uint8": 1, "int16": 2, "uint32": 4, "float32": 4}
FIELD = re.compile(r"(\S+?)(?:\[(\d+)\])? (\w+)")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return deployed(tmp_path_factory.mktemp("mcap") / "a", Stand(), Stage.POSTURE)


def fields(schema: str) -> dict[str, list[tuple[str, int, str]]]:
    """Fields of every type of a definition: type, number, name; the whole one has no name."""
    out: dict[str, list[tuple[str, int, str]]] = {}
    for part in re.split(r"^=+\nMSG: ", "\n" + schema, flags=re.MULTILINE):
        name, _, text = part.partition("\n")
        lines = [line for line in text.splitlines() if line and not line.startswith("#")]
        found = [FIELD.fullmatch(line) for line in lines]
        out[name] = [(m[1], int(m[2] or 1), m[3]) for m in found if m is not None]
        assert len(out[name]) == len(lines)
    return out


def places(schema: str) -> tuple[dict[str, int], int]:
    """Where CDR has every field, and the whole size: each number aligned to its own size."""
    types, out, place = fields(schema), {}, 0

    def walk(name: str, prefix: str) -> None:
        nonlocal place
        for kind, count, field in types[name]:
            for i in range(count):
                path = f"{prefix}{field}" + (f"[{i}]" if count > 1 else "")
                if kind in SIZES:
                    place = -(-place // SIZES[kind]) * SIZES[kind]
                    out[path] = place
                    place += SIZES[kind]
                else:
                    walk(kind, f"{path}.")

    walk("", "")
    return out, place


def test_the_schemas_come_to_the_bytes_on_the_wire() -> None:
    state, size = places(LOW_STATE)
    assert size == STATE_SIZE and state["tick"] == 12 and state["motor_state[0].q"] == 72
    assert state["wireless_remote[0]"] == 2028 and state["crc"] == STATE_SIZE - 4
    command, size = places(LOW_CMD)
    assert size == COMMAND_SIZE and command["motor_cmd[0].mode"] == 2 and command["motor_cmd[1].q"] == 32


def test_what_is_read_back_is_what_was_logged(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert replay(ReplayOptions(log, mcap=tmp_path / "a.mcap")) == 0
    records, told = read_log(log), capsys.readouterr().out
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file)
        found = list(reader.iter_messages(log_time_order=False))
        about = next(iter(reader.iter_metadata())).metadata
    assert json.loads(about["log"]) == read_head(log)
    by_topic: dict[str, list[tuple[int, bytes]]] = {}
    for schema, channel, message in found:
        assert schema is not None and message.log_time == message.publish_time
        expected = {"rt/lowstate": ("unitree_hg/msg/LowState", "ros2msg", "cdr"),
                    "rt/lowcmd": ("unitree_hg/msg/LowCmd", "ros2msg", "cdr")}  # fmt: skip
        if channel.topic in expected:
            assert (schema.name, schema.encoding, channel.message_encoding) == expected[channel.topic]
        else:
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
        by_topic.setdefault(channel.topic, []).append((message.log_time, message.data))
    for topic, kind in (("rt/lowstate", Kind.STATE), ("rt/lowcmd", Kind.COMMAND)):
        logged = [(round(1e9 * r.time), r.data) for r in records if r.kind is kind]
        assert by_topic[topic] == logged
        assert f"{len(logged)} on {topic}" in told
    events = [json.loads(data)["text"] for _, data in by_topic["safewbc/events"]]
    assert events == [r.data.decode() for r in records if r.kind is Kind.EVENT]
    stages = [json.loads(data)["stage"] for _, data in by_topic["safewbc/stage"]]
    assert stages == ["zero torque", "damping", "posture while hung", "latched damping"]


def test_numbers_are_where_a_decoder_of_cdr_looks_for_them(log: Path, tmp_path: Path) -> None:
    records = read_log(log)
    write_mcap(records, {}, tmp_path / "a.mcap")
    state, _ = places(LOW_STATE)
    with (tmp_path / "a.mcap").open("rb") as file:
        datas = [m.data for _, c, m in make_reader(file).iter_messages(topics=["rt/lowstate"])]
    ticks = [struct.unpack_from("<I", data, 4 + state["tick"])[0] for data in datas]
    assert ticks == list(range(2, 2 * len(datas) + 1, 2))
    for data in datas[::500]:
        assert data[:4] == b"\x00\x01\x00\x00"
        taus = [struct.unpack_from("<f", data, 4 + state[f"motor_state[{i}].tau_est"])[0] for i in range(35)]
        assert taus == [0.5] * 29 + [0.0] * 6
        up = struct.unpack_from("<f", data, 4 + state["imu_state.accelerometer[2]"])[0]
        assert up == pytest.approx(9.81, abs=0.01)


def test_broken_states_are_left_out_and_counted(log: Path, tmp_path: Path) -> None:
    records = [r for r in read_log(log) if r.kind is Kind.STATE][:20]
    flipped = records[3].data[:200] + bytes([records[3].data[200] ^ 1]) + records[3].data[201:]
    records[3] = Record(records[3].number, records[3].time, Kind.STATE, flipped)
    records[7] = Record(records[7].number, records[7].time, Kind.STATE, records[7].data[:-1])
    written = write_mcap(records, {}, tmp_path / "a.mcap")
    assert written.broken == 2 and written.messages["rt/lowstate"] == 18
    with (tmp_path / "a.mcap").open("rb") as file:
        message = StateMessage()
        assert all(message.read(m.data) for _, _, m in make_reader(file).iter_messages())


def test_a_file_that_is_there_stays_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_text("mine")
    with pytest.raises(ConfigError, match="does not exist yet"):
        write_mcap([], {}, tmp_path / "a.mcap")
    with pytest.raises(ConfigError, match="can be written"):
        write_mcap([], {}, tmp_path / "none" / "a.mcap")
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap"]


def test_without_mcap_it_is_said_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    with pytest.raises(SafeWbcError, match=r"pip install 'safewbc\[mcap\]'"):
        write_mcap([], {}, tmp_path / "a.mcap")
