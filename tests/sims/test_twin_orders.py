"""Orders and scripts: what they may be, and that what they may not be is refused with its name and its value."""

from pathlib import Path

import pytest

from robots.errors import ConfigError
from sims.twin.faults import FAULTS, FOREVER, Fault, read_fault, usage
from sims.twin.orders import load_script, read_order, read_script


@pytest.mark.parametrize(
    ("line", "values"),
    [
        ("state-stop", (FOREVER,)),
        ("state-stop 0.2", (0.2,)),
        ("state-lost", (1,)),
        ("state-lost 3", (3,)),
        ("state-late", (50.0,)),
        ("state-repeated 4", (4,)),
        ("state-swapped", ()),
        ("state-crc 10", (10,)),
        ("state-nan", (1, "left_knee")),
        ("state-nan 5 waist_yaw", (5, "waist_yaw")),
        ("encoder right_elbow_joint -1", ("right_elbow", -1.0)),
        ("hot left_knee 95", ("left_knee", 95.0)),
        ("motor-error left_knee 0x200", ("left_knee", 512)),
        ("battery 15", (15,)),
        ("foreign-writer 0.5", (0.5,)),
        ("waist-locked", ()),
        ("imu-stuck", ()),
        ("gyro-step 0.05", (0.05,)),
        ("network 4 2", (4.0, 2.0, 0.0)),
        ("network 4 2 5", (4.0, 2.0, 5.0)),
        ("torque-constant 0.9", (0.9,)),
        ("push 60 0 -10 0.2", (60.0, 0.0, -10.0, 0.2)),
        ("remote L2 B", ("L2", "B")),
        ("stick 0.5 0 -1", (0.5, 0.0, -1.0)),
        ("remote-lost", ()),
        ("switcher-refuses", ()),
    ],
)
def test_a_fault_by_its_name(line: str, values: tuple[object, ...]) -> None:
    for text in (line, f"fault   {line} "):
        order = read_order(text)
        assert order.verb == "fault" and order.text == " ".join(text.split())
        assert order.fault == Fault(line.split(maxsplit=1)[0], values)


def test_every_fault_is_read_by_one_of_these_lines_and_has_a_usage() -> None:
    assert usage("state-nan") == "[COUNT] [JOINT]"
    assert usage("remote") == "BUTTON..."
    assert usage("push") == "FX FY FZ SECONDS"
    assert all(usage(name) or not arguments for name, arguments in FAULTS.items())


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("jump", ["order", "'jump'", "lower, raise", "state-stop"]),
        ("", ["order", "''"]),
        ("fault", ["fault", "''", "state-stop"]),
        ("fault lower", ["fault", "'lower'", "state-stop"]),
        ("lower 3", ["lower", "'3'", "nothing more"]),
        ("clear knee", ["fault", "'knee'", "state-stop"]),
        ("state-stop -1", ["state-stop seconds", "'-1'", "from 0"]),
        ("state-stop soon", ["state-stop seconds", "'soon'", "a number"]),
        ("state-lost 1.5", ["state-lost count", "'1.5'", "whole number from 1"]),
        ("state-lost 0", ["state-lost count", "'0'", "from 1"]),
        ("state-swapped 2", ["state-swapped", "'2'", "nothing"]),
        ("encoder left_knee", ["encoder", "'left_knee'", "JOINT TURNS"]),
        ("encoder tail 1", ["encoder joint", "'tail'", "left_knee"]),
        ("encoder left_knee nan", ["encoder turns", "'nan'", "-10 to 10"]),
        ("motor-error left_knee 0x100000000", ["motor-error bits", "whole number"]),
        ("battery 101", ["battery percent", "'101'", "0 to 100"]),
        ("network 4", ["network", "'4'", "DELAY_MS JITTER_MS [LOSS_PERCENT]"]),
        ("push 1 2 3", ["push", "'1 2 3'", "FX FY FZ SECONDS"]),
        ("remote", ["remote", "''", "BUTTON..."]),
        ("remote L2 Z", ["remote button", "'Z'", "L2"]),
        ("stick 2 0 0", ["stick lx", "'2'", "-1 to 1"]),
    ],
)
def test_what_is_not_allowed_is_named(line: str, told: list[str]) -> None:
    with pytest.raises(ConfigError) as caught:
        read_order(line)
    for part in told:
        assert part in str(caught.value)


def test_other_orders() -> None:
    for verb in ("lower", "raise", "status", "end", "clear"):
        assert read_order(verb).verb == verb
    assert read_order("clear battery").cleared == "battery" and read_order("clear").cleared is None
    assert read_fault(["waist-locked"]) == Fault("waist-locked")


def test_a_script_is_sorted_by_time_and_may_have_comments(tmp_path: Path) -> None:
    path = tmp_path / "script.txt"
    path.write_text("# first\n\n2.5 raise\n1 lower  # down\n2.5 fault battery 10\n")
    assert [(t, order.text) for t, order in load_script(path)] == [
        (1.0, "lower"),
        (2.5, "raise"),
        (2.5, "fault battery 10"),
    ]


@pytest.mark.parametrize(
    ("lines", "told"),
    [
        (["1 lower", "raise"], ["line 2", "'raise'", "a time"]),
        (["-1 lower"], ["line 1", "'-1'"]),
        (["inf lower"], ["line 1", "'inf'"]),
        (["1 lower", "", "2 battery 300"], ["line 3: battery percent", "'300'", "0 to 100"]),
        (["2"], ["line 1: order", "''"]),
    ],
)
def test_a_script_with_a_wrong_line_is_refused_as_a_whole(lines: list[str], told: list[str]) -> None:
    with pytest.raises(ConfigError) as caught:
        read_script(lines)
    for part in told:
        assert part in str(caught.value)


def test_a_script_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.txt"):
        load_script(tmp_path / "none.txt")
