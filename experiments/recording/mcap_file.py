"""A deployment's log as an MCAP file, for viewers of robots' recordings: the bytes of the wire, with their schemas.

States and commands are CDR on the wire already, little-endian with the header before it, so each message is what came
in or was computed, to the last byte. The format: https://mcap.dev.
"""

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from controllers.deployment.ring import Kind, Record
from controllers.deployment.stages import Stage
from experiments.recording.plain import plain
from experiments.recording.ros_schemas import LOW_CMD, LOW_STATE
from robots.errors import ConfigError, SafeWbcError
from robots.unitree.messages import StateMessage

STATES, COMMANDS, EVENTS, STAGES = "rt/lowstate", "rt/lowcmd", "safewbc/events", "safewbc/stage"
"""Topics: as on the robot's network, and two of our own."""

TIMES = "monotonic clock of the machine that wrote the log"
COMPUTED = "every command as it was computed; where one was late, the one before went out again; none in a dry run"
"""What has to be said of the file beside its messages."""


@dataclass(frozen=True, slots=True)
class Written:
    """What a file holds.

    Attributes:
        messages: number of messages by topic.
        broken: number of states left out, whose length or check sum was wrong.
    """

    messages: Mapping[str, int]
    broken: int


def write_mcap(records: Iterable[Record], head: Mapping[str, Any], path: Path) -> Written:
    """Write the file, whole or not at all.

    Args:
        records: of a deployment, in their order.
        head: what the log's first page says; goes into the file's metadata.
        path: of the file, which must not exist.

    Raises:
        SafeWbcError: mcap is not installed.
        ConfigError: the file exists, or cannot be written.
    """
    try:
        from mcap.writer import Writer
    except ImportError as error:
        raise SafeWbcError("mcap is not installed: pip install 'safewbc[mcap]'") from error
    if path.exists():
        raise ConfigError("mcap", str(path), "a file that does not exist yet")
    staged = path.with_name(f"{path.name}.new")
    try:
        with staged.open("wb") as file:
            writer = Writer(file)
            writer.start(library="safewbc")
            about = {"times": TIMES, COMMANDS: COMPUTED, "log": json.dumps(plain(head))}
            writer.add_metadata("safewbc", about)
            written = _Messages(writer).write(records)
            writer.finish()
        staged.replace(path)
    except OSError as error:
        raise ConfigError("mcap", str(path), f"a file that can be written ({error.strerror or error})") from error
    finally:
        staged.unlink(missing_ok=True)
    return written


class _Messages:
    """Registers the topics, and writes messages to them."""

    def __init__(self, writer: Any) -> None:
        self._writer = writer
        self._channels: dict[str, int] = {}
        for topic, name, schema in ((STATES, "LowState", LOW_STATE), (COMMANDS, "LowCmd", LOW_CMD)):
            number = writer.register_schema(f"unitree_hg/msg/{name}", "ros2msg", schema.encode())
            self._channels[topic] = writer.register_channel(topic, "cdr", number)
        for topic, field in ((EVENTS, "text"), (STAGES, "stage")):
            number = writer.register_schema(f"safewbc.{field}", "jsonschema", _schema(field))
            self._channels[topic] = writer.register_channel(topic, "json", number)

    def write(self, records: Iterable[Record]) -> Written:
        counts, broken = dict.fromkeys(self._channels, 0), 0
        state = StateMessage()
        for record in records:
            if record.kind is Kind.STATE and not (len(record.data) == state.size and state.read(record.data)):
                broken += 1
                continue
            for topic, data in _messages_of(record):
                counts[topic] += 1
                stamp = round(1e9 * record.time)
                self._writer.add_message(self._channels[topic], stamp, data, stamp, counts[topic])
        return Written(counts, broken)


def _messages_of(record: Record) -> Iterator[tuple[str, bytes]]:
    """Topic and bytes of every message that a record comes to."""
    if record.kind is Kind.STATE:
        yield STATES, record.data
    elif record.kind is Kind.COMMAND:
        yield COMMANDS, record.data
    elif record.kind is Kind.EVENT:
        text = record.data.decode("utf-8", "replace")
        yield EVENTS, json.dumps({"text": text}).encode()
        # a stage says its name when it begins, and its cause behind it
        name = text.partition(":")[0]
        if name in {stage.value for stage in Stage}:
            yield STAGES, json.dumps({"stage": name}).encode()


def _schema(field: str) -> bytes:
    """JSON schema of a message of one text."""
    return json.dumps({"type": "object", "properties": {field: {"type": "string"}}, "required": [field]}).encode()
